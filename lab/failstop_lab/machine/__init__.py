"""A simulated machine, on which the whole service runs in one process (lab/failstop_lab/simulate/README.md)."""
