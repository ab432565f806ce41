"""Messages: decodes what a browser has sent as a JSON object, or as an empty one. Pure."""

from __future__ import annotations

import json
from typing import Any


def read(data: str | bytes) -> dict[str, Any]:
    """The object that was sent; an empty one for anything else, even if it is nested too deeply."""
    try:
        found = json.loads(data or b"{}")
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def whole(value: object, most: int) -> int | None:
    """The value as a whole number from 1 to `most`; None if it is not one."""
    return value if isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= most else None
