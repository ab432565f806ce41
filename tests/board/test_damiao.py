"""Damiao's motors behind a slcan adapter: their lines, and what their answers mean."""

from __future__ import annotations

import json
import random
from math import pi
from pathlib import Path
from struct import pack
from typing import Any

import pytest

from failstop.board.checks import FrameError
from failstop.board.damiao import codec, slcan
from failstop.board.damiao.wire import WIRE, described
from failstop.board.wire import SERVO_HEAT, SERVO_MISSING, Answer, Health, Restarted, Sample, Wheels
from failstop_lab.boards.damiao import BUFFERS, IS_OFF, IS_ON, LOST, OVER_HEATED, QUEUE, Adapter, Damiao, Motor
from tests.support.simulated import Simulated

MS = 1_000_000
AT_MOST_MS = 500
MOTORS = codec.Motors(2)
HOST = json.loads((Path(__file__).parent / "recorded_damiao_host.json").read_text())
BYTE_NS = WIRE.port.byte_ns


def sent(board: Damiao, data: bytes, at_ns: int) -> int:
    """When all of it has come, and was handled."""
    for value in data:
        at_ns += BYTE_NS
        board.byte(at_ns, value)
    board.until(at_ns + 10 * MS)
    return at_ns + 10 * MS


def driving(board: Damiao, speeds: tuple[float, ...] = (10.0, -5.0)) -> int:
    """The board enabled, and driving; when it did."""
    motors = codec.Motors(len(board.motors))
    now_ns = sent(board, motors.burst + motors.opening + motors.arm(500 * MS), 0)
    now_ns = sent(board, motors.frame(speeds, 100.0), now_ns)
    assert board.wheels == speeds
    return now_ns


def heard(board: Damiao, reader: codec.Replies) -> list[Sample]:
    """What its answers since the last look mean."""
    answers, board.said = board.said, []
    return reader.feed(b"".join(data for _, data in answers))


def asked(board: Damiao, reader: codec.Replies, at_ns: int, questions: range = range(4)) -> tuple[int, list[Sample]]:
    found: list[Sample] = []
    for index in questions:
        at_ns = sent(board, codec.Motors(len(board.motors)).questions[index], at_ns)
        found += heard(board, reader)
    return at_ns, found


def bits(samples: list[Sample]) -> list[tuple[int, ...]]:
    return [tuple([row[3] for row in each.rows if len(row) > 3]) for each in samples if isinstance(each, Health)]


def test_a_foreign_host_writes_the_same_lines() -> None:
    """damiao-motor through the slcan of python-can, at a pseudo-terminal."""
    assert HOST["versions"] == {"python-can": "4.6.1", "damiao-motor": "1.0.6"}
    wrote = dict(HOST["wrote"])
    for motor in (1, 2):
        assert slcan.line(motor, codec.ENABLE).decode() == wrote[f"enable {motor}"]
        assert slcan.line(motor, codec.CLEAR).decode() == wrote[f"clear {motor}"]
        assert codec.register(motor, codec.REPORT).decode() == wrote[f"report {motor}"]
        assert codec.register(motor, codec.WRITE, codec.TIMEOUT, 10_000).decode() == wrote[f"timeout {motor}"]
        assert codec.register(motor, codec.WRITE, codec.MODE, codec.SPEED_MODE).decode() == wrote[f"mode {motor}"]
        for index in codec.ASKED:
            assert codec.register(motor, codec.READ, index).decode() == wrote[f"read {motor} {index}"]
    speeds = [float(name.split()[1]) for name in wrote if name.startswith("speed")]
    assert len(speeds) > 5
    for speed in speeds:
        assert MOTORS.frame((speed, speed), codec.LIMIT).decode() == wrote[f"speed {speed}"]


def test_a_foreign_host_s_adapter_is_open_behind_its_own_lines() -> None:
    adapter = Adapter()
    for value in HOST["opened"].encode():
        adapter.byte(value)
    assert (adapter.open, adapter.bitrate) == (True, 8)


