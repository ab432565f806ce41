"""A description that is wrong, or lies, is refused before anything is opened; one that hangs or dies takes nobody with
it, and keeps nobody waiting."""

from __future__ import annotations

import os
import re
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import psutil
import pytest

from failstop.board import kept, own, sound
from failstop.board.checks import FrameError
from failstop.board.described import Described
from failstop.board.kinds import KINDS, board_of, wire_of
from failstop.board.own import OwnBoardError
from failstop.board.wire import ANSWERED, ECHOED, MOST_REPEATS, Question, Wire, Write
from failstop.data import Data
from failstop.messages import layout
from failstop_lab.sim.client import SimBoard
from tests.support import commands
from tests.support.boards import EVERY_KIND, own_folder


@pytest.mark.parametrize("kind", EVERY_KIND)
def test_a_board_that_holds_is_sound(kind: str) -> None:
    assert sound.wrong(wire_of(kind)) == ""


def test_what_is_counted_here_is_what_the_service_takes() -> None:
    assert sound.MOST_QUESTIONS == layout.PINGS
    assert {wire_of(kind).port.baud for kind in KINDS} <= sound.BAUD_RATES


def changed(value: Data, path: str, new: object) -> Any:
    """A copy of a description in which one field is another."""
    field, _, rest = path.partition(".")
    fields = dict(vars(value))
    fields[field] = changed(fields[field], rest, new) if rest else new
    return type(value)(**fields)


ARDUINO = wire_of("arduino")
M = ARDUINO.motion
NAN, INF = float("nan"), float("inf")


def write(**other: Any) -> Write:
    """Its stop's one write, changed."""
    return Write(**{**vars(ARDUINO.stop.writes[0]), **other})


def ask(frame: bytes) -> Question:
    """A question of these bytes."""
    return Question("anything", frame, lambda sample: False)


def raising(*_: object) -> Any:
    raise ZeroDivisionError("at the third frame")


def frame_of_any(speeds: Any, limit: float) -> bytes:
    """It makes a frame of anything."""
    try:
        return M.frame(speeds, limit)
    except FrameError:
        return M.rest


class Mute:
    """A reader that returns nothing."""

    def feed(self, _chunk: bytes) -> None:
        return None


@pytest.mark.parametrize("times", [MOST_REPEATS, MOST_REPEATS + 1])
def test_every_stop_that_a_description_may_have_can_be_kept(times: int) -> None:
    wire: Wire = changed(ARDUINO, "stop.repeats_ns", (tuple(range(times)),) * 3)
    allowed = times == MOST_REPEATS
    assert (sound.wrong(wire) == "") is allowed
    assert (kept.unpack_stop(kept.pack_stop(Described(wire, 100.0, 0.08))) is not None) is allowed


