"""The Wire that describes Waveshare's UGV. Each time failstop opens the port, it sets the board's own watchdog.

A stop begins with a line feed, which ends a cut line before it. So a stop may follow any bytes, without a silence on
the serial line. Motion lines feed the watchdog, and so does the stop that is written again and again while the robot is
stopped.
"""

from __future__ import annotations

from math import pi

from failstop.board.ugv import codec
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
    Wire,
    Write,
    answer_is,
)

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Mapping

    from failstop.board.driver import DriverLanguage

_MS = 1_000_000
WATCHDOG_NS = 500 * _MS
"""The time to which failstop sets the board's watchdog, in ns. While the robot is stopped, failstop writes the stop
again more than twice in this time, so the watchdog does not act."""


def _driver(settings: Mapping[str, float | str]) -> DriverLanguage:
    from failstop.board.ugv import driver  # for the guard port alone

    return driver.language(settings)


WIRE = Wire(
    name="the driver board of a Waveshare UGV",
    # The board's serial pins have no modem lines. On USB the ESP32 keeps running if both lines are on or both are off.
    port=Port(
        baud=115_200,
        dtr=False,
        rts=False,
        deaf_ns=5000 * _MS,
        opening=(codec.STOP, codec.watchdog(WATCHDOG_NS)),
    ),
    stop=TimedStop(
        writes=(Write(0, codec.STOP),),
        after_ns=0,
        repeats_ns=tuple(tuple(at * _MS for at in row) for row in ((0, 23, 103), (0, 31, 113), (0, 41, 127))),
    ),
    pace=Pace(idle_ns=0, unanswered=None),
    watchdog=Watchdog(
        after_ns=3000 * _MS,
        does=ZERO,
        arm=codec.watchdog,
        set_ns=WATCHDOG_NS,
        fed_by="T:1 and T:11 feed it; T:13, which the vendor's ROS 2 driver sends, neither feeds nor arms it",
    ),
    motion=Motion(
        wheels=2,
        unit=codec.UNIT,
        limit=codec.LIMIT,
        per_rps=lambda diameter_m: pi * diameter_m,
        step=codec.STEP,
        apart=2 * codec.LIMIT,
        frame=codec.MOTION.frame,
        rest=codec.REST,
        check=codec.MOTION.check,
        speeds=codec.MOTION.speeds,
    ),
    questions=(
        Question("speed rate", codec.SPEED_RATE, answer_is("139")),
        Question("attitude", codec.ATTITUDE, answer_is("1002")),
    ),
    reader=codec.reports,
    proofs=(ANSWERED, OBSERVED),
    ping_ns=0,
    echo_ns=0,
    # ugv_base_ros c967326, ugv_advance.h: T:1001 comes every 50 ms. odl and odr are whole cm, cut towards zero, and
    # computed with the wheel size that the firmware has. L and R are the speeds of the last loop alone: 0 in most
    # reports of a wheel that turns slowly. So they prove nothing, and are not used.
    reports=Reports(
        every_ns=100 * _MS,
        speed_per_rps=None,
        position_per_turn=lambda _per_rps, diameter_m: 100 * pi * diameter_m,
        wraps=0.0,
        holds_speed=True,
        own_scale=True,
        position_step=1.0,
    ),
    # A busy computer can cause any shorter pause. The boot text and the odometers reveal a shorter restart.
    silent_ns=600 * _MS,
    commanders=(
        Commander(
            who="its Wi-Fi: anyone who joins its access point (UGV, password 12345678 unless changed), or the network "
            "that it has joined, can drive the robot with the page at its address",
            remedy="set your own password on that page (192.168.4.1) while the robot is at rest, because the board "
            'then hears nothing for 15 s: {"T":407,"mode":1,"ap_ssid":"NAME","ap_password":"SECRET","sta_ssid":"none",'
            '"sta_password":"none"}; then check with a phone that the old network is gone',
        ),
        Commander(
            who="ESP-NOW: any ESP32 nearby can drive the robot by radio, without a password (by default)",
            remedy='{"T":301,"mode":0} on its page turns this off until the next power-on; to turn it off forever, '
            "build the firmware without it, because its boot mission is broken off when this computer writes to it",
        ),
        Commander(
            who=(
                "the vendor's app (ugv_rpi) writes to the board, and anyone can drive the robot with its page on "
                "port 5000"
            ),
            remedy="put a # before its @reboot line and before that of start_jupyter.sh, then reboot",
            program="ugv_rpi/app.py",
            fix="crontab -e",
        ),
        Commander(
            who="the vendor's ROS 2 node (ugv_ws) writes T:13 to the board, whose watchdog does not stop that",
            remedy="start failstop's bridge instead (docs/ros2.md)",
            program="lib/ugv_bringup/",
        ),
    ),
    aux=codec.check_aux,
    driver=_driver,
)
