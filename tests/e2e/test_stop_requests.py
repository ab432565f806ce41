"""Anyone may stop: whatever arrives in the stop pipe, from whomever."""

from __future__ import annotations

import contextlib
import errno
import os
import re
import signal
import time

import pytest

from failstop.api import verdict
from failstop.api.client import send_stop
from failstop.lab.trial import Trial, judge, wait_for
from failstop.policy import causes
from failstop.shm import instance
from failstop.supervisor.events import ASKED_BYTES as ASKED_ROOM
from tests.support.children import NOBODY, become
from tests.support.commands import failstop

FLOOD_S = 4.0


def _as_nobody(action: object) -> int:
    """Run `action()` in a child of user nobody; returns its exit code."""
    pid = os.fork()
    if pid == 0:
        code = 1
        try:
            if os.getuid() == 0:
                become(NOBODY)
            action()  # type: ignore[operator]
            code = 0
        finally:
            os._exit(code)
    return os.waitstatus_to_exitcode(os.waitpid(pid, 0)[1])


def _stop_pipe(trial: Trial) -> str:
    return instance.stop_path(instance.find(trial.name))


def test_by_an_unprivileged_user(trial: Trial) -> None:
    trial.enable()
    trial.drive(0.2)
    assert trial.moving()
    trial.board.events()
    asked_ns = time.monotonic_ns()
    assert _as_nobody(lambda: send_stop(trial.name, "nobody says so")) == 0
    trial.drive(0.2)
    stopped = judge(trial.board.events(), asked_ns, True)
    assert stopped.stop_ns is not None
    assert stopped.motion_after == 0
    assert trial.robot.state.estop == "stop request: nobody says so"


@pytest.mark.parametrize("message", [b"\0", b"\xff\xfe\n\n", b"x" * 4000, b"\n", b"a\x1b[2Jb\n"])
def test_any_bytes_are_a_stop(trial: Trial, message: bytes) -> None:
    trial.enable()
    trial.drive(0.1)
    fd = os.open(_stop_pipe(trial), os.O_WRONLY | os.O_NONBLOCK)
    os.write(fd, message)
    os.close(fd)
    wait_for("the latch", lambda: trial.robot.state.estop is not None)
    trial.drive(0.1)
    assert not trial.moving()
    assert (trial.robot.state.estop or "").isprintable()


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
    trial.board.wait_wheels(moving=False, timeout_s=2.0)
    wait_for("a service that is whole", lambda: trial.robot.state.waiting_for is None)
    wait_for("an end of the flood", lambda: _can_reset(trial))
    trial.robot.enable()
    trial.drive(0.1)
    assert trial.moving()


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


def test_while_disabled_it_latches_too(trial: Trial) -> None:
    trial.robot.estop("early")
    wait_for("the latch", lambda: (trial.robot.state.estop or "").startswith("stop request: early"))


def test_the_first_reason_is_kept(trial: Trial) -> None:
    trial.robot.estop("one")
    wait_for("the latch", lambda: trial.robot.state.estop is not None)
    epoch = trial.robot.state.epoch
    trial.robot.estop("two")
    wait_for("the second stop", lambda: trial.robot.state.epoch > epoch)
    assert (trial.robot.state.estop or "").startswith("stop request: one")
    last = trial.robot.state.last_stop
    assert last is not None


def test_pad_button_and_key_stop(trial: Trial) -> None:
    for press, cause in (
        (lambda: trial.board.pad(0x0100), causes.BUTTON(0x0100)),
        (lambda: trial.board.key(1, 0x01), causes.KEY(1)),
    ):
        trial.enable()
        trial.drive(0.15)
        assert trial.moving()
        trial.board.events()
        pressed_ns = time.monotonic_ns()
        press()
        trial.drive(0.2)
        stopped = judge(trial.board.events(), pressed_ns, True)
        assert stopped.stop_ns is not None
        assert stopped.stop_ns < 100e6
        assert stopped.motion_after == 0
        assert trial.robot.state.cause == cause
        assert trial.robot.state.estop == str(cause)
        trial.board.pad(0)


@pytest.mark.parametrize("words", ["gate died", str(causes.UNSTILL()), "gamepad button 0x0100", "stop request"])
def test_nobody_s_words_pass_for_a_cause_of_the_service_s_own(trial: Trial, words: str) -> None:
    trial.enable()
    assert _as_nobody(lambda: send_stop(trial.name, words)) == 0
    wait_for("the latch", lambda: trial.robot.state.estop is not None)
    state = trial.robot.state
    assert state.estop == f"stop request: {words}"
    assert state.cause == causes.PIPED(words)
    assert verdict.word(state) == verdict.STOPPED, "what the IMU sees is not for anybody to say"
    assert all(process.restarts == 0 for process in state.processes.values())
    killed_pid = state.processes["gate"].pid
    os.kill(killed_pid, signal.SIGKILL)
    beside = re.compile("^failstop: (stopped again|also): gate died\\b", re.M)
    wait_for("the death to be told beside it", lambda: beside.search(trial.service.said()) is not None)
    assert trial.robot.state.estop == f"stop request: {words}"


def test_a_thousand_reasons_at_full_speed_do_not_fill_the_log(trial: Trial) -> None:
    trial.robot.estop("the first")
    wait_for("the latch", lambda: "STOP latched: " in trial.service.said())
    before = trial.service.written()
    fd = os.open(_stop_pipe(trial), os.O_WRONLY | os.O_NONBLOCK)
    until_s = time.monotonic() + FLOOD_S
    reasons = 0
    while reasons < 1000 or time.monotonic() < until_s:
        with contextlib.suppress(BlockingIOError):
            os.write(fd, f"reason {reasons} {'x' * 150}\n".encode())
            reasons += 1
    os.close(fd)
    assert trial.service.written() - before < 2 * ASKED_ROOM + 2000
    trial.kill("gate")
    beside = re.compile("^failstop: (stopped again|also): gate died\\b", re.M)
    wait_for("what is no request to be told", lambda: beside.search(trial.service.said(before)) is not None)
    assert trial.service.end() == 0
    said = trial.service.said()
    assert "STOP latched: stop request: the first (trial, pid" in said
    assert re.search(r"^failstop: \d+ stop requests while a stop was latched were left out: ", said, re.M)
    assert trial.service.written() - before < 2 * ASKED_ROOM + 10_000


@pytest.mark.parametrize("letter", ["x", "\u20ac"])
def test_a_reason_of_5000_characters_is_cut_to_what_the_service_takes(trial: Trial, letter: str) -> None:
    result = failstop("estop", "--name", trial.name, 5000 * letter)
    assert (result.returncode, result.stdout.count("\n"), result.stderr) == (0, 1, "")
    latch = trial.robot.state.estop or ""
    assert re.fullmatch(rf"stop request: {letter}+ \.\.\. \(failstop estop, pid \d+\)", latch)
    assert latch in result.stdout
    trial.robot.reset()
    trial.robot.estop(5000 * letter)
    wait_for("the latch", lambda: trial.robot.state.estop is not None)
    assert re.fullmatch(rf"stop request: {letter}+ \.\.\. \(trial, pid \d+\)", trial.robot.state.estop or "")
    assert all(len(line) < 1000 for line in trial.service.said().splitlines())


def test_mode_button_and_other_keys_do_not_stop(trial: Trial) -> None:
    trial.enable()
    trial.board.pad(0x2000)
    trial.board.key(2, 0x01)
    trial.board.key(1, 0x08)
    # MODE gives the wheels to the sticks, which rest: the client has them back after the pad's timeout.
    trial.drive(0.8)
    assert trial.moving()
    assert trial.robot.state.estop is None