def test_reports_mean_what_a_foreign_host_reads_in_them() -> None:
    for data, status, speed, celsius in HOST["read"]:
        reader = codec.Replies(2)
        text = b"".join(
            slcan.line(0x10 + motor, bytes((motor, 0, codec.READ, codec.V_MAX)) + pack("<f", 45.0)) for motor in (1, 2)
        )
        first = slcan.line(0x11, Motor(1).report(0.0))
        found = reader.feed(first + slcan.line(0x12, bytes.fromhex(data)) + text)
        (wheels,) = [each for each in found if isinstance(each, Wheels)]
        # Half a step of the scale may be zero.
        assert wheels.speeds[1] == pytest.approx(speed, abs=0.02)
        assert int(data[0], 16) == status
        assert int(data[14:], 16) == celsius


@pytest.mark.parametrize("firmware", [0, 1], ids=["canable-fw", "canable2-fw"])
def test_the_adapter_s_receiver_does_what_its_firmware_did(firmware: int) -> None:
    """A case: steps of bytes in hex; then the frames that went to the CAN, whether it is open, and its bit rate. Lines
    whole, cut, garbled, empty and of other programs. Recorded of both firmwares' own code, built for a PC."""
    recorded = json.loads((Path(__file__).parent / "recorded_slcan.json").read_text())
    assert [len(commit) for commit in recorded["commits"]] == [40, 40]
    cases = recorded["cases"][firmware]
    assert len(cases) > 50
    for case in cases:
        adapter = Adapter(buffer=BUFFERS[firmware])
        for data, frames, opened, bitrate in case:
            found = [frame for value in bytes.fromhex(data) if (frame := adapter.byte(value))]
            assert [[can_id, each.hex()] for can_id, each in found] == frames, data
            assert (adapter.open, adapter.bitrate) == (bool(opened), bitrate)


def test_speeds_are_whole_steps_towards_zero() -> None:
    frame = MOTORS.frame((1.02, -1.02), 5.0)
    assert MOTORS.speeds(frame) == (65 / 64, -65 / 64)
    assert MOTORS.check(frame, 5.0) == ""
    assert MOTORS.check(frame, 1.0) == "left at 1.01562, limit 1"
    assert MOTORS.frame((0.01, -0.01), 5.0) == MOTORS.rest
    for other in (pack("<f", -0.0), pack("<f", float("nan")), pack("<f", 0.01), pack("<f", 281.0)):
        bad = slcan.line(0x201, other + bytes(4)) + slcan.line(0x202, bytes(8))
        assert MOTORS.check(bad, codec.LIMIT)
    assert MOTORS.check(frame.lower(), 5.0)
    with pytest.raises(FrameError):
        MOTORS.arm(0)


def test_a_turn_a_second_is_the_motor_s_own_unit() -> None:
    assert WIRE.motion.per_rps(0.1) == pytest.approx(2 * pi)
    assert WIRE.motion.scale_known


@pytest.mark.parametrize("count", [2, 3, 4])
def test_the_motors_turn_when_they_are_armed_and_stop_with_one_write(count: int) -> None:
    board = Damiao(count=count)
    motors = codec.Motors(count)
    now_ns = sent(board, motors.burst + motors.opening, 0)
    now_ns = sent(board, motors.frame((3.0,) * count, 5.0), now_ns)
    assert not any(board.wheels), "disabled"
    now_ns = sent(board, motors.arm(500 * MS), now_ns)
    assert not any(board.wheels), "the speed that it was told before counts no more"
    now_ns = sent(board, motors.frame((3.0,) * count, 5.0), now_ns)
    assert board.wheels == (3.0,) * count
    sent(board, described(count).stop.writes[0].data, now_ns)
    assert board.wheels == (0.0,) * count
    assert [motor.status for motor in board.motors] == [IS_ON] * count, "they hold"
    assert not board.dropped


