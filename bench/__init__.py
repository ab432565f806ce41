"""The measurements behind the README's table: `make bench`, or `python -m bench --help`."""
