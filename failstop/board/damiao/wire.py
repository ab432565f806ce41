"""The Wire that describes Damiao's motors behind a slcan adapter. Each write has a line for every motor.

A stop is one write for all motors, so a process can't die after it has stopped only some of them. If the kernel takes
only a part of the write, the next burst of any process stops the other motors. A stop is always for four motors,
because `failstop stop` and `failstop setup` may not know how many there are. A line for a motor that does not exist
does nothing.

A stop can't reach a motor that hears nothing, for example because its CAN plug is out. Such a motor is stopped by its
own watchdog. While one motor does not answer, stops do not count as acknowledged, and motion can't be enabled.
"""

from __future__ import annotations

from math import pi

from failstop.board.damiao import codec
from failstop.board.wire import (
    ANSWERED,
    COAST,
    OBSERVED,
    Commander,
    Motion,
    Pace,
    Port,
    Question,
    Reports,
    TimedStop,
    Watchdog,
    Wire,
    Write,
    answer_is,
)

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Mapping

    from failstop.board.driver import DriverLanguage

_MS = 1_000_000
PER_RPS = 2 * pi


USUAL = 2


def _driver(settings: Mapping[str, float | str]) -> DriverLanguage:
    from failstop.board.damiao import driver  # for the guard port alone

    return driver.language(settings)


def wire(speeds: int, _can_id: int = 0) -> Wire:
    """Describe a base with `speeds` motors, which have the CAN ids 1, 2 and so on. With 0, the number of motors is not
    known yet, and questions go to two motors only."""
    motors = codec.Motors(speeds or USUAL)
    return Wire(
        name=f"{speeds} Damiao motors behind a slcan adapter" if speeds else "Damiao motors behind a slcan adapter",
        # An adapter on USB has no baud rate. An adapter with a UART has its own rate, which is the setting board.baud.
        port=Port(baud=1_000_000, dtr=False, rts=False, deaf_ns=0, opening=(motors.opening,)),
        stop=TimedStop(
            writes=(Write(0, motors.burst),),
            after_ns=0,
            repeats_ns=tuple(
                tuple(at * _MS for at in row) for row in ((0, 23, 57, 107), (0, 29, 63, 117), (0, 37, 71, 127))
            ),
        ),
        pace=Pace(idle_ns=100_000, unanswered=None),
        watchdog=Watchdog(
            after_ns=0,
            does=COAST,
            arm=motors.arm,
            set_ns=500 * _MS,
            fed_by="every frame to a motor feeds its own; the manual does not say whether a question does. It then "
            "switches itself off, and rolls until motion is enabled again",
        ),
        motion=Motion(
            wheels=motors.wheels,
            unit=codec.UNIT,
            limit=codec.LIMIT,
            per_rps=lambda _diameter_m: PER_RPS,
            step=1 / codec.STEPS,
            apart=2 * codec.LIMIT,
            frame=motors.frame,
            rest=motors.rest,
            check=motors.check,
            speeds=motors.speeds,
            scale_known=True,
        ),
        questions=tuple(
            Question(f"register {index} and a report of each motor", ask, answer_is(str(at)))
            for at, (index, ask) in enumerate(zip(codec.ASKED, motors.questions, strict=True))
        ),
        reader=motors.replies,
        proofs=(ANSWERED, OBSERVED),
        ping_ns=50 * _MS,
        echo_ns=0,
        reports=Reports(
            every_ns=100 * _MS,
            speed_per_rps=lambda _per_rps, _diameter_m: PER_RPS,
            position_per_turn=None,
            wraps=0.0,
            holds_speed=True,
            own_scale=True,
        ),
        silent_ns=700 * _MS,
        commanders=(
            Commander(
                who="another computer or adapter on the CAN, or the vendor's debugging tool at a motor's UART",
                remedy="take it off while the service drives",
            ),
            Commander(
                who="slcand makes a network interface of the adapter, so any program can write to it",
                remedy="end slcand",
                program="slcand",
            ),
        ),
        aux=motors.check_aux,
        driver=_driver,
    )


WIRE = wire(0)
"""The description for an unknown number of motors. It asks two motors, and stops four."""
