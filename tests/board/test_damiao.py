"""Damiao's motors behind a slcan adapter: their lines, and what their answers mean."""

from __future__ import annotations

import json
import random
from math import inf, pi
from pathlib import Path
from struct import pack
from typing import Any

import pytest

from failstop.board.checks import FrameError
from failstop.board.damiao import codec, slcan
from failstop.board.damiao.wire import WIRE
from failstop.board.kinds import board_of
from failstop.board.wire import SERVO_HEAT, SERVO_MISSING, SERVO_OTHER, Answer, Health, Restarted, Sample, Wheels
from failstop.policy.setting import SettingError
from failstop.policy.settings import Settings
from failstop.setup.rig import alone
from failstop_lab.boards.damiao import BUFFERS, IS_OFF, IS_ON, LOST, MIT, OVER_HEATED, QUEUE, Adapter, Damiao, Motor
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
    sent(board, WIRE.stop.writes[0].data, now_ns)
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
        (IS_OFF, "motor 2 is disabled, although it was enabled", 0),
        (5, "motor 2 switched itself off: it reports fault 5", SERVO_OTHER),
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


def test_a_motor_that_was_never_switched_on_is_told_as_well() -> None:
    """The line that enables it was lost, so it has never reported that it is enabled."""
    board, reader = Damiao(), codec.Replies(2)
    arm = MOTORS.arm(500 * MS)
    now_ns = sent(board, MOTORS.burst + arm.replace(slcan.line(2, codec.ENABLE), b""), 0)
    assert [motor.status for motor in board.motors] == [IS_ON, IS_OFF]
    _, found = asked(board, reader, now_ns)
    assert [each.text for each in found if isinstance(each, Restarted)] == [
        "motor 2 is disabled, although it was enabled"
    ]


@pytest.mark.parametrize("count", [2, 4])
@pytest.mark.parametrize(
    ("change", "text"),
    [
        ({"mode": MIT}, "has lost the mode in which it takes speeds"),
        ({"ticks": 0}, "has lost its watchdog's time"),
        ({"ticks": 0, "mode": MIT}, "has lost its watchdog's time"),
    ],
)
def test_registers_that_a_motor_was_armed_with_are_read_back(count: int, change: dict[str, int], text: str) -> None:
    board, reader = Damiao(count=count), codec.Replies(count)
    now_ns, found = asked(board, reader, driving(board, (10.0,) * count))
    now_ns, found = asked(board, reader, now_ns)
    assert not [each for each in found if isinstance(each, Restarted)]
    for name, value in change.items():
        setattr(board.motors[-1], name, value)
    told: list[Sample] = []
    for _ in range(codec.DIFFERS + 1):
        now_ns, found = asked(board, reader, now_ns)
        told += found
    assert [each.text for each in told if isinstance(each, Restarted)] == [f"motor {count} {text}"]
    now_ns = sent(board, codec.Motors(count).arm(500 * MS), now_ns)
    now_ns, found = asked(board, reader, now_ns)
    now_ns, more = asked(board, reader, now_ns)
    assert not [each for each in [*found, *more] if isinstance(each, Restarted)], "armed again it has them"


def test_one_garbled_register_is_no_restart() -> None:
    board, reader = Damiao(), codec.Replies(2)
    now_ns, _ = asked(board, reader, driving(board))
    for ticks in (20_000, 10_000, 20_000):
        board.motors[1].ticks = ticks
        now_ns, found = asked(board, reader, now_ns)
        assert not [each for each in found if isinstance(each, Restarted)]


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


def stopped_ms(simulated: Simulated, from_ns: int) -> list[float]:
    """How long after that each motor was told zero; infinite: it was not."""
    found = [inf] * len(receiver(simulated).motors)
    for event in reversed([each for each in simulated.board.events() if each.executed_ns > from_ns and each.speeds]):
        found = [
            at if speed else (event.executed_ns - from_ns) / MS for at, speed in zip(found, event.speeds, strict=False)
        ]
    return found


def test_the_motors_are_armed_and_their_watchdogs_are_set(pair: Simulated) -> None:
    assert [motor.ticks for motor in receiver(pair).motors] == [10_000, 10_000]


@pytest.mark.parametrize("unplugged", [0, 1])
def test_a_motor_that_hears_nothing_stops_the_robot_and_is_named(pair: Simulated, unplugged: int) -> None:
    board, begun_ns = receiver(pair), pair.lab.machine.now_ns
    board.motors[unplugged].unplugged = True
    pair.drive(1.2)
    assert stopped_ms(pair, begun_ns)[1 - unplugged] < AT_MOST_MS
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
    assert stopped_ms(pair, begun_ns)[1] < AT_MOST_MS
    state = pair.robot.state
    assert state.cause.kind.name == "restarted"
    assert "motor 1 switched itself off: its driver is too hot" in str(state.cause)


def test_a_motor_that_can_not_be_enabled_stops_the_others(pair: Simulated) -> None:
    board = receiver(pair)
    pair.robot.disable()
    board.motors[1].status, board.motors[1].broken = OVER_HEATED, True
    pair.wait(0.5)
    if pair.robot.state.estop:
        pair.robot.reset()
    pair.enable()
    pair.drive(1.0)
    assert not any(board.wheels)
    assert "motor 2 is disabled, although it was enabled" in str(pair.robot.state.cause)


def test_a_motor_whose_power_was_off_for_a_moment_stops_the_others_and_is_armed_again(pair: Simulated) -> None:
    board = receiver(pair)
    board.motors[1].restart()
    pair.drive(0.6)
    assert "motor 2 is disabled, although it was enabled" in str(pair.robot.state.cause)
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


