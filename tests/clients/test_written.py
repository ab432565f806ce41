"""What the C library writes into its slot is what the gate reads there, and what the service publishes is what
fs_get_state() shows, to the bit: random values, a million records each way in `make c-client`."""

from __future__ import annotations

import ctypes
import os
import random
import struct
import time
from collections.abc import Iterator
from math import isnan, nan
from typing import Any

import pytest

from failstop.api.robot import Driving, Preempted, judge
from failstop.api.snapshot import Block
from failstop.messages import box, layout, records
from failstop.messages.packing import pack
from failstop.policy import causes
from failstop.policy.causes import Reply
from failstop.policy.settings import FIRST_SOURCE
from tests.clients.own_run import OwnRun, State, Velocity, a_double, bits, own_run, same
from tests.clients.scene import INVALID, OK, REFUSED, UNDECLARED
from tests.support.amounts import amount

ROUNDS = amount(1_000, 500_000)
"""Of each test, on each of two bases: a million in `make c-client`."""
STATES = amount(300, 62_500)
"""The same for states, of which each has eight records."""
SOURCES = ("web", "a" * records.SOURCE_BYTES, "b")
INTERLOCKS = ("hatch", "lid_closed", "c" * 16)
BLOCKS = (None, Block.LATCHED, Block.DISABLED, Block.HELD, Block.NO_COMMAND, Block.NO_SCAN)
LINKS = ("unproven", "alive", "deaf", "unheard", "unasked", "silent")
ANSWERS = {Driving: 1, Preempted: 2}
LONG_NS = 3_600_000_000_000
FIELDS = tuple(name for name, *_ in State._fields_)


@pytest.fixture(scope="module", params=["mecanum", "ackermann"])
def made(request: pytest.FixtureRequest) -> Iterator[OwnRun]:
    values: dict[str, Any] = {
        "wheels.layout": request.param,
        "wheels.sign_2": -1,
        **{f"sources.{name}.priority": at for at, name in enumerate(SOURCES, 1)},
        **{f"sources.{name}.timeout_s": 0.3 for name in SOURCES},
        **{f"interlocks.{name}.refusal": name for name in INTERLOCKS},
        **{f"interlocks.{name}.timeout_s": 0.3 for name in INTERLOCKS},
    }
    with own_run(f"written-{os.getpid()}", **values) as run:
        yield run


def drawn(times: int = ROUNDS) -> Iterator[random.Random]:
    seed = os.environ.get("FAILSTOP_SEED", "1")
    for number in range(times):
        yield random.Random(f"{seed} {number}")


def test_a_command_is_the_one_that_the_gate_hears(made: OwnRun) -> None:
    given = Velocity(size=ctypes.sizeof(Velocity))
    sources = [None, *(name.encode() for name in (FIRST_SOURCE, *SOURCES))]
    for draw in drawn():
        wanted_ns = draw.choice((0, draw.getrandbits(64)))
        values = [a_double(draw) for _ in range(3)]
        given.vx, given.vy, given.wz = values
        given.manual, given.source, given.wanted_ns = draw.choice((0, 1, 2, -1)), draw.choice(sources), wanted_ns
        before_ns = time.monotonic_ns()
        assert made.c.fs_command(made.handle, ctypes.byref(given)) == OK
        found = made.slot.new("command")
        assert found
        t_ns, *heard, manual, source = found
        assert t_ns == wanted_ns or (not wanted_ns and before_ns <= t_ns <= time.monotonic_ns())
        assert same(heard, values)
        assert (manual, source) == (bool(given.manual), (given.source or FIRST_SOURCE.encode()).decode())
        assert made.slot.new("command") is None
    assert set(made.rang()) == {made.slot.index}


def test_what_is_no_command_reaches_nobody(made: OwnRun) -> None:
    given = Velocity(size=ctypes.sizeof(Velocity))
    made.slot.new("command")
    for draw in drawn():
        values = [a_double(draw) for _ in range(3)]
        source, wanted = None, INVALID
        if draw.random() < 0.7:
            values[draw.randrange(3)] = draw.choice((nan, -nan, float("inf"), float("-inf")))
        else:
            source, wanted = draw.choice((b"nobody", b"we", b"webs", b"", b"gamepad" * 9)), UNDECLARED
        given.vx, given.vy, given.wz = values
        given.source = source
        assert made.c.fs_command(made.handle, ctypes.byref(given)) == wanted
        assert made.slot.new("command") is None