def test_a_motor_s_own_watchdog_acts_and_the_next_enable_ends_it() -> None:
    board = Damiao()
    now_ns = driving(board)
    board.until(now_ns + 480 * MS)
    assert board.wheels == (10.0, -5.0)
    board.until(now_ns + 520 * MS)
    assert board.wheels == (0.0, 0.0)
    assert {motor.status for motor in board.motors} == {LOST}
    now_ns = sent(board, MOTORS.frame((3.0, 3.0), 5.0), now_ns + 600 * MS)
    assert board.wheels == (0.0, 0.0), "motion alone does not"
    now_ns = sent(board, MOTORS.arm(500 * MS), now_ns)
    sent(board, MOTORS.frame((3.0, 3.0), 5.0), now_ns)
    assert board.wheels == (3.0, 3.0)


def test_a_line_that_was_cut_never_reaches_a_motor() -> None:
    """Any line of failstop, cut anywhere, in front of a stop: neither CANable runs it. Bare it is run, with digits of
    older lines: the control."""
    frames = [*MOTORS.questions, MOTORS.opening, MOTORS.arm(500 * MS), MOTORS.frame((280.0, -280.0), 280.0)]
    lines = {line for frame in frames for line in frame.split(b"\r") if line}
    bare = 0
    for buffer in BUFFERS:
        for line in lines:
            for end in range(1, len(line)):
                adapter = Adapter(b"t2018FFFF7F7FFFFF7F7F\r" + line[:end], buffer=buffer)
                assert [frame for value in slcan.FLUSH if (frame := adapter.byte(value))] == []
                adapter = Adapter(b"t2018FFFF7F7FFFFF7F7F\r" + line[:end], buffer=buffer)
                bare += adapter.byte(13) is not None
    assert bare > 100


def test_a_cut_speed_that_zeros_complete_is_no_faster_and_has_the_same_sign() -> None:
    """At an adapter that keeps longer lines than a CANable."""
    chance = random.Random(7)
    for _ in range(300):
        speed = chance.choice((-1, 1)) * chance.uniform(0.02, codec.LIMIT)
        line = MOTORS.frame((speed, 0.0), codec.LIMIT)[: slcan.MOST_LINE]
        (true,) = [each for each in MOTORS.speeds(MOTORS.frame((speed, 0.0), codec.LIMIT)) or () if each]
        for end in range(5, len(line)):
            adapter = Adapter(line[:end], buffer=500)
            (frame,) = [frame for value in slcan.FLUSH if (frame := adapter.byte(value))]
            board = Motor(1, armed=True)
            board.takes(*frame, 0)
            assert abs(board.told) <= abs(true)
            assert board.told * true > -1e-30, "or it is as good as zero"


def test_a_question_is_answered_when_every_motor_has_answered_it() -> None:
    board, reader = Damiao(turns=True), codec.Replies(2)
    now_ns, found = asked(board, reader, driving(board))
    assert [each.text for each in found if isinstance(each, Answer)] == ["0", "1", "2", "3"]
    now_ns, found = asked(board, reader, now_ns)
    assert [each.speeds for each in found if isinstance(each, Wheels)] == [pytest.approx((10.0, -5.0), abs=0.02)] * 4
    board.motors[1].unplugged = True
    now_ns, found = asked(board, reader, now_ns)
    assert not [each for each in found if isinstance(each, (Answer, Wheels))]


def test_answers_to_two_questions_are_not_taken_together() -> None:
    """The first motor answers one question alone, the second one the next one alone."""
    board, reader = Damiao(), codec.Replies(2)
    now_ns = driving(board)
    for silent, question in ((1, 0), (0, 1), (1, 2), (0, 3)):
        board.motors[silent].unplugged = True
        now_ns, found = asked(board, reader, now_ns, range(question, question + 1))
        board.motors[silent].unplugged = False
        assert not [each for each in found if isinstance(each, Answer)]


