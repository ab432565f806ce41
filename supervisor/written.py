"""Answer: who wrote the stop that a cause asked for, and when. Pure.

| the cause came with the time of its stop | the port owner has answered the epoch    | the stop is            |
|------------------------------------------|------------------------------------------|------------------------|
| any                                      | not yet, and it still may                | waited for             |
| yes                                      | any                                      | that of who noticed it |
| no                                       | no: it is dead, or late                  | still to be written    |
| no                                       | yes; the cause is its own                | still to be written    |
| no                                       | yes, with a stop about as old or younger | that of the port owner |
| no                                       | yes, with a stop from long before        | still to be written    |

Who publishes a cause of its own without a time could not write. What is still to be written, the supervisor writes.
"""

from __future__ import annotations

from failstop.shm import layout

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.supervisor.stops import Stop

SOONER_NS = 20_000_000
"""The port owner may have noticed the cause this much sooner; its burst from before that is none for this cause."""
BY_PORT_OWNER = "port owner"
BY_SUPERVISOR = "supervisor"


def who_wrote(stop: Stop, *, answered: bool, may_answer: bool, port_owner_ns: int) -> tuple[str, int] | None:
    """Return (by whom, when in ns; 0: the supervisor is to write it now), or None to wait. `answered`: the port owner
    has; `may_answer`: it lives and has had little time; `port_owner_ns`: its last burst."""
    if may_answer and not answered:
        return None
    own = stop.noticed_by == layout.PORT_OWNER
    if stop.written_ns:
        return (BY_PORT_OWNER if own else BY_SUPERVISOR), stop.written_ns
    if answered and not own and port_owner_ns >= stop.t_ns - SOONER_NS:
        return BY_PORT_OWNER, port_owner_ns
    return BY_SUPERVISOR, 0
