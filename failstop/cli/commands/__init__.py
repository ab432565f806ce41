"""The subcommands of `failstop`: each module has add_arguments(parser) and main(arguments) -> exit code."""

from __future__ import annotations

from argparse import ArgumentParser


def add_name(parser: ArgumentParser) -> None:
    """The option that chooses the instance."""
    parser.add_argument("--name", default="failstop", help="the service's name (default: failstop)")
