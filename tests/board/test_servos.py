"""Frames to an arm's bus servos: their bounds, the time that they hold the receiver, and the proof of the stop.

A frame is cut anywhere, then comes the stop's one write, the burst and behind it the servos' stop: the last motor
command is a stop, no servo was sent anywhere else than it was told, and the last that each heard is to stop.
"""

from __future__ import annotations

from itertools import product
from struct import pack, unpack_from
from typing import Any

import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from failstop.board.checks import FrameError
from failstop.board.rrc import codec, servos
from failstop.board.rrc.board import BOARD
from failstop.board.rrc.burst import BURST, FIRST_STOP_END
from failstop.board.rrc.codec import STOP, check_aux, check_motion
from failstop.board.rrc.framing import BUS_SERVO, MOTOR, PWM_SERVO, seal
from failstop.board.rrc.servos import bus_servo_move, bus_servo_stop, check_bus
from failstop.board.servos import HELD_NS, LONGEST_MOVE_MS, MOVE_NS, READS, SERVO_STOP, SILENT_NS
from failstop.policy.settings import declaration
from failstop_lab.sim.motors import Motors
from failstop_lab.sim.receiver import Receiver
from failstop_lab.sim.servos import Servos

ARM = (1, 2, 3, 4, 5, 10)
WRITE = BURST + BOARD.arm.stops(ARM)
SPINNING = (0.5, -0.25, 0.75, -1.0)
QUESTIONS = [servos.bus_servo_read(servo, what) for servo in ARM for what in READS]
TORQUES = [servos.bus_servo_torque(servo, on) for servo in ARM for on in (True, False)]
STOPS = [bus_servo_stop(ids) for ids in ((1,), (1, 2), (4, 5, 10))]


def moved(data: bytes) -> dict[int, int]:
    """Where a servo's frame sends servos, as the firmware reads it: beyond the data there are zeros here."""
    if data[:1] != b"\x01":
        return {}
    memory = data.ljust(4 + 3 * 255, b"\0")
    return dict(unpack_from("<BH", memory, 4 + 3 * index) for index in range(memory[3]))


def judge(stream: bytes, meant: dict[int, int]) -> None:
    """The moves that the board makes of a stream that ends with the stop's write."""
    motors, last = Motors(SPINNING), b""
    stopped: set[Any] = set()
    for _, func, data in Receiver().feed(stream):
        if func == MOTOR:
            last, stopped = data, set()
            assert motors.execute(data) == (0.0, 0.0, 0.0, 0.0), stream.hex()
        elif func == BUS_SERVO:
            for servo, position in moved(data).items():
                assert meant.get(servo) == position, stream.hex()
                stopped.discard(servo)
            stopped |= set(data[2 : 2 + data[1]]) if data[0] == SERVO_STOP else set()
    assert last == STOP[4:-1]
    assert not motors.wild
    assert motors.stopped
    assert stopped == set(ARM)


def cut_anywhere(frame: bytes) -> None:
    meant = moved(frame[4:-1]) if frame[2] == BUS_SERVO else {}
    for cut in range(len(frame) + 1):
        judge(frame[:cut] + WRITE, meant)


def test_the_arm_s_stop_is_the_end_of_one_write() -> None:
    stops = bus_servo_stop((1, 2, 3)) + bus_servo_stop((4, 5, 10))
    assert (BOARD.burst, BOARD.arm.stops(ARM), BOARD.arm.stops(())) == (BURST, stops, b"")
    assert [BOARD.arm.stops((servo,)) for servo in ARM] == [bus_servo_stop([servo]) for servo in ARM]
    assert BOARD.first_stop == BURST[:FIRST_STOP_END]


@pytest.mark.parametrize("frame", [*QUESTIONS, *TORQUES, *STOPS], ids=bytes.hex)
def test_each_frame_but_moves_cut_anywhere(frame: bytes) -> None:
    assert check_bus(frame, ARM, LONGEST_MOVE_MS) == ""
    cut_anywhere(frame)