def test_a_motor_that_does_not_answer_is_named_and_comes_back() -> None:
    board, reader = Damiao(), codec.Replies(2)
    now_ns, _ = asked(board, reader, driving(board))
    board.motors[1].unplugged = True
    now_ns, found = asked(board, reader, now_ns)
    now_ns, found = asked(board, reader, now_ns)
    assert bits(found)[-1] == (0, SERVO_MISSING)
    board.motors[1].unplugged = False
    now_ns, found = asked(board, reader, now_ns)
    assert bits(found)[-1] == (0, 0)


def test_one_lost_answer_names_nobody() -> None:
    board, reader = Damiao(), codec.Replies(2)
    now_ns, _ = asked(board, reader, driving(board))
    for question in range(4):
        board.motors[question % 2].unplugged = True
        now_ns, found = asked(board, reader, now_ns, range(question, question + 1))
        assert not any(SERVO_MISSING in row for row in bits(found))
        board.motors[question % 2].unplugged = False
        now_ns, found = asked(board, reader, now_ns)
        assert not any(SERVO_MISSING in row for row in bits(found))


@pytest.mark.parametrize(
    ("status", "text", "wrong"),
    [
        (OVER_HEATED, "motor 2 switched itself off: its driver is too hot", SERVO_HEAT),
        (LOST, "motor 2 switched itself off: it heard nothing for too long", 0),
        (IS_OFF, "motor 2 switched itself off: it is disabled", 0),
    ],
)
def test_a_motor_that_switches_itself_off_while_it_drives_is_told_once(status: int, text: str, wrong: int) -> None:
    board, reader = Damiao(), codec.Replies(2)
    now_ns, found = asked(board, reader, driving(board))
    assert not [each for each in found if isinstance(each, Restarted)]
    board.motors[1].status = status
    now_ns, found = asked(board, reader, now_ns)
    assert [each.text for each in found if isinstance(each, Restarted)] == [text]
    assert bits(found)[-1] == (0, wrong)
    now_ns, found = asked(board, reader, now_ns)
    assert not [each for each in found if isinstance(each, Restarted)]


def test_a_motor_that_is_off_for_a_moment_while_it_is_armed_is_no_restart() -> None:
    """As one may be between the frame that clears its fault and the one that enables it."""
    board, reader = Damiao(), codec.Replies(2)
    now_ns, _ = asked(board, reader, driving(board))
    board.motors[1].status = IS_OFF
    for _ in range(codec.OFF_AFTER - 1):
        now_ns = sent(board, codec.register(2, codec.REPORT), now_ns)
    board.motors[1].status = IS_ON
    found = heard(board, reader)
    assert not [each for each in found if isinstance(each, Restarted)]
    _, found = asked(board, reader, now_ns)
    assert not [each for each in found if isinstance(each, Restarted)]


def test_arming_again_is_no_restart() -> None:
    board, reader = Damiao(), codec.Replies(2)
    now_ns, _ = asked(board, reader, driving(board))
    now_ns = sent(board, MOTORS.burst + MOTORS.arm(500 * MS), now_ns)
    assert not [each for each in heard(board, reader) if isinstance(each, Restarted)]


@pytest.mark.parametrize("opened", [True, False])
def test_the_stop_opens_an_adapter_that_somebody_has_closed(opened: bool) -> None:
    board = Damiao()
    now_ns = driving(board)
    now_ns = sent(board, b"" if opened else b"C\r", now_ns)
    sent(board, WIRE.stop.writes[0].data, now_ns)
    assert board.wheels == (0.0, 0.0)


def test_a_can_that_nobody_takes_frames_from_fills_the_adapter_and_the_motors_stop_by_themselves() -> None:
    """The adapter keeps old motion and drops new stops. Back on the CAN within the motors' time the old motion is sent,
    so the next stop must follow; later the motors are off, and it moves nothing."""
    for away_ms, moves in ((300, True), (700, False)):
        board = Damiao()
        now_ns = driving(board)
        board.can_dead = True
        for _ in range(QUEUE):
            now_ns = sent(board, MOTORS.frame((8.0, 8.0), 10.0), now_ns - 10 * MS)
        now_ns = sent(board, WIRE.stop.writes[0].data, now_ns)
        assert board.dropped
        board.until(now_ns + away_ms * MS)
        board.can_dead = False
        board.until(now_ns + (away_ms + 20) * MS)
        assert any(board.wheels) is moves
        sent(board, WIRE.stop.writes[0].data, now_ns + (away_ms + 20) * MS)
        assert not any(board.wheels)


