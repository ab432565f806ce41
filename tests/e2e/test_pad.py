"""The gamepad: MODE, the sticks and a button. Its silence is a row of the fault table; rules are in tests/telemetry."""

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
    assert not simulated.turning()
