"""The measurements behind docs/measured.md: `make bench`, or `python -m bench --help`."""
