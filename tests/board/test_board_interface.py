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
from failstop.board.checks import FrameError
from failstop.board.interface import BY_IMU, HEARD_BATTERY, Board, ServoBus
from failstop.board.kinds import KINDS, board_of, facts_of
from failstop.board.rrc.board import BOARD
from failstop.board.tap import Tap
from failstop.doctor import stop_path
from failstop.doctor.look import OK
from failstop.messages import layout
from failstop.messages.box import MOST_SPEEDS
from failstop.policy.layouts import BOARDS
from failstop.policy.settings import Settings
from failstop.procs.loop import Timer
from failstop.procs.peer import leave_after_ns
from failstop.procs.schedule import Pings
from failstop_lab.boards.line import arrivals, model_of, play
from failstop_lab.boards.traits import HAS_KEYS, traits_of
from tests.support.boards import wide
from tests.support.rooms import imports, package
from tests.support.starting import nodes
from tests.support.states import latched, stop

ROOT = Path(__file__).resolve().parent.parent.parent
# What the rooms may import of the board. The gate and telemetry never see the port. What can be asked of a
# servo, and what its bus takes, is no more this board's than the servos are.
KNOWN = {
    "supervisor": {"finder", "port", "stop_port", "interface", "kinds", "kept"},
    "procs": {"stop_port", "interface", "kinds"},
    "procs/gate/arm": {"interface", "servos"},
    "procs/port_owner": {"port", "stop_port", "interface", "servos", "handled"},
    "procs/stopper": {"stop_port", "interface"},
    "procs/telemetry": {"interface", "port", "handled"},
}


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
    "proof": "failstop/board/handled.py",
    **{user: f"procs/{user.replace(' ', '_')}" for user in ("gate", "port owner", "stopper", "telemetry")},
    "supervisor": "supervisor",
    **{user: f"failstop/{user}" for user in ("doctor", "incidents", "setup")},
    "stop tool": "failstop/stop_tool.py",
    "command line": "failstop/cli",
    "API": "failstop/api",
}
"""Modules that may use the interface."""


BY_NAMES = {"Board": (".board", "._board"), "ServoBus": (".board.arm", "._board.arm", ".bus", "._bus")}
"""What users call a value of each class."""


def used(part: type, member: str) -> set[str]:
    """The users of one member of a class of the interface."""
    ends = BY_NAMES[part.__name__]
    return {user for user, place in USERS.items() if any(member in names(path, ends) for path in files(place))}


def files(place: str) -> list[Path]:
    found = ROOT / place
    return [found] if found.suffix else sorted(found.rglob("*.py"))


@functools.cache
def names(path: Path, ends: tuple[str, ...]) -> set[str]:
    """Members of the values that one file calls so."""
    return {
        node.attr
        for node in nodes(ast.parse(path.read_text()))
        if isinstance(node, ast.Attribute) and called(node.value).endswith(ends)
    }


def called(node: ast.expr) -> str:
    """An expression as it is written, with a dot before it, so that its end is a whole name."""
    return f".{ast.unparse(node)}"


@pytest.mark.parametrize("part", [Board, ServoBus])
def test_whatever_a_board_has_to_bring_is_used_and_explained(part: type) -> None:
    page = (ROOT / "docs" / "reference" / "board.md").read_text()
    rows = page.partition(f"### {part.__name__}\n")[2].partition("\n### ")[0]
    explained = set(re.findall(r"^\| `(\w+)\b[^|]*(?:\\\|[^|]*)*\| \S", rows, re.MULTILINE))
    members = {*inspect.get_annotations(part), *(name for name in vars(part) if not name.startswith("_"))}
    assert explained == members
    assert [name for name in sorted(members) if not used(part, name)] == []


@pytest.mark.parametrize("kind", BOARDS)
def test_every_kind_of_board_has_all_of_the_interface(kind: str) -> None:
    board = board_of(*Settings({"board.kind": kind}).board())
    for name in inspect.get_annotations(Board):
        assert getattr(board, name) is not None or name == "arm"
    for name in inspect.get_annotations(ServoBus):
        assert board.arm is None or getattr(board.arm, name) is not None
    assert board.burst.startswith(board.first_stop)
    assert board.wheels == Settings({"board.kind": kind}).speeds <= MOST_SPEEDS
    assert board.motor_speeds((-0.0,) * board.wheels, 1.0) == board.stop
    assert board.check_motion(board.stop, 0.0) == ""
    assert board.check_aux(board.motor_speeds((0.5,) * board.wheels, 1.0))
    for wrong in (board.wheels - 1, board.wheels + 1):
        with pytest.raises(FrameError):
            board.motor_speeds((0.0,) * wrong, 1.0)
    assert len(set(board.pings)) == len(board.pings) <= layout.PINGS
    assert len(board.repeats_ns) == 3
    assert all(list(row) == sorted(set(row)) and max((0, *row)) < leave_after_ns(board) for row in board.repeats_ns)
    assert board.hearing().feed(b"") == []


