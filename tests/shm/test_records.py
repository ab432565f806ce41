"""Records: every payload comes back as it went in, fits its record, and is damage in any other size."""

from __future__ import annotations

import contextlib
import select
import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.messages import records
from failstop.messages.layout import SEGMENT_BY_NAME
from failstop.messages.packing import pack
from failstop.messages.records import Shape
from failstop.policy import causes
from failstop.policy.settings import LONGEST_NAME, MOST_OF_A_FAMILY

U64 = st.integers(0, 2**64 - 1)
U32 = st.integers(0, 2**32 - 1)
U8 = st.integers(0, 255)
I8 = st.integers(-128, 127)
SPEED = st.floats(allow_nan=False)
TOP = 2**64 - 1
SERVO = st.tuples(U8, st.integers(-102, 102).map(lambda percent: percent / 100), U8, U8)
CAUSE = st.binary(max_size=causes.ARGUMENTS_BYTES + 2)
"""A packed one; what is in it is no matter of the records."""


def capacity(place: str) -> int:
    of, _, record = place.partition("/")
    return SEGMENT_BY_NAME[of].records[record].capacity


def text_strategy(room: int) -> st.SearchStrategy[str]:
    """Text of any length, surrogates from undecodable paths and all; the long ones most often."""
    return st.one_of(
        st.text(max_size=40),
        st.text(st.characters(), min_size=room // 4, max_size=room + 20),
        st.sampled_from(["é" * room, "x" + "é" * room, "🛑" * room, "x🛑" * room, "\0" * room, "\udcff" * room]),
    )


def is_cut(found: str, text: str, room: int) -> bool:
    """True when `found` is the longest beginning of `text` that fits."""
    text = text.encode("utf-8", "replace").decode()
    if len(found.encode()) > room or not text.startswith(found):
        return False
    return found == text or len(text[: len(found) + 1].encode()) > room


ROUND_TRIPS: dict[str, tuple[Shape, tuple[st.SearchStrategy[object], ...]]] = {
    "frame": (records.FRAME, (U64, U8, st.binary(max_size=260))),
    "stopped": (records.STOPPED, (U64, U64, U64, CAUSE)),
    "wrote": (records.WROTE, (U8, st.lists(SPEED, max_size=records.MOST_REPORTED).map(tuple))),
    "proved": (records.PROVED, (U64, U64)),
    "command": (records.COMMAND, (U64, SPEED, SPEED, SPEED, st.booleans(), st.just("teleop"))),
    "latch": (records.LATCH, (U64, U64, U64, CAUSE)),
    "request": (records.REQUEST, (U64, U64, U8)),
    "imu": (records.IMU, (SPEED,) * 6),
    "health": (records.HEALTH, (SERVO, SERVO)),
    "bias": (records.BIAS, (SPEED, SPEED, SPEED, st.booleans(), st.booleans())),
    "asserted": (records.ASSERTED, (U64, st.lists(st.sampled_from(["bumper", "front left", "arm"]), max_size=8))),
    "battery": (records.BATTERY, (U32, st.just(2))),
    "wheels_seen": (records.WHEELS_SEEN, (U8, U8, st.booleans(), U8, U64, U64, *(SPEED,) * 2 * records.MOST_WHEELS)),
    "pad": (records.PAD, (st.integers(0, 65535), U8, I8, I8, I8, I8, st.just(1))),
    "servo": (records.SERVO, (U8, U8, st.none() | st.integers(-(2**15), 2**16))),
    "pad_arm": (records.PAD_ARM, (U8, st.floats(-1, 1))),
    "arm_goal": (records.ARM_GOAL, (U64, U8, st.dictionaries(U8, SPEED, min_size=1, max_size=8))),
}


@pytest.mark.parametrize("kind", ROUND_TRIPS)
@given(data=st.data())
def test_what_is_packed_comes_back(kind: str, data: st.DataObject) -> None:
    shape, values = ROUND_TRIPS[kind]
    given = data.draw(st.tuples(*values))
    packed = shape.pack(*given)
    assert shape.unpack(packed) == given
    assert kind != "arm_goal" or len(packed) <= capacity("client.0/arm_goal")


TEXTS: dict[str, tuple[Shape, tuple[st.SearchStrategy[object], ...], int, st.SearchStrategy[tuple[bytes, ...]]]] = {
    "port": (records.PORT, (U64, U64, st.sampled_from([0, 1, 2])), 300, st.just(())),
    "hello": (records.HELLO, (U64, U32, U64), 64, st.just(())),
    "reply": (records.REPLY, (U64, U64, st.booleans(), st.sampled_from([0, 1, 2])), 290, st.tuples(CAUSE)),
}


@pytest.mark.parametrize("kind", TEXTS)
@given(data=st.data())
def test_a_text_is_cut_to_its_room_and_the_rest_comes_back(kind: str, data: st.DataObject) -> None:
    shape, before, room, after = TEXTS[kind]
    given, text, cause = data.draw(st.tuples(st.tuples(*before), text_strategy(room), after))
    packed = shape.pack(*given, text, *cause)
    found = shape.unpack(packed)
    assert len(packed) <= shape.most
    assert (found[: len(given)], found[len(given) + 1 :]) == (given, cause)
    assert is_cut(str(found[len(given)]), text, room)


def test_a_command_keeps_what_is_no_number_for_the_gate_to_refuse() -> None:
    packed = records.COMMAND.pack(1, float("nan"), float("inf"), -0.0, True, "cmd_vel")
    assert [str(value) for value in records.COMMAND.unpack(packed)[1:4]] == ["nan", "inf", "-0.0"]


@given(session=U64, sees=text_strategy(190), wrong=text_strategy(190))
def test_said(session: int, sees: str, wrong: str) -> None:
    packed = records.SAID.pack(session, sees, wrong)
    found_session, *found = records.SAID.unpack(packed)
    assert found_session == session
    assert len(packed) <= records.SAID.most
    for told, text in zip(found, (sees, wrong), strict=True):
        assert "\n" not in told, "each is a line"
        assert is_cut(told, text.replace("\n", " "), 190)


@given(pid=U32, block=U32)
def test_a_life_is_a_word(pid: int, block: int) -> None:
    life = records.life(pid, block)
    assert 0 <= life < 2**64
    assert records.unpack_life(life) == (pid, block)


LONG = ["x" * 5000, "é" * 5000, "x" + "é" * 5000, "€" * 5000, "🛑" * 5000, "\udcff" * 5000, "\0" * 5000]


@pytest.mark.parametrize("text", [*LONG, "x" * (records.HELD_BYTES + 1), "\u20ac" * 67])
def test_names_that_something_depends_on_are_refused_and_not_cut(text: str) -> None:
    with pytest.raises(ValueError, match="is longer than 16 bytes"):
        records.COMMAND.pack(1, 0.0, 0.0, 0.0, False, text)
    with pytest.raises(ValueError, match="is longer than 200 bytes"):
        records.ASSERTED.pack(1, [text[:5], text])


def test_every_name_that_the_settings_allow_fits() -> None:
    longest = [f"{number}".rjust(LONGEST_NAME, "x") for number in range(MOST_OF_A_FAMILY)]
    assert records.ASSERTED.unpack(records.ASSERTED.pack(1, longest))[1] == longest
    for name in longest:
        assert records.COMMAND.unpack(records.COMMAND.pack(1, 0.0, 0.0, 0.0, True, name))[-1] == name
    rules = {"sources": longest, "interlocks": longest, "lease_ns": TOP}
    assert len(pack(rules)) <= capacity("supervisor/rules")


ANGLES = st.floats(-4, 4, width=32)


@given(session=U64, count=st.integers(1, 8), length=st.sampled_from([1, 2, 200]), angle=ANGLES)
def test_arm_path(session: int, count: int, length: int, angle: float) -> None:
    rows = [(float(at), [angle] * count) for at in range(length)]
    packed = records.ARM_PATH.pack(session, 0.5, list(range(count)), rows)
    found = records.ARM_PATH.unpack(packed)
    assert found == (session, 0.5, list(range(count)), [(t_s, tuple(row)) for t_s, row in rows])
    assert len(packed) <= capacity("client.0/arm_path")


@pytest.mark.parametrize(("joints", "points"), [(0, 1), (9, 1), (1, 0), (1, 201)])
def test_an_arm_s_request_of_nothing_or_of_more_than_fits_is_refused(joints: int, points: int) -> None:
    with pytest.raises(ValueError, match="at most 8 and 200"):
        records.ARM_PATH.pack(1, 1.0, list(range(joints)), [(0.0, [0.0] * joints)] * points)
    if joints != 1:
        with pytest.raises(ValueError, match="must be 1 to 8"):
            records.ARM_GOAL.pack(1, 1, dict.fromkeys(range(joints), 0.0))


@pytest.mark.parametrize("data", [b"", b"\0", b"\1", b"\1" + bytes(8), b"\1" + bytes(10), b"\x09" + bytes(72)])
def test_a_goal_of_no_joint_or_of_more_than_there_may_be_or_cut_off_is_no_goal(data: bytes) -> None:
    with pytest.raises(ValueError, match=f"a goal of joints in {len(data)} bytes"):
        records.ARM_GOAL.unpack(bytes(9) + data)


@pytest.mark.parametrize(
    ("data", "told"),
    [
        (b"\5\5", "0 joints and 0 points in 2 bytes"),
        (struct.pack("<BH", 2, 1), "2 joints and 1 points in 3 bytes"),
        (struct.pack("<BH", 0, 2) + bytes(16), "0 joints and 2 points in 19 bytes"),
        (struct.pack("<BH", 9, 1) + bytes(9 + 44), "9 joints and 1 points in 56 bytes"),
        (struct.pack("<BH", 1, 1) + bytes(1 + 11), "1 joints and 1 points in 15 bytes"),
        (struct.pack("<BH", 1, 1) + bytes(1 + 13), "1 joints and 1 points in 17 bytes"),
        (struct.pack("<BH", 1, 1) + bytes(1 + 24), "1 joints and 1 points in 28 bytes"),
    ],
)
def test_a_trajectory_of_a_wrong_number_of_joints_or_points_is_refused(data: bytes, told: str) -> None:
    with pytest.raises(ValueError, match=f"^a trajectory of {told}$"):
        records.ARM_PATH.unpack(bytes(16) + data)


@given(payload=st.binary(max_size=200))
def test_any_bytes_of_a_client_s_arm_are_unpacked_or_a_value_error(payload: bytes) -> None:
    for unpack in (records.ARM_GOAL.unpack, records.ARM_PATH.unpack):
        with contextlib.suppress(ValueError):
            unpack(payload)


LEAST = (
    {"frame": 9, "stopped": 24, "port": 17, "latch": 24, "left": 8 * records.GOODBYES, "hello": 20, "reply": 20}
    | {
        "request": 17,
        "aux": 8,
        "seen": 16,
        "command": 49,
        "asserted": 8,
        "said": 8,
        "imu": 48,
        "battery": 5,
        "bias": 26,
    }
    | {"odometry": 113, "pad_command": 24, "pad_request": 1, "pad": 8, "speed_limit": 9, "health": 0}
    | {"wheels_seen": 84}
    | {"wrote": 1, "proved": 16}
)
"""Bytes of each at least; those of a text, a frame or names may have more."""
LONGER = {
    "frame",
    "stopped",
    "port",
    "latch",
    "hello",
    "reply",
    "asserted",
    "said",
    "pad_request",
    "health",
    "wrote",
    "aux",
}
SHAPES = {name.lower(): found for name, found in vars(records).items() if isinstance(found, Shape)}


def test_every_payload_is_under_test() -> None:
    assert SHAPES.keys() == set(LEAST) | {"arm_goal", "arm_path", "servo", "pad_arm"}


def test_half_a_servo_or_number_is_damage() -> None:
    with pytest.raises(ValueError, match=r"^numbers in 12 bytes$"):
        records.WROTE.unpack(bytes(13))
    with pytest.raises(ValueError, match=r"^servos in 5 bytes$"):
        records.HEALTH.unpack(bytes(5))


def test_a_shape_takes_its_numbers_and_its_tail_and_nothing_else() -> None:
    numbers = Shape("<BH")
    assert numbers.unpack(numbers.pack(1, 2)) == (1, 2)
    with pytest.raises(struct.error):
        numbers.pack(1, 2, 3)
    named = Shape("<B", records._text(4))
    assert named.unpack(named.pack(1, "\u00e9\u20ac")) == (1, "\u00e9")
    assert named.unpack(b"\1\xff") == (1, "\ufffd")
    assert (numbers.most, named.most) == (3, 5)


@pytest.mark.parametrize("kind", LEAST)
def test_a_wrong_size_is_a_value_error(kind: str) -> None:
    shape, least = SHAPES[kind], LEAST[kind]
    assert (shape.most > least) is (kind in LONGER)
    shape.unpack(bytes(least))
    shape.unpack(bytes(shape.most))
    for wrong in (*range(least), shape.most + 1, shape.most + 8, shape.most + 320):
        with pytest.raises(ValueError, match=f"payload of {wrong} bytes, {least} to {shape.most} expected"):
            shape.unpack(bytes(wrong))


@pytest.mark.parametrize("kind", ["port", "hello", "asserted", "said"])
def test_a_text_that_is_no_utf_8_is_shown_as_far_as_it_goes(kind: str) -> None:
    assert "\ufffd" in str(SHAPES[kind].unpack(bytes(LEAST[kind]) + b"\xff"))


def test_no_bytes_of_a_client_are_too_strange_to_be_read() -> None:
    assert records.REPLY.unpack(struct.pack("<QQBBH", 1, 2, 0, 0, 1) + b"\xff\xfe") == (1, 2, 0, 0, "\ufffd", b"\xfe")
    assert causes.unpack(struct.pack("<H", causes.PIPED.number) + b"\xff") == causes.PIPED("\ufffd")
    command = records.COMMAND.pack(1, 0.0, 0.0, 0.0, False, "teleop")
    assert records.COMMAND.unpack(command[:-16] + b"\xff" * 16)[-1] == "\ufffd" * 16
    session = struct.pack("<Q", 7)
    assert records.SAID.unpack(session + b"one\ntwo\nthree") == (7, "one", "two three")
    assert records.SAID.unpack(session + b"one") == (7, "one", "")


@given(words=st.text(max_size=400), who=st.text(max_size=100), pid=st.integers(1, 2**22))
def test_a_request_is_one_line_that_a_pipe_takes_whole_and_a_record_holds(words: str, who: str, pid: int) -> None:
    line = records.asking(words, who, pid)
    assert line.endswith(b"\n")
    assert line.count(b"\n") == 1
    assert len(line) < select.PIPE_BUF
    told = causes.requested(line[:-1])
    assert causes.unpack(told.pack()) == told, "nothing is cut any more"
    assert told.kind is (causes.REQUESTED if who.split() else causes.PIPED)
    assert told.named().get("pid") == (pid if who.split() else None)


@pytest.mark.parametrize("letter", ["x", "\u00e9", "\u20ac", "\U0001f916"])
@pytest.mark.parametrize("shift", range(4))
def test_of_a_reason_that_is_too_long_whole_characters_are_left_and_that_is_seen(letter: str, shift: int) -> None:
    words = "y" * shift + 5000 * letter
    text = records.asking(words, "nav", 7).decode()
    kept, left_out, who = text.partition(" ...")
    assert (left_out, who) == (" ...", "\tnav\t7\n")
    assert words.startswith(kept)
    assert records.ASKED_BYTES - 8 < len((kept + left_out).encode()) <= records.ASKED_BYTES
    assert records.asking(kept).decode() == f"{kept}\n", "what fits is left as it is"


def test_payloads_are_little_endian_without_padding() -> None:
    assert records.FRAME.pack(1, 2, b"x") == bytes([1, 0, 0, 0, 0, 0, 0, 0, 2]) + b"x"
    assert records.PAD.pack(0x0102, 3, -1, 4, 5, 6, 1) == bytes([2, 1, 3, 255, 4, 5, 6, 1])
    command = struct.pack("<QdddB16s", 1, 0.2, 0.0, 0.0, 1, b"cmd_vel")
    assert records.COMMAND.pack(1, 0.2, 0.0, 0.0, True, "cmd_vel") == command


@pytest.mark.parametrize("state", range(len(records.PORT_STATES)))
def test_what_the_port_owner_says_of_one_port_is_not_said_of_another(state: int) -> None:
    entry = (1, 1, records.PORT.pack(7, 50, state, "/dev/ttyACM0"))
    closed = records.PORT_CLOSED
    assert [records.port_state(entry, number) for number in (6, 7, 8)] == [closed, state, closed]
    assert records.port_state(None, 7) == closed


def test_of_more_servos_than_a_record_has_room_for_the_first_are_reported() -> None:
    rows = [(servo, 0.25, 30, 0) for servo in range(1, records.MOST_SERVOS + 2)]
    assert records.HEALTH.unpack(records.HEALTH.pack(*rows)) == tuple(rows[:-1])


@pytest.mark.parametrize("before", [b"", b"damaged"])
def test_a_goodbye_where_none_lay_is_of_its_session_alone(before: bytes) -> None:
    said = records.goodbye(7, before)
    assert set(records.LEFT.unpack(said)) == {7, records.NOBODY}
    assert records.LEFT.unpack(records.goodbye(8, said))[:3] == (8, 7, records.NOBODY)


def test_what_can_not_be_printed_is_not_shown() -> None:
    assert records.printable("a\x1b[2J\u00e9\n\u202e\U0001f916") == "a?[2J\u00e9??\U0001f916"


def test_who_asks_for_a_stop_is_told_only_where_somebody_is_named() -> None:
    assert records.asking(" wall \n ahead ", " nav\t2 ", 7) == b"wall ahead\tnav 2\t7\n"
    assert records.asking("wall") == b"wall\n"
    assert records.asking("wall", "nav") == b"wall\tnav\t0\n"
    assert records.asking("wall", "nav", 7, "held") == b"wall\tnav\t7\theld\n"
    assert records.asking("wall", row="held") == b"wall\n", "a cause is a client's, who has a name"
    assert records.asking("", "n" * 100, 7) == b"\t" + b"n" * records.WHO_BYTES + b"\t7\n"
    assert records.asking("x" * records.ASKED_BYTES) == b"x" * records.ASKED_BYTES + b"\n", "just fits"
