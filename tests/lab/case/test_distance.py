"""The stopping distance that the settings give is the way that the simulated board's wheels make, on every screen."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from failstop.api import distance
from failstop.board.kinds import is_described
from failstop.cli.main import main
from failstop.policy.kinematics import AXES
from failstop.policy.layouts import BOARDS
from failstop.policy.settings import Settings
from failstop.setup import sizes
from failstop.setup.draft import Draft
from failstop.setup.talk import Talk
from failstop_lab.boards.live import DIAMETER_M
from failstop_lab.boards.traits import traits_of
from failstop_lab.faults.table import TABLE
from failstop_lab.prove import report
from tests.support.simulated import Simulated

CLOSE = 0.05
"""Of the distance: the phase of timers in which a fault comes."""
PHASES_S = (0.8, 0.807, 0.813)
SCREENS = ("config", "setup", "prove", "the operator's page")
LATER = {
    "board-silent": "the board hears and obeys until then; only nobody sees what its wheels do",
    "board-motor-unplugged": "a motor that hears nothing is stopped by its own watchdog alone",
    "board-wheel-runs-away": "the way of a wheel that does not do what it is told follows from no setting",
    "names-removed": "the program that drives is obeyed until then",
    "usb-drop-unwatched": "no software reaches a board that is unplugged; counted from its return",
}
"""Rows of the fault table that the distance leaves out (docs/prove.md says so), and why."""


def settings_of(kind: str, **changed: object) -> Settings:
    return Settings({"board.kind": kind, **changed})


def way_m(simulated: Simulated, fault_ns: int, settings: Settings) -> float:
    """The way of the base from the fault on, with its wheels braking as soon as the board has executed a stop."""
    at_ns, way, speed = fault_ns, 0.0, 0.0
    # A wheel that slips across its way rolls a part of the base's: over all three half of it, in squares.
    turn_m = settings["wheels.diameter_m"] * math.pi * (math.sqrt(2) if settings.speeds == 3 else 1.0)
    for frame in simulated.board.events():
        if frame.executed_ns > at_ns:
            way += speed * (frame.executed_ns - at_ns) / 1e9
            at_ns = frame.executed_ns
        turning = math.sqrt(sum(rps**2 for rps in frame.speeds) / len(frame.speeds)) * turn_m
        if frame.executed_ns > fault_ns and not turning:
            break
        # Of two motors with a frame each the first one has stopped before the other one.
        speed = max(speed, turning)
    step_s = 1e-4
    while speed > 0.0:
        way += speed * step_s
        speed -= settings[distance.BRAKING] * step_s
    return way


def rolled_m(simulated: Simulated, settings: Settings) -> float:
    """The longest way of the wheels after the obstacle sensor falls silent, at the fastest that the base goes."""
    velocity = (0.2, 0.2 * AXES[settings.text("wheels.layout")][1], 0.0)
    simulated.enable()
    ways = []
    for phase_s in PHASES_S:
        simulated.drive(phase_s, velocity)
        simulated.robot.sensed()
        fault_ns = simulated.now_ns()
        while simulated.now_ns() < fault_ns + 700_000_000:
            simulated.robot.drive(*velocity)
            simulated.wait(0.02)
        ways.append(way_m(simulated, fault_ns, settings))
    return max(ways)


def least_share(kind: str) -> float:
    """The slowest that a steady 0.2 m/s is sent, as a share of it: marks make some frames a trifle slower."""
    board = traits_of(kind).language
    rps = 0.2 / (math.pi * DIAMETER_M)
    frame = board.motor_speeds((rps,) * board.wheels, 2 * rps)
    every = [board.speeds(board.marked(frame, turn)) or () for turn in range(8)]
    return min(min(speeds) for speeds in every) / rps


def screens(kind: str, simulated: Simulated, folder: Path, capsys: pytest.CaptureFixture[str]) -> Iterator[str]:
    """Every screen that tells of the distance, in one line."""
    file = folder / "robot.toml"
    file.write_text(f'[board]\nkind = "{kind}"\n')
    assert main(["config", "--config", str(file)]) == 0
    yield capsys.readouterr().out
    settings = settings_of(kind)
    asked = (*sizes.OF_LAYOUT[settings.text("wheels.layout")], *sizes.LIMITS)
    given = {sizes.answer_key(key): f"{settings[key]:g}" for key in asked}
    draft = Draft("failstop", {"STATE_DIRECTORY": str(folder)})
    sizes.step(Talk(given, draft, silent=True), {"board.kind": kind}, known=True)
    yield capsys.readouterr().out
    yield " ".join(report.ways(report.Evidence("", simulated=True, realtime=True, user=settings)))
    yield simulated.load("failstop.web.view").view(simulated.robot.state, [], 0.0)["stands"]


@pytest.mark.slow
@pytest.mark.parametrize("kind", BOARDS)
@pytest.mark.claim("DISTANCE-1")
def test_every_screen_tells_the_way_that_the_wheels_make(
    kind: str, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """By the fault that is answered last. The driver's own screens agree to the centimetre."""
    settings = settings_of(kind)
    way, (_, latest) = distance.furthest(settings)
    assert latest == ("telemetry hangs" if is_described(kind) else "the obstacle sensor falls silent")
    simulated = Simulated(kind=kind)
    # Behind a deadline the distance reckons with a busy machine, which the simulated one is not.
    spare = 0.1 if is_described(kind) else CLOSE
    assert way * (least_share(kind) - spare) <= rolled_m(simulated, settings) <= way * (1 + CLOSE)
    told = [" ".join(screen.split()) for screen in screens(kind, simulated, tmp_path, capsys)]
    assert [distance.WITHIN.format(way) in screen for screen in told] == [True] * len(SCREENS), told
    simulated.robot.limit_speed(0.5)
    assert simulated.robot.state.stands_within_m == pytest.approx(distance.furthest(settings, 0.5)[0])


def test_no_row_of_the_fault_table_is_answered_later() -> None:
    """LATER has those that are, and why. The table has an interlock, which is declared here."""
    _, (seconds, _) = distance.furthest(settings_of("rrc", **{"interlocks.arm.timeout_s": 0.5}))
    assert {row.name for row in TABLE if row.bar_ms and row.bar_ms > 1000 * seconds + 0.1} == LATER.keys()


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
        ({"attend.required": "on"}, "the operator is not heard"),
    ],
)
def test_the_furthest_follows_the_settings(changed: dict[str, Any], latest: str) -> None:
    assert distance.furthest(settings_of("rrc", **changed))[1][1] == latest


@pytest.mark.parametrize(
    ("kind", "told"),
    [
        ("rrc", "it drives on, because this board has no watchdog that failstop knows of."),
        ("feetech", "it drives on, because this board has no watchdog that failstop knows of."),
        ("ugv", "the board's own watchdog stops it within 0.12 m."),
        ("hoverboard", "the board's own watchdog acts after 0.16 m: it lets its wheels coast."),
        ("vesc", "the board's own watchdog acts after 0.20 m: it lets its wheels coast."),
    ],
)
def test_a_frozen_machine_is_told_of(kind: str, told: str) -> None:
    """By the watchdog of a board that has one; wheels without current brake by nothing that is known."""
    assert told in distance.sentences(settings_of(kind))[-1]


def test_the_speed_for_a_distance_is_printed(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["config", "--within", "0.1"]) == 0
    assert capsys.readouterr().out.startswith(
        "To stop within 0.10 m of any fault that failstop can detect, the robot may go at most 0.166 m/s."
    )
    assert main(["config", "--within", "0"]) == 1
    assert capsys.readouterr().err == "failstop: --within 0: it must be a distance above 0, in m\n"
