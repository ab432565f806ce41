"""The Wire that describes ros_arduino_bridge. failstop limits how many lines may be unanswered, because the board can
hold only a few answers.

The board answers a stop with 21 bytes, three times the length of the stop. It answers the question for positions with
25 bytes. While 63 bytes of answers wait to be sent, the firmware reads no lines. Its receive buffer also holds 63
bytes. While that buffer is full, the bytes that arrive are lost. The lost bytes could be a stop, or the sign and the
space between two numbers. If at most two lines wait for an answer, nothing is lost, even if 15 stops arrive without a
gap (tests/board/test_stop_of_every_board.py). Three writers together repeat no more than 15 stops.

The USB identities are those of Arduino's own Uno and Mega (boards.txt of the core for AVR). A clone has the identity of
its adapter chip, so clones are not listed.
"""

from __future__ import annotations

from failstop.board.arduino import codec
from failstop.board.wire import (
    ANSWERED,
    OBSERVED,
    ZERO,
    Commander,
    Motion,
    Pace,
    Port,
    Question,
    Reports,
    TimedStop,
    Watchdog,
    Wheels,
    Wire,
    Write,
    answer_is,
)

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Mapping

    from failstop.board.driver import DriverLanguage

_MS = 1_000_000


def _driver(settings: Mapping[str, float | str]) -> DriverLanguage:
    from failstop.board.arduino import driver  # for the guard port alone

    return driver.language(settings)


WIRE = Wire(
    name="an Arduino with ros_arduino_bridge",
    # Opening the port raises DTR, which resets the board. Its bootloader then waits 1.4 s for a program.
    port=Port(baud=codec.USUAL_BAUD, dtr=True, rts=True, deaf_ns=2000 * _MS, opening=(codec.STOP,)),
    stop=TimedStop(
        writes=(Write(0, codec.STOP),),
        after_ns=0,
        repeats_ns=tuple(tuple(at * _MS for at in row) for row in ((0, 23, 103), (0, 31, 113), (0, 41, 127))),
    ),
    # An answer of 25 bytes takes this long on the line. So nothing is unanswered by then, unless the board is held up.
    pace=Pace(idle_ns=4_400_000, unanswered=2),
    watchdog=Watchdog(
        after_ns=2000 * _MS,
        does=ZERO,
        arm=None,
        set_ns=0,
        fed_by="every motion line feeds it, a question does not; a firmware without USE_BASE has none, and no motors",
    ),
    motion=Motion(
        wheels=2,
        unit=codec.UNIT,
        limit=codec.LIMIT,
        per_rps=lambda _diameter_m: codec.COUNTS / codec.PERIODS,
        step=1.0,
        apart=2 * codec.LIMIT,
        frame=codec.MOTION.frame,
        rest=codec.REST,
        check=codec.MOTION.check,
        speeds=codec.MOTION.speeds,
    ),
    questions=(
        Question("baud rate", codec.BAUD_RATE, answer_is(*map(str, codec.BAUDS))),
        Question("positions", codec.POSITIONS, lambda sample: isinstance(sample, Wheels)),
    ),
    reader=codec.answers,
    proofs=(ANSWERED, OBSERVED),
    # Positions are asked for ten times a second, which is enough for navigation.
    ping_ns=50 * _MS,
    echo_ns=0,
    # Every other question asks for positions. They are 32-bit counters (`volatile long`, joshnewans 210a122,
    # encoder_driver.ino). The same number converts positions and speeds to turns.
    reports=Reports(
        every_ns=300 * _MS,
        speed_per_rps=None,
        position_per_turn=lambda per_rps, _diameter_m: per_rps * codec.PERIODS,
        wraps=2.0**32,
        holds_speed=True,
        own_scale=False,
        position_step=1.0,
    ),
    # As long as seven answers take, because a busy computer may lose a few in a row. The counters reveal a shorter
    # restart.
    silent_ns=700 * _MS,
    # The sketch of ros_arduino_bridge has 57600. About half of the robots that publish their files have changed it.
    other_bauds=(115_200,),
    usb=(
        *("2341:0043", "2341:0001", "2a03:0043", "2341:0243"),  # Uno
        *("2341:0010", "2341:0042", "2a03:0010", "2a03:0042", "2341:0210", "2341:0242"),  # Mega
    ),
    commanders=(
        Commander(
            who="ros_arduino_bridge's own node writes to the board, and failstop checks nothing that it writes",
            remedy="remove it from the launch file, or let it open the guard port (docs/guard.md)",
            program="ros_arduino_python/nodes/arduino_node.py",
        ),
    ),
    aux=codec.check_aux,
    driver=_driver,
)
