"""Progress: shows the progress of a request in one line on the terminal, and removes the line at the end. If the output
is not a terminal, this prints nothing."""

from __future__ import annotations

import os
import sys

from failstop.cli import style


class Progress:
    """Shows the progress of a request. It is a context manager. Call it with each text about the progress."""

    def __init__(self) -> None:
        self._live = style.lives(os.environ, terminal=sys.stdout.isatty())
        self._shown = 0
        """How many columns of the terminal's line are in use."""

    def __enter__(self) -> Progress:
        return self

    def __exit__(self, *_: object) -> None:
        if self._shown:
            self("")
            sys.stdout.write("\r")

    def __call__(self, text: str) -> None:
        if self._live:
            text = style.cut(text, style.width() - 1)
            sys.stdout.write(f"\r{text}{' ' * (self._shown - style.cells(text))}")
            sys.stdout.flush()
            self._shown = style.cells(text)
