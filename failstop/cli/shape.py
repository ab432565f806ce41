"""Shape: how `--help` looks - descriptions filled to the width of the terminal, examples as they are written."""

from __future__ import annotations

import argparse

EXAMPLES = "examples:\n"
"""An epilog that begins so is not filled."""


class Shape(argparse.HelpFormatter):
    """Formatter for the parsers of cli.py."""

    def _fill_text(self, text: str, width: int, indent: str) -> str:
        if text.startswith(EXAMPLES):
            return "".join(indent + line for line in text.splitlines(keepends=True))
        return super()._fill_text(text, width, indent)