# The whole service.


@pytest.fixture
def pair() -> Simulated:
    simulated = Simulated(kind="damiao")
    simulated.enable()
    simulated.drive(0.6)
    return simulated


def receiver(simulated: Simulated) -> Damiao:
    model: Any = simulated.lab.board.model
    found = model.receiver
    assert isinstance(found, Damiao)
    return found


def stopped_ms(simulated: Simulated, wheel: int, from_ns: int) -> float:
    """How long after that this wheel was told zero."""
    frames = [each for each in simulated.board.events() if each.executed_ns > from_ns and each.speeds]
    return (next(each.executed_ns for each in frames if not each.speeds[wheel]) - from_ns) / MS


def test_the_motors_are_armed_and_their_watchdogs_are_set(pair: Simulated) -> None:
    assert [motor.ticks for motor in receiver(pair).motors] == [10_000, 10_000]


@pytest.mark.parametrize("unplugged", [0, 1])
def test_a_motor_that_hears_nothing_stops_the_robot_and_is_named(pair: Simulated, unplugged: int) -> None:
    board, begun_ns = receiver(pair), pair.lab.machine.now_ns
    board.motors[unplugged].unplugged = True
    pair.drive(1.2)
    assert stopped_ms(pair, 1 - unplugged, begun_ns) < AT_MOST_MS
    state = pair.robot.state
    assert state.cause.kind.name == "wheel_missing"
    assert f"motor {unplugged + 1} (CAN id {unplugged + 1})" in str(state.cause)
    assert state.last_stop.acknowledged_s is None
    assert not any(board.wheels), "that motor, by its own watchdog"
    board.motors[unplugged].unplugged = False
    pair.wait(0.5)
    pair.robot.reset()
    pair.enable()
    pair.drive(0.5)
    assert all(board.wheels), "its fault is cleared by the enable"


def test_a_motor_that_switches_itself_off_stops_the_others(pair: Simulated) -> None:
    board, begun_ns = receiver(pair), pair.lab.machine.now_ns
    board.motors[0].status = OVER_HEATED
    pair.drive(0.6)
    assert stopped_ms(pair, 1, begun_ns) < AT_MOST_MS
    state = pair.robot.state
    assert state.cause.kind.name == "restarted"
    assert "motor 1 switched itself off: its driver is too hot" in str(state.cause)


def test_a_motor_whose_power_was_off_for_a_moment_stops_the_others_and_is_armed_again(pair: Simulated) -> None:
    board = receiver(pair)
    board.motors[1].restart()
    pair.drive(0.6)
    assert "motor 2 switched itself off: it is disabled" in str(pair.robot.state.cause)
    assert not any(board.wheels)
    pair.robot.reset()
    pair.enable()
    pair.drive(0.3)
    assert all(board.wheels)


def test_a_can_that_is_dead_stops_all_motors_by_themselves_and_the_robot_says_so(pair: Simulated) -> None:
    board = receiver(pair)
    board.can_dead = True
    pair.drive(1.5)
    assert {motor.status for motor in board.motors} == {LOST}
    assert pair.robot.state.cause.kind.name in ("deaf", "restarted", "board_silent")
    board.can_dead = False
    pair.drive(0.5)
    assert not any(board.wheels), "nothing moves before an enable"


def test_a_stop_is_acknowledged_and_the_wheels_are_seen_still(pair: Simulated) -> None:
    pair.robot.estop("enough")
    pair.wait(1.0)
    stop = pair.robot.state.last_stop
    assert stop.acknowledged_s is not None
    assert stop.observed_s is not None
    assert receiver(pair).wheels == (0.0, 0.0)
    assert [motor.status for motor in receiver(pair).motors] == [IS_ON, IS_ON], "they hold"