# Three and four motors.

LAYOUTS = {"differential": 2, "omni3": 3, "mecanum": 4}


@pytest.mark.parametrize(("layout", "count"), LAYOUTS.items())
def test_the_layout_says_how_many_motors_there_are(layout: str, count: int) -> None:
    settings = Settings({"board.kind": "damiao", "wheels.layout": layout})
    board = board_of(*settings.board())
    assert (settings.speeds, board.wheels) == (count, count)
    assert board.name == f"{count} Damiao motors behind a slcan adapter"
    assert {board.burst} == {WIRE.stop.writes[0].data}, "a stop is the same for any number"


def test_a_stop_of_a_program_that_does_not_know_the_settings_stops_four_motors() -> None:
    """As `failstop stop` and `failstop setup` may not."""
    board = Damiao(count=4)
    now_ns = driving(board, (10.0, -5.0, 3.0, -1.0))
    sent(board, board_of("damiao", 1.0, 0.0).burst, now_ns)
    assert board.wheels == (0.0,) * 4


@pytest.mark.parametrize("count", [2, 3, 4])
def test_what_is_written_at_an_enable_fits_into_the_adapter(count: int) -> None:
    """USB brings a whole write in less time than a frame takes on the CAN. A question may come with it."""
    board = Damiao(count=count)
    motors = codec.Motors(count)
    now_ns = sent(board, motors.burst + motors.opening, 0)
    for value in motors.arm(500 * MS) + motors.questions[0]:
        now_ns += 1000
        board.byte(now_ns, value)
    board.until(now_ns + 10 * MS)
    assert not board.dropped
    assert {motor.status for motor in board.motors} == {IS_ON}


def base(layout: str) -> Simulated:
    simulated = Simulated(kind="damiao", motors=LAYOUTS[layout], settings={"wheels.layout": layout})
    simulated.enable()
    return simulated


def test_four_mecanum_wheels_are_armed_turn_sideways_and_stop() -> None:
    simulated = base("mecanum")
    simulated.drive(0.5, (0.0, 0.1, 0.0))
    board = receiver(simulated)
    assert [motor.ticks for motor in board.motors] == [10_000] * 4
    signs = [round(speed / abs(board.wheels[0])) for speed in board.wheels]
    # The right wheels are mounted the other way round by default (wheels.sign_3, wheels.sign_4).
    assert signs == [-1, 1, -1, 1]
    simulated.robot.estop("enough")
    simulated.wait(1.0)
    assert board.wheels == (0.0,) * 4
    assert simulated.robot.state.last_stop.acknowledged_s is not None
    assert simulated.robot.state.last_stop.observed_s is not None


@pytest.mark.parametrize("unplugged", range(4))
def test_any_of_four_motors_that_hears_nothing_stops_the_robot_and_is_named(unplugged: int) -> None:
    simulated = base("mecanum")
    simulated.drive(0.6)
    board, begun_ns = receiver(simulated), simulated.lab.machine.now_ns
    board.motors[unplugged].unplugged = True
    simulated.drive(1.2)
    times_ms = stopped_ms(simulated, begun_ns)
    assert max(time_ms for motor, time_ms in enumerate(times_ms) if motor != unplugged) < AT_MOST_MS
    assert f"motor {unplugged + 1} (CAN id {unplugged + 1})" in str(simulated.robot.state.cause)
    assert not any(board.wheels)


@pytest.mark.parametrize("id_", range(4))
def test_one_wheel_of_four_can_be_turned_alone_as_setup_does(id_: int) -> None:
    """By three of the ids, of which one may be the fourth motor's: then all four must answer."""
    values, velocity = alone("damiao", 4, id_, 0.05, 0.08)
    settings = Settings(dict(values))
    assert settings.speeds == (4 if {3} & {int(settings[f"wheels.id_{number}"]) for number in (1, 2, 3)} else 3)
    simulated = Simulated(values, kind="damiao", motors=4)
    simulated.enable()
    simulated.drive(0.5, velocity)
    assert [bool(speed) for speed in receiver(simulated).wheels] == [motor == id_ for motor in range(4)]
    simulated.robot.estop("enough")
    simulated.wait(0.5)
    assert not any(receiver(simulated).wheels)


def test_a_wheel_with_an_id_beyond_all_motors_is_refused() -> None:
    assert Settings({"board.kind": "damiao", "wheels.id_1": 3}).speeds == 4
    with pytest.raises(SettingError, match="0 to 3"):
        Settings({"board.kind": "damiao", "wheels.id_1": 4})
    with pytest.raises(SettingError, match="ids go from 0 to 1"):
        Settings({"board.kind": "ugv", "wheels.id_1": 2})


def test_three_omni_wheels_turn_on_the_spot_together() -> None:
    simulated = base("omni3")
    simulated.drive(0.5, (0.0, 0.0, 0.5))
    board = receiver(simulated)
    assert len(set(board.wheels)) == 1
    assert any(board.wheels)
    simulated.robot.estop("enough")
    simulated.wait(0.5)
    assert not any(board.wheels)


def test_a_layout_with_more_motors_than_there_are_is_not_enabled() -> None:
    """Motors 3 and 4 answer nothing."""
    simulated = Simulated(kind="damiao", motors=2, settings={"wheels.layout": "mecanum"})
    simulated.wait(1.0)
    assert "motor 3 (CAN id 3), which does not answer" in str(simulated.robot.state.waiting_for)