@pytest.mark.parametrize("servo", ARM)
def test_a_move_of_one_to_each_place_cut_anywhere(servo: int) -> None:
    changed = 0
    for position in range(1001):
        frame = bus_servo_move([(servo, position)], 40)
        assert check_bus(frame, ARM, LONGEST_MOVE_MS) == ""
        assert moved(frame[4:-1]) == {servo: position}
        lasts_ms = unpack_from("<H", frame, 5)[0]
        assert 40 <= lasts_ms <= 43
        changed += lasts_ms != 40
        # The whole stop only where it can matter: the receiver drops what is cut elsewhere for its CRC.
        if lasts_ms != 40 or position % 50 == 0:
            cut_anywhere(frame)
    assert changed, "the test can fail"


@given(
    moves=st.lists(
        st.tuples(st.sampled_from(ARM), st.integers(0, 1000)), min_size=1, max_size=2, unique_by=lambda m: m[0]
    ),
    duration_ms=st.integers(1, LONGEST_MOVE_MS),
    data=st.data(),
)
@settings(max_examples=150, deadline=None)
def test_any_move_and_the_stop_cut_anywhere(
    moves: list[tuple[int, int]], duration_ms: int, data: st.DataObject
) -> None:
    frame = bus_servo_move(moves, duration_ms)
    assert check_bus(frame, ARM, LONGEST_MOVE_MS) == ""
    cut_anywhere(frame)
    cut, first = data.draw(st.integers(0, len(frame))), data.draw(st.integers(0, len(WRITE)))
    meant = dict(moves)
    judge(frame[:cut] + WRITE[:first] + WRITE, meant)
    judge(frame[:cut] + WRITE[:first] + WRITE[first:] + WRITE, meant)


def test_motor_frames_and_the_stop_s_own_write_cut_anywhere() -> None:
    for speeds in ((0.8, 0.8, -0.8, -0.8), (-0.694,) * 4, (1.0, -2.0, 0.1, 1e-3)):
        frame = codec.motor_speeds(speeds, 2.0)
        for cut in range(len(frame)):
            judge(frame[:cut] + WRITE, {})
    for cut in range(len(WRITE) + 1):
        judge(WRITE[:cut] + WRITE, {})


def test_control_a_servo_s_own_stop_behind_a_cut_burst_goes_unheard_by_the_receiver() -> None:
    """Why it is no write of its own: it goes as the rest of whatever was cut, a motor frame too."""
    alone = WRITE[len(BURST) :]
    taken_for_a_motor_s = 0
    for cut in range(len(BURST)):
        receiver = Receiver()
        receiver.feed(BURST[:cut])
        heard = [func for _, func, _ in receiver.feed(alone)]
        taken_for_a_motor_s += receiver.func == MOTOR and heard.count(BUS_SERVO) < 2
    assert taken_for_a_motor_s > 50


def test_control_zeros_complete_a_cut_move_and_the_check_refuses_it() -> None:
    made = (seal(BUS_SERVO, pack("<BHBBH", 1, 40, 1, 2, position)) for position in range(256, 1001))
    with pytest.raises(AssertionError):
        cut_anywhere(next(frame for frame in made if check_bus(frame, ARM, 60).startswith("another move")))


