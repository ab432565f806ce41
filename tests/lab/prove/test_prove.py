"""`failstop prove` on simulated boards: it passes where all is well, and above all it fails where it is not."""

from __future__ import annotations

import contextlib
import dataclasses
import json
import os
import random
import signal
import subprocess
import time
from collections.abc import Iterator
from pathlib import Path
from types import SimpleNamespace

import pytest

from failstop.api.errors import Refused
from failstop.cli.main import main
from failstop.doctor.system import System
from failstop.policy.halted import CONFIRMED, MAY_TURN
from failstop.setup.ending import SIGNALS, interruptible
from failstop.supervisor import status
from failstop_lab.faults.driving import Driver
from failstop_lab.prove import pack
from failstop_lab.prove.run import PathRun, Result
from failstop_lab.prove.session import check_free
from failstop_lab.prove.stand import ProveStand
from failstop_lab.prove.table import BY_PATH, BY_TURNING
from failstop_lab.sim.client import SimBoard
from failstop_lab.trial import Trial, wait_for
from tests.lab.prove import stands
from tests.lab.prove.judged import UNSEEN, firm
from tests.lab.prove.noise import SIMULATED
from tests.support.commands import FAILSTOP, failstop
from tests.support.terminal import Terminal

WORD = "spin\n"
CTRL_C = b"\x03"
LIMIT_S = 240
TRIES = 5
MINE = {"limits.vx_mps": 0.25, "limits.wz_radps": 1.5, "interlocks.dock.timeout_s": 0.3, "device.path": "/dev/x"}
ROWS = ("timeout", "scan", "kill-supervisor", "service-stop")
"""Of the short form: who stops is the gate, the port owner, and the service as it ends."""


def prove(*words: str, said: str = "") -> subprocess.CompletedProcess[str]:
    return failstop("prove", *words, said=said, timeout=LIMIT_S)


@contextlib.contextmanager
def on_stand(place: Path, **settings: object) -> Iterator[ProveStand]:
    """Its rows are not excused by what else this machine does (test_starved_rows.py)."""
    with stands.on_stand(place, **settings) as stand:
        stand.held.starved = lambda *_: ""  # type: ignore[method-assign]
        yield stand


def one(stand: ProveStand, path: str, velocity: str = "0.2") -> Result:
    """A row; one in which a busy machine had no wheel turn proves nothing, and is taken again."""
    wanted = BY_PATH[path].leased(status.LEASE_WITHOUT_S)
    for _ in range(TRIES):
        result = PathRun(stand, SIMULATED, wanted, BY_TURNING[velocity], None, random.Random()).perform()
        if UNSEEN not in result.wrong:
            return result
    raise AssertionError(f"{path}: {UNSEEN}, {TRIES} times")


@pytest.fixture
def board(tmp_path: Path) -> Iterator[SimBoard]:
    with SimBoard(tmp_path / "board") as running:
        yield running


