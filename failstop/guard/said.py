"""Said: the words that the guard uses in its reports about itself. The service's screens show these reports, and
`failstop doctor` recognizes the guard by these words."""

from __future__ import annotations

from failstop.api.words import GUARDED

GUARD = "failstop guard"
"""The guard's name while no driver has the port open."""
DRIVES = GUARDED
WAITS = "no driver has opened the guard port "
REFUSED = "failstop refused "
WITHHELD = "it was driving when failstop was restarted, so it must send zero or pause before it can drive"


def path_in(sees: str) -> str:
    """Return the path of the guard port from a client's report `sees`. Empty if the client is not a guard."""
    for words in (DRIVES, WAITS):
        if sees.startswith(words):
            return sees.removeprefix(words)
    return ""
