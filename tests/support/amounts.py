"""Amounts of what is tried: little in `make test`, and much in `make campaigns`."""

from __future__ import annotations

import os

LONG = os.environ.get("FAILSTOP_CAMPAIGN") == "long"


def amount(little: int, much: int) -> int:
    return much if LONG else little
