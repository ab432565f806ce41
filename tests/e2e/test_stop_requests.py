"""Anyone may stop: whatever arrives in the stop pipe, from whomever."""

from __future__ import annotations

import os
import re

import pytest

from failstop.api import verdict
from failstop.policy import causes
from tests.support.simulated import Simulated

BESIDE = re.compile("^failstop: (stopped again|also): gate died\\b", re.M)


@pytest.mark.claim("ASK-1")
def test_any_bytes_are_a_stop(simulated: Simulated) -> None:
    for message in (b"\0", b"\xff\xfe\n\n", b"x" * 4000, b"\n", b"a\x1b[2Jb\n"):
        simulated.set_off()
        asked_ns = simulated.now_ns()
        fd = simulated.os.open(f"/run/failstop/{simulated.name}/stop", os.O_WRONLY | os.O_NONBLOCK)
        simulated.os.write(fd, message)
        simulated.os.close(fd)
        simulated.drive(0.1)
        simulated.stops(asked_ns, 2)
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
    assert state.estop == state.last_stop.reason == f"stop request: one (says it is trial, pid {simulated.pid})"


@pytest.mark.parametrize("words", ["gate died", str(causes.UNSTILL()), "gamepad button 0x0100", "stop request"])
def test_nobody_s_words_pass_for_a_cause_of_the_service_s_own(simulated: Simulated, words: str) -> None:
    simulated.enable()
    simulated.load("failstop.api.client").send_stop(simulated.name, words)
    simulated.robot.wait_for("latched", 1.0)
    state = simulated.robot.state
    assert state.estop == f"stop request: {words}"
    assert state.cause == simulated.load("failstop.policy.causes").PIPED(words)
    assert verdict.word(state) == verdict.TOLD_TO_STOP, "what the IMU sees is not for anybody to say"
    assert all(process.restarts == 0 for process in state.processes.values())
    simulated.die("gate")
    simulated.wait_for("the death to be told beside it", lambda: BESIDE.search(simulated.said) is not None)
    assert simulated.robot.state.estop == f"stop request: {words}"


@pytest.mark.parametrize("letter", ["x", "\u20ac"])
def test_a_reason_of_5000_characters_is_cut_to_what_the_service_takes(simulated: Simulated, letter: str) -> None:
    code, out, err = simulated.command("estop", 5000 * letter)
    assert (code, out.count("\n"), err) == (0, 1, "")
    latch = simulated.robot.state.estop
    assert re.fullmatch(rf"stop request: {letter}+ \.\.\. \(says it is failstop estop, pid \d+\)", latch)
    assert latch.split(" (says")[0] in out, "people know that it was their own command"
    simulated.robot.reset()
    simulated.robot.estop(5000 * letter)
    simulated.robot.wait_for("latched", 1.0)
    assert re.fullmatch(rf"stop request: {letter}+ \.\.\. \(says it is trial, pid \d+\)", simulated.robot.state.estop)
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