def test_asserted_interlocks_and_the_sensor_are_those_that_the_gate_hears(made: OwnRun) -> None:
    for draw in drawn():
        names = draw.choices(INTERLOCKS, k=draw.randrange(4))
        array = (ctypes.c_char_p * len(names))(*(name.encode() for name in names))
        before_ns = time.monotonic_ns()
        assert made.c.fs_assert_interlocks(made.handle, array, ctypes.c_size_t(len(names))) == OK
        assert made.c.fs_sensed(made.handle) == OK
        asserted, sensed = made.slot.latest("interlocks"), made.slot.latest("sensed")
        assert asserted
        assert sensed
        assert asserted[1:] == (names,)
        assert sensed[1:] == ([],)
        assert before_ns <= asserted[0] <= sensed[0] <= time.monotonic_ns()


def test_words_for_people_are_those_that_python_would_write(made: OwnRun) -> None:
    pieces = ("a", "scan gone", " ", "\n", "\t", "ä", "€", "\U0001f916", "x" * 60, "é" * 90)
    for draw in drawn():
        sees, wrong = ("".join(draw.choices(pieces, k=draw.randrange(6))) for _ in range(2))
        assert made.c.fs_say(made.handle, sees.encode(), wrong.encode()) == OK
        found = made.slot.latest("said")
        assert found
        said = [records.cut(" ".join(text.split()), records.SAID_BYTES).decode() for text in (sees, wrong)]
        assert [text.rstrip(" ") for text in found[1:]] == [text.rstrip(" ") for text in said]


def test_a_request_and_what_it_is_about_are_those_that_the_gate_hears(made: OwnRun) -> None:
    verbs = {records.ENABLE: made.c.fs_enable, records.DISABLE: made.c.fs_disable}
    made.c.fs_reset.argtypes = [ctypes.c_void_p, ctypes.c_uint64, ctypes.c_double]
    for each in verbs.values():
        each.argtypes = [ctypes.c_void_p, ctypes.c_double]
    found = made.slot.latest("request")
    number = found[1] if found else 0
    for draw in drawn():
        verb, seen = draw.choice((records.ENABLE, records.DISABLE, records.RESET)), draw.getrandbits(64)
        before_ns = time.monotonic_ns()
        done = made.c.fs_reset(made.handle, seen, 0.0) if verb == records.RESET else verbs[verb](made.handle, 0.0)
        assert done == OK
        number += 1
        found = made.slot.new("request")
        assert found
        assert found[1:] == (number, verb)
        assert before_ns <= found[0] <= time.monotonic_ns()
        if verb == records.RESET:
            assert made.slot.latest("seen") == (found[0], seen)
    made.rang()


def arguments(draw: random.Random, kind: causes.Kind) -> list[Any]:
    texts, numbers, floats = ("", "gate", "two words", "ä€", "x" * 30), (0, 1, 250, 40321), (0.0, 0.05, 12.345)
    return [draw.choice(texts if of is str else numbers if of is int else floats) for _, of in kind.parameters]


def a_cause(draw: random.Random) -> causes.Cause:
    kind = draw.choice(list(causes.BY_NUMBER.values()))
    return kind(*arguments(draw, kind))


