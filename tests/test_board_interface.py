"""The board behind its interface: the promises that types cannot make, and who may know more of the board than that."""

from __future__ import annotations

import ast
from math import inf, nan
from pathlib import Path

import pytest

from failstop.board import decoder
from failstop.board.framing import FrameError
from failstop.board.interface import BOARD
from failstop.lab.sim.receiver import Receiver
from failstop.shm import layout

ROOT = Path(__file__).resolve().parent.parent
# What the rooms may import of the board. Telemetry knows it; the gate never sees the port. What can be asked of a
# servo, and what its bus takes, is no more this board's than the servos are.
KNOWN = {
    "supervisor": {"finder", "port", "stop_port", "interface"},
    "procs/gate": {"interface", "servos"},
    "procs/port_owner": {"port", "stop_port", "interface", "servos"},
    "procs/stopper": {"port", "stop_port", "interface"},
}


def test_the_stop_is_a_motion_frame_of_zeros() -> None:
    assert BOARD.motor_speeds((0.0, -0.0, 0.0, 0.0), 1.0) == BOARD.stop
    assert BOARD.check_motion(BOARD.stop, 0.0) == ""


@pytest.mark.parametrize("speed", [nan, inf, -inf, 1.001])
@pytest.mark.parametrize("wheel", range(4))
def test_no_frame_for_a_speed_that_must_not_be(wheel: int, speed: float) -> None:
    speeds = [0.5] * 4
    speeds[wheel] = speed
    with pytest.raises(FrameError):
        BOARD.motor_speeds(speeds, 1.0)


def test_the_check_reads_the_bytes_and_not_the_encoder() -> None:
    frame = BOARD.motor_speeds((0.5, -0.5, 1.0, 0.0), 1.0)
    assert BOARD.check_motion(frame, 1.0) == ""
    assert BOARD.check_motion(frame, 0.9) != ""
    assert all(BOARD.check_motion(frame[:end], 1.0) for end in range(len(frame)))
    for at in range(len(frame)):
        assert BOARD.check_motion(frame[:at] + bytes((frame[at] ^ 1,)) + frame[at + 1 :], 1.0)


def test_no_motion_passes_as_another_frame() -> None:
    assert BOARD.check_aux(BOARD.motor_speeds((0.5, 0.5, 0.5, 0.5), 1.0))
    assert BOARD.check_aux(BOARD.stop)
    assert BOARD.check_aux(BOARD.burst)


def test_the_burst_ends_between_frames_with_a_stop() -> None:
    assert BOARD.burst.endswith(BOARD.stop)
    receiver = Receiver()
    assert receiver.feed(BOARD.burst)[-1][0] == len(BOARD.burst) - 1


def test_the_pings_move_nothing_and_are_different_frames() -> None:
    assert len(set(BOARD.pings)) == len(BOARD.pings) == layout.PINGS
    for ping in BOARD.pings:
        assert BOARD.check_motion(ping, 1000.0) != ""
        assert len(decoder.Decoder().feed(ping)) == 1


def board_modules(folder: str) -> set[str]:
    """Modules of the board that a room's files import."""
    found: set[str] = set()
    for path in (ROOT / folder).glob("*.py"):
        for node in ast.walk(ast.parse(path.read_text())):
            if isinstance(node, ast.ImportFrom) and node.module == "failstop.board":
                found |= {alias.name for alias in node.names}
            elif isinstance(node, ast.ImportFrom) and (node.module or "").startswith("failstop.board."):
                found.add((node.module or "").split(".")[2])
            elif isinstance(node, ast.Import):
                found |= {alias.name.split(".")[2] for alias in node.names if alias.name.startswith("failstop.board.")}
    return found


@pytest.mark.parametrize("folder", KNOWN)
def test_who_knows_what_of_the_board(folder: str) -> None:
    found = board_modules(folder)
    assert found, "the check sees imports"
    assert found <= KNOWN[folder]


def test_the_page_on_porting_names_all_of_the_interface() -> None:
    page = (ROOT / "docs" / "dev" / "porting.md").read_text()
    for name in ("motor_speeds", "check_motion", "check_aux", "stop", "burst", "pings", "pong"):
        assert f"| `{name}" in page
        assert hasattr(BOARD, name)
