"""A machine that does not run the stand test in time: what it spoils is INVALID, and what it cannot excuse fails."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import sys
import time
from collections.abc import Callable
from pathlib import Path
from types import SimpleNamespace

import pytest

from failstop.api.client import send_stop
from failstop.policy import causes
from failstop.policy.causes import Cause
from failstop.supervisor import status
from failstop_lab.faults import processes
from failstop_lab.prove import character, report, session, table
from failstop_lab.prove.character import MOUNTED, Restless, Unfit
from failstop_lab.prove.held import WOKEN_LATE_NS, Held, waited_ns
from failstop_lab.prove.report import Evidence
from failstop_lab.prove.run import PathRun, Result, judge_latch
from failstop_lab.prove.stand import ProveStand
from failstop_lab.prove.table import ARM_PATHS, BY_PATH, BY_TURNING, PATHS
from failstop_lab.sim.client import Event, SimBoard
from failstop_lab.trial import wait_for
from tests.lab.prove.judged import MEANS, MS, UNSEEN, run, wrong
from tests.lab.prove.noise import DRIVE, SIMULATED, STILL, gyro
from tests.lab.prove.stands import on_stand
from tests.support.board_events import FAULT_NS, TURNING, event
from tests.support.board_events import STILL as REST


def result(**changed: object) -> Result:
    return Result(BY_PATH["stop-request"], BY_TURNING["0.2"], simulated=True, **changed)  # type: ignore[arg-type]


@pytest.mark.parametrize(
    ("wrong", "doubts", "starved", "runaway", "verdict"),
    [
        ([], [], "", False, "PASS"),
        ([], [], "held", False, "PASS"),
        (["late"], ["late"], "", False, "FAIL"),
        (["late"], ["late"], "held", False, "INVALID"),
        (["late", "NO STOP"], ["late"], "held", False, "FAIL"),
        (["late"], ["late"], "held", True, "FAIL"),
    ],
)
def test_what_a_starved_machine_brings_about_is_invalid(
    wrong: list[str], doubts: list[str], starved: str, runaway: bool, verdict: str
) -> None:
    assert result(wrong=wrong, doubts=doubts, starved=starved, runaway=runaway).verdict == verdict
    assert verdict in report.VERDICT_STYLES


Change = Callable[[PathRun], object]
LATE_MS = BY_PATH["stop-request"].reaction_bar_ms(simulated=True) + 0.1


def shakes(*stretches: tuple[float, float]) -> Change:
    samples = gyro(*stretches, bias=0.0, start_ns=FAULT_NS - 1_000 * MS)
    return lambda made: setattr(made.stand.watch, "samples", samples)


def sees(*events: Event) -> Change:
    return lambda made: setattr(made.stand.board, "events", lambda: list(events))


def answers(written_ms: float, answered_ms: float, by: str = "port_owner") -> Change:
    written_ns, answered_ns = (FAULT_NS + round(ms * MS) for ms in (written_ms, answered_ms))

    def change(made: PathRun) -> None:
        made.stand.watch.written = [(written_ns, by)]
        made.stand.watch.answers = [(written_ns + MS, answered_ns)]

    return change


def latched(cause: Cause | None) -> SimpleNamespace:
    return SimpleNamespace(cause=cause, estop=cause and str(cause))


def latches(cause: Cause | None) -> Change:
    return lambda made: setattr(made.stand.driver.robot, "state", latched(cause))


EXCUSABLE: dict[str, Change] = {
    "at the board after": sees(event(0, LATE_MS, REST)),
    "written after": answers(LATE_MS, LATE_MS + 5, "stopper"),
    "acknowledged after 1002 ms": answers(1, table.ACKNOWLEDGED_MS + 2),
    UNSEEN: shakes((3.0, STILL)),
    "at rest after": shakes((1.0, DRIVE), (1.0, DRIVE), (1.5, STILL)),
}
WRONG = (None, causes.KEY(1), causes.PIPED("another"), causes.DIED("prove"))
FIRM: dict[str, Change] = {
    "NO STOP written": lambda made: setattr(made.stand.watch, "written", []),
    "not acknowledged": lambda made: setattr(made.stand.watch, "answers", []),
    "1 motion frames after the stop": sees(event(0, 1.0, REST), event(1, 2.0, TURNING), event(2, 3.0, REST)),
    "the board has seen NO STOP": sees(),
    **{f"latched: {cause}, not piped prove": latches(cause) for cause in WRONG},
    "THE WHEELS DID NOT COME TO REST": shakes((5.0, DRIVE)),
    "the IMU is silent": shakes((1.0, DRIVE)),
    "the service ended with exit code 3": PathRun.check_end,
}


@pytest.mark.parametrize("what", [*EXCUSABLE, *FIRM])
def test_a_starved_machine_excuses_a_late_time_and_no_stop_that_is_not_there(what: str) -> None:
    made = run("service-stop" if what.startswith("the service") else "stop-request")
    (EXCUSABLE | FIRM)[what](made)
    assert any(fault.startswith(what) for fault in wrong(made)), made.result.wrong
    assert made.result.verdict == "FAIL"
    assert made.result.runaway is (what in ("the IMU is silent", "THE WHEELS DID NOT COME TO REST"))
    made.result.starved = "held"
    assert made.result.verdict == ("INVALID" if what in EXCUSABLE else "FAIL"), made.result.wrong


@pytest.mark.parametrize(("goes_on_ms", "verdict"), [(400.0, "INVALID"), (900.0, "FAIL")])
def test_commands_that_pause_may_go_on_until_the_sensor_counts(goes_on_ms: float, verdict: str) -> None:
    made = run("scan", latch=None)
    made.stand.watch.zeros = [FAULT_NS + MS]
    sees(event(0, 300.0, REST), event(1, goes_on_ms, TURNING), event(2, goes_on_ms + 100, REST))(made)
    assert wrong(made) == ["1 motion frames after the stop"]
    assert made.result.verdict == "FAIL"
    made.result.starved = "held"
    assert made.result.verdict == verdict


def test_a_run_that_is_in_time_to_the_last_moment_is_right() -> None:
    assert wrong(run()) == wrong(run(events=[event(0, LATE_MS - 0.2, REST)])) == []


@pytest.mark.parametrize(
    ("cause", "starved", "verdict"),
    [
        (causes.HANGS("supervisor", 60), "", "FAIL"),
        (causes.HANGS("supervisor", 60), "held", "INVALID"),
        (causes.STARVED("gate", 260), "", "INVALID"),
        (causes.HELD_UP(300), "", "INVALID"),
        (causes.OPERATOR_GONE("stand test", "was not heard for 1200 ms"), "", "FAIL"),
        (causes.OPERATOR_GONE("stand test", "was not heard for 1200 ms"), "held", "INVALID"),
        (causes.DIED("gate"), "held", "FAIL"),
        (None, "held", "FAIL"),
    ],
)
def test_a_stop_for_somebody_who_was_not_run_spoils_the_row(cause: Cause | None, starved: str, verdict: str) -> None:
    found = result(starved=starved)
    judge_latch(found, latched(cause), BY_PATH["stop-request"].latched)  # type: ignore[arg-type]
    assert found.verdict == verdict


def test_an_invalid_row_says_what_to_do() -> None:
    found = result(starved="this test was not run for 210 ms")
    found.doubt("written after 190.0 ms, the bar is 102")
    line = report.row(found)
    assert "INVALID the machine was starved (this test was not run for 210 ms): repeat on a quieter one" in line
    assert "written after 190.0 ms" in line


def evidence(*verdicts: str, ended: str = "", spoiled: bool = False) -> Evidence:
    found = Evidence("/dev/any", simulated=True, realtime=True, ended=ended, spoiled=spoiled)
    for verdict in verdicts:
        row = result(starved="held" if verdict == "INVALID" else "", skipped="nobody" if verdict == "SKIP" else "")
        if verdict in ("INVALID", "FAIL"):
            row.doubt("late")
        assert row.verdict == verdict
        found.results.append(row)
    return found


@pytest.mark.parametrize(
    ("found", "verdict", "code"),
    [
        (evidence("PASS", "SKIP"), "PASS", 0),
        (evidence(), "FAIL", 1),
        (evidence("PASS", "FAIL"), "FAIL", 1),
        (evidence("PASS", "INVALID"), "INVALID", 1),
        (evidence("PASS", "INVALID", "FAIL"), "FAIL", 1),
        (evidence("SKIP"), "FAIL", 1),
        (evidence("PASS", ended="the IMU can't tell"), "FAIL", 1),
        (evidence(ended="the IMU can't tell", spoiled=True), "INVALID", 1),
        (evidence("PASS", "FAIL", ended="no service", spoiled=True), "FAIL", 1),
        (evidence("PASS", "INVALID", ended=session.NOT_SEEN_AT_REST), "FAIL", 1),
        (evidence("PASS", "INVALID", ended=report.INTERRUPTED), "FAIL", 130),
    ],
)
def test_the_sum_is_invalid_when_what_failed_was_spoiled(found: Evidence, verdict: str, code: int) -> None:
    assert (found.verdict, found.exit_code) == (verdict, code)
    assert (found.passed, found.as_dict()["passed"]) == (verdict == "PASS", verdict == "PASS")
    assert (f"\n{verdict}\n" in report.text(found), found.as_dict()["verdict"]) == (True, verdict)
    assert report.last_lines(found)[-2] == verdict
    assert ("1 invalid" in report.last_lines(found)[0]) == any(row.verdict == "INVALID" for row in found.results)


def test_lateness_is_counted_since_a_moment() -> None:
    held, now_ns = Held(), time.monotonic_ns()
    held.woken(0, WOKEN_LATE_NS - 1)
    assert held.starved((0, now_ns)) == ""
    held.woken(0, 80 * MS)
    held.woken(1_000 * MS, 1_060 * MS)
    assert held.longest(0) == (80 * MS, "this test")
    assert held.starved((81 * MS, now_ns)) == "this test was not run for 60 ms"
    assert held.starved((2_000 * MS, now_ns)) == ""
    assert held.starved((2_000 * MS, now_ns), causes.HELD_UP(300)) == str(causes.HELD_UP(300))
    assert held.starved((2_000 * MS, now_ns), causes.KEY(1)) == ""


def test_others_that_wait_for_a_processor_are_named() -> None:
    waits = {7: 5_000 * MS, 8: 0}
    held = Held(others=lambda: {"gate": 7, "the simulated board": 8, "stopper": 0})
    for at_ns, gate_ms, board_ms in ((100 * MS, 49, 0), (200 * MS, 0, 60), (300 * MS, 49, 0)):
        held.look(at_ns, waits.__getitem__)
        waits[7] += gate_ms * MS
        waits[8] += board_ms * MS
    held.look(400 * MS, waits.__getitem__)
    assert held.longest(0) == (60 * MS, "the simulated board")
    assert held.longest(301 * MS) == (0, "")


def test_a_row_that_the_machine_spoils_is_taken_again() -> None:
    """No more than a few times, and one that failed, or after which none can follow, is not."""
    spoiled = [result(wrong=["late"], doubts=["late"], starved=f"held {number}") for number in range(9)]
    told: list[Result] = []
    found = session.until_valid(iter([*spoiled[:2], result()]).__next__, told.append)
    assert (found.verdict, found.again, told) == ("PASS", ["held 0", "held 1"], spoiled[:2])
    assert "measured 3 times" in report.row(found)
    assert session.until_valid(iter(spoiled).__next__, told.append).verdict == "INVALID"
    for last in (result(wrong=["NO STOP"]), result(wrong=["late"], doubts=["late"], starved="held", over="no service")):
        assert session.until_valid(iter([last]).__next__, told.append).again == []


@pytest.mark.parametrize(("share", "told"), [(0.19, ""), (0.3, "this test waited for a processor for 30% of the time")])
def test_waiting_for_a_processor_counts(share: float, told: str) -> None:
    held = Held(lambda: (5_000 * MS, 700 * MS))
    assert held.starved((4_000 * MS, round((700 - 1_000 * share) * MS))) == told


def test_the_kernel_counts_the_waiting() -> None:
    before_ns = waited_ns()
    assert waited_ns() >= before_ns > 0


STOPPED = """
import os, signal, time
from failstop_lab.prove.held import Held
with Held() as held:
    os.kill(os.getpid(), signal.SIGSTOP)
    while not held.longest(0)[0]:
        time.sleep(0.001)
