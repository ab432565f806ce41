"""The measurements behind docs/dev/measured.md: `make bench`, or `python -m bench --help`."""


class BenchError(Exception):
    """What keeps a measurement from being made; one line, with the remedy."""
