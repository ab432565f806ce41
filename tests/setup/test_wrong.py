"""Wrong answers and a faulty robot: each ends in a sentence with what helps, nothing written, wheels stopped, and is
taken up again. The simulated board is the judge."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import threading
from argparse import ArgumentParser
from collections.abc import Iterator, Mapping, Sequence
from io import StringIO
from itertools import product
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import psutil
import pytest

from failstop import config, helpers
from failstop.api.errors import FailstopError, Refused
from failstop.api.robot import Robot
from failstop.board.kinds import board_of
from failstop.policy import causes
from failstop.policy.halted import CONFIRMED, MAY_TURN
from failstop.policy.layouts import BOARDS
from failstop.setup import command, finish, rig, robots
from failstop.setup.draft import Draft
from failstop.setup.halt import Halt
from failstop.setup.rig import LEVER_M, alone, toml
from failstop.setup.talk import Left, NotAnAnswer, Talk, word_of
from failstop.setup.wheels import Trial, names, parsed
from failstop_lab.sim.client import SimBoard
from tests.setup.given import GIVEN, KIND, words
from tests.setup.person import Person, is_motion
from tests.support.amounts import LONG
from tests.support.children import needs_root
from tests.support.commands import FAILSTOP
from tests.support.unprivileged import may_reach, unprivileged

WHEELS = {0: "left+", 1: "right-"}
STOPS_S, ENDS_S, WAIT_S = 30.0, 60.0, 90.0
CTRL_C = b"\x03"


def written(place: Path) -> list[Path]:
    """Settings that were written anywhere there."""
    return list(place.rglob("*.toml*"))


def talk(place: Path, **given: str) -> Talk:
    return Talk(given, Draft("failstop", {"STATE_DIRECTORY": str(place)}), silent=True)


UNKEPT = ("stand", "prove", "file")
"""These are asked each time."""
WHEELS_TOO = ("wheel_0", "wheel_1")
WRONG_WHEELS = "answers about the wheels must be wrong: give them all again"
LEAVES = "no settings were written; run `failstop setup` again to go on from here"
WRONG: dict[str, tuple[dict[str, str], tuple[str, ...], str]] = {
    "no port": ({"port": "/nowhere"}, (), "there is no /nowhere: plug the board in, or type another"),
    "no path": ({"port": "ttyUSB0"}, (), "type a path such as /dev/ttyACM0, or unplug"),
    "no serial port": ({"port": "/dev/null"}, (), "/dev/null is not a serial port"),
    "a folder": ({"port": "/tmp"}, (), "/tmp is not a serial port"),
    "no kind": (
        {"board": "esp32"},
        (),
        "type rrc, arduino, feetech, hoverboard, ugv, or the path of your own board's folder",
    ),
    "wrong kind": (
        {"board": "rrc"},
        (),
        "the board that answers is ugv, but board.kind is rrc: give --board ugv, or plug",
    ),
    "no robot": ({"robot": "9"}, (), "type a number from 1 to 4"),
    "not on a stand": ({"stand": "no"}, (), "nothing was moved: put the robot on a stand"),
    "no wheel": ({"wheel_0": "middle+"}, (), "type the wheel (left, right), then + for forward or - for backward"),
    "two of one": ({"wheel_1": "left-"}, WHEELS_TOO, "left can't be the wheel of both id 0 and id 1"),
    "none": (
        {"wheel_0": "none"},
        (),
        "every id of this robot has a wheel: are the motors' supply and",
    ),
    "backward": ({"forward": "no"}, WHEELS_TOO, WRONG_WHEELS),
    "to the right": ({"turn": "no"}, (*WHEELS_TOO, "forward"), WRONG_WHEELS),
    "in millimetres": ({"diameter_m": "80"}, (), "type a number from 0.02 to 1, in m"),
    "no number": ({"wz_radps": "fast"}, (), "in rad/s"),
    "no folder": ({"file": "/nowhere/made.toml"}, (), "you may not write to /nowhere: type another path, or no"),
    "no file": ({"file": "/tmp"}, (), "/tmp is no file: type another path, or no"),
    "unwritten": ({"file": "no"}, (), "you chose not to write the settings"),
    "no word": ({"replace": "yes"}, (), "type the whole word replace, or no"),
}
"""Each wrong answer at each step: what is said, which answers before it are asked anew, and the sentence."""


def run(place: Path, answers: Mapping[str, str]) -> subprocess.CompletedProcess[str]:
    """Setup with these answers and nobody there, from the folder `place`."""
    environ = {**os.environ, "STATE_DIRECTORY": str(place / "state"), "FAILSTOP_ROOT": str(place)}
    streams: dict[str, Any] = {"stdin": subprocess.DEVNULL, "capture_output": True, "text": True}
    return subprocess.run(
        [*FAILSTOP, "setup", *words(place, answers)], cwd=place, env=environ, check=False, timeout=WAIT_S, **streams
    )


def flat(done: subprocess.CompletedProcess[str]) -> str:
    """All that it said, as one line."""
    return " ".join(f"{done.stdout} {done.stderr}".split())


def kept(place: Path) -> list[str]:
    """The questions whose answers were kept."""
    path = place / "state/setup.json"
    return list(json.loads(path.read_text())) if path.exists() else []


@pytest.fixture(scope="module")
def wired(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SimBoard]:
    """A board that no wrong answer moves."""
    with SimBoard(tmp_path_factory.mktemp("wired") / "b", board=KIND) as board:
        yield board


@pytest.fixture
def connected(wired: SimBoard, place: Path) -> SimBoard:
    """It, at the port `b` of the folder."""
    (place / "b").symlink_to(os.path.realpath(wired.link))
    wired.events()
    return wired


@pytest.mark.slow
@pytest.mark.parametrize("wrong", WRONG if LONG else ["to the right"])
def test_a_wrong_answer_ends_with_what_helps_and_is_taken_up_again(
    wrong: str, connected: SimBoard, place: Path
) -> None:
    said, lost, sentence = WRONG[wrong]
    if "replace" in said:
        (place / "made.toml").write_text("there")
    done = run(place, {**GIVEN, **said})
    assert done.returncode == 1
    assert sentence in flat(done)
    assert LEAVES in flat(done)
    assert "nothing was written; no settings were written" not in flat(done)
    if "replace" in said:
        assert (place / "made.toml").read_text() == "there"
        (place / "made.toml").unlink()
    assert not written(place)
    asked = [*GIVEN, "replace"]
    before = asked[: asked.index(min(said, key=asked.index))]
    assert kept(place) == [key for key in before if key not in (*lost, *UNKEPT)]
    answers = {key: value for key, value in GIVEN.items() if key not in kept(place)}
    again = run(place, answers)
    assert again.returncode == 0, flat(again)
    assert written(place) == [place / "made.toml"]
    assert not any(is_motion(event) for event in connected.events())


@pytest.mark.slow
@needs_root
@pytest.mark.parametrize(
    ("mode", "sentences"),
    [
        (
            0o600,
            (
                "User nobody may not open ",
                "which belongs to the group root. -> the Debian package",
                "can't be used yet",
            ),
        ),
        (0o666, ("you may not write to ",)),
    ],
)
def test_missing_rights_are_told_with_what_gives_them(
    mode: int, sentences: Sequence[str], connected: SimBoard, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    if not may_reach(robots.__file__):
        pytest.skip("user nobody may not enter the folder of this checkout")
    place.chmod(0o755)
    os.chmod(place / "b", mode)
    monkeypatch.setenv("STATE_DIRECTORY", str(place / "state"))
    monkeypatch.chdir(place)
    parser = ArgumentParser()
    command.add_arguments(parser)
    arguments = parser.parse_args(words(place, GIVEN))
    assert robots.of_kind(KIND)  # loads what a child without privileges may not be able to

    def work() -> str:
        with contextlib.redirect_stdout(StringIO()) as said:
            try:
                command.main(arguments)
            except Left as error:
                print(error)
        return " ".join(said.getvalue().split())

    said = unprivileged(work)
    for sentence in (*sentences, "your answers could not be kept", LEAVES.split(";")[0]):
        assert sentence in said
    assert not written(place)
    assert not any(is_motion(event) for event in connected.events())


UNPLUGGED = f"is unplugged: {MAY_TURN}"
DEAF = f"the board did not confirm it: {MAY_TURN}"
STOPPED = "the wheels are stopped, as the board reports"
FAULTS: dict[tuple[str, str], str] = {
    ("ask", "silent"): "no board that failstop knows answers at",
    ("ask", "deaf"): "so it may hear nothing; check the board's power, its cable (TX and RX must cross)",
    ("ask", "unplug"): "has disappeared",
    **dict.fromkeys(product(("wheel_0", "forward", "prove"), ("ctrl-c", "hang-up")), STOPPED),
    **dict.fromkeys(product(("wheel_0", "forward", "prove"), ("unplug",)), UNPLUGGED),
    **dict.fromkeys(product(("wheel_0", "forward", "prove"), ("deaf",)), DEAF),
    **dict.fromkeys(product(("wheel_0", "forward", "prove"), ("sigkill",)), ""),
}
"""Each fault at each step that has the board at work: of wheels that turn, and before. Empty: nobody is left to say."""


def wait_for_its_end(port: str) -> None:
    """Wait for every process of setup's at this port: nobody is left who could turn a wheel, or stop one."""
    found = {each: each.info["cmdline"] or [] for each in psutil.process_iter(["cmdline"])}
    left = [each for each, words in found.items() if port in words and "failstop_lab.sim" not in words]
    assert not psutil.wait_procs(left, ENDS_S)[1]


