"""Anyone may stop: whatever arrives in the stop pipe, from whomever."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import time

import pytest

from failstop.api import verdict
from failstop.api.client import send_stop
from failstop.files import instance
from failstop.lab.trial import Trial, judge, wait_for
from failstop.policy import causes
from failstop.supervisor.events import REPEATS_BYTES as ASKED_ROOM
from tests.support.children import NOBODY, call
from tests.support.shared_trial import set_off
from tests.support.simulated import MS, Simulated


def _stop_pipe(trial: Trial) -> str:
    return instance.stop_path(instance.find(trial.name))


@pytest.mark.claim("ASK-1")
def test_by_an_unprivileged_user(trial: Trial) -> None:
    set_off(trial)
    asked_ns = time.monotonic_ns()
    call(lambda: send_stop(trial.name, "nobody says so"), NOBODY if os.getuid() == 0 else -1)
    trial.drive(0.2)
    stopped = judge(trial.board.events(), asked_ns, True)
    assert stopped.stop_ns is not None
    assert stopped.motion_after == 0
    assert trial.robot.state.estop == "stop request: nobody says so"


def test_a_full_pipe_is_a_stop_and_the_service_works_on(trial: Trial) -> None:
    trial.enable()
    trial.drive(0.1)
    fd = os.open(_stop_pipe(trial), os.O_WRONLY | os.O_NONBLOCK)
    with pytest.raises(BlockingIOError) as full:  # noqa: PT012 - fills it faster than it is read, or gives up
        for _ in range(10_000):
            os.write(fd, b"flood " * 600)
        raise BlockingIOError(errno.EAGAIN, "was read as fast as it was filled")
    os.close(fd)
    assert full.value.errno == errno.EAGAIN
    wait_for("the latch", lambda: trial.robot.state.estop is not None)
    trial.board.wait_wheels(turning=False, timeout_s=5.0)
    wait_for("a service that is whole", lambda: trial.robot.state.waiting_for is None)
    wait_for("an end of the flood", lambda: _can_reset(trial))
    set_off(trial)


def _can_reset(trial: Trial) -> bool:
    try:
        trial.robot.reset()
    except Exception:
        return False
    time.sleep(0.05)
    return trial.robot.state.estop is None


def test_a_flood_is_no_flood_of_bursts(trial: Trial) -> None:
    trial.board.events()
    fd = os.open(_stop_pipe(trial), os.O_WRONLY | os.O_NONBLOCK)
    start_s = time.monotonic()
    while time.monotonic() < start_s + 0.5:
        with contextlib.suppress(BlockingIOError):
            os.write(fd, b"again\n")
    os.close(fd)
    stops = sum(event.is_stop for event in trial.board.events())
    took_s = time.monotonic() - start_s
    # A burst has four stop frames, and one goes out every 20 ms; twice as many, for their repeats and the 5 Hz zeros.
    assert stops < 2 * 4 * took_s / 0.02
    wait_for("a service that is whole", lambda: trial.robot.state.waiting_for is None)


# What is asked for, on the simulated machine.

BESIDE = re.compile("^failstop: (stopped again|also): gate died\\b", re.M)


def write(simulated: Simulated, data: bytes) -> int:
    """Any bytes in the stop pipe; how many it has taken."""
    fd = simulated.os.open(f"/run/failstop/{simulated.name}/stop", os.O_WRONLY | os.O_NONBLOCK)
    try:
        found: int = simulated.os.write(fd, data)
    except BlockingIOError:
        found = 0
    simulated.os.close(fd)
    return found


@pytest.mark.claim("ASK-1")
def test_any_bytes_are_a_stop(simulated: Simulated) -> None:
    for message in (b"\0", b"\xff\xfe\n\n", b"x" * 4000, b"\n", b"a\x1b[2Jb\n"):
        simulated.set_off()
        asked_ns = simulated.now_ns()
        write(simulated, message)
        simulated.drive(0.1)
        stopped = judge(simulated.board.events(), asked_ns, True)
        assert stopped.stop_ns is not None, message
        assert stopped.stop_ns <= 2 * MS
        assert stopped.motion_after == 0
        assert simulated.robot.state.estop
        assert simulated.robot.state.estop.isprintable()


@pytest.mark.claim("CAUSE-1")
def test_while_disabled_it_latches_and_the_first_reason_is_kept(simulated: Simulated) -> None:
    simulated.robot.estop("one")
    simulated.robot.wait_for("latched", 1.0)
    epoch = simulated.robot.state.epoch
    simulated.robot.estop("two")
    simulated.wait_for("the second stop", lambda: simulated.robot.state.epoch > epoch)
    state = simulated.robot.state
    assert state.estop == state.last_stop.reason == f"stop request: one (trial, pid {simulated.pid})"


@pytest.mark.parametrize("words", ["gate died", str(causes.UNSTILL()), "gamepad button 0x0100", "stop request"])
def test_nobody_s_words_pass_for_a_cause_of_the_service_s_own(simulated: Simulated, words: str) -> None:
    simulated.enable()
    simulated.load("failstop.api.client").send_stop(simulated.name, words)
    simulated.robot.wait_for("latched", 1.0)
    state = simulated.robot.state
    assert state.estop == f"stop request: {words}"
    assert state.cause == simulated.load("failstop.policy.causes").PIPED(words)
    assert verdict.word(state) == verdict.STOPPED, "what the IMU sees is not for anybody to say"
    assert all(process.restarts == 0 for process in state.processes.values())
    simulated.die("gate")
    simulated.wait_for("the death to be told beside it", lambda: BESIDE.search(simulated.said) is not None)
    assert simulated.robot.state.estop == f"stop request: {words}"


def test_a_thousand_reasons_at_full_speed_do_not_fill_the_log(simulated: Simulated) -> None:
    simulated.robot.estop("the first")
    simulated.wait_for("the latch", lambda: "STOP latched: " in simulated.said)
    before = len(simulated.said)
    until_ns, reasons = simulated.now_ns() + 4000 * MS, 0
    while reasons < 1000 or simulated.now_ns() < until_ns:
        reasons += write(simulated, f"reason {reasons} {'x' * 150}\n".encode()) > 0
        simulated.wait(0.002)
    assert len(simulated.said) - before < 2 * ASKED_ROOM + 2000
    simulated.kill("gate")
    told = "what is no request to be told"
    simulated.wait_for(told, lambda: BESIDE.search(simulated.said[before:]) is not None)
    assert simulated.end() == 0
    assert "STOP latched: stop request: the first (trial, pid" in simulated.said
    assert re.search(r"^failstop: \d+ stop requests while a stop was latched were left out: ", simulated.said, re.M)
    assert len(simulated.said) - before < 2 * ASKED_ROOM + 10_000


@pytest.mark.parametrize("letter", ["x", "\u20ac"])
def test_a_reason_of_5000_characters_is_cut_to_what_the_service_takes(simulated: Simulated, letter: str) -> None:
    code, out, err = simulated.command("estop", 5000 * letter)
    assert (code, out.count("\n"), err) == (0, 1, "")
    latch = simulated.robot.state.estop
    assert re.fullmatch(rf"stop request: {letter}+ \.\.\. \(failstop estop, pid \d+\)", latch)
    assert latch in out
    simulated.robot.reset()
    simulated.robot.estop(5000 * letter)
    simulated.robot.wait_for("latched", 1.0)
    assert re.fullmatch(rf"stop request: {letter}+ \.\.\. \(trial, pid \d+\)", simulated.robot.state.estop)
    assert all(len(line) < 1000 for line in simulated.said.splitlines())


def test_mode_button_and_other_keys_do_not_stop(simulated: Simulated) -> None:
    simulated.enable()
    simulated.board.pad(0x2000)
    simulated.board.key(2, 0x01)
    simulated.board.key(1, 0x08)
    # MODE gives the wheels to the sticks, which rest: the client has them back after the pad's timeout.
    simulated.drive(0.8)
    assert simulated.turning()
    assert simulated.robot.state.estop is None
