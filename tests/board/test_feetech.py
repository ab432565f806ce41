"""Feetech's half-duplex bus: a stop amid the servos' answers, and what the service writes beside it."""

from __future__ import annotations

import random
import re
from typing import Any

import pytest

from failstop.board import servos
from failstop.board.feetech import codec
from failstop.board.feetech.wire import ANSWERS_NS
from failstop.board.kinds import wire_of
from failstop.board.wire import (
    SERVO_CURRENT,
    SERVO_HEAT,
    SERVO_LOAD,
    SERVO_MISSING,
    SERVO_OTHER,
    SERVO_SENSOR,
    SERVO_VOLTAGE,
    Answer,
    Battery,
    Health,
    Sample,
    Wheels,
)
from failstop.messages import records
from failstop.policy import causes
from failstop.policy import servos as policy_servos
from failstop.policy.settings import Settings
from failstop_lab.boards.feetech import DELAY_NS, LONGEST_DELAY_NS, Bus
from failstop_lab.boards.line import arrivals, play, stop_writes
from tests.support.simulated import Simulated

MS = 1_000_000
BYTE_NS = wire_of("feetech").port.byte_ns
WRITER = 0
ASKED_NS = MS + len(codec.QUESTIONS[-1]) * BYTE_NS
"""When the question is over, and the servos may answer."""


def stopped_ns(bus: Bus, phase_ns: int, stop: bytes = codec.BURST) -> int:
    """How long after a stop was begun, so long after a question, the wheels are told to stop for good."""
    begin_ns = ASKED_NS + phase_ns
    repeats = [(at_ns, stop) for at_ns, _ in stop_writes(wire_of("feetech").stop, WRITER, begin_ns, BYTE_NS)]
    writes = [(0, codec.motion((1000, -1000, 500), codec.LIMIT)), (MS, codec.QUESTIONS[-1]), *repeats]
    play(bus, arrivals(writes, BYTE_NS), 200 * MS)
    assert not any(bus.wheels)
    last = max(at_ns for at_ns, speeds in bus.commands if any(speeds))
    return min(at_ns for at_ns, _ in bus.commands if at_ns > last) - begin_ns