@pytest.mark.slow
def test_the_main_paths_on_the_simulated_board(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """Every stop is written, answered and seen, and the wheels stand; how soon, is judged in test_starved_rows.py."""
    settings = tmp_path / "own.toml"
    settings.write_text(f"{status.LEASE} = {status.LEASE_WITHOUT_S}\n")
    out = tmp_path / "evidence"
    page = tmp_path / "evidence.html"
    words = ("--only", ",".join(ROWS), "--at", "0.2", "--config", str(settings), "--out", str(out), "--pack", str(page))
    done = prove("--sim", "--quick", "--json", *words)
    result = json.loads(done.stdout)
    rows = result["rows"]
    assert [row["path"] for row in rows] == list(ROWS)
    assert [firm(row["wrong"]) for row in rows] == [[]] * len(ROWS), done.stderr
    verdicts = {row["verdict"] for row in rows}
    assert "PASS" in verdicts, rows
    assert all(row["rest_s"] is not None for row in rows)
    # The times that it takes from shared memory are those of the board, and a stop has come before its answer.
    assert all(0 < row["board_ms"] < row["acknowledged_ms"] > row["written_ms"] > 0 for row in rows)
    assert min(abs(row["board_ms"] - row["written_ms"]) for row in rows) < 20
    assert rows[0]["written_ms"] >= 299
    assert result["character"]["still"]["most"] < 0.0035 < result["character"]["spinning"]["0.2"]["least"]
    (folder,) = out.iterdir()
    assert {"report.txt", "result.json"} <= {file.name for file in folder.iterdir()}
    record = json.loads(page.with_suffix(".json").read_text())
    assert f"evidence: {page}\n" in done.stderr
    assert main(["prove", "--check", str(page)]) == 0
    assert f"{result['verdict']}: {result['covers']}; " in capsys.readouterr().out
    # This board has no watchdog that a frozen service could leave the wheels to.
    whole = f"of {len(BY_PATH) - 1} stop paths, not each at every speed, on a SIMULATED board"
    assert result["covers"].endswith(whole)
    assert any(reason.startswith("stop-request, disable, pad, ") for reason in result["unproved"])
    assert page.read_text() == pack.page(record)
    assert record.items() >= {**result, "rows": [{**row, "samples": []} for row in rows]}.items()
    passed = verdicts == {"PASS"}
    assert ("\nPASS\n" in (folder / "report.txt").read_text()) is passed
    assert (done.returncode == 0) is passed


@pytest.mark.slow
def test_the_command_fails_on_a_board_that_does_not_stop(board: SimBoard, tmp_path: Path) -> None:
    board.refuse_stop(True)
    out = str(tmp_path / "evidence")
    done = prove("--device", board.link, "--only", "timeout", "--at", "0.2", "--quick", "--out", out, said=WORD)
    assert done.returncode == 1
    assert "THE WHEELS DID NOT COME TO REST" in done.stdout
    assert "POWER SWITCH" in done.stdout
    assert "\nFAIL\n" in done.stdout
    assert "PASS" not in done.stdout
    assert list(Path(out).iterdir()), "failures are evidence too"


@pytest.mark.slow
def test_a_timeout_that_is_set_too_long_fails(tmp_path: Path) -> None:
    with on_stand(tmp_path, **{"gate.command_timeout_s": 0.9}) as stand:
        result = one(stand, "timeout")
        assert result.verdict == "FAIL"
        assert result.written_ms is not None
        assert result.written_ms >= 899
        assert any(wrong.startswith("written after") for wrong in result.wrong)
        assert any(wrong.startswith("at rest after") for wrong in result.wrong)
        assert not result.runaway


class Blind(Driver):
    """A sensor that has failed once delivers nothing any more."""

    failed = False

    def step(self) -> None:
        self.failed = self.failed or not self.senses
        self.senses = self.senses and not self.failed
        super().step()


@pytest.mark.slow
def test_paths_that_the_short_form_leaves_out(tmp_path: Path) -> None:
    """With a user's settings beside those of the test: the user's limits hold, interlocks are asserted.
    And at last a sensor whose return does not move the wheels again fails its path."""
    with on_stand(tmp_path, **MINE) as stand:
        assert (stand.settings["limits.vx_mps"], stand.settings["limits.wz_radps"]) == (0.25, 1.5)
        for path in ("stop-request", "hang-supervisor", "pad", "kill-stopper"):
            result = one(stand, path, "turn")
            assert firm(result.wrong) == [], path
            assert stand.whole()
            assert not stand.driver.robot.state.enabled
        stand.driver.leave()
        stand.driver = Blind(stand.name, "prove", tuple(stand.settings.interlocks()))
        stand.driver.each = stand.look
        result = one(stand, "scan")
    assert result.verdict == "FAIL"
    assert firm(result.wrong) == ["the sensor is back, but the wheels do not turn again"]


def test_without_the_word_nothing_is_written(board: SimBoard) -> None:
    for said in ("", "SPIN\n"):
        done = prove("--device", board.link, said=said)
        assert done.returncode == 2
        assert "no consent: nothing was moved" in done.stderr
        assert "OFF THE GROUND" in done.stderr
        assert "POWER SWITCH" in done.stderr
    assert board.events() == []


def test_before_anything_moves_it_names_the_interlocks_that_it_asserts_itself(board: SimBoard, tmp_path: Path) -> None:
    path = tmp_path / "failstop.toml"
    path.write_text("[interlocks.arm_folded]\ntimeout_s = 0.5\n[interlocks.charger_off]\ntimeout_s = 0.5\n")
    done = prove("--device", board.link, "--config", str(path), said="")
    assert "THE TEST ITSELF ASSERTS YOUR INTERLOCKS: arm_folded, charger_off." in done.stderr
    assert "INTERLOCKS" not in prove("--device", board.link, said="").stderr


def test_a_service_that_runs_is_left_alone_and_hinders_no_simulated_board(board: SimBoard) -> None:
    name = f"prove-other-{os.getpid()}"
    with Trial(name) as trial:
        done = prove("--name", name, "--device", trial.link, said=WORD)
        assert done.returncode == 2
        supervisor = trial.service.pids()["supervisor"]
        assert f"end it first: sudo kill {supervisor}\n" in done.stderr  # it is in no unit
        done = prove("--device", trial.link, said=WORD)
        assert done.returncode == 2
        found = f"the service '{name}' (pid {supervisor}) has {trial.link} open; end it first: sudo kill {supervisor}\n"
        assert found in done.stderr
        done = prove("--name", name, "--device", board.link, said="no\n")
        assert (done.returncode, "no consent" in done.stderr) == (2, True), done.stderr
        # Of a robot's port it is not known whether the service is about to open it under another name.
        real = dataclasses.replace(System().node(board.link), pseudo=False)  # type: ignore[type-var]
        system = SimpleNamespace(node=lambda _: real, service=System().service)
        with pytest.raises(Refused, match=f"the service '{name}' is running"):
            check_free(board.link, name, system=system)  # type: ignore[arg-type]
        assert trial.service.ready()
        assert not any(event.is_motion for event in trial.board.events())
        os.kill(supervisor, signal.SIGTERM)
        wait_for("the service to end", trial.service.gone)
        check_free(trial.link, name)


def test_words_that_are_in_no_table(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["prove", "--sim", "--only", "timeout,earthquake"]) == 1
    assert "no stop path 'earthquake'" in capsys.readouterr().err
    assert main(["prove", "--sim", "--at", "9"]) == 1
    assert "no velocity '9'" in capsys.readouterr().err


@pytest.mark.parametrize("number", SIGNALS)
def test_every_signal_that_ends_a_program_is_an_interruption(number: int) -> None:
    before = signal.getsignal(number)
    with pytest.raises(KeyboardInterrupt), interruptible():
        signal.raise_signal(number)
    assert signal.getsignal(number) is before


@pytest.mark.slow
def test_an_interruption_stops_the_wheels_first(board: SimBoard, tmp_path: Path) -> None:
    command = [*FAILSTOP, "prove", "--device", board.link, "--quick", "--out", str(tmp_path / "evidence")]
    pipe = subprocess.PIPE
    with subprocess.Popen(command, stdin=pipe, stdout=pipe, stderr=pipe, text=True, start_new_session=True) as process:
        assert process.stdin is not None
        process.stdin.write(WORD)
        process.stdin.flush()
        wait_for("the wheels to turn", lambda: any(board.wheels()), 30)
        interrupted_ns = time.monotonic_ns()
        os.killpg(process.pid, signal.SIGHUP)
        stop = board.wait_for(lambda event: event.is_stop and event.arrival_ns > interrupted_ns, 30.0)
        out, _ = process.communicate(timeout=30)
    assert process.returncode == 130
    assert f"ENDED EARLY: interrupted; {CONFIRMED}" in out
    after = [event for event in board.events(since=0) if event.is_motor and event.arrival_ns > interrupted_ns]
    assert not any(event.is_motion for event in after if event.index > stop.index)
    assert after[-1].is_stop
    assert_nothing_runs(f"prove-{process.pid}")


@pytest.mark.slow
@pytest.mark.parametrize("back", [True, False])
def test_an_unplugged_board_is_waited_for_and_stopped(back: bool, board: SimBoard, tmp_path: Path) -> None:
    """Ctrl-C, with the plug out: nobody says that the wheels are stopped before the stop is on the board."""
    command = [*FAILSTOP, "prove", "--device", board.link, "--quick", "--out", str(tmp_path / "evidence")]
    with Terminal(*command, patience_s=60.0) as person:
        person.says("anything else to quit:", WORD.strip())
        board.wait_wheels(True, 60.0)
        board.unplug()
        person.presses(CTRL_C)
        assert "stopped" not in person.reads(f"{board.link} is unplugged: {MAY_TURN}. Plug it in again")
        assert any(board.wheels())
        if back:
            board.replug()
            person.reads(f"ENDED EARLY: interrupted; {CONFIRMED}")
            assert not any(board.wheels())
        else:
            person.presses(CTRL_C)
            person.reads(f"ENDED EARLY: interrupted; {board.link} is unplugged: {MAY_TURN}")
        assert person.ends() == (130 if back else 1)
    (record,) = tmp_path.glob("evidence/*/result.json")
    assert (CONFIRMED in json.loads(record.read_text())["ended"]) == back


@pytest.mark.slow
def test_a_test_that_is_killed_takes_its_service_along(board: SimBoard) -> None:
    command = [*FAILSTOP, "prove", "--device", board.link, "--quick"]
    with subprocess.Popen(command, stdin=subprocess.PIPE, stdout=subprocess.DEVNULL, text=True) as process:
        process.stdin.write(WORD)  # type: ignore[union-attr]
        process.stdin.flush()  # type: ignore[union-attr]
        wait_for("the wheels to turn", lambda: any(board.wheels()), 30)
        process.kill()
    board.wait_wheels(False, 30.0)
    wait_for("the service to end", lambda: not any(f"name=prove-{process.pid} " in line for line in command_lines()))
    assert board.events()[-1].is_stop


@pytest.mark.slow
def test_a_stand_that_is_left_while_the_service_hangs_is_safe(tmp_path: Path) -> None:
    with SimBoard(tmp_path / "board") as board:
        with ProveStand(board.link, {}, str(tmp_path), board) as stand:
            stand.driver.velocity = (0.2, 0.0, 0.0)
            stand.driver.enable()
            stand.run(5.0, lambda: any(board.wheels()))
            assert any(board.wheels())
            pids = stand.service.pids()
            os.kill(pids["supervisor"], signal.SIGSTOP)
            os.kill(pids["port_owner"], signal.SIGSTOP)
            name = stand.name
        assert stand.outcome
        assert stand.outcome.sentence() == CONFIRMED
        assert not any(board.wheels())
        assert [event for event in board.events() if event.is_motor][-1].is_stop
        assert_nothing_runs(name)


def assert_nothing_runs(name: str) -> None:
    assert not [file for file in os.listdir("/dev/shm") if file.startswith(f"failstop.{name}.")]
    assert not os.path.exists(f"/run/failstop/{name}")
    assert not any(f"name={name} " in line for line in command_lines())


def command_lines() -> list[str]:
    found = []
    for pid in filter(str.isdigit, os.listdir("/proc")):
        with contextlib.suppress(OSError):
            found.append(Path(f"/proc/{pid}/cmdline").read_text().replace("\0", " "))
    return found
