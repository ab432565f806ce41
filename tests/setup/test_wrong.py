"""Wrong answers and a faulty robot: each ends in a sentence with what helps, nothing written, wheels stopped, and is
taken up again. The simulated board is the judge."""

from __future__ import annotations

import signal
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.doctor.system import Node, System
from failstop.lab.sim.client import SimBoard
from failstop.setup import ports, robots
from failstop.setup.draft import Draft
from failstop.setup.rig import LEVER_M, alone, toml
from failstop.setup.talk import Left, NotAnAnswer, Talk
from failstop.setup.wheels import names, parsed
from tests.setup.person import Person, Wiring

KIND, WHEELS = "ugv", {0: "left+", 1: "right-"}
STOPS_S = 30.0


def written(place: Path) -> list[Path]:
    """Settings that were written anywhere there."""
    return list(place.rglob("*.toml*"))


@pytest.mark.slow
def test_it_is_left_by_every_fault_with_a_remedy_and_taken_up_again(place: Path) -> None:
    port = str(place / "b")
    given = ("--port", port, "--robot", "ugv-rover")
    with SimBoard(port, board=KIND) as board:
        with Person(place, "--port", port, "--board", "hoverboard") as person:  # the wrong kind
            person.reads("the board that answers is ugv")
            person.reads("give --board ugv")
            assert person.ends() == 1
        board.deaf(True)
        with Person(place, "--afresh", *given, "--board", KIND) as person:
            person.reads("it does not hear; look at the board's power; its cable, whose TX and RX cross")
            assert person.ends() == 1
        board.deaf(False)
        wiring = Wiring(board, WHEELS)
        with Person(place, "--afresh", *given) as person:  # two wheels with one id, then Ctrl-C while a wheel turns
            person.says("Type yes:", "yes")
            person.says("Id 0: which wheel, which way?", "left+")
            person.says("Id 1: which wheel, which way?", "left-")
            person.reads("left was said of id 0 and of id 1: one wheel can't have two. Both are turned once more.")
            board.events()
            person.reads("Id 0: which wheel, which way?")
            person.types(wiring.seen())
            board.wait_wheels(True, STOPS_S)
            person.typist.type(b"\x03")
            person.reads("the wheels are stopped, nothing is written; `failstop setup` goes on from here")
            assert person.ends() == 1
        board.wait_wheels(False, STOPS_S)
        with Person(place) as person:  # taken up again; the plug is pulled while a wheel turns
            person.reads("A setup was left with: ")
            person.says("Go on with it?", "")
            person.says("Type yes:", "yes")
            person.reads("wheel 0: left+ (as before)")
            board.wait_wheels(True, STOPS_S)
            board.unplug()
            person.reads("the wheels were stopped: ")
            person.reads("if a wheel turns, use the POWER SWITCH; nothing is written")
            assert person.ends() == 1
        board.replug()
        with Person(place) as person:  # and killed while a wheel turns
            person.says("Go on with it?", "")
            person.says("Type yes:", "yes")
            board.wait_wheels(True, STOPS_S)
            person.typist.process.send_signal(signal.SIGKILL)
            board.wait_wheels(False, STOPS_S)
        with Person(place, "--afresh", *given, "--stand", "no") as person:
            person.reads("nothing was moved: put the robot on a stand; nothing is written")
    assert not written(place)


def talk(place: Path, **given: str) -> Talk:
    return Talk(given, Draft("failstop", {"STATE_DIRECTORY": str(place)}), silent=True)


class Locked(System):
    """A port that this user may not open."""

    def node(self, path: str) -> Node | None:
        return Node(path, path, False, "dialout", accessible=False)

    def open_files(self) -> Iterator[tuple[int, set[str] | None]]:
        yield from ()


def test_missing_rights_end_it_with_the_group(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with pytest.raises(Left, match="can't be used so"):
        ports.step(talk(place, port="/dev/null"), Locked())
    said = " ".join(capsys.readouterr().out.split())
    assert "which is of the group dialout -> sudo usermod -aG dialout" in said


def test_the_board_is_found_by_what_goes_and_comes(place: Path) -> None:
    looks = iter([{"/dev/ttyS0", "/dev/ttyUSB0"}, {"/dev/ttyS0"}, {"/dev/ttyS0"}, {"/dev/ttyS0", "/dev/ttyUSB1"}])
    assert ports.went(talk(place, unplugged="done", plugged="done"), lambda: next(looks)) == "/dev/ttyUSB1"
    with pytest.raises(Left, match="no port went when the cable was pulled"):
        ports.went(talk(place, unplugged="done"), lambda: {"/dev/ttyS0"})


def test_a_name_that_stays_is_preferred(tmp_path: Path) -> None:
    node, link = tmp_path / "ttyUSB0", tmp_path / "by-id/usb-board"
    node.touch()
    link.parent.mkdir()
    link.symlink_to(node)
    assert ports.stable(str(node), str(link.parent)) == str(link)
    assert ports.stable(str(tmp_path / "other"), str(link.parent)) == str(tmp_path / "other")


@pytest.mark.parametrize(
    ("said", "meant"),
    [
        ("fl+", "fl+"),
        ("RR -", "rr-"),
        ("rl forward", "rl+"),
        ("fr back", "fr-"),
        ("again", "again"),
        ("x+", ""),
        ("fl", ""),
    ],
)
def test_a_wheel_and_its_way_are_understood(said: str, meant: str) -> None:
    if meant:
        assert parsed(said, names(4), spare=False) == meant
    else:
        with pytest.raises(NotAnAnswer, match="type the wheel"):
            parsed(said, names(4), spare=False)


def test_none_is_an_answer_only_where_an_id_may_be_spare() -> None:
    assert parsed("none", names(2), spare=True) == "none"
    with pytest.raises(NotAnAnswer, match="motors' supply"):
        parsed("none", names(2), spare=False)


def test_every_robot_is_data_that_settings_take() -> None:
    found = {**robots.of_kind("rrc"), **robots.of_kind("ugv")}
    assert len(found) == len(list(robots.FOLDER.glob("*.toml")))
    assert found["ugv-rover"].settings["wheels.track_m"] == 0.172


def test_a_wheel_alone_cancels_the_other_to_the_last_bit() -> None:
    for id_ in (0, 1):
        _, (vx, _, wz) = alone("ugv", 2, id_, 0.123456789, 0.08)
        sides = vx - LEVER_M * wz, vx + LEVER_M * wz
        assert sides[1 - id_] == 0.0
        assert sides[id_] == pytest.approx(0.123456789)


def test_settings_are_written_table_by_table() -> None:
    assert toml({"a.x": 1, "b.y": "t", "a.z": 0.5}) == '[a]\nx = 1\nz = 0.5\n\n[b]\ny = "t"\n'
