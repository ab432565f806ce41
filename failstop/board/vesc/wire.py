"""The Wire that describes one or two VESCs. The second controller is on the CAN of the first. Each controller has its
own packets.

The packets for both controllers go out in one write. So no process can die between two writes and leave one motor
turning. If the kernel takes only a part of a write, the next burst of any process stops both motors, because the
receiver finds every whole packet after a cut packet. One danger remains: a controller that hears nothing, for example
because its CAN plug is out. Only its own timeout then stops its motor. Because it does not answer, stops do not count
as acknowledged, and motion can't be enabled.

A burst is a stop, zeros, and a second stop. After a garbled length, the receiver may wait for a long packet. The four
bursts of a writer are longer than any packet. So a garbled length delays a stop by 0.14 s at most, but no stop is lost.
"""

from __future__ import annotations

from failstop.board.facts import USUAL_CAN_ID
from failstop.board.vesc import codec
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
IDLE_NS = 100_000
HUB_PER_RPS, CAR_PER_RPS = 900.0, 1450.0
"""How many ERPM usually make one wheel turn per second. HUB_PER_RPS is for a hub motor with 15 pairs of poles, as in a
hoverboard. CAR_PER_RPS is for a RoboRacer car, which has 4614 ERPM at 1 m/s (f1tenth_system 03865a0, vesc.yaml) and
wheels of 0.1 m."""


def _driver(settings: Mapping[str, float | str]) -> DriverLanguage:
    from failstop.board.vesc import driver  # for the guard port alone

    return driver.language(settings)


def wire(speeds: int, can_id: int) -> Wire:
    """Make the description of one VESC if `speeds` is 1, and of two VESCs otherwise. `can_id` is the CAN id of the
    second VESC."""
    can_ids = () if speeds == 1 else (can_id,)
    motors = codec.Motors(can_ids)
    return Wire(
        name="two VESCs" if can_ids else "a VESC",
        port=Port(baud=115_200, dtr=False, rts=False, deaf_ns=0, opening=()),
        stop=TimedStop(
            writes=(Write(0, motors.burst),),
            after_ns=0,
            repeats_ns=tuple(
                tuple(at * _MS for at in row) for row in ((0, 23, 53, 103), (0, 29, 61, 113), (0, 37, 71, 127))
            ),
        ),
        # The bursts of a stop take a while on a serial line. A frame that follows them waits until they have been sent.
        pace=Pace(idle_ns=IDLE_NS, unanswered=None),
        watchdog=Watchdog(
            after_ns=1000 * _MS,
            does=COAST,
            arm=None,
            set_ns=0,
            fed_by="every command to a motor feeds its own controller's, a question does not; VESC Tool sets its time "
            "(0 switches it off) and a brake current instead of coasting",
        ),
        motion=Motion(
            wheels=motors.wheels,
            unit=codec.UNIT,
            limit=codec.LIMIT,
            per_rps=lambda _diameter_m: HUB_PER_RPS if can_ids else CAR_PER_RPS,
            step=1.0,
            apart=2 * codec.LIMIT,
            frame=motors.frame,
            rest=motors.rest,
            check=motors.check,
            speeds=motors.speeds,
        ),
        questions=tuple(
            Question(f"values {mask:#x} of each motor", ask, answer_is(str(index)))
            for index, (mask, ask) in enumerate(zip(codec.MASKS, motors.questions, strict=True))
        ),
        reader=motors.replies,
        proofs=(ANSWERED, OBSERVED),
        ping_ns=50 * _MS,
        echo_ns=0,
        # Every question asks for speeds and tachometers. A tachometer counts six steps in one electrical revolution.
        reports=Reports(
            every_ns=100 * _MS,
            speed_per_rps=lambda per_rps, _diameter_m: per_rps,
            position_per_turn=lambda per_rps, _diameter_m: per_rps / 60 * codec.STEPS,
            wraps=2.0**32,
            holds_speed=True,
            own_scale=False,
            position_step=1.0,
        ),
        # A busy computer may lose a few answers in a row. The tachometers reveal a shorter restart.
        silent_ns=700 * _MS,
        commanders=(
            Commander(
                who="a remote control or a gamepad at a VESC (App to Use in VESC Tool: PPM, ADC, Nunchuk, NRF)",
                remedy="set App to Use to UART, or to No App with USB, on each VESC",
            ),
            Commander(
                who="VESC Tool, by Bluetooth or by the USB port of the other VESC",
                remedy="close it, and switch Bluetooth off at a VESC that has it",
            ),
            Commander(
                who="the ROS driver of RoboRacer (vesc_driver) writes to the port",
                remedy="let it open the guard port instead (docs/guard.md), or start the bridge of failstop",
                program="lib/vesc_driver/",
            ),
        ),
        aux=codec.check_aux,
        steering=codec.Steering,
        driver=_driver,
    )


WIRE = wire(2, USUAL_CAN_ID)
"""The description for two motors, with the usual CAN id. The service does not use it, but makes a description with the
CAN id of the settings."""
