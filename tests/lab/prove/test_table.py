"""The table of stop paths, its bars, and the plans made of it."""

from __future__ import annotations

import dataclasses

import pytest

from failstop.messages.layout import PROCESS_NAMES
from failstop.policy import causes
from failstop.policy.settings import Settings
from failstop_lab.faults.fault import Wanted
from failstop_lab.prove import report, table
from failstop_lab.prove.report import Evidence
from failstop_lab.prove.run import Result
from failstop_lab.prove.stand import settings_for
from failstop_lab.prove.table import (
    ARM_PATHS,
    BESIDE_PATHS,
    BY_PATH,
    BY_TURNING,
    PATHS,
    QUICK_NAMES,
    TURNINGS,
    Path,
    plan,
    within,
)
from tests.lab.prove.noise import SIMULATED, gyro


def test_every_process_is_killed_and_hung() -> None:
    for kind in (table.KILL, table.HANG):
        assert {path.process for path in PATHS if path.kind == kind} == set(PROCESS_NAMES)
    others = {table.TIMEOUT, table.STOP_REQUEST, table.DISABLING, table.SCAN, table.PAD_STOP}
    assert {path.kind for path in PATHS} >= others
    assert len(BY_PATH) == len(PATHS)


def test_every_bar_is_one() -> None:
    for path in PATHS:
        assert 0 < path.reaction_bar_ms(simulated=False) < path.reaction_bar_ms(simulated=True)
        for velocity in TURNINGS:
            assert path.reaction_ms / 1000 < path.rest_bar_s(velocity) < 1.2


def test_the_bars_are_those_that_were_measured_before() -> None:
    bar = BY_PATH["timeout"].rest_bar_s(BY_TURNING["0.35"])
    assert bar == pytest.approx(0.75 + table.REST_RESOLUTION_S)
    assert BY_PATH["hang-gate"].rest_bar_s(BY_TURNING["turn"]) == pytest.approx(0.075 + 0.25 + table.REST_RESOLUTION_S)


FAST = Settings({"limits.vx_mps": 0.5, "limits.wz_radps": 2.0})


@pytest.mark.parametrize(
    ("vx", "wz", "found"),
    [
        (0.5, 2.0, {"0.2": 0.2, "0.35": 0.35, "turn": 1.0}),
        (0.3, 2.0, {"0.2": 0.2, "0.3": 0.3, "turn": 1.0}),
        (0.2, 0.5, {"0.2": 0.2, "turn": 0.5}),
        (0.05, 0.25, {"0.05": 0.05, "turn": 0.25}),
    ],
)
def test_no_velocity_is_beyond_the_limits_of_the_robot(vx: float, wz: float, found: dict[str, float]) -> None:
    settings = Settings({"limits.vx_mps": vx, "limits.wz_radps": wz})
    assert {velocity.name: max(velocity.command) for velocity in within(settings)} == found
    for path, velocity in plan(quick=False, settings=settings, has_arm=True, beside=True):
        assert velocity.command[0] <= vx
        assert velocity.command[2] <= wz
        assert path.rest_bar_s(velocity) > 0
    assert settings_for({"limits.vx_mps": vx})["limits.vx_mps"] == vx


def test_plans() -> None:
    whole = plan(quick=False, settings=FAST)
    assert len(whole) == len(set(whole)) == len(PATHS) * len(TURNINGS)
    quick = plan(quick=True, settings=FAST)
    assert {path.name for path, _ in quick} == set(QUICK_NAMES)
    assert {velocity for _, velocity in quick} == set(TURNINGS)
    assert plan(quick=False, only=("scan",), at=("turn",), settings=FAST) == [(BY_PATH["scan"], BY_TURNING["turn"])]


STRICT = Settings({"gate.driver_silence": "latch", "gate.driver_death": "latch"})
BESIDE = {path.name: path for path in BESIDE_PATHS}


@pytest.mark.parametrize(
    ("path", "latched"),
    [
        (BY_PATH["timeout"], ((causes.DRIVER_SILENT,),)),
        (BESIDE["arm-client-hung"], ((causes.DRIVER_SILENT,),)),
        (BESIDE["arm-client-killed"], ((causes.DRIVER_DIED,),)),
    ],
    ids=lambda value: getattr(value, "name", ""),
)
def test_a_robot_that_latches_for_its_driver_has_to(path: Path, latched: tuple[Wanted, ...]) -> None:
    assert path.under(Settings()).latched == ()
    assert path.under(STRICT).latched == latched
    assert path.under(Settings({"gate.driver_silence": "disable", "gate.driver_death": "stay"})).latched == ()


def test_no_other_path_is_about_the_driver() -> None:
    about = {BY_PATH["timeout"], BESIDE["arm-client-hung"], BESIDE["arm-client-killed"]}
    for path in {*PATHS, *ARM_PATHS, *BESIDE_PATHS} - about:
        assert path.under(STRICT) is path


def result(**changed: object) -> Result:
    found = Result(BY_PATH["timeout"], BY_TURNING["0.2"], False, 301.0, "gate", 420.0, 0.5)
    return dataclasses.replace(found, **changed)  # type: ignore[arg-type]


def test_rows_say_what_was_measured_and_what_is_wrong() -> None:
    assert "301.00 (340)" in report.row(result())
    assert report.row(result()).endswith("PASS")
    assert report.row(result(wrong=["NO STOP written"])).endswith("FAIL NO STOP written")
    assert report.row(result(skipped="no press of a button arrived")).endswith("SKIP no press of a button arrived")
    assert "no reading for 0.30 s" in report.row(result(blind_s=0.3))


@pytest.mark.starts
def test_evidence_is_kept_in_a_dated_folder(tmp_path: object) -> None:
    evidence = Evidence("/dev/board", False, True, SIMULATED, [result(samples=gyro((1.0, 0.002)))])
    evidence.begun_unix_s = 0.0
    paths = report.save(evidence, str(tmp_path))
    assert [path.removeprefix(f"{tmp_path}/") for path in paths][:2] == [
        "1970-01-01T000000Z/report.txt",
        "1970-01-01T000000Z/result.json",
    ]
    again = report.save(evidence, str(tmp_path))
    assert again[1] == f"{tmp_path}/1970-01-01T000000Z-2/result.json", "another run of that second is not written over"


def test_a_limit_that_does_not_fit_is_told_with_one_that_does() -> None:
    assert SIMULATED.lines()[-1].endswith("it fits this robot")
    other = dataclasses.replace(SIMULATED, limit_radps=0.0031)
    assert "set it to 0.0031" in other.lines()[-1]