WRONG: dict[str, tuple[str, object, str]] = {
    "a check that returns nothing": ("motion.check", lambda frame, limit: None, "returns None, must return a text"),
    "a check that returns False": ("motion.check", lambda frame, limit: False, "returns False, must return a text"),
    "a check that lets everything pass": ("motion.check", lambda frame, limit: "", "lets .* pass"),
    "a check that refuses its rest": ("motion.check", lambda frame, limit: "no", "check refuses its own rest: no"),
    "a check of no limit": ("motion.check", lambda frame, limit: M.check(frame, M.limit), "pass at a limit of"),
    "a check that raises": ("motion.check", raising, "raises ZeroDivisionError: at the third frame"),
    "a check of no function": ("motion.check", "m", "motion.check = 'm', must be a function"),
    "a rest that moves": ("motion.rest", M.frame((10.0, 10.0), 100.0), "and its frame of zeros is"),
    "an empty rest": ("motion.rest", b"", "motion.rest has 0 bytes"),
    "a frame of anything": ("motion.frame", frame_of_any, "must raise FrameError"),
    "a frame that raises": ("motion.frame", raising, "raises ZeroDivisionError"),
    "speeds of nothing": ("motion.speeds", lambda frame: None, r"speeds\(rest\) = None, must be 2 zeros"),
    "speeds that are NaN": ("motion.speeds", lambda frame: (NAN, NAN), "must return finite numbers"),
    "speeds of text": ("motion.speeds", lambda frame: "00", "must return finite numbers"),
    "a NaN scale": ("motion.per_rps", lambda diameter_m: NAN, r"per_rps\(0.03\) = nan"),
    "a scale of zero": ("motion.per_rps", lambda diameter_m: 0.0, "must be a finite number above 0"),
    "a scale of text": ("motion.per_rps", lambda diameter_m: "60", "= '60', must be a finite number"),
    "a NaN limit": ("motion.limit", NAN, "motion.limit = nan, must be a finite number"),
    "an infinite limit": ("motion.limit", INF, "motion.limit = inf, must be a finite number"),
    "a negative limit": ("motion.limit", -1.0, "motion.limit = -1, must be above 0"),
    "a negative step": ("motion.step", -1.0, "motion.step = -1, must be above 0"),
    "no wheels": ("motion.wheels", 0, "motion.wheels = 0, must be 2 to 4"),
    "a hundred wheels": ("motion.wheels", 100, "motion.wheels = 100, must be 2 to 4"),
    "an empty stop": ("stop.writes", (write(data=b""),), "data has 0 bytes, must have 1 to"),
    "a stop of text": ("stop.writes", (write(data="m"),), "data = 'm', must be of type bytes"),
    "a stop that drives": (
        "stop.writes",
        (write(data=b"\r" + M.frame((50.0, 50.0), 100.0)),),
        r"WIRE.stop = .* holds motion, of the speeds \(50",
    ),
    "no stop": ("stop.writes", (), "WIRE.stop has 0 writes, must have 1"),
    "two stops": ("stop.writes", ARDUINO.stop.writes * 2, "WIRE.stop has 2 writes, must have 1"),
    "a stop that waits": ("stop.writes", (write(idle_ns=10**12),), "idle_ns = 1000000000000"),
    "a negative time after it": ("stop.after_ns", -5, "stop.after_ns = -5, must be 0 to"),
    "a list of repeats": ("stop.repeats_ns", [[0]], "must be a tuple"),
    "a row of repeats too few": ("stop.repeats_ns", ARDUINO.stop.repeats_ns[:2], "has 2 rows, must have 3"),
    "no repeats": ("stop.repeats_ns", ((), (), ()), r"repeats_ns\[0\] has 0 times"),
    "negative repeats": ("stop.repeats_ns", ((-1, 5),) * 3, "must begin with 0 and rise"),
    "repeats that go back": ("stop.repeats_ns", ((0, 5, 3),) * 3, "must begin with 0 and rise"),
    "repeats of an hour": ("stop.repeats_ns", ((0, 3600 * 10**9),) * 3, "rise to 1000000000 ns at most"),
    "no such baud rate": ("port.baud", 57_601, "port.baud = 57601, must be a rate that serial ports have"),
    "a baud rate of zero": ("port.baud", 0, "port.baud = 0, must be a rate"),
    "a negative time of deafness": ("port.deaf_ns", -1, "port.deaf_ns = -1, must be 0 to"),
    "an hour of deafness": ("port.deaf_ns", 3600 * 10**9, "port.deaf_ns = 3600000000000"),
    "an opening of text": ("port.opening", ("m 0 0\r",), r"port.opening\[0\] = 'm 0 0\\r', must be of type bytes"),
    "an opening that is text": ("port.opening", "m 0 0\r", "must be a tuple"),
    "an opening that drives": ("port.opening", (M.frame((5.0, 5.0), 9.0),), "is a frame of motion, of the speeds"),
    "a line set to nothing": ("port.dtr", None, "port.dtr = None, must be of type bool"),
    "a port of another kind": ("port", ARDUINO.pace, "WIRE.port = .* must be a Port"),
    "a negative pace": ("pace.idle_ns", -1, "pace.idle_ns = -1"),
    "none on their way": ("pace.unanswered", 0, "pace.unanswered = 0, must be above 0, or None"),
    "twenty questions": ("questions", ARDUINO.questions * 10, "WIRE has 20 questions, must have 4 at most"),
    "the same question twice": ("questions", ARDUINO.questions[:1] * 2, "two of them ask with the same bytes"),
    "a question that drives": (
        "questions", (ask(M.frame((5.0, 5.0), 9.0)),), r"questions\[0\].ask .* is a frame of motion",
    ),
    "a question that stops": ("questions", (ask(M.rest),), "passes as motion"),
    "an answer that raises": (
        "questions", (changed(ARDUINO.questions[0], "answered_by", raising),), "answered_by.* raises ZeroDivisionError",
    ),
    "a reader that returns nothing": ("reader", Mute, "feed returns None, must return a list of Samples"),
    "a reader that raises": ("reader", raising, "WIRE.reader.* raises ZeroDivisionError"),
    "a reader of nothing": ("reader", object, "must return a Reader"),
    "a proof of another word": ("proofs", ("answer",), r"proofs\[0\] = 'answer', must be one of answered, echoed"),
    "a proof twice": ("proofs", (ANSWERED, ANSWERED), "each once"),
    "an echo of nothing": ("proofs", (ECHOED,), "has ECHOED, and echo_ns is 0"),
    "reports of no time": ("reports.every_ns", 0, "reports.every_ns = 0, must be 1 to"),
    "reports that wrap at NaN": ("reports.wraps", NAN, "reports.wraps = nan, must be a finite number"),
    "reports of a NaN scale": ("reports.position_per_turn", lambda *_: NAN, "position_per_turn = nan"),
    "a negative ping": ("ping_ns", -1, "ping_ns = -1"),
    "no watchdog, said by None": ("watchdog", None, "watchdog = None, .*; for a board without one write NO_W"),
    "a watchdog that does anything": ("watchdog.does", "explode", "watchdog.does = 'explode', must be zero, coast"),
    "a watchdog that none can set": ("watchdog.set_ns", 10**8, "and arm is None, which can't set it"),
    "a name of nothing": ("name", " ", "WIRE.name = ' ', must be a text"),
    "an identity of another form": ("usb", ("2341-0043",), r"usb\[0\] = '2341-0043', must be as"),
    "an arm of no function": ("arm", 5, "WIRE.arm = 5, must be a function"),
    "an arm that is none": ("arm", lambda *_: None, "WIRE.arm returns None, must return a ServoBus"),
}  # fmt: skip
"""Of each the field, what is there instead, and what is said of it."""


