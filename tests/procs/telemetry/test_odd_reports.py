"""Odd reports: whatever a board says, telemetry goes on, publishes nothing that can't be, and logs it once."""

from __future__ import annotations

import itertools
import json
import math
import struct
from collections.abc import Callable
from copy import copy
from functools import partial
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.board import plausible
from failstop.board.hoverboard.feedback import seal
from failstop.board.rrc import framing
from failstop.board.rrc.framing import seal as sealed
from failstop.messages import layout, records
from failstop.messages.packing import Note
from failstop.policy.causes import BY_NUMBER, read
from failstop.procs.telemetry.battery import LOW_READINGS
from tests.support.telemetry_scene import Scene

HUGE = 10**310
"""An integer that no float holds; JSON may say it."""
ODD: tuple[Any, ...] = (
    math.nan,
    math.inf,
    -math.inf,
    1e308,
    -1e308,
    HUGE,
    -HUGE,
    10**5000,
    None,
    "12",
    b"\xff",
    [],
    {},
    True,
    object(),
)
"""No number that a voltage, a speed or a rate can be."""
LOW = {"battery.stop_mv": 6600}


def line(**values: object) -> bytes:
    return json.dumps({"T": 1001, **values}).encode() + b"\n"


def ugv(**changed: object) -> Scene:
    return Scene(**{"board.kind": "ugv", "wheels.layout": "differential", **changed})


def odd(scene: Scene) -> list[str]:
    return [note.text for note in map(Note.unpack, scene.told("notes")) if note.kind == "odd"]


def causes(scene: Scene) -> list[str]:
    return [str(read(cause)) for cause in scene.told("causes")]


@pytest.mark.parametrize(
    "report",
    [
        line(v=-1),
        line(v=0),
        line(v=1e308),
        line(v=-1e308),
        b'{"T":1001,"v":NaN}\n',
        b'{"T":1001,"v":-Infinity}\n',
        b'{"T":1001,"v":1' + b"0" * 310 + b"}\n",
    ],
)
def test_a_battery_that_cannot_be_is_unknown_stops_nothing_and_is_logged_once(report: bytes) -> None:
    """A board that is fed by USB alone reports -0.01 V: no battery, and neither an emergency nor an empty one."""
    scene = ugv(**LOW)
    scene.wake(line(v=1160), elapsed_ns=1_000_000_000)
    assert scene.latest("battery") == (11_600, 0)
    for _ in range(2 * LOW_READINGS):
        scene.wake(report, elapsed_ns=1_000_000_000)
        assert scene.latest("battery") == (0, 0), "what State.battery_v shows as None"
    assert causes(scene) == []
    [said] = odd(scene)
    assert said.startswith("the board reports a battery of ")
    assert said.endswith(", and no low battery stops the robot meanwhile")
    scene.wake(line(v=1150), elapsed_ns=1_000_000_000)
    assert scene.latest("battery") == (11_500, 0), "the charger saw no step"


def test_a_low_battery_still_stops_after_an_odd_reading() -> None:
    scene = ugv(**LOW)
    for centivolts in [650] * (LOW_READINGS - 1) + [-1, 650]:
        scene.wake(line(v=centivolts), elapsed_ns=1_000_000_000)
    assert causes(scene) == ["the battery is at 6.50 V"]


@pytest.mark.parametrize("centivolts", [-5, 0, 5, -32768])
def test_a_hoverboard_without_a_battery(centivolts: int) -> None:
    scene = Scene(**{"board.kind": "hoverboard", "wheels.layout": "differential", **LOW})
    for _ in range(2 * LOW_READINGS):
        scene.wake(seal(0, 0, centivolts=centivolts), elapsed_ns=1_000_000_000)
    assert scene.latest("battery") == (0, 0)
    assert causes(scene) == []
    assert len(odd(scene)) == 1


def test_the_rrc_without_a_battery() -> None:
    scene = Scene(**LOW)
    scene.battery(11_600, *[12] * 2 * LOW_READINGS)
    assert scene.latest("battery") == (0, 0)
    assert causes(scene) == []
    assert odd(scene) == [
        "the board reports a battery of 0.01 V: no battery has such a voltage, so it counts as not reported, and no "
        "low battery stops the robot meanwhile"
    ]


@pytest.mark.parametrize("value", ["NaN", "Infinity", "1e308", "1" + "0" * 310])
def test_wheels_that_turn_at_no_number_prove_no_rest(value: str) -> None:
    scene = ugv()
    for _ in range(20):
        scene.wake(b'{"T":1001,"L":%s,"R":%s,"odl":%s,"odr":0}\n' % ((value.encode(),) * 3), elapsed_ns=100_000_000)
    assert (scene.own.word("judged_ns").get(), scene.own.word("still_ns").get()) == (0, 0)
    [said] = odd(scene)
    assert said.startswith("the board reports wheels as ")


class Listed:
    """The reader of an own board, which returns what it was given, or raises it."""

    def __init__(self, given: Any) -> None:
        self._given = given

    def feed(self, chunk: bytes) -> Any:
        if isinstance(self._given, Exception):
            raise self._given
        return self._given


