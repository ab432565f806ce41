"""`failstop chaos --device`: random stop paths on a stand, judged by the board's answers and its IMU."""

from __future__ import annotations

import itertools
import json
import random
import subprocess
from pathlib import Path
from typing import Any

import pytest

from failstop.api.errors import FailstopError
from failstop.cli.main import main
from failstop_lab.commands import write_json
from failstop_lab.faults.fault import CONTINUE, HANG, KILL
from failstop_lab.faults.steps import Steps
from failstop_lab.faults.table import FAULT_BY_NAME
from failstop_lab.prove import random_runs
from failstop_lab.prove.run import PathRun, Result
from failstop_lab.prove.stand import ProveStand
from failstop_lab.prove.table import BY_PATH, BY_TURNING, of_fault
from failstop_lab.sim.client import SimBoard
from tests.lab.prove.noise import SIMULATED
from tests.support.commands import FAILSTOP

CONSENT = ("--on-the-stand", "--wheels-are-free")
PIDS = {"supervisor": 1, "port_owner": 2, "gate": 3, "telemetry": 4, "stopper": 5}


def test_a_campaign_takes_every_path_of_any_board_without_a_person_and_rows_survived() -> None:
    found = random_runs.paths()
    assert set(BY_PATH) - set(found) == {"pad", "frozen"}
    rows = [FAULT_BY_NAME[name] for name in found if name not in BY_PATH]
    assert {"kill-gate+stopper", "kill-gate-hang-stopper", "hang-gate-continued", "kill-port_owner+gate+telemetry"} <= {
        row.name for row in rows
    }
    for row in rows:
        assert row.survives
        assert row.steps
        assert not row.stop_tool
        assert found[row.name].reaction_ms == row.bar_ms
        assert found[row.name].latched == row.latched


def test_a_seed_says_every_draw_from_any_index_on() -> None:
    chosen = list(random_runs.paths().values())
    drawn = [(p.name, v.name, c.random()) for p, v, c in random_runs.draws(chosen, 7, lambda made: made >= 20)]
    again = [(p.name, v.name, c.random()) for p, v, c in random_runs.draws(chosen, 7, lambda made: made >= 5, 15)]
    assert drawn[15:] == again
    assert len({name for name, _, _ in drawn}) > 10
    assert len({name for _, name, _ in drawn}) == len(BY_TURNING)


@pytest.mark.parametrize("name", ["kill-gate-hang-stopper", "hang-gate-continued", "kill-port_owner+gate"])
def test_steps_are_taken_as_the_row_says(name: str) -> None:
    row, taken, waited = FAULT_BY_NAME[name], list[tuple[int, int]](), list[float]()
    sent = Steps(row, random.Random(3), lambda pid, number: taken.append((pid, int(number))), lambda _: True)
    sent.perform(PIDS, waited.append)
    numbers = {KILL: 9, HANG: 19, CONTINUE: 18}
    first = [step for step in taken if step[1] == 19 and (step[0], 9) in taken]  # what dies at once stands still first
    assert len(first) in (0, len(row.struck(KILL)))
    steps = [step for step in taken if step not in first]
    assert sorted(steps) == sorted((PIDS[process], numbers[action]) for action, process in row.steps)
    if CONTINUE in {action for action, _ in row.steps}:
        assert taken[-1][1] == 18
        assert row.bar_ms
        assert waited[0] > row.bar_ms / 1000, "the stop is due before it wakes up"


def test_the_table_counts_and_spreads() -> None:
    path, velocity = of_fault(FAULT_BY_NAME["kill-gate+stopper"]), BY_TURNING["turn"]
    results = [Result(path, velocity, False, acknowledged_ms=ms, rest_s=ms / 100) for ms in (10.0, 30.0, 20.0)]
    results.append(Result(path, velocity, False, wrong=["NO STOP written"]))
    (line,) = random_runs.table_lines(results)[1:]
    assert line.split() == ["kill-gate+stopper", "4", "1", "20", "/", "30", "0.20", "/", "0.30"]


@pytest.mark.slow
def test_a_campaign_on_a_board_whose_frames_nobody_sees_ends_when_it_does_not_stop(tmp_path: Path) -> None:
    only = ("--only", "kill-gate+stopper,kill-telemetry-hang-gate,stop-request", "--count", "99", "--seed", "4")
    out = tmp_path / "stand.json"
    with SimBoard(tmp_path / "board") as board:
        command = [*FAILSTOP, "chaos", "--device", board.link, *CONSENT, *only, "--json", str(out)]
        with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
            assert process.stdout
            said = list(itertools.takewhile(lambda line: "PASS" not in line, process.stdout))
            board.refuse_stop(True)
            rest, errors = process.communicate(timeout=60)
    assert process.returncode == 1
    assert "NO STOP" not in "".join(said), "the first runs were good"
    assert "THIS TURNS THE WHEELS" in errors
    assert "POWER SWITCH" in errors
    assert "THE WHEELS DID NOT COME TO REST" in rest
    assert "ENDED EARLY" in rest
    result = json.loads(out.read_text())
    assert (result["seed"], result["passed"], result["simulated"]) == (4, False, False)
    good, failed = [[row for row in result["rows"] if (row["verdict"] == "FAIL") is bad] for bad in (False, True)]
    assert result["rows"][-1] in failed, "no run after that one"
    for row in good:
        # A calm stretch of a wheel that turned may reach back to the cause: rest after 0 s is a rest.
        assert row["acknowledged_ms"]
        assert row["rest_s"] is not None
        assert not row["samples"] or row["verdict"] != "PASS"


@pytest.mark.slow
def test_a_run_that_breaks_off_is_stopped_looked_at_and_begun_anew(tmp_path: Path) -> None:

    class Fails(random.Random):
        def choice(self, seq: Any) -> Any:
            raise OSError("nobody is there")

    path, velocity = of_fault(FAULT_BY_NAME["kill-gate+stopper"]), BY_TURNING["0.2"]
    with SimBoard(tmp_path / "board") as board, ProveStand(board.link, {}, str(tmp_path)) as stand:
        for stops in (True, False):
            board.refuse_stop(not stops)
            result = PathRun(stand, SIMULATED, path, velocity, None, Fails(1)).perform()
            assert "OSError: nobody is there" in result.wrong
            assert result.runaway is not stops
            assert any(board.wheels()) is not stops
            if stops:
                assert stand.whole(), "the next run finds a service"
        board.refuse_stop(False)


def test_the_list_on_a_stand(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["chaos", "--device", "/dev/any", "--list"]) == 0
    listed = [line.split()[0] for line in capsys.readouterr().out.splitlines()]
    assert listed == list(random_runs.paths())
    assert not any(name.startswith(("client-", "usb-")) for name in listed)


def test_a_result_that_does_not_fit_the_disk_is_told_with_its_name() -> None:
    """Not as a failure of standard output, which a disk's error alone would look like."""
    with pytest.raises(FailstopError, match="--json /dev/full could not be written: No space left on device"):
        write_json("/dev/full", {"rows": []})
