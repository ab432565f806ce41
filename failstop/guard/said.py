"""Said: the words by which the guard tells the service's screens about itself, and by which doctor finds it."""

from __future__ import annotations

GUARD = "failstop guard"
"""Its name while no driver has the port open."""
DRIVES = "uses the guard port "
WAITS = "no driver has opened the guard port "
REFUSED = "failstop refused "


def path_in(sees: str) -> str:
    """The port's path in a client's words; empty: it is no guard's."""
    for words in (DRIVES, WAITS):
        if sees.startswith(words):
            return sees.removeprefix(words)
    return ""
