"""Messages: decodes the JSON that a browser sends. Pure."""

from __future__ import annotations

import json
from typing import Any


def read(data: str | bytes) -> dict[str, Any]:
    """Return the JSON object that was sent, or an empty object for anything else, such as damaged JSON."""
    try:
        found = json.loads(data or b"{}")
    except (ValueError, RecursionError):
        return {}
    return found if isinstance(found, dict) else {}


def whole(value: object, most: int) -> int | None:
    """Return the value if it is a whole number from 1 to `most`, else None."""
    return value if isinstance(value, int) and not isinstance(value, bool) and 1 <= value <= most else None