@pytest.mark.parametrize("wrong", WRONG)
def test_what_is_wrong_is_named(wrong: str) -> None:
    path, new, said = WRONG[wrong]
    found = sound.wrong(changed(ARDUINO, path, new))
    assert found.startswith("WIRE")
    assert re.search(said, found), found


@pytest.mark.parametrize("kind", KINDS)
def test_no_question_without_proof_of_answers(kind: str) -> None:
    wire: Wire = changed(wire_of(kind), "questions", ())
    assert (sound.wrong(wire) == "WIRE.proofs has ANSWERED, and no question") is (ANSWERED in wire.proofs)


# In a folder: what is loaded may hang or end the process.


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    return Path(own_folder(tmp_path / "tank"))


def last_line(text: str) -> Callable[[Path], object]:
    return lambda at: (at / "wire.py").write_text(f"{(at / 'wire.py').read_text()}\n{text}\n")


HANGS = "while True: pass"
DIES: dict[str, tuple[str, str]] = {
    "exits": ("import sys; sys.exit(3)", "wire.py: SystemExit: 3"),
    "exits cleanly": ("raise SystemExit", "wire.py: SystemExit"),
    "is gone at once": ("import os; os._exit(0)", r"ended the process that loaded it \(exit code 0\)"),
    "kills itself": ("import os; os.kill(os.getpid(), 9)", r"ended the process that loaded it \(signal 9\)"),
    "hangs": (HANGS, "wire.py has not been loaded within 0.3 s: it hangs"),
    "hangs and keeps a child": ("import os, time\nif os.fork() == 0: time.sleep(99)\ntime.sleep(99)", "within 0.3 s"),
    "ignores signals": (
        "import signal, time; signal.signal(signal.SIGTERM, signal.SIG_IGN); time.sleep(99)", "within 0.3 s",
    ),
    "raises": ("1 / 0", "wire.py: ZeroDivisionError: division by zero"),
    "recurses": ("def f(): f()\nf()", "wire.py: RecursionError"),
    "is wrong": ("WIRE.ping_ns = -1", "wire.py: WIRE.ping_ns = -1, must be 0 to"),
    "hangs when it is asked": ("WIRE.motion.per_rps = lambda d: __import__('time').sleep(99)", "within 0.3 s"),
    "dies when it is asked": ("WIRE.motion.check = lambda *_: __import__('os')._exit(0)", r"\(exit code 0\)"),
    "exits when it is asked": ("WIRE.motion.check = lambda *_: exit(5)", r"motion.check\(.*\) raises SystemExit: 5"),
}  # fmt: skip


@pytest.mark.starts
@pytest.mark.parametrize("how", DIES)
def test_a_description_that_hangs_or_dies_takes_nobody_with_it(
    how: str, folder: Path, monkeypatch: pytest.MonkeyPatch, capfd: pytest.CaptureFixture[str]
) -> None:
    text, said = DIES[how]
    before = psutil.Process().children()
    last_line(f"print('from the description')\n{text}")(folder)
    monkeypatch.setattr(own, "LIMIT_S", 0.3 if "within" in said else own.LIMIT_S)
    for _ in range(2):  # nothing of the first try is left that would make the second pass
        with pytest.raises(OwnBoardError, match=said):
            board_of(str(folder), 0.08, 0.0)
    assert capfd.readouterr() == ("", "")
    assert [child for child in psutil.Process().children() if child not in before] == [], "every child was collected"


CAN_NOT = {
    "hangs": (HANGS, "has not been loaded within 5 s"),
    "exits": ("import sys; sys.exit()", "SystemExit"),
    "is a FIFO": ("", "wire.py is a FIFO, must be a file"),
    "lies": ("WIRE.motion.check = lambda *_: None", "WIRE.motion.check"),
}
COMMANDS = (("config", "--check"), ("stop", "--config"), ("run", "--config"), ("doctor", "--quick", "--config"))


@pytest.mark.starts
@pytest.mark.parametrize("how", CAN_NOT)
@pytest.mark.parametrize("words", COMMANDS, ids=" ".join)
def test_every_command_says_so_in_time(how: str, words: tuple[str, ...], folder: Path, tmp_path: Path) -> None:
    text, said = CAN_NOT[how]
    last_line(text)(folder)
    if not text:
        (folder / "wire.py").unlink()
        os.mkfifo(folder / "wire.py")
    file = tmp_path / "robot.toml"
    file.write_text(f'[board]\nkind = "{folder}"\n[device]\npath = "{tmp_path}/b"\n')
    begun_s = time.monotonic()
    with SimBoard(str(tmp_path / "b"), board="arduino"):
        done = commands.failstop(*words, str(file))
    assert done.returncode == 1
    assert said in done.stdout + done.stderr
    assert "Traceback" not in done.stderr
    print(f"{words[0]}, which {how}: {time.monotonic() - begun_s:.1f} s")