def own(given: Callable[[Any], object]) -> Scene:
    """Telemetry with an own board whose reader returns this, made of the vocabulary (wire.py) as its process has it."""
    scene = ugv(**LOW)
    wire = scene.load("failstop.board.kinds").wire_of("ugv")
    found = given(scene.load("failstop.board.wire"))
    wire = copy(wire)
    wire.reader = lambda: Listed(found)
    scene.telemetry._hearing = scene.load("failstop.board.described").Samples(wire)
    return scene


SAMPLES: dict[str, Callable[[Any, Any], object]] = {
    "voltage": lambda wire, value: wire.Battery(value),
    "a speed": lambda wire, value: wire.Wheels((value, 0.0), ()),
    "positions": lambda wire, value: wire.Wheels((), (value, value)),
    "all of the wheels": lambda wire, value: wire.Wheels(value, value),
    "obeyed speeds": lambda wire, value: wire.Obeyed((value, value)),
    "all that is obeyed": lambda wire, value: wire.Obeyed(value),
    "an acceleration": lambda wire, value: wire.Imu((value, 0.0, 9.8), (0.0, 0.0, 0.0)),
    "a rate": lambda wire, value: wire.Imu((0.0, 0.0, 9.8), (value, 0.0, 0.0)),
    "all of an IMU": lambda wire, value: wire.Imu(value, value),
    "a servo": lambda wire, value: wire.Health(((value, 0.0, 20),)),
    "a load": lambda wire, value: wire.Health(((1, value, 20),)),
    "a temperature": lambda wire, value: wire.Health(((1, 0.0, value),)),
    "a servo's error": lambda wire, value: wire.Health(((1, 0.0, 20, value),)),
    "all servos": lambda wire, value: wire.Health(value),
    "no voltage": lambda wire, value: object.__new__(wire.Battery),
    "no vectors": lambda wire, value: object.__new__(wire.Imu),
}


def published(scene: Scene) -> list[float]:
    found: list[float] = [float(value) for value in (*scene.latest("imu"), *scene.latest("battery"))]
    found += [float(part) for row in scene.latest("health") for part in row]
    return found


def _one(make: Callable[[Any, Any], object], value: object, wire: Any) -> list[object]:
    return [make(wire, value)]


@pytest.mark.parametrize("make", SAMPLES.values(), ids=list(SAMPLES))
def test_an_own_board_that_says_anything_ends_nothing(make: Callable[[Any, Any], object]) -> None:
    for value in ODD:
        scene = own(partial(_one, make, value))
        for _ in range(2 * LOW_READINGS):
            scene.wake(b"x", elapsed_ns=20_000_000)
        assert scene.own.word("beat_ns").get() == scene.clock(), "it went on"
        assert all(map(math.isfinite, published(scene)))
        assert causes(scene) == []
        assert len(odd(scene)) <= 1, "once"
        assert scene.own.word("still_ns").get() == 0
        assert scene.own.word("unheeded_ns").get() == 0


@pytest.mark.parametrize("place", range(3))
def test_a_servo_of_an_own_board_that_answers_anything_ends_nothing(place: int) -> None:
    for value in ODD:
        scene = own(lambda wire: [])
        numbers: list[object] = [1, 5, 5]
        numbers[place] = value
        answer = scene.load("failstop.board.servos").ServoAnswer(*numbers)
        scene.telemetry._hearing._wire.reader = lambda answer=answer: Listed([answer])
        scene.telemetry._hearing.reset()
        scene.wake(b"x", elapsed_ns=20_000_000)
        assert scene.own.word("beat_ns").get() == scene.clock()
        assert len(odd(scene)) == 1


def test_a_command_of_no_speeds_is_no_command_of_zeros() -> None:
    scene = own(lambda wire: [wire.Obeyed(())])
    scene.wake(b"x")
    assert len(odd(scene)) == 1


@pytest.mark.parametrize("given", [None, 7, [None], [7, "x"], ValueError("a bug"), RecursionError(), [object()]])
def test_a_reader_that_fails_or_returns_anything_ends_nothing(given: object) -> None:
    scene = own(lambda wire: given)
    for _ in range(20):
        scene.wake(b"x", elapsed_ns=100_000_000)
    assert scene.own.word("beat_ns").get() == scene.clock()
    assert len(odd(scene)) <= 1


@pytest.mark.parametrize(
    ("text", "sign"),
    [
        ("it printed its boot text", "it printed its boot text"),
        ("x" * 300, "x" * 57 + "..."),
        ("\n\x1b" * 2, "????"),
        ("\N{ROBOT FACE}" * 60, "\N{ROBOT FACE}" * 60),
        ("\ud800", "?"),
        (None, "None"),
    ],
    ids=["usual", "long", "unprintable", "four bytes each", "no UTF-8", "no text"],
)
def test_a_restart_of_an_own_board_stops_with_any_text(text: Any, sign: str) -> None:
    scene = own(lambda wire: [wire.Wheels((0.0, 0.0), (0.0, 0.0)), wire.Restarted(text)])
    scene.gate["enabled"] = True
    scene.wake(b"x", elapsed_ns=20_000_000)
    assert causes(scene) == [f"the board restarted: {sign}"]