@pytest.mark.parametrize("kind", KINDS)
def test_a_described_board_is_told_no_more_than_its_limit(kind: str) -> None:
    board = board_of(*Settings({"board.kind": kind}).board())
    most = board.most_rps
    fast = board.motor_speeds(wide(most, -most, board.wheels), most)
    assert board.check_motion(fast, most) == ""
    assert board.check_motion(fast, most * 0.9) != ""
    one, other = (board.motor_speeds(wide(*pair, board.wheels), 1.0) for pair in ((0.5, 0.0), (0.0, 0.5)))
    assert one != other
    for bad in (nan, inf, 1.001):
        with pytest.raises(FrameError):
            board.motor_speeds(wide(0.0, bad, board.wheels), 1.0)


THE_LIST = {"failstop/board/kinds.py"}
OF_THE_BENCH = "lab/failstop_lab/"
"""The room that tries boards out: it runs no robot."""


def test_the_list_of_kinds_is_the_one_place_that_names_boards() -> None:
    """Beside their own folders."""
    found = {
        str(path.relative_to(ROOT))
        for path in package()
        if not str(path.relative_to(ROOT)).startswith(OF_THE_BENCH)
        and any(re.search(rf"\b{kind}\b", path.read_text()) for kind in BOARDS)
    }
    own = {name for name in found if re.match(rf"failstop/board/({'|'.join(BOARDS)})/", name)}
    assert len(own) > 5
    assert found - own == THE_LIST


def test_a_board_without_pings_is_driven_and_only_not_asked(monkeypatch: pytest.MonkeyPatch) -> None:
    """The page allows it: nobody divides by their number, waits for an answer, or calls the board deaf."""
    monkeypatch.setattr(type(BOARD), "pings", ())
    pings = Pings(len(BOARD.pings), 1, Timer(), 0)
    pings.stopped(0)
    assert not pings.due(10**12)
    (found,) = stop_path.judged("stopper's duplicate", BOARD, Tap(-1, BOARD).answered_ms(0.0), "failstop doctor")
    assert (found.level, found.text) == (OK, "stopper's duplicate: written; this board never acknowledges a stop")
    unasked = Device("/dev/ttyACM0", "open", "unasked")
    (found,) = stop_path.of_service("failstop", latched(device=unasked, last_stop=stop(acknowledged_s=None)))
    assert (found.level, found.text) == (OK, "the service's last stop: written; this board never acknowledges a stop")


def reports_battery(kind: str, board: Board) -> bool:
    """Whether its receiver reports the battery, by itself or in the answers to failstop's questions."""
    receiver = model_of(kind).live()
    asked = [(at * 20_000_000, ping) for at, ping in enumerate(board.pings * 3, 1)]
    play(receiver, arrivals(asked, board.port.byte_ns), 2_000_000_000)
    heard = board.hearing().feed(b"".join(data for _, data in receiver.said))
    return any(said == HEARD_BATTERY for said, _ in heard)


@pytest.mark.parametrize("kind", BOARDS)
def test_the_facts_that_settings_need_are_the_board_s(kind: str) -> None:
    """They are known before a board is made, so they could differ from it."""
    facts = facts_of(kind)
    assert facts
    board = board_of(kind, 0.1, 0.0)
    assert facts.speeds == board.wheels
    for name, speeds in facts.layouts.items():
        assert board_of(*Settings({"board.kind": kind, "wheels.layout": name}).board()).wheels == speeds
    if facts.most:
        assert board_of(kind, 0.1, 0.0, speeds=facts.most).wheels == facts.most
    assert (facts.arm is None) is (board.arm is None)
    assert facts.imu or board.observed_by != BY_IMU
    assert facts.battery is (kind == BOARDS[0] or reports_battery(kind, board))
    assert facts.keys is (HAS_KEYS in traits_of(kind).parts)
    if facts.arm and board.arm:
        last = facts.arm.highest
        assert board.arm.check(board.arm.move([(1, last)], 40), (1,), 60) == ""
        with pytest.raises(FrameError):
            board.arm.move([(1, last + 1)], 40)
        for wheel in facts.arm.wheels:
            with pytest.raises(FrameError):
                board.arm.move([(wheel, 0)], 40)


def test_a_board_of_your_own_has_no_facts_before_it_is_made() -> None:
    assert facts_of("/etc/failstop/boards/tank") is None
