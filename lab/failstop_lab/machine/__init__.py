"""A simulated machine, on which the whole service runs in one process (docs/dev/simulation.md)."""