@pytest.mark.claim("BOARD-2")
@pytest.mark.parametrize("delay_ns", [DELAY_NS, LONGEST_DELAY_NS])
def test_a_stop_that_falls_into_the_answers_is_heard_when_they_are_over(delay_ns: int) -> None:
    """In the same write, at the latest at its last stop frame."""
    garbled = 0
    for phase_ns in range(0, ANSWERS_NS, MS // 40):
        bus = Bus(delay_ns, seed=phase_ns)
        assert stopped_ns(bus, phase_ns) <= ANSWERS_NS
        garbled += bus.collisions > 0
    assert garbled > 30


def test_control_one_stop_frame_is_lost_in_the_answers_until_it_is_repeated() -> None:
    found = [stopped_ns(Bus(seed=phase_ns), phase_ns, codec.STOP) for phase_ns in range(0, MS // 2, MS // 40)]
    assert min(found) > wire_of("feetech").stop.repeats_ns[WRITER][1]


def test_no_answer_is_taken_from_other_bytes() -> None:
    """Some adapters send back what is sent down; garbled answers fail their check."""
    reader, rng = codec.Replies(), random.Random(0)
    down = (codec.BURST, *codec.QUESTIONS, codec.TORQUE_ON, codec.motion((5, -5, 0), codec.LIMIT))
    assert [reader.feed(frame) for frame in down] == [[]] * len(down)
    answers = [codec.packet(wheel, 0, bytes(codec.SIZES[0])) for wheel in codec.WHEELS]
    assert len(codec.Replies().feed(b"".join(answers))) == 5
    for _ in range(300):
        at, bit = rng.randrange(3), rng.randrange(8)
        garbled = [bytearray(answer) for answer in answers]
        garbled[at][rng.randrange(len(garbled[at]))] ^= 1 << bit
        assert not any(isinstance(each, Wheels) for each in codec.Replies().feed(b"".join(map(bytes, garbled))))
    assert not any(isinstance(each, (Wheels, Answer)) for each in codec.Replies().feed(b"".join(answers[::-1])))


@pytest.fixture(scope="module")
def driven() -> Simulated:
    simulated = Simulated(kind="feetech")
    simulated.enable()
    return simulated


def bus_of(simulated: Simulated) -> Bus:
    model: Any = simulated.lab.board.model
    bus = model.receiver
    assert isinstance(bus, Bus)
    return bus


@pytest.mark.slow
def test_nothing_but_a_stop_meets_an_answer(driven: Simulated) -> None:
    driven.drive(2.0)
    bus = bus_of(driven)
    assert len(bus.said) > 3 * 10
    assert len(bus.commands) > 20
    assert (bus.collisions, bus.broadcast_speeds) == (0, 0)
    assert driven.robot.state.battery_v == pytest.approx(11.8)


def wheel(decivolts: int, load: int, temperature: int) -> bytes:
    """A wheel's memory from its goal speed on."""
    return bytes(14) + load.to_bytes(2, "little") + bytes((decivolts, temperature))


def test_a_joint_at_its_first_pulse_and_a_servo_at_no_degrees_have_answered() -> None:
    """A 0 is no reading to who asks, but for the torque."""
    told = [
        sample.value
        for what, (_, size) in codec.READS.items()
        for sample in codec.Replies().feed(codec.packet(6, 0, bytes(size)))
        if isinstance(sample, servos.ServoAnswer) and sample.what == what
    ]
    assert dict(zip(codec.READS, told, strict=True)) == {what: what != servos.TORQUE for what in codec.READS}


def test_servos_tell_of_their_load_temperature_and_supply_once_a_second() -> None:
    reader = codec.Replies()
    position = bytes((0, 8, 0, 0)) + (0x400 | 250).to_bytes(2, "little") + bytes((118, 41))
    assert [vars(sample) for sample in reader.feed(codec.packet(3, 0, position))] == [
        {"servo": 3, "what": servos.POSITION, "value": 0x800}
    ]
    loads = {7: 100, 8: 0x400 | 1000, 9: 0}
    answers = b"".join(codec.packet(id_, 0, wheel(118 + id_, load, 30 + id_)) for id_, load in loads.items())
    told = [sample for _ in range(codec.REPORT_EVERY + 1) for sample in reader.feed(answers)]
    health = [sample for sample in told if isinstance(sample, Health)]
    rows = (3, -0.25, 41, 0), (7, 0.1, 37, 0), (8, -1.0, 38, 0), (9, 0.0, 39, 0)
    assert [sample.rows for sample in health] == [rows] * 2
    assert [sample.volts for sample in told if isinstance(sample, Battery)] == [12.5, 12.5]


def test_health_is_told_in_whole_percent() -> None:
    rows = ((3, -0.25, 41, 32), (8, 1.023, 0, 0))
    assert records.HEALTH.unpack(records.HEALTH.pack(*rows)) == ((3, -0.25, 41, 32), (8, 1.02, 0, 0))
    with pytest.raises(ValueError, match="servos in 5 bytes"):
        records.HEALTH.unpack(bytes(5))
    many = [(id_, 0.0, 20, 0) for id_ in range(records.MOST_SERVOS + 3)]
    assert records.HEALTH.unpack(records.HEALTH.pack(*many)) == tuple(many[: records.MOST_SERVOS])


def wrongs(samples: list[Sample]) -> list[dict[int, int]]:
    """What each report of the servos' health says is wrong."""
    reports = [sample.rows for sample in samples if isinstance(sample, Health)]
    return [{servo: row[0] for servo, _, _, *row in rows if row and row[0]} for rows in reports]


@pytest.mark.parametrize("missing", [(7,), (8,), (9,), (7, 8), (7, 9), (8, 9)])
def test_a_wheel_that_answers_nothing_while_another_does_is_missing_until_it_answers(missing: tuple[int, ...]) -> None:
    reader = codec.Replies()
    answer = {id_: codec.packet(id_, 0, wheel(118, 0, 30)) for id_ in codec.WHEELS}
    others = b"".join(data for id_, data in answer.items() if id_ not in missing)
    assert wrongs(reader.feed(b"".join(answer.values()))) == [{}]
    assert wrongs(reader.feed(others)) == [], "it may have been garbled on the line"
    assert wrongs(reader.feed(3 * others))[-1] == dict.fromkeys(missing, SERVO_MISSING)
    told = wrongs(reader.feed(2 * b"".join(answer.values())))
    assert told[-1] == {}


def test_the_error_byte_of_an_answer_is_told_at_once_and_when_it_is_over() -> None:
    reader = codec.Replies()
    whole = [codec.packet(id_, 0, wheel(118, 0, 30)) for id_ in codec.WHEELS]
    assert wrongs(reader.feed(b"".join(whole))) == [{}]
    bad = codec.packet(8, SERVO_LOAD | SERVO_HEAT, wheel(118, 0, 80))
    assert wrongs(reader.feed(whole[0] + bad + whole[2])) == [{8: SERVO_LOAD | SERVO_HEAT}]
    assert wrongs(reader.feed(whole[0] + bad + whole[2])) == []
    assert wrongs(reader.feed(b"".join(whole))) == [{}]
    joint = codec.packet(3, SERVO_VOLTAGE | 128, bytes(8))
    assert wrongs(reader.feed(joint)) == [{3: SERVO_VOLTAGE}], "the eighth bit is no servo's"


@pytest.mark.parametrize("missing", codec.WHEELS)
def test_a_base_whose_wheel_does_not_answer_is_not_enabled_and_says_which(missing: int) -> None:
    simulated = Simulated(kind="feetech")
    bus = bus_of(simulated)
    bus.silent.add(missing)
    simulated.wait(3.0)
    name = f"{('left', 'rear', 'right')[missing - 7]} wheel (servo {missing})"
    state = simulated.robot.state
    assert state.servos_wrong == {name: "it does not answer"}
    assert name not in state.servos
    with pytest.raises(simulated.failstop.Refused, match=re.escape(f"{name}, which does not answer; next: check")):
        simulated.robot.enable()
    told = " ".join(simulated.command("why")[1].split())
    assert f"also {name}: it does not answer" in told
    assert f"do check the {name}: its plug on the bus, its power and its id, then" in told
    assert f"{name}: it does not answer" in " ".join(simulated.command("status")[1].split())
    bus.silent.discard(missing)
    simulated.wait(2.0)
    assert simulated.robot.state.servos_wrong == {}
    simulated.enable()


@pytest.mark.parametrize("missing", codec.WHEELS)
def test_a_wheel_that_stops_answering_is_not_the_whole_board(missing: int) -> None:
    """Two servos answer: the board hears, and nobody is sent to look at its wires. Once none answers, it is deaf."""
    simulated = Simulated(kind="feetech")
    simulated.wait(2.0)
    bus_of(simulated).silent.add(missing)
    simulated.wait(5.0)
    assert simulated.robot.state.device.link == "alive"
    with pytest.raises(simulated.failstop.Refused, match=re.escape(f"(servo {missing}), which does not answer; next:")):
        simulated.robot.enable()
    told = " ".join(simulated.command("why")[1].split())
    assert f"(servo {missing}): its plug on the bus, its power and its id" in told
    assert "POWER SWITCH" not in told
    assert "does NOT hear" not in told
    bus_of(simulated).silent |= set(codec.WHEELS)
    simulated.wait(5.0)
    assert simulated.robot.state.device.link == "deaf"
    bus_of(simulated).silent.clear()
    simulated.wait(2.0)
    simulated.enable()


def test_a_wheel_that_stops_answering_while_the_robot_drives_stops_it_by_name() -> None:
    simulated = Simulated(kind="feetech")
    simulated.enable()
    simulated.drive(0.5)
    assert any(bus_of(simulated).wheels)
    bus_of(simulated).silent.add(8)
    simulated.drive(0.6)
    assert str(simulated.robot.state.cause) == str(causes.WHEEL_MISSING("rear wheel (servo 8)"))
    assert not any(bus_of(simulated).wheels)
    simulated.wait(5.0)
    assert simulated.robot.state.device.link == "alive"
    assert str(simulated.robot.state.cause) == str(causes.WHEEL_MISSING("rear wheel (servo 8)"))


def test_what_is_wrong_with_a_servo_has_one_meaning_everywhere() -> None:
    assert tuple(policy_servos.WRONG) == (
        SERVO_VOLTAGE,
        SERVO_SENSOR,
        SERVO_HEAT,
        SERVO_CURRENT,
        SERVO_LOAD,
        SERVO_OTHER,
        SERVO_MISSING,
    )
    rows = ((8, 0.0, 0, SERVO_HEAT | SERVO_LOAD), (3, 0.1, 30, 0), (77, 0.0, 0, SERVO_VOLTAGE), (78, 0.0, 0, 16))
    assert policy_servos.servo_faults(rows, Settings({"board.kind": "feetech"})) == {
        "rear wheel (servo 8)": "it is too hot and it is overloaded",
        "servo 77": "its supply voltage is out of range",
        "servo 78": "it reports another fault, which its maker's tool can show",
    }
