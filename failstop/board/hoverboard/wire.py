"""The hoverboard's wire: a stop stands alone between idle gaps, and each writer repeats it at its own times.

Whenever the line falls idle, the receiver looks at what came since its last look, and takes exactly eight bytes: two
frames without a gap are dropped together. It also looks at the end of each of its own feedback frames, every 10.1 ms,
and drops a half-received frame then, so a lone stop is lost in 6.1 % of cases. So each writer repeats, at its own
times. Whichever of two writers begins, and however much later the other one, at most one pair of their early writes
touches besides the first, and one more is lost to the feedback. The stop of one or two writers is accepted within 12
ms, that of three within 40 ms (tests/board/test_stop_of_every_board.py). The port owner mostly writes alone: its second
write comes so late that a host which holds the first back for a few ms does not send both at once. If a host is held up
again and again, repeats reach the board in pairs and are lost, which is why some come as late as 53 to 116 ms.

An adapter that stalls sends everything it kept at once, and the board drops all of it. So the repeats go on until 100
ms after the longest stall (0.3 s) that every board is tested with, at times at which no two writers touch and no two
repeats of one writer fall on the same place in the feedback.
"""

from __future__ import annotations

from failstop.board.hoverboard import codec
from failstop.board.hoverboard.feedback import Feedback
from failstop.board.wire import (
    COAST,
    ECHOED,
    OBSERVED,
    Commander,
    Motion,
    Pace,
    Port,
    Reports,
    TimedStop,
    Watchdog,
    Wire,
    Write,
)

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Mapping

    from failstop.board.driver import DriverLanguage

IDLE_NS = 200_000
"""A little more than the time of two bytes: the receiver sees an idle line after one."""
_MS = 1_000_000


def _driver(settings: Mapping[str, float | str]) -> DriverLanguage:
    from failstop.board.hoverboard import driver  # for the guard port alone

    return driver.language(settings)


WIRE = Wire(
    name="a hoverboard with hoverboard-firmware-hack-FOC",
    port=Port(baud=115_200, dtr=False, rts=False, deaf_ns=0, opening=()),
    stop=TimedStop(
        writes=(Write(IDLE_NS, codec.STOP),),
        after_ns=IDLE_NS,
        repeats_ns=tuple(
            tuple(int(at * _MS) for at in row)
            for row in (
                (0, 5.4, 10.6, 25, 61, 116, 162, 207, 252, 307, 352, 397),
                (0, 1.8, 10.6, 28, 53, 98, 143, 188, 233, 279, 334, 379),
                (0, 3.6, 7.2, 19.5, 64, 107, 152, 197, 242, 288, 343, 388),
            )
        ),
    ),
    pace=Pace(idle_ns=IDLE_NS, unanswered=None),
    watchdog=Watchdog(
        after_ns=805 * _MS,
        does=COAST,
        arm=None,
        set_ns=0,
        fed_by="every accepted frame feeds it; frames without a gap between them do not; the next frame drives again",
    ),
    motion=Motion(
        wheels=2,
        unit=codec.UNIT,
        limit=codec.LIMIT,
        per_rps=lambda _diameter_m: 60.0,
        step=1.0,
        apart=codec.APART,
        frame=codec.motion,
        rest=codec.STOP,
        check=codec.check_motion,
        speeds=codec.speeds,
        marked=codec.marked,
    ),
    questions=(),
    reader=Feedback,
    proofs=(ECHOED, OBSERVED),
    ping_ns=0,
    # Two of its feedbacks, the stop's transmission, one of its loops, and an adapter that holds bytes back for 16 ms.
    echo_ns=50 * _MS,
    # Always rpm, whatever the commands mean; in its usual mode they are a voltage.
    reports=Reports(
        every_ns=20 * _MS,
        speed_per_rps=lambda _per_rps, _diameter_m: 60.0,
        position_per_turn=None,
        wraps=0.0,
        holds_speed=False,
        own_scale=True,
    ),
    # A busy computer explains any shorter pause. A short restart shows in its echo.
    silent_ns=600 * _MS,
    commanders=(
        Commander(
            who="its second cable: a side board or a receiver there drives it too, in firmware built with DUAL_INPUTS",
            remedy="pull that cable, or build the firmware without DUAL_INPUTS (Inc/config.h)",
        ),
    ),
    driver=_driver,
)
