"""The board behind its interface: the promises that types cannot make, and who may know more of the board than that."""

from __future__ import annotations

import ast
import functools
import inspect
import re
from math import inf, nan
from pathlib import Path

import pytest

from failstop.api.snapshot import Device
from failstop.board import decoder
from failstop.board.framing import FrameError
from failstop.board.interface import BOARD, Board
from failstop.doctor import stop_path
from failstop.doctor.look import OK
from failstop.lab.sim.receiver import Receiver
from failstop.messages import layout
from failstop.procs.loop import Timer
from failstop.procs.port_owner.schedule import Pings
from tests.support.rooms import imports
from tests.support.states import latched, stop

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
    assert len(set(BOARD.pings)) == len(BOARD.pings)
    assert len(BOARD.pings) in (0, layout.PINGS), "a word in shared memory for each; none for a board that answers none"
    for ping in BOARD.pings:
        assert BOARD.check_motion(ping, 1000.0) != ""
        assert len(decoder.Decoder().feed(ping)) == 1


def test_the_first_stop_begins_the_burst_and_the_burst_with_no_servos_is_the_burst() -> None:
    assert BOARD.burst.startswith(BOARD.first_stop)
    assert BOARD.first_stop.endswith(BOARD.stop)
    assert BOARD.burst_with(()) == BOARD.burst
    assert BOARD.burst_with((1, 2)).startswith(BOARD.burst)


def board_modules(folder: str) -> set[str]:
    """Modules of the board that a room's files import."""
    found: set[str] = set()
    for path in (ROOT / folder).glob("*.py"):
        for node, _ in imports(path):
            above = "" if isinstance(node, ast.Import) else f"{node.module}."
            names = (f"{above}{alias.name}" for alias in node.names)
            found |= {name.split(".")[2] for name in names if name.startswith("failstop.board.")}
    return found


@pytest.mark.parametrize("folder", KNOWN)
def test_who_knows_what_of_the_board(folder: str) -> None:
    found = board_modules(folder)
    assert found, "the check sees imports"
    assert found <= KNOWN[folder]


USERS = {
    "stop port": "failstop/board/stop_port.py",
    "gate": "procs/gate",
    "port owner": "procs/port_owner",
    "supervisor": "supervisor",
    "stopper": "procs/stopper",
    "telemetry": "procs/telemetry",
    "doctor": "failstop/doctor",
    "incidents": "failstop/incidents",
    "stop tool": "failstop/stopping.py",
    "command line": "failstop/cli",
    "API": "failstop/api",
}
"""Users of the interface, by the words of the page."""


def used(member: str) -> set[str]:
    """The users of one member of the interface."""
    return {user for user, place in USERS.items() if any(member in names(path) for path in files(place))}


def files(place: str) -> list[Path]:
    found = ROOT / place
    return [found] if found.suffix else sorted(found.rglob("*.py"))


@functools.cache
def names(path: Path) -> set[str]:
    """Of BOARD, in one file."""
    text = path.read_text()
    return {
        node.attr
        for node in ast.walk(ast.parse(text if "BOARD" in text else ""))
        if isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name) and node.value.id == "BOARD"
    }


def takes(member: str) -> list[str] | None:
    """Names of what it takes; None: it is a constant."""
    found = getattr(BOARD, member)
    return list(inspect.signature(found).parameters) if callable(found) else None


def test_the_page_on_porting_has_all_of_the_interface_and_no_more() -> None:
    page = (ROOT / "docs" / "dev" / "porting.md").read_text()
    rows = re.findall(r"^\| `(\w+)(?:\(([\w, ]*)\))?` \| ([\w, ]+) \|", page.partition("| `Board` |")[2], re.MULTILINE)
    told = {name: (given.split(", ") if given else None, set(users.split(", "))) for name, given, users in rows}
    members = [name for name in vars(Board) if not name.startswith("_")]
    assert told == {name: (takes(name), used(name)) for name in members}
    count = len(members)
    assert f"the {count} members of `Board`" in (ROOT / "docs" / "boards.md").read_text()


def test_a_board_without_pings_is_driven_and_only_not_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    """The page allows a board without pings: nobody divides by their number, waits for an answer, or calls it deaf."""
    monkeypatch.setattr(Board, "pings", ())
    pings = Pings(len(BOARD.pings), 1, Timer(), 0)
    pings.stopped(0)
    assert not pings.due(10**12)
    (found,) = stop_path.judged("stopper's duplicate", stop_path.Tap(-1).answered_ms(0.0), "failstop doctor")
    assert (found.level, found.text) == (OK, "stopper's duplicate: written; this board acknowledges nothing")
    unasked = Device("/dev/ttyACM0", "open", "unasked")
    (found,) = stop_path.of_service("failstop", latched(device=unasked, last_stop=stop(acknowledged_s=None)))
    assert (found.level, found.text) == (OK, "the service's last stop: written; this board acknowledges nothing")
