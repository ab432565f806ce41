"""The gamepad on the running service: MODE, the sticks, a button, and the reset by holding MODE."""

from __future__ import annotations

import time

from failstop.lab.trial import Trial, wait_for

MODE = 0x2000
FRAME_S = 0.05


def _frames(trial: Trial, seconds: float, buttons: int = 0, ly: int = 0) -> None:
    """Pad frames at 20 Hz, as the board sends them."""
    until = time.monotonic() + seconds
    while time.monotonic() < until:
        trial.board.pad(buttons, ly=ly, hold=False)
        time.sleep(FRAME_S)


def _drive_mode(trial: Trial) -> None:
    _frames(trial, 0.1)
    _frames(trial, 0.1, MODE)
    _frames(trial, 0.1)
    wait_for("the drive mode", lambda: trial.robot.state.pad_mode == "drive")


def test_sticks_drive_without_a_scan_and_a_button_latches(trial: Trial) -> None:
    trial.enable()
    _drive_mode(trial)
    _frames(trial, 0.5, ly=127)
    assert trial.board.wheels()[0] > 0.1
    assert trial.robot.state.sources[0].who == "gamepad"
    trial.board.pad(0x0100, ly=127, hold=False)
    wait_for("the latch", lambda: trial.robot.state.estop == "gamepad button 0x0100")
    trial.board.wait_wheels(moving=False, timeout_s=2.0)
    wait_for("the pad to be locked", lambda: trial.robot.state.pad_mode == "locked")
    _frames(trial, 0.3, ly=127)
    assert not trial.moving()


def test_a_pad_gone_silent_is_the_deadman_s_case(trial: Trial) -> None:
    trial.enable()
    _drive_mode(trial)
    _frames(trial, 0.3, ly=127)
    assert trial.moving()
    trial.board.wait_wheels(moving=False, timeout_s=1.0)
    wait_for("the block", lambda: trial.robot.state.blocked == "cmd timeout")


def test_mode_held_for_two_seconds_while_latched_resets(trial: Trial) -> None:
    _frames(trial, 0.1)
    trial.robot.estop("test")
    wait_for("the latch", lambda: trial.robot.state.estop is not None)
    _frames(trial, 1.0, MODE)
    assert trial.robot.state.estop is not None
    _frames(trial, 1.3, MODE)
    wait_for("the reset", lambda: trial.robot.state.estop is None)
    assert not trial.robot.state.enabled, "a reset enables nothing"
    assert "gamepad: latched stop cleared" in trial.service.said()