def strike(fault: str, board: SimBoard, person: Person) -> None:
    """The fault."""
    if fault == "ctrl-c":
        person.presses(CTRL_C)
    elif fault == "hang-up":
        person.process.send_signal(signal.SIGHUP)
    elif fault == "sigkill":
        person.process.send_signal(signal.SIGKILL)
    elif fault == "unplug":
        board.unplug()
    else:
        board.deaf(True)


def test_a_stop_that_somebody_asks_for_while_the_service_starts_is_not_reset(
    place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    class Stopped:
        def __init__(self, *_: object, **__: object) -> None:
            pass

        def wait_for(self, *_: object) -> object:
            return SimpleNamespace(cause=causes.PIPED("hand near wheel"), epoch=2)

        def close(self) -> None:
            pass

    port = place / "b"
    port.touch()
    monkeypatch.setattr(rig, "Robot", Stopped)
    monkeypatch.setattr(helpers, "python", lambda *_: ["sleep", "60"])
    kind = {"board.kind": KIND, "wheels.layout": "differential"}
    halt = Halt(str(port), board_of(KIND, 1.0, 0.0), print)
    with pytest.raises(Left, match=r"somebody stopped the robot: .*hand near wheel"), rig.Rig(str(port), kind, halt):
        pass


@pytest.mark.slow
@pytest.mark.parametrize("ask", ["disable", "stop"])
def test_motion_that_somebody_ends_while_a_wheel_turns_does_not_begin_again(ask: str, place: Path) -> None:
    port = str(place / "b")
    values, velocity = rig.alone(KIND, 2, 1, 0.05, 0.08)
    halt = Halt(port, board_of(KIND, 0.08, 0.0), pytest.fail)

    def end(name: str) -> None:
        board.wait_wheels(True, STOPS_S)
        with Robot(name, client="somebody") as robot:
            robot.disable() if ask == "disable" else robot.estop("hand near wheel")
        board.wait_wheels(False, STOPS_S)
        board.events()

    with SimBoard(port, board=KIND) as board, rig.Rig(port, {**values, "gate.lease_s": 0.25}, halt) as made:
        somebody = threading.Thread(target=end, args=(made.name,))
        somebody.start()
        with pytest.raises(Left, match="disabled" if ask == "disable" else "hand near wheel"):
            made.drive(velocity, 20.0)
        somebody.join()
        assert not any(is_motion(event) for event in board.events())


@pytest.mark.slow
@pytest.mark.parametrize(
    ("step", "fault"), FAULTS if LONG else [("wheel_0", "unplug"), ("prove", "ctrl-c"), ("prove", "deaf")]
)
def test_a_fault_ends_it_with_what_helps_and_the_wheels_stand(step: str, fault: str, place: Path) -> None:
    port = str(place / "b")
    answers = {**GIVEN, "port": port, "prove": "yes", "unproved": "no"}
    turned = answers if step in ("ask", "prove") else {key: answers[key] for key in answers if key != step}
    if fault == "silent":
        del turned["board"]  # one that says nothing unasked, of any kind
    sentence = FAULTS[step, fault]
    with SimBoard(port, board="arduino" if fault == "silent" else KIND) as board:
        if step == "ask" and fault != "unplug":
            board.deaf(True)
        with Person(place, *words(place, turned)) as person:
            if step == "ask" and fault == "unplug":
                person.reads("is asked what it is")
                board.unplug()
            elif step != "ask":
                board.wait_wheels(True, STOPS_S)
                strike(fault, board, person)
            if fault == "unplug" and step != "ask":
                person.reads(f"{UNPLUGGED}. Plug it in again")
                person.presses(CTRL_C)
            if sentence:
                person.reads(sentence)
                person.reads(LEAVES)
                assert person.ends() == 1
        board.wait_wheels(False, STOPS_S)
        wait_for_its_end(port)
        assert not any(board.wheels())
    assert not written(place)
    if step == "ask":  # where nothing answers it may be another port
        assert kept(place) == (["port", "board"] if fault == "unplug" else [])
    else:
        assert kept(place) == [key for key in list(GIVEN)[: list(GIVEN).index(step)] if key not in UNKEPT]


KEEPS_ON = {"board": "rrc", "robot": "other", "layout": "mecanum", "stand": "yes"}
"""Answers up to the first wheel that turns, of a board that keeps its last speed forever."""


@pytest.mark.slow
@pytest.mark.parametrize("back", [True, False])
def test_an_unplugged_board_is_waited_for_and_stopped(back: bool, place: Path) -> None:
    """Ctrl-C, with the plug out: nobody says that the wheels are stopped before the stop is on the board."""
    port = str(place / "b")
    with SimBoard(port) as board:
        with Person(place, *words(place, {"port": port, **KEEPS_ON})) as person:
            board.wait_wheels(True, STOPS_S)
            board.unplug()
            person.presses(CTRL_C)
            assert "stopped" not in person.reads(f"{UNPLUGGED}. Plug it in again")
            assert any(board.wheels())
            if back:
                board.replug()
                person.reads(f"failstop: {CONFIRMED}; no settings were written")
                assert not any(board.wheels())
            else:
                person.presses(CTRL_C)
                person.reads(f"failstop: {port} {UNPLUGGED}; no settings were written")
            assert person.ends() == 1
        wait_for_its_end(port)
        assert any(board.wheels()) is not back
    assert not written(place)


@pytest.mark.slow
def test_a_stand_test_that_hangs_is_given_up_at_the_third_ctrl_c(place: Path) -> None:
    port = str(place / "b")
    with SimBoard(port, board=KIND) as board:
        with Person(place, *words(place, {**GIVEN, "port": port, "prove": "yes"})) as person:
            board.wait_wheels(True, STOPS_S)
            children = psutil.Process(person.process.pid).children()
            tests = [each for each in children if "prove" in each.cmdline()]
            tests[0].send_signal(signal.SIGSTOP)
            while psutil.wait_procs(tests, 0.5)[1]:
                person.presses(CTRL_C)
            person.reads(STOPPED)
            person.reads(LEAVES)
            assert person.ends() == 1
        assert not any(board.wheels())
        wait_for_its_end(port)
        assert not any(board.wheels())


@pytest.mark.slow
@pytest.mark.parametrize("wrong", ["forward", "turn"])
def test_a_no_to_all_wheels_together_has_the_wheels_asked_again(wrong: str, place: Path) -> None:
    port = str(place / "b")
    given = {key: GIVEN[key] for key in GIVEN if key not in ("forward", "turn", "wheel_0", "wheel_1")}
    with SimBoard(port, board=KIND) as board:
        with Person(place, *words(place, {**given, "port": port, "file": str(place / "made.toml")})) as person:
            for wheels, fits in ((("left-", "right-"), False), (("left+", "right-"), True)):
                for id_, wheel in enumerate(wheels):
                    person.says(f"Id {id_}: which wheel turned, and which way?", wheel)
                for key, question in (
                    ("forward", "Did every wheel turn forward?"),
                    ("turn", "Did the left wheels turn"),
                ):
                    person.says(question, "yes" if fits or key != wrong else "no")
                    if key == wrong and not fits:
                        person.reads("One of the answers about the wheels must be wrong.")
                        break
            person.reads("Next")
            assert person.ends() == 0
        assert not any(board.wheels())
    assert "sign_1 = 1" in (place / "made.toml").read_text()


@pytest.mark.slow
@pytest.mark.parametrize("first", ["setup", "service"])
def test_a_board_that_is_unplugged_before_the_service_is_ready_is_named(
    first: str, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """In the same words, whoever notices first."""
    port, kind = str(place / "b"), {"board.kind": KIND, "wheels.layout": "differential"}
    halt = Halt(port, board_of(KIND, 1.0, 0.0), print)
    with SimBoard(port, board=KIND) as board:

        def not_yet(*_: object, **__: object) -> None:
            if board.info()["opened"] and os.path.lexists(port):
                board.unplug()
            raise FailstopError("it is not ready yet")

        monkeypatch.setattr(rig, "Robot", not_yet)
        if first == "service":
            board.unplug()  # so the service ends at its start
            monkeypatch.setattr(rig, "GONE_S", 3.0)
        with pytest.raises(Left, match="was unplugged before the wheels were turned"), rig.Rig(port, kind, halt):
            pass


def test_why_the_service_enables_nothing_is_told(place: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    class Refuses:
        def __init__(self, *_: object, **__: object) -> None:
            self.state = SimpleNamespace(cause=None, waiting_for="", blocked="")

        def wait_for(self, *_: object) -> object:
            return self.state

        def enable(self) -> None:
            raise Refused("nobody attends")

        def close(self) -> None:
            pass

    port = place / "b"
    port.touch()
    monkeypatch.setattr(rig, "Robot", Refuses)
    monkeypatch.setattr(rig, "READY_S", 0.1)
    monkeypatch.setattr(helpers, "python", lambda *_: ["sleep", "60"])
    kind = {"board.kind": KIND, "wheels.layout": "differential"}
    halt = Halt(str(port), board_of(KIND, 1.0, 0.0), print)
    with (
        pytest.raises(Left, match=r"ready within .* nobody attends"),
        rig.Rig(str(port), kind, halt),
    ):
        pass


def test_every_file_that_is_replaced_is_kept(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = place / "made.toml"
    for number in range(4):
        finish.write(talk(place, file=str(path), replace="replace"), f"made = {number}\n", "failstop")
    kept = {found.name: found.read_text() for found in place.glob("made.toml*")}
    assert kept == {
        "made.toml": "made = 3\n",
        "made.toml.old": "made = 0\n",
        "made.toml.old.2": "made = 1\n",
        "made.toml.old.3": "made = 2\n",
    }
    assert f"The previous settings are in {path}.old.3." in capsys.readouterr().out


def test_a_yes_is_not_the_word_replace_and_is_asked_again(
    place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    path = place / "made.toml"
    path.write_text("old")
    answers = iter(["yes", "", "replace"])
    monkeypatch.setattr("failstop.setup.talk.read_line", lambda _: next(answers))
    finish.write(Talk({"file": str(path)}, talk(place).draft, silent=False), "new", "failstop")
    assert path.read_text() == "new"
    assert capsys.readouterr().out.count("type the whole word replace, or no") == 2


def test_what_was_not_proved_is_named(place: Path, capsys: pytest.CaptureFixture[str]) -> None:
    rows = [{"path": path, "verdict": verdict} for path, verdict in (("scan", "PASS"), ("kill-gate", "INVALID"))]
    finish.closing(talk(place), "/x/s.toml", "left", {"rows": rows, "unproved": ["pad: this board has no gamepad"]})
    said = " ".join(capsys.readouterr().out.split())
    assert "1 of the 2 tests of the main stop paths, on this robot with its wheels off the ground" in said
    assert (
        "not proved: kill-gate (the stand test ended with INVALID) not proved: pad: this board has no gamepad" in said
    )
    assert "failstop run --config /x/s.toml --name left & failstop enable --name left" in said
    finish.closing(talk(place), "/x/s.toml", "left", {})
    assert "-> failstop prove --quick --config /x/s.toml --name left" in capsys.readouterr().out
    finish.closing(talk(place), config.installed("left"), "left", {})
    assert "-> failstop prove --quick --name left\n" in capsys.readouterr().out


@pytest.mark.parametrize("gate", ["on", "off"])
def test_the_guard_port_is_offered_for_a_board_that_has_one(
    place: Path, capsys: pytest.CaptureFixture[str], gate: str
) -> None:
    settings = {"board.kind": "arduino", "device.path": "/dev/ttyACM0", "scan.gate": gate}
    finish.closing(talk(place), "/x/s.toml", "left", {}, settings)
    said = " ".join(capsys.readouterr().out.split())
    assert "Let it open the guard port instead of /dev/ttyACM0" in said
    assert "failstop guard --name left" in said
    assert ('scan.gate is "on"' in said) == (gate == "on")


def test_no_guard_port_is_offered_for_a_board_that_nobody_has_described_drivers_of(
    place: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(finish, "language_of", lambda *_: None)
    finish.closing(talk(place), "/x/s.toml", "left", {}, {"board.kind": "arduino"})
    assert "guard" not in capsys.readouterr().out


@pytest.mark.parametrize(
    ("wheels", "said", "meant"),
    [
        (4, "fl+", "fl+"),
        (4, "RR -", "rr-"),
        (4, "rl forward", "rl+"),
        (4, "fr back", "fr-"),
        (4, "r-", ""),
        (4, "again", "again"),
        (4, "x+", ""),
        (4, "fl", ""),
        (3, "l+", "left+"),
        (3, "ri b", "right-"),
        (3, "r+", ""),
        (3, "+", ""),
    ],
)
def test_a_wheel_and_its_way_are_understood(wheels: int, said: str, meant: str) -> None:
    """Also by the beginning of a word where no other begins so."""
    if meant:
        assert parsed(said, names(wheels), spare=False) == meant
    else:
        with pytest.raises(NotAnAnswer, match="type the wheel"):
            parsed(said, names(wheels), spare=False)


@pytest.mark.parametrize("kept", [{}, {"wheel_0": "left+"}, {"wheel_0": "left+", "wheel_1": "right-"}])
def test_the_questions_about_the_wheels_are_explained_only_if_one_is_asked(
    kept: Mapping[str, str], place: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    conversation = Talk({}, talk(place).draft, silent=False)
    for key, answer in kept.items():
        conversation.draft.keep(key, answer)
    turned: list[int] = []
    monkeypatch.setattr(Trial, "_turn", lambda _, id_: turned.append(id_))
    monkeypatch.setattr("failstop.setup.talk.read_line", lambda _: ("left+", "right-")[turned[-1]])
    values = {"board.kind": KIND, "wheels.layout": "differential"}
    found = Trial(conversation, "/nowhere", values, Halt("/nowhere", board_of(KIND, 1.0, 0.0), print))._ids()
    assert found == {"wheels.id_1": 0, "wheels.sign_1": 1, "wheels.id_2": 1, "wheels.sign_2": -1}
    assert turned == [id_ for id_ in (0, 1) if f"wheel_{id_}" not in kept]
    assert capsys.readouterr().out.count("The wheels turn slowly, one after the other") == bool(turned)


@pytest.mark.parametrize("why", [KeyboardInterrupt(), Left("no board answers")], ids=["ctrl-c", "left"])
@pytest.mark.parametrize(("name", "option"), [("failstop", ""), ("newcomer", " --name newcomer")])
def test_the_command_that_goes_on_has_the_name_of_the_service(
    name: str, option: str, why: BaseException, place: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def converse(*_: object) -> None:
        raise why

    monkeypatch.setenv("STATE_DIRECTORY", str(place / "state"))
    monkeypatch.setattr(command, "_converse", converse)
    parser = ArgumentParser()
    command.add_arguments(parser)
    with pytest.raises(Left) as found:
        command.main(parser.parse_args(["--name", name]))
    assert str(found.value).endswith(f"no settings were written; run `failstop setup{option}` again to go on from here")


def test_a_layout_is_answered_by_its_word_or_its_beginning() -> None:
    check = word_of(["differential", "omni3"])
    assert check("Omni") == "omni3"
    for wrong in ("", "1", "mecanum"):
        with pytest.raises(NotAnAnswer, match="type differential, omni3"):
            check(wrong)


def test_none_is_an_answer_only_where_an_id_may_be_spare() -> None:
    assert parsed("none", names(2), spare=True) == "none"
    with pytest.raises(NotAnAnswer, match="motors' supply"):
        parsed("none", names(2), spare=False)


def test_every_robot_is_data_that_settings_take() -> None:
    found = {key: robot for kind in BOARDS for key, robot in robots.of_kind(kind).items()}
    assert len(found) == len(list(robots.FOLDER.glob("*.toml")))
    assert found["ugv-rover"].settings["wheels.track_m"] == 0.172


def test_a_wheel_alone_cancels_the_other_to_the_last_bit() -> None:
    for id_ in (0, 1):
        _, (vx, _, wz) = alone("ugv", 2, id_, 0.123456789, 0.08)
        sides = vx - LEVER_M * wz, vx + LEVER_M * wz
        assert sides[1 - id_] == 0.0
        assert sides[id_] == pytest.approx(0.123456789)


def test_settings_are_written_table_by_table() -> None:
    assert toml({"a.x": 1, "b.y": "t", "a.z": 0.5}) == 'a.x = 1\na.z = 0.5\n\nb.y = "t"\n'


def test_what_is_typed_before_a_question_is_no_answer_to_it(place: Path) -> None:
    """Nobody can say which wheel turned before it has."""
    answers = {key: value for key, value in GIVEN.items() if key in ("port", "board", "robot")}
    with SimBoard(place / "b", board=KIND) as board, Person(place, *words(place, answers)) as person:
        person.reads("Type yes:")
        person.presses(b"yes\nleft+\nright+\n")
        person.reads("Id 0: which wheel turned, and which way?")
        turned = [event for event in board.events() if is_motion(event)]
        assert turned, "the wheel had turned"
        person.types("right-")
        person.reads("Id 1: which wheel turned, and which way?")
        assert json.loads((place / "state/setup.json").read_text())["wheel_0"] == "right-"
        person.presses(CTRL_C)
        assert person.ends() == 1
