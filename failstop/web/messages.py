"""Messages: what a browser has sent, taken for an object or for nothing. Pure."""

from __future__ import annotations

import json
from typing import Any


def read(data: str | bytes) -> dict[str, Any]:
    """The object that was sent; an empty one for anything else, however deeply it is nested."""
    try:
        found = json.loads(data or b"{}")
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def whole(value: object, most: int) -> int | None:
    """A number of 1 to `most`; None for anything else."""
    return value if isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= most else None