def test_an_answer_is_the_one_that_the_gate_has_written(made: OwnRun) -> None:
    """It is written before the request, so that nobody has to wait for it."""
    made.c.fs_disable.argtypes = [ctypes.c_void_p, ctypes.c_double]
    reply, text = made.writer(layout.GATE, "reply.0"), ctypes.create_string_buffer(4096)
    assert made.c.fs_disable(made.handle, 0.0) == OK
    found = made.slot.latest("request")
    assert found
    number = found[1]
    for draw in drawn():
        number += 1
        cause = draw.choice((None, a_cause(draw)))
        words = "".join(draw.choices(("no", " ", "ä", "€", "x" * 50), k=draw.randrange(8)))
        place = draw.choice(("", records.CAUSE)) if cause else ""
        answer = Reply(draw.choice((records.REFUSED, records.DONE)), f"{words}{place}: {words[:9]}", cause)
        packed = answer.pack(made.slot.session, number)
        reply.write(packed)
        done = made.c.fs_disable(made.handle, 5.0)
        assert done == (OK if answer.done else REFUSED)
        if not answer.done:
            made.c.fs_last_error(made.handle, text, ctypes.c_size_t(len(text)))
            wanted = str(causes.unpack_reply(packed)[2]).encode()
            assert text.value[: len(wanted)] == wanted[: len(text.value)], "639 bytes at most"
            assert len(text.value) == min(len(wanted), 639)
    made.rang()


def a_state(draw: random.Random, now_ns: int) -> dict[str, Any]:
    """A record of the gate; any of its values may be missing, as before this client has commanded."""
    states = ("held", "drives", "waits", "silent")
    names = (FIRST_SOURCE, *SOURCES)
    rows = [
        {"source": name, "priority": at, "who": f"{name} (pid {at})", "state": draw.choice(states)}
        for at, name in enumerate(draw.sample(names, k=draw.randrange(4)))
    ]
    cause = a_cause(draw) if draw.random() < 0.3 else None
    blocks = (box.DISABLED, box.HELD, box.NO_COMMAND, box.NO_SCAN, None, None)
    enabled = draw.random() < 0.6
    return {
        "unmet": draw.choice(("", "hatch")),
        "enabled": enabled,
        "enabled_ns": draw.getrandbits(62) if enabled else 0,
        "limit": draw.randrange(101),
        "estop": cause and cause.pack(),
        "blocked": f"{box.LATCHED}{cause}" if cause else draw.choice(blocks),
        "body_vel": [a_double(draw) for _ in range(3)],
        "wheels_rps": [draw.choice((0.0, draw.uniform(-9, 9))) for _ in range(box.MOST_SPEEDS)],
        "epoch": draw.getrandbits(40),
        "sources": rows,
        "clients": [{"slot": 0, "name": "written", "pid": 7, "driving": draw.random() < 0.5}],
        "scan_ns": now_ns,
    }


def publish(made: OwnRun, draw: random.Random) -> None:
    """Whatever the processes may publish, all at once."""
    now_ns = time.monotonic_ns()
    ago_ns = max(1, now_ns - LONG_NS)  # this clock begins with the machine, which may have been started just now
    old_ns = draw.choice((now_ns, max(1, now_ns - 3_000_000_000), ago_ns))
    made.writer(layout.GATE, "state").write(pack(a_state(draw, now_ns)), old_ns)
    epoch, cause = draw.getrandbits(64) if draw.random() < 0.2 else 0, a_cause(draw)
    latch = records.LATCH.pack(epoch, now_ns, now_ns, cause.pack())
    made.writer(layout.SUPERVISOR, "latch").write(latch, now_ns)
    made.writer(layout.SUPERVISOR, "link").write(draw.choice(LINKS).encode(), now_ns)
    made.word(layout.SUPERVISOR, "epoch").set(draw.getrandbits(64))
    made.word(layout.SUPERVISOR, "ready").set(draw.choice((0, 1, 2)))
    # Far from the lease, so that it does not end between C's look and Python's.
    made.word(layout.SUPERVISOR, "beat_ns").set(draw.choice((now_ns + LONG_NS, now_ns + LONG_NS, ago_ns)))
    port = records.PORT.pack(draw.getrandbits(64), now_ns, draw.randrange(len(records.PORT_STATES)), "/dev/robot")
    made.writer(layout.PORT_OWNER, "port").write(port, now_ns)
    telemetry = {
        "imu": records.IMU.pack(*(bits(draw) for _ in range(6))),
        "battery": records.BATTERY.pack(draw.choice((0, draw.getrandbits(32))), draw.randrange(3)),
        "odometry": records.ODOMETRY.pack(
            *(bits(draw) for _ in range(8)), draw.randrange(2), *(bits(draw) for _ in range(6))
        ),
        "wheels": records.WHEELS_SEEN.pack(
            draw.randrange(3), draw.randrange(3), draw.random() < 0.5, draw.randrange(5), now_ns,
            draw.choice((0, now_ns + LONG_NS, ago_ns)),
            *(draw.choice((nan, *[draw.uniform(-50, 50)] * 9)) for _ in range(8)),
        ),
    }  # fmt: skip
    for record, payload in telemetry.items():
        made.writer(layout.TELEMETRY, record).write(payload, old_ns)


