"""A simulated machine: one Python process in which the whole service runs, under a clock of its own (docs/dev/simulation.md)."""
