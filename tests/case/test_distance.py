"""The stopping distance that the settings give is the way that the simulated board's wheels make."""

from __future__ import annotations

import math
from typing import Any

import pytest

from failstop.api import distance
from failstop.board.kinds import is_described
from failstop.cli.main import main
from failstop.lab.boards.live import DIAMETER_M
from failstop.policy.layouts import BOARDS
from failstop.policy.settings import Settings
from tests.support.simulated import Simulated

CLOSE = 0.05
"""Of the distance: the phase of timers in which a fault comes."""
PHASES_S = (0.8, 0.807, 0.813)


def settings_of(kind: str, **changed: object) -> Settings:
    return Settings({"board.kind": kind, **changed})


def way_m(simulated: Simulated, fault_ns: int, braking_mps2: float) -> float:
    """The way of the base from the fault on, with its wheels braking as soon as the board has executed a stop."""
    at_ns, way, speed = fault_ns, 0.0, 0.0
    for frame in simulated.board.events():
        if frame.executed_ns > at_ns:
            way += speed * (frame.executed_ns - at_ns) / 1e9
            at_ns = frame.executed_ns
        turning = math.sqrt(sum(rps**2 for rps in frame.speeds) / len(frame.speeds)) * math.pi * DIAMETER_M
        if frame.executed_ns > fault_ns and not turning:
            break
        speed = turning
    step_s = 1e-4
    while speed > 0.0:
        way += speed * step_s
        speed -= braking_mps2 * step_s
    return way


@pytest.mark.parametrize("kind", BOARDS)
def test_the_furthest_way_is_the_wheels_own(kind: str) -> None:
    settings = settings_of(kind)
    way, latest = distance.furthest(settings)
    assert latest.what == ("the obstacle sensor falls silent")
    velocity = (0.2, 0.0 if is_described(kind) else 0.2, 0.0)
    ways = []
    for phase_s in PHASES_S:
        simulated = Simulated(kind=kind)
        simulated.enable()
        simulated.drive(phase_s, velocity)
        robot = simulated.robot
        robot.sensed()
        fault_ns = simulated.now_ns()
        while simulated.now_ns() < fault_ns + 700_000_000:
            robot.drive(*velocity)
            simulated.wait(0.02)
        ways.append(way_m(simulated, fault_ns, settings[distance.BRAKING]))
    assert max(ways) == pytest.approx(way, rel=CLOSE)


@pytest.mark.parametrize(("metres", "seconds", "braking"), [(0.1, 0.5, 1.0), (2.0, 0.0, 0.3), (0.01, 0.005, 4.0)])
def test_a_speed_is_the_one_of_its_distance(metres: float, seconds: float, braking: float) -> None:
    speed = distance.speed_mps(metres, seconds, braking)
    assert distance.distance_m(speed, seconds, braking) == pytest.approx(metres)


@pytest.mark.parametrize(
    ("changed", "latest"),
    [
        ({"scan.gate": "off"}, "telemetry hangs"),
        ({"scan.gate": "off", "gate.command_timeout_s": 0.8}, "the program that drives falls silent"),
        ({"interlocks.door.timeout_s": 2.0}, "the interlock door is no longer asserted"),
    ],
)
def test_the_furthest_follows_the_settings(changed: dict[str, Any], latest: str) -> None:
    assert distance.furthest(settings_of("rrc", **changed))[1].what == latest


def test_a_frozen_machine_is_told_of() -> None:
    """By the watchdog of a board that has one."""
    assert "it drives on: this board has no watchdog of its own" in distance.told(settings_of("rrc"))[-1]
    assert "it stands after 0.12 m, by the board's own watchdog" in distance.told(settings_of("ugv"))[-1]


def test_the_speed_for_a_distance_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["config", "--within", "0.1"]) == 0
    assert capsys.readouterr().out.endswith("braking with 1 m/s2: at most 0.166 m/s.\n")
    assert main(["config", "--within", "0"]) == 1
    assert capsys.readouterr().err == "failstop: --within 0: it must be a distance above 0, in m\n"


def test_config_ends_with_the_distance(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["config"]) == 0
    assert " ".join(distance.told(Settings())) in " ".join(capsys.readouterr().out.split())
