"""A part of the suite on a machine where failstop is installed, runs, and has run before."""
