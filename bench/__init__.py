"""The measurements behind docs/reference/measured.md: `make bench`, or `python -m bench --help`."""


class BenchError(Exception):
    """The obstacle to a measurement; one line, with the remedy."""
