"""Said: the words in the guard's reports about itself. They appear on the service's screens, and doctor recognises the
guard by them."""

from __future__ import annotations

from failstop.api.words import GUARDED

GUARD = "failstop guard"
"""The guard's name while no driver has the port open."""
DRIVES = GUARDED
WAITS = "no driver has opened the guard port "
REFUSED = "failstop refused "


def path_in(sees: str) -> str:
    """The path of the guard port in a client's report. Empty if the client is not a guard."""
    for words in (DRIVES, WAITS):
        if sees.startswith(words):
            return sees.removeprefix(words)
    return ""
