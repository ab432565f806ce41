"""The gamepad: MODE, the sticks, a button, and the reset by holding MODE."""

from __future__ import annotations

from tests.support.simulated import MS, Simulated

MODE = 0x2000
FRAME_S = 0.05


def frames(simulated: Simulated, seconds: float, buttons: int = 0, ly: int = 0) -> None:
    """Pad frames at 20 Hz, as the board sends them."""
    for _ in range(round(seconds / FRAME_S)):
        simulated.board.pad(buttons, ly=ly)
        simulated.wait(FRAME_S)


def sticks(simulated: Simulated) -> None:
    """Enabled, in the drive mode, and the stick forward."""
    simulated.enable()
    for buttons in (0, MODE, 0):
        frames(simulated, 0.1, buttons)
    assert simulated.robot.state.pad_mode == "drive"
    frames(simulated, 0.5, ly=127)
    assert simulated.board.wheels()[0] > 0.1


def test_sticks_drive_without_a_scan_and_a_button_latches(simulated: Simulated) -> None:
    sticks(simulated)
    assert simulated.robot.state.sources[0].who == "gamepad"
    simulated.board.events()
    pressed_ns = simulated.now_ns()
    simulated.board.pad(0x0100, ly=127)
    stop = simulated.board.wait_for(lambda event: event.is_stop)
    assert stop.arrival_ns - pressed_ns <= 2 * MS
    simulated.wait_for("the latch", lambda: simulated.robot.state.estop == "gamepad button 0x0100")
    simulated.wait_for("the pad to be locked", lambda: simulated.robot.state.pad_mode == "locked")
    frames(simulated, 0.3, ly=127)
    assert not simulated.moving()


def test_a_pad_gone_silent_is_the_deadman_s_case(simulated: Simulated) -> None:
    sticks(simulated)
    simulated.board.wait_wheels(moving=False)
    simulated.wait_for("the block", lambda: simulated.robot.state.blocked == "cmd timeout")


def test_mode_held_for_two_seconds_while_latched_resets(simulated: Simulated) -> None:
    frames(simulated, 0.1)
    simulated.robot.estop("test")
    simulated.robot.wait_for("latched", 1.0)
    frames(simulated, 1.9, MODE)
    assert simulated.robot.state.estop is not None
    frames(simulated, 0.3, MODE)
    state = simulated.robot.state
    assert (state.estop, state.enabled) == (None, False), "a reset enables nothing"
    assert "gamepad: latched stop cleared" in simulated.said
