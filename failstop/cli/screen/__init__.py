"""Screens: a state in, lines of text out. Only terminal.py touches a terminal, only follow.py a service."""
