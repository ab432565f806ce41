"""Faults: what can go wrong as one table, how to make it happen, and the judge on the board's side of the wire."""