def test_the_ring_has_room_for_any_cause() -> None:
    ring = layout.SEGMENT_BY_NAME[layout.TELEMETRY].records["causes"]
    for row in BY_NUMBER.values():
        longest = row(*("\N{ROBOT FACE}" * 100 if of is str else of(1) for _, of in row.parameters))
        assert len(longest.pack()) <= ring.capacity


def test_a_reader_that_never_ends_is_cut_off() -> None:
    scene = own(lambda wire: itertools.repeat(wire.Battery(11.6)))
    scene.wake(b"x")
    assert scene.latest("battery") == (11_600, 0)


def test_a_question_that_fails_ends_nothing() -> None:
    scene = own(lambda wire: [wire.Battery(11.6)])
    wire = scene.telemetry._hearing._wire
    question = copy(wire.questions[0])
    question.answered_by = lambda sample: sample.text
    wire.questions = (question,)
    scene.wake(b"x")
    assert scene.latest("battery") == (11_600, 0)
    [said] = odd(scene)
    assert "AttributeError" in said


NUMBERS: st.SearchStrategy[Any] = st.one_of(
    st.floats(), st.integers(), st.sampled_from([HUGE, -HUGE, True, None, "x", [], {}])
)
REPORT = st.dictionaries(
    st.sampled_from(["T", "L", "R", "odl", "odr", "ax", "ay", "az", "gx", "gy", "gz", "v"]), NUMBERS
)


@given(st.lists(REPORT, max_size=6))
def test_any_line_of_the_ugv(rows: list[dict[str, object]]) -> None:
    scene = ugv(**LOW)
    for row in rows:
        scene.wake(line(**row), elapsed_ns=100_000_000)
    assert scene.own.word("beat_ns").get() == scene.clock()
    assert all(map(math.isfinite, published(scene)))
    assert all(mv == 0 or 1000 <= mv <= 1_000_000 for mv in scene.latest("battery")[:1])


@given(st.lists(st.tuples(*[st.integers(-32768, 32767)] * 6), max_size=6))
def test_any_feedback_of_the_hoverboard(rows: list[tuple[int, ...]]) -> None:
    scene = Scene(**{"board.kind": "hoverboard", "wheels.layout": "differential", **LOW})
    for row in rows:
        scene.wake(seal(*row), elapsed_ns=100_000_000)
    assert scene.own.word("beat_ns").get() == scene.clock()


@given(
    st.lists(
        st.tuples(st.sampled_from(range(12)), st.binary(max_size=40)),
        max_size=8,
    )
)
def test_any_frame_of_the_rrc(rows: list[tuple[int, bytes]]) -> None:
    scene = Scene(**LOW)
    for func, data in rows:
        scene.wake(sealed(func, data), elapsed_ns=100_000_000)
    assert scene.own.word("beat_ns").get() == scene.clock()
    assert all(map(math.isfinite, published(scene)))


@given(st.lists(st.floats(width=32), min_size=6, max_size=6))
def test_any_imu_sample_of_the_rrc(raw: list[float]) -> None:
    scene = Scene()
    scene.turn((framing.IMU_FUNC, struct.pack("<6f", *raw)))
    possible = all(abs(part) <= plausible.MOST_G for part in raw[:3]) and all(
        abs(part) <= plausible.MOST_DPS for part in raw[3:]
    )
    assert bool(scene.latest("imu")) == possible
    assert len(odd(scene)) == (not possible)


@given(
    st.lists(st.binary(max_size=64), max_size=6),
    st.sampled_from(["arduino", "damiao", "ugv", "hoverboard", "feetech", "vesc", "rrc"]),
)
def test_any_bytes_of_any_board(chunks: list[bytes], kind: str) -> None:
    layout = {"rrc": "mecanum", "feetech": "omni3"}.get(kind, "differential")
    scene = Scene(**{"board.kind": kind, "wheels.layout": layout, **LOW})
    for chunk in chunks:
        scene.wake(chunk, elapsed_ns=100_000_000)
    assert scene.own.word("beat_ns").get() == scene.clock()


def test_a_value_of_any_kind_is_shown_in_a_short_line() -> None:
    class Rude:
        def __repr__(self) -> str:
            raise RuntimeError("no")

    deep: list[object] = []
    deep.append(deep)
    for value in (*ODD, Rude(), deep, [0.0] * 1_000_000, "\x1b[31m\n", (1.0, "x")):
        text = plausible.odd_text(value)
        assert len(text) <= plausible.LONGEST_ODD_TEXT
        assert text.isprintable()
    assert plausible.odd_text((1.0, "x")) == "1.0, 'x'"
    assert records.BATTERY.pack(round(plausible.MOST_V * 1000), 0)