@given(data=st.binary(max_size=255), command=st.integers(0, 0x3A), servo=st.sampled_from(ARM))
@settings(max_examples=400, deadline=None)
def test_whatever_passes_holds_the_receiver_for_no_longer_than_it_may(data: bytes, command: int, servo: int) -> None:
    shaped = pack("<BHB", command, data[0] if data else 0, len(data) // 3 % 90) + data
    for body in (data, bytes((command,)) + data, shaped, bytes((command, len(data))) + data, bytes((command, servo))):
        frame = seal(BUS_SERVO, body[:255])
        assert check_aux(frame)
        assert check_motion(frame, 1000.0)
        if check_bus(frame, ARM, LONGEST_MOVE_MS) == "":
            assert Servos(0, 0).holds_ns(frame[4:-1]) <= BOARD.arm.held_ns(frame)
            assert BOARD.arm.held_ns(frame) <= HELD_NS or body[0] in READS
            cut_anywhere(frame)


def move(*servos_to: tuple[int, int], ms: int = 40, count: int | None = None) -> bytes:
    """A move as no encoder of failstop's makes it."""
    rows = b"".join(pack("<BH", *each) for each in servos_to)
    return seal(BUS_SERVO, pack("<BHB", 1, ms, len(servos_to) if count is None else count) + rows)


NOT_COUNTED = "a count that is not its data's"
HEADLESS = [b"\0" + STOPS[0][1:], STOPS[0][:1] + b"\0" + STOPS[0][2:], seal(PWM_SERVO, STOPS[0][4:-1])]
CUT = [STOPS[0][:size] for size in range(5)]
REFUSED = [
    *((frame, "not a bus servo's frame") for frame in (*CUT, *HEADLESS, STOP, WRITE)),
    (seal(BUS_SERVO, b""), "no sub-command"),
    (STOPS[0] + b"\0", "9 bytes, its length byte says 8"),
    (STOPS[1] + b"\0", "10 bytes, its length byte says 9"),
    (STOPS[1][:-1], "8 bytes, its length byte says 9"),
    (STOPS[0][:-1] + b"\0", "bad crc"),
    (move(*((at, 500) for at in range(1, 84))), "83 servos hold the receiver for 72.2 ms, limit 2"),
    (move(*((at, 500) for at in range(1, 4))), "3 servos hold the receiver for 2.6 ms, limit 2"),
    (bytes.fromhex("AA550508030601020304050AE8"), "6 servos hold the receiver for 3.1 ms, limit 2"),
    (bytes.fromhex("AA5505030301FE11"), "servo 254 is none of the arm's"),
    (bytes.fromhex("AA55050A01E8030201410302E8039F"), "a move of 1000 ms, limit 60"),
    (move((1, 500), ms=0), "a move of 0 ms, limit 60"),
    (move((1, 1001)), "position 1001, limit 1000"),
    (move((6, 500)), "servo 6 is none of the arm's"),
    (move((1, 500), (1, 600)), "a servo twice"),
    *((frame, NOT_COUNTED) for frame in (move(), move(count=1), move(count=255), seal(BUS_SERVO, b"\x01"))),
    *((seal(BUS_SERVO, data), NOT_COUNTED) for data in (b"\x03", b"\x03\0", b"\x03\xff\x01")),
    (seal(BUS_SERVO, b"\x05"), "0 servos, must be 1"),
    (seal(BUS_SERVO, b"\x0b\x01\x02"), "2 servos, must be 1"),
    *(
        (seal(BUS_SERVO, bytes((sub, *rest))), f"bus servo sub-command {sub:02X}")
        for subs, rest in (((0x10, 0x12, 0x20, 0x24, 0x30), (1, 2)), ((0x22, 0x32, 0x34, 0x36, 0x38, 0x3A), (1,)))
        for sub in subs
    ),
]


def test_a_frame_is_refused_with_its_reason() -> None:
    assert [(frame, BOARD.arm.check(frame, ARM, LONGEST_MOVE_MS)) for frame, _ in REFUSED] == REFUSED
    assert BOARD.arm.check(move((1, 500), ms=41), ARM, 40) == "a move of 41 ms, limit 40"


def test_questions_and_torques_are_those_of_the_encoders() -> None:
    arm = BOARD.arm
    assert [arm.read(servo, what) for servo in ARM for what in READS] == QUESTIONS
    assert [arm.torque(servo, on, 500) for servo in ARM for on in (True, False)] == TORQUES


def test_how_long_a_frame_holds_the_receiver_is_no_less_than_its_bytes_take_on_the_servos_bus() -> None:
    arm, servos_bus = BOARD.arm, Servos(0, 0)
    some = [*STOPS, *TORQUES, move((1, 500)), move((1, 500), (2, 500))]
    for frame in some:
        takes_ns = servos_bus.holds_ns(frame[4:-1])
        assert takes_ns <= arm.held_ns(frame) <= 1.01 * takes_ns
    assert [arm.held_ns(frame) for frame in some[-2:]] == [MOVE_NS, 2 * MOVE_NS]
    assert {arm.held_ns(frame) for frame in QUESTIONS} == {SILENT_NS}


DURATIONS = [
    ([(1, 500)], 40, 60, 40),
    ([(1, 500)], 60, 60, 60),
    ([(1, 500)], 1, 1, 1),
    ([(3, 459)], 40, 60, 41),
    ([(3, 459)], 40, 41, 41),
    ([(3, 459)], 40, 40, 39),
    ([(2, 517), (4, 461)], 40, 60, 42),
    ([(2, 517), (4, 461)], 40, 41, 39),
    ([(1, 769), (10, 834)], 40, 40, 38),
    ([(3, 416)], 2, 2, 1),
    # Zeros complete a cut of it before its first servo, but that moves none.
    ([(1, 500)], 5, 60, 5),
]
"""Moves, the time that is asked for and the longest one, and the time that is sent, in ms."""


def moves_if_cut(frame: bytes) -> bool:
    """Whether the board moves a servo when zeros come after a cut of this frame."""
    streams = (frame[:cut] + bytes(32) for cut in range(4, len(frame) - 1))
    return any(moved(data) for stream in streams for _, func, data in Receiver().feed(stream) if func == BUS_SERVO)


@pytest.mark.parametrize(("positions", "asked_ms", "longest_ms", "sent_ms"), DURATIONS)
def test_a_move_takes_the_nearest_time_that_its_cuts_let_it_and_a_longer_one_first(
    positions: list[tuple[int, int]], asked_ms: int, longest_ms: int, sent_ms: int
) -> None:
    assert BOARD.arm.move(positions, asked_ms, longest_ms) == move(*positions, ms=sent_ms)
    assert not moves_if_cut(move(*positions, ms=sent_ms))
    last_ms = sent_ms if sent_ms >= asked_ms else longest_ms + 1
    nearer = [*range(asked_ms, last_ms), *range(asked_ms - 1, sent_ms, -1)]
    assert all(moves_if_cut(move(*positions, ms=ms)) for ms in nearer)


def test_a_move_with_no_time_that_its_cuts_let_it_is_refused() -> None:
    assert moves_if_cut(move((10, 948), ms=1))
    with pytest.raises(
        FrameError, match=r"^moves \[\(10, 948\)\] within 1 ms: zeros would complete every frame for it$"
    ):
        BOARD.arm.move([(10, 948)], 1, 1)
    with pytest.raises(FrameError, match=r"^duration_ms is 41, must be an integer from 1 to 40$"):
        BOARD.arm.move([(1, 500)], 41, 40)
    assert BOARD.arm.move([(1, 500)], 60) == move((1, 500), ms=60)


def test_an_encoder_keeps_to_the_settings_bound() -> None:
    for servo, position in product(ARM, range(0, 1001, 7)):
        frame = bus_servo_move([(servo, position)], 40, 40)
        assert check_bus(frame, ARM, 40) == ""


def test_every_servo_of_the_settings_can_be_sent_everywhere() -> None:
    """Servo 170 at 853 is the head of a motor frame, which no encoder makes; every eighth position, 853 among them."""
    with pytest.raises(FrameError, match="aa5503"):
        bus_servo_move([(170, 853)], 40)
    id_of = declaration("joints.NAME.servo")
    assert (id_of.low, id_of.high) == (1, 100)
    for servo, position in product(range(1, 101), range(853 % 8, servos.HIGHEST_POSITION + 1, 8)):
        bus_servo_move([(servo, position)], 40)


def test_where_a_frame_sends_its_servos() -> None:
    arm = BOARD.arm
    assert arm.moves(arm.move([(1, 500), (2, 600)], 40)) == [(1, 500, 40_000_000), (2, 600, 40_000_000)]
    one = move((1, 500))
    assert arm.moves(one) == [(1, 500, 40_000_000)]
    not_a_move = seal(BUS_SERVO, b"\x02" + one[5:-1])
    others = [not_a_move, b"\0" + one[1:], seal(PWM_SERVO, one[4:-1]), *STOPS, *QUESTIONS, *TORQUES, BOARD.stop, b""]
    others += [move(), move((1, 500), count=2), move((1, 1001)), move((1, 500), ms=0)]
    assert [arm.moves(other) for other in others] == [[]] * len(others)


@given(st.binary(max_size=64))
def test_no_bytes_make_the_reader_of_moves_raise(data: bytes) -> None:
    BOARD.arm.moves(data)
    BOARD.arm.moves(bytes.fromhex("aa5505") + data)
