"""The Wire that describes a hoverboard. The line must be silent before and after a stop, and each writer repeats its
stop at times of its own.

The board looks at the bytes that it has received whenever the line falls idle. It accepts exactly eight bytes, and
drops any other number. So two frames without a gap between them are both dropped. The board also looks whenever it has
sent a feedback frame, which is every 10.1 ms. If only a part of a frame has come by then, the frame is lost. In this
way, 6.1 % of single stops are lost.

So each writer repeats its stop, at times of its own. The stops of two writers then rarely touch, whatever the delay
between their first stops. If the first stops touch, at most one pair of the early repeats touches too. The feedback
makes the board lose at most one more stop. With one or two writers the board accepts a stop within 12 ms, and with
three writers within 40 ms (tests/board/test_stop_of_every_board.py).

Usually only the port owner writes. Its second stop comes 5.4 ms after the first one, so the two stops don't touch even
if the computer sends the first one a few ms late. Many late stops may reach the board in pairs and be lost. So a few
repeats come as late as 53 to 116 ms after the first stop.

After a stall, an adapter sends everything that it has kept at once, and the board drops all of it. Every board is
tested with stalls of up to 0.3 s, so the repeats go on for about 0.4 s. The late repeats of two writers never touch. If
feedback makes the board lose one late repeat, the next one of the same writer comes at another place in a feedback
frame.
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
"""How long the line must be silent before and after a stop, in ns. This is a little longer than two bytes take. The
receiver considers the line idle after the time of one byte."""
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
    # The time of two feedback frames, the stop's own transmission, one loop of the firmware, and 16 ms for which an
    # adapter may hold bytes back.
    echo_ns=50 * _MS,
    # The reports are always in rpm. The commands are a voltage in the board's usual mode.
    reports=Reports(
        every_ns=20 * _MS,
        speed_per_rps=lambda _per_rps, _diameter_m: 60.0,
        position_per_turn=None,
        wraps=0.0,
        holds_speed=False,
        own_scale=True,
    ),
    # A busy computer can cause any shorter pause. The echo reveals a shorter restart.
    silent_ns=600 * _MS,
    commanders=(
        Commander(
            who="its second cable: a side board or a receiver there drives it too, in firmware built with DUAL_INPUTS",
            remedy="pull that cable, or build the firmware without DUAL_INPUTS (Inc/config.h)",
        ),
    ),
    driver=_driver,
)
