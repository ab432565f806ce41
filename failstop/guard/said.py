"""Said: the words with which the guard reports about itself on the service's screens, and by which doctor finds it."""

from __future__ import annotations

from failstop.api.words import GUARDED

GUARD = "failstop guard"
"""The guard's name while no driver has the port open."""
DRIVES = GUARDED
WAITS = "no driver has opened the guard port "
REFUSED = "failstop refused "


def path_in(sees: str) -> str:
    """The path of the guard port in a client's report; empty if that client is not a guard."""
    for words in (DRIVES, WAITS):
        if sees.startswith(words):
            return sees.removeprefix(words)
    return ""
