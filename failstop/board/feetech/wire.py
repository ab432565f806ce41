"""The Wire that describes the Feetech bus. A stop is repeated within one write, because a servo that is answering hears
nothing.

Both directions share one line, so a stop that begins during an answer is garbled, and so is the answer. So the burst
lasts longer than the three answers to a question, and each writer repeats the burst. Frames other than stops must not
collide with an answer. failstop writes them only after the line has been silent for the time of three answers. A servo
does not acknowledge a sync write. So the questions ask each wheel for the goal speed that it obeys and for its present
speed.
"""

from __future__ import annotations

from failstop.board.feetech import codec
from failstop.board.wire import (
    ECHOED,
    NO_WATCHDOG,
    OBSERVED,
    Commander,
    Motion,
    Pace,
    Port,
    Question,
    Reports,
    TimedStop,
    Wire,
    Write,
    answer_is,
)

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Mapping

    from failstop.board.driver import DriverLanguage
    from failstop.board.interface import ServoBus

_MS = 1_000_000
ANSWERS_NS = 2_500_000
"""How long three answers of 25 bytes take, in ns. This includes the return delay before each answer, which is at most
0.51 ms on a new servo. LeRobot sets the delay to 0."""


def _arm(port: Port) -> ServoBus:
    # Imported here because an arm is rare, so a robot without one does not load its module.
    from failstop.board.feetech.arm import FeetechArm

    return FeetechArm(port)


def _driver(settings: Mapping[str, float | str]) -> DriverLanguage:
    from failstop.board.feetech import driver  # for the guard port alone

    return driver.language(settings)


WIRE = Wire(
    name="a bus of Feetech servos, as LeKiwi has",
    port=Port(baud=1_000_000, dtr=False, rts=False, deaf_ns=0, opening=(codec.BURST, codec.TORQUE_ON)),
    stop=TimedStop(
        writes=(Write(0, codec.BURST),),
        after_ns=0,
        repeats_ns=tuple(tuple(at * _MS for at in row) for row in ((0, 9, 103), (0, 11, 113), (0, 17, 127))),
    ),
    pace=Pace(idle_ns=ANSWERS_NS, unanswered=1),
    watchdog=NO_WATCHDOG,
    motion=Motion(
        wheels=len(codec.WHEELS),
        unit=codec.UNIT,
        limit=codec.LIMIT,
        per_rps=lambda _diameter_m: codec.TURN,
        step=1.0,
        apart=2 * codec.LIMIT,
        frame=codec.motion,
        rest=codec.STOP,
        check=codec.check_motion,
        speeds=codec.speeds,
        # A wheel is on its servo's own axle, and the servo counts its own turns.
        scale_known=True,
    ),
    questions=tuple(
        Question(f"{size} bytes of each wheel", codec.BEFORE_QUESTION + ask, answer_is(str(size)))
        for size, ask in zip(codec.SIZES, codec.QUESTIONS, strict=True)
    ),
    reader=codec.Replies,
    proofs=(ECHOED, OBSERVED),
    ping_ns=100 * _MS,
    # The answers, and an adapter that holds bytes back for 16 ms.
    echo_ns=20 * _MS,
    # Each answer to a question has the present speed.
    reports=Reports(
        every_ns=125 * _MS,
        speed_per_rps=lambda per_rps, _diameter_m: per_rps,
        position_per_turn=None,
        wraps=0.0,
        holds_speed=True,
        own_scale=False,
    ),
    # As long as seven answers take. A busy computer loses a few in a row, and a garbled length loses up to five
    # (codec.BEFORE_QUESTION).
    silent_ns=700 * _MS,
    commanders=(
        Commander(
            who="LeRobot's own host writes to the bus, and its wheels keep their speed when it dies",
            remedy="end it; lerobot_robot_failstop takes its place",
            program="lerobot.robots.lekiwi.lekiwi_host",
        ),
    ),
    arm=_arm,
    driver=_driver,
)