def by_python(made: OwnRun) -> dict[str, Any]:
    """The fields of fs_state by Python's client. Ages are left out, because the time of the look is in them."""
    seen = made.reader.read()
    decided, cause, *_ = made.reader.decided()
    answer, _ = judge(decided, FIRST_SOURCE, cause)
    imu, odometry, turning = seen.imu, seen.odometry, seen.turning
    assert imu
    assert odometry
    return {
        "enabled": int(seen.enabled),
        "latched": int(seen.cause is not None),
        "cause": seen.cause.kind.number if seen.cause else 0,
        "block": BLOCKS.index(seen.block),
        "answer": ANSWERS.get(type(answer), 3),
        "answer_block": BLOCKS.index(getattr(answer, "block", None)),
        "moving": int(seen.moving),
        "link": LINKS.index(seen.device.link),
        "port_open": int(seen.device.state == "open"),
        "epoch": seen.epoch,
        "enabled_ns": seen.enabled_ns,
        "velocity": tuple(seen.body_vel),
        "wheels_radps": tuple(seen.wheels_radps),
        "steering_rad": nan if seen.steering_rad is None else seen.steering_rad,
        "speed_limit": seen.speed_limit,
        "turning": records.WHEELS_DO.index(turning.does),
        "turning_unexpected": int(turning.unexpected),
        "measured_radps": tuple(turning.speeds_radps or ()),
        "turned_rad": tuple(turning.turned_rad or ()),
        "acceleration": imu.acceleration_mps2,
        "rate": imu.rate_radps,
        "battery_v": seen.battery_v or nan,
        "pose": odometry[1:4],
        "twist": odometry[4:7],
        "odometry_measured": int(odometry.source == records.ODOMETRY_FROM[records.BY_ROLLING]),
    }


def shown(value: Any) -> Any:
    return tuple(value) if isinstance(value, ctypes.Array) else value


def agree(one: Any, other: Any) -> bool:
    """NaN is NaN: the sign and payload of one that stands for "none" mean nothing."""
    if isinstance(one, tuple):
        # C has room for four wheels; those that do not exist are 0, or NaN where they are measured.
        missing = one[len(other) :] if isinstance(other, tuple) else (1,)
        return all(value == 0 or isnan(value) for value in missing) and all(map(agree, one, other))
    if isinstance(one, float):
        return (isnan(one) and isnan(other)) or struct.pack("<d", one) == struct.pack("<d", other)
    return bool(one == other)


def test_a_state_is_the_one_that_python_shows(made: OwnRun) -> None:
    made.c.fs_drive.argtypes = [ctypes.c_void_p, *[ctypes.c_double] * 3]
    assert made.c.fs_drive(made.handle, 0.0, 0.0, 0.0) == OK, "it has a source now, about which there is an answer"
    state, compared = State(size=ctypes.sizeof(State)), set()
    for draw in drawn(STATES):
        assert made.c.fs_drive(made.handle, 0.0, 0.0, 0.0) == OK, "the last command must not be too old"
        publish(made, draw)
        assert made.c.fs_get_state(made.handle, ctypes.byref(state)) == OK
        wanted = by_python(made)
        found = {name: shown(getattr(state, name)) for name in wanted}
        assert not {name: (found[name], wanted[name]) for name in wanted if not agree(found[name], wanted[name])}
        compared |= set(wanted)
    left = set(FIELDS) - compared - {"size", "reserved1_", "reserved2_", "ready"}
    assert left == {"age_s", "measured_age_s", "imu_age_s", "battery_age_s", "odometry_age_s"}