print(held.longest(0)[0])
"""


def test_a_process_that_was_not_run_knows_it() -> None:
    with subprocess.Popen([sys.executable, "-c", STOPPED], stdout=subprocess.PIPE, text=True) as process:
        stat = Path(f"/proc/{process.pid}/stat")
        wait_for("it to be stopped", lambda: stat.read_text().rpartition(") ")[2][0] == "T")
        stopped_ns = time.monotonic_ns()
        wait_for("some time to pass", lambda: time.monotonic_ns() - stopped_ns > 2 * WOKEN_LATE_NS)
        os.kill(process.pid, signal.SIGCONT)
        said, _ = process.communicate(timeout=30)
    assert int(said) >= WOKEN_LATE_NS


@pytest.mark.parametrize("simulated", [True, False])
def test_advice_fits_the_board(simulated: bool) -> None:
    driver = SimpleNamespace(robot=SimpleNamespace(disable=str), enable=str)
    settings = {"still.std_radps": 0.0035, "limits.acceleration_mps2": 0.5, "limits.acceleration_radps2": 2.0}
    watch = SimpleNamespace(samples=gyro((2.0, STILL)), forget=str)
    stand = SimpleNamespace(
        settings=settings, driver=driver, board=simulated or None, run=lambda *_: True, watch=watch, means=MEANS
    )
    with pytest.raises(Unfit) as error:
        character.characterize(stand, [BY_TURNING["0.2"]], quick=True)  # type: ignore[arg-type]
    assert (MOUNTED in str(error.value)) is not simulated
    assert ("quieter machine" in str(error.value)) is simulated


@pytest.mark.slow
@pytest.mark.parametrize(("error", "verdict"), [(Unfit("no rest"), "INVALID"), (Restless("NO REST"), "FAIL")])
def test_a_session_that_the_machine_spoils_ends_as_invalid(tmp_path: Path, error: Exception, verdict: str) -> None:
    def breaks_off(_: str) -> None:
        stand.held.woken(time.monotonic_ns() - 2 * WOKEN_LATE_NS, time.monotonic_ns())
        raise error

    with SimBoard(tmp_path / "board") as board:
        stand = ProveStand(board.link, {}, str(tmp_path), board)
        found = session.session([], [], stand, say=breaks_off)
    assert found.verdict == verdict
    assert str(error) in found.ended
    assert ("the machine was starved" in found.ended) is (verdict == "INVALID")


@pytest.mark.slow
def test_a_stop_before_the_cause_spoils_the_row(tmp_path: Path) -> None:
    with on_stand(tmp_path) as stand:
        asked: list[int] = []

        def each() -> None:
            stand.look()
            if not asked and stand.board and max(map(abs, stand.board.wheels())) > 0.7:
                asked.append(time.monotonic_ns())
                stand.held.woken(asked[0] - 2 * WOKEN_LATE_NS, asked[0])
                send_stop(stand.name, "somebody")

        stand.driver.each = each
        found = PathRun(stand, SIMULATED, BY_PATH["disable"], BY_TURNING["0.2"], None, random.Random()).perform()
        assert [text for text in found.wrong if "stopped, but not by the test: stop request: somebody" in text]
        assert found.verdict == "INVALID", found.wrong
        assert stand.whole(), "the next row finds a service"
    found.starved = ""
    assert found.verdict == "FAIL", "on a machine that runs everybody"


def test_bars_of_a_lease_are_those_of_the_lease_in_force() -> None:
    longer = {path.name for path in (*PATHS, *ARM_PATHS) if path.leased(status.LEASE_WITHOUT_S) != path}
    struck = {"hang-gate", "hang-supervisor", "hang-port_owner"}
    assert longer == struck | {"arm-hang-supervisor", "arm-hang-port_owner"}
    for name in struck:
        before, after = BY_PATH[name], BY_PATH[name].leased(status.LEASE_WITHOUT_S)
        assert after.reaction_ms == 1e3 * status.LEASE_WITHOUT_S + processes.SLACK_MS
        for velocity in BY_TURNING.values():
            later_s = (after.reaction_ms - before.reaction_ms) / 1e3
            assert after.rest_bar_s(velocity) - before.rest_bar_s(velocity) == pytest.approx(later_s)
    assert all(path.leased(0.0) == path for path in (*PATHS, *ARM_PATHS))
