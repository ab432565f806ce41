"""The reason of a stop is whatever a program has at hand: the stop is out before anything of it can go wrong."""

from __future__ import annotations

import subprocess
import threading
from enum import Enum

import pytest

from failstop import AsyncRobot, Robot
from failstop.api import reason
from failstop.api.client import send_stop
from failstop.api.events import EventLog
from failstop.messages import records
from failstop.shm import bell
from failstop_lab.trial import Trial, wait_for


class Raises:
    """Everything that Python asks an object for its words by."""

    def __str__(self) -> str:
        raise RuntimeError("no words")

    __repr__ = __format__ = __str__  # type: ignore[assignment]


class Poses:
    @property  # type: ignore[misc]
    def __class__(self) -> type:
        raise KeyError("no class")


class Silent(Exception):
    def __str__(self) -> str:
        raise RuntimeError("no words")


class Wall(Exception):
    def __init__(self, distance_m: float) -> None:
        self.distance_m = distance_m

    def __str__(self) -> str:
        return f"a wall at {self.distance_m} m"


class Text(str):
    __slots__ = ()

    def split(self, *_: object) -> list[str]:  # type: ignore[override]
        raise RuntimeError("no words")

    __str__ = __getitem__ = __len__ = split  # type: ignore[assignment]


class Nameless(type):
    @property
    def __name__(cls) -> str:  # type: ignore[override]
        raise RuntimeError("no name")


class Anonymous(metaclass=Nameless):
    pass


class Why(Enum):
    WALL = 1


def deep() -> list[object]:
    found: list[object] = []
    for _ in range(100_000):
        found = [found]
    return found


WORDS = {
    "a text": ("hand near wheel", "hand near wheel"),
    "nothing": (None, ""),
    "a number": (7, "7"),
    "a fraction": (0.5, "0.5"),
    "a truth": (False, "False"),
    "bytes": (b"hand\xff", "hand\ufffd"),
    "an exception": (ValueError("no scan", 3), "ValueError: no scan, 3"),
    "an exception without words": (TimeoutError(), "TimeoutError"),
    "an exception of a chain": (KeyError("base"), "KeyError: base"),
    "one that cannot be encoded": ("\udc80 near \ud800", "? near ?"),
    "a text of its own kind": (Text("hand"), "hand"),
    "a huge text": (50_000_000 * "x", (records.ASKED_BYTES - 4) * "x" + " ..."),
    "a huge number": (1 << 100_000, "int"),
    "an object": (object(), "object"),
    "an object that raises": (Raises(), "Raises"),
    "an object without a class": (Poses(), "Poses"),
    "an exception that raises": (Silent("a hand"), "Silent: a hand"),
    "an exception of objects": (ValueError(Raises(), "hand"), "ValueError: hand"),
    "an exception with words of its own": (Wall(0.3), "Wall: 0.3"),
    "a class that raises": (Anonymous(), ""),
    "a list without end": (deep(), "list"),
    "a name": (Why.WALL, "Why"),
}
MORE = {"an exception with words of its own": "Wall: a wall at 0.3 m", "a name": "Why.WALL"}


@pytest.mark.parametrize("name", WORDS)
def test_every_reason_has_words_without_a_call_of_its_own_code(name: str) -> None:
    given, told = WORDS[name]
    words, _ = reason.plain(given)
    line = records.asking(words, "nav", 7)
    assert line.decode() == f"{told}\tnav\t7\n"


@pytest.mark.parametrize("name", [name for name, (given, _) in WORDS.items() if reason.plain(given)[1]])
def test_what_is_told_whole_is_a_single_request(name: str) -> None:
    assert name not in MORE


@pytest.mark.parametrize("name", WORDS)
def test_every_reason_stops(trial: Trial, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("failstop.api.client.OWN_WORDS_S", 0.0)  # else the next test's stop may be a word of this one's
    given, told = WORDS[name]
    trial.robot.estop(given)
    state = trial.robot.wait_for("latched", 5.0)
    assert state.cause
    assert state.cause.arguments[0] == told


@pytest.mark.parametrize("name", MORE)
def test_an_object_s_own_words_follow_in_the_events(trial: Trial, name: str) -> None:
    log = EventLog(trial.name)
    trial.robot.estop(WORDS[name][0])
    wait_for("its words", lambda: any(MORE[name] in event.text for event in log.read()))


def test_the_stop_is_out_before_an_object_is_asked_for_its_words(trial: Trial) -> None:
    latched = []

    class Waits:
        def __str__(self) -> str:
            latched.append(trial.robot.wait_for("latched", 5.0).cause)
            raise SystemExit

    trial.robot.estop(Waits())
    wait_for("its words to be asked for", lambda: latched)
    assert [str(cause).partition(" (")[0] for cause in latched] == ["stop request: Waits"]


def test_an_object_that_never_gives_its_words_holds_nobody_up(trial: Trial) -> None:
    over, ended = threading.Event(), threading.Event()

    class Hangs:
        def __str__(self) -> str:
            over.wait(20.0)
            ended.set()
            return "too late"

    log = EventLog(trial.name)
    trial.robot.estop(Hangs())
    assert not ended.is_set()
    over.set()
    assert ended.wait(5.0)
    assert str(trial.robot.wait_for("latched", 5.0).cause).startswith("stop request: Hangs (")
    assert not any("too late" in event.text for event in log.read())


def test_words_that_come_late_are_no_second_stop(trial: Trial, monkeypatch: pytest.MonkeyPatch) -> None:
    sent: list[bytes] = []
    monkeypatch.setattr(bell, "send", lambda _, line: sent.append(line))
    trial.robot.estop(Wall(0.3))
    monkeypatch.setattr("failstop.api.client.OWN_WORDS_S", 0.0)
    trial.robot.estop(Wall(0.3))
    said = [line.split(b"\t")[0] for line in sent]
    assert said == [b"Wall: 0.3", b"Wall: a wall at 0.3 m", b"Wall: 0.3"]


def test_whoever_asks_is_named_as_well_as_can_be(trial: Trial) -> None:
    send_stop(trial.name, "hand", Raises())
    assert str(trial.robot.wait_for("latched", 5.0).cause).startswith("stop request: hand (says it is Raises, pid ")


def test_an_asynchronous_robot_stops_for_an_exception(trial: Trial) -> None:
    AsyncRobot(trial.name, client="async").estop(ValueError("wall"))
    cause = trial.robot.wait_for("latched", 5.0).cause
    assert str(cause).startswith("stop request: ValueError: wall (says it is async, pid ")


def test_a_robot_that_is_closed_stops_for_an_exception(trial: Trial) -> None:
    robot = Robot(trial.name)
    robot.close()
    robot.estop(subprocess.CalledProcessError(1, "nav"))
    assert "CalledProcessError: 1, nav" in str(trial.robot.wait_for("latched", 5.0).cause)
