"""The subcommands of `failstop`. Each module has add_arguments(parser), and main(arguments), which returns the exit
code."""

from __future__ import annotations

from argparse import ArgumentParser, ArgumentTypeError
from math import inf


def add_name(parser: ArgumentParser) -> None:
    """Add the option --name, which selects the service."""
    parser.add_argument("--name", default="failstop", help="the service's name (default: failstop)")


def seconds(text: str) -> float:
    """Convert the value of an option to seconds. Raises ArgumentTypeError if it is not a number above 0."""
    try:
        found = float(text)
    except ValueError:
        found = inf
    if not 0 < found < inf:
        raise ArgumentTypeError(f"{text} is no time in seconds: give a number above 0, such as 2")
    return found
