"""What a driver of a VESC may write, held against the board's own receiver, and the answers that it hears."""

from __future__ import annotations

import json
import math
import random
from binascii import crc_hqx
from pathlib import Path
from typing import TYPE_CHECKING

import pytest

from failstop.board.driver import DriverFrame, DriverMotion, DriverRefusal, language_of
from failstop.board.vesc import codec
from failstop.board.vesc.driver import MOTOR_NS
from failstop.guard.scale import Scale
from failstop.policy.settings import Settings
from failstop_lab.boards.vesc import Vesc, wrapped
from tests.support.amounts import amount

from .damage import damaged, judged

if TYPE_CHECKING:
    from failstop.board.driver import DriverLanguage

HOST = Path(__file__).parent.parent / "board" / "recorded_vesc_host.json"
BYTE_NS = 87_000
MS = 1_000_000
RPM, DUTY, CURRENT, BRAKE, POSITION, HANDBRAKE, SERVO, MCCONF, ALIVE, FORWARD = 8, 5, 6, 7, 9, 10, 12, 13, 30, 34
CURRENT_SHARE, BOOT_LOADER, REBOOT, EVERYBODY = 84, 1, 29, 255
PAIR: dict[str, object] = {"board.kind": "vesc"}
CAR: dict[str, object] = {"board.kind": "vesc", "wheels.layout": "ackermann"}


def packet(command: int, value: int, size: int = 4) -> bytes:
    return wrapped(bytes((command,)) + value.to_bytes(size, "big", signed=True))


def behind(command: int, value: int, can_id: int = 1) -> bytes:
    return wrapped(bytes((FORWARD, can_id, command)) + value.to_bytes(4, "big", signed=True))


def made(settings: dict[str, object] | None = None) -> DriverLanguage:
    language = language_of("vesc", Settings(settings or PAIR).flat())
    assert language
    return language


def motions(chunk: bytes) -> list[tuple[float, ...]]:
    return [tuple(row.speeds) for row in made().wrote(chunk, 0) if isinstance(row, DriverMotion)]


def refusals(chunk: bytes, settings: dict[str, object] | None = None) -> list[str]:
    return [row.what for row in made(settings).wrote(chunk, 0) if isinstance(row, DriverRefusal)]


def commanded(chunk: bytes) -> list[tuple[float, ...]]:
    board = Vesc(joined=False)
    for at, value in enumerate(chunk, 1):
        board.byte(at * BYTE_NS, value)
    board.until(len(chunk) * BYTE_NS + 1_000_000)
    return [speeds for _, speeds in board.commands]


def test_what_pyvesc_writes_is_taken_as_it_is_meant() -> None:
    """59 packets of pyvesc 1.0.5: a name, a value, the bytes."""
    (rows,) = json.loads(HOST.read_text()).values()
    assert len(rows) >= 50
    for name, value, text in rows:
        chunk = bytes.fromhex(text)
        if name == "rpm":
            assert motions(chunk) == [(value, 0.0)] == commanded(chunk)
            assert chunk == codec.Motors().frame((value,), codec.LIMIT) or not value
        elif name == "values":
            (row,) = made().wrote(chunk, 0)
            assert isinstance(row, DriverFrame)
            assert row.data == chunk
        else:
            assert motions(chunk) == [(0.0, 0.0)]
            assert bool(refusals(chunk)) == (value != 0 and name != "brake")


def test_both_motors_are_driven_by_one_driver() -> None:
    chunk = packet(RPM, 1000) + behind(RPM, -700) + packet(BRAKE, 2000) + behind(DUTY, 0)
    assert motions(chunk) == [(1000, 0), (1000, -700), (0, -700), (0, 0)]
    assert motions(chunk) == commanded(chunk)


@pytest.mark.parametrize("command", [DUTY, CURRENT, CURRENT_SHARE, BRAKE, RPM])
@pytest.mark.parametrize("can_id", [None, 1, EVERYBODY])
def test_a_zero_stops_the_motors_that_the_board_itself_would_stop(command: int, can_id: int | None) -> None:
    """A packet for every controller on the CAN is not one for the controller at the port."""
    zero = packet(command, 0) if can_id is None else behind(command, 0, can_id)
    chunk = packet(RPM, 1000) + behind(RPM, -700) + zero
    assert motions(chunk)[-1] == commanded(chunk)[-1] == ((0, -700) if can_id is None else (1000, 0))
    assert refusals(chunk) == []


def test_packets_may_come_split_and_glued() -> None:
    text = packet(RPM, 900) + behind(RPM, 5) + packet(ALIVE, 0, 1) + packet(RPM, 0)
    for cut in range(len(text)):
        language = made()
        rows = language.wrote(text[:cut], 0) + language.wrote(text[cut:], 0)
        assert [tuple(row.speeds) for row in rows if isinstance(row, DriverMotion)] == [(900, 0), (900, 5), (0, 5)]


@pytest.mark.parametrize("settings", [PAIR, CAR], ids=["two motors", "a car"])
def test_what_names_no_speed_renews_none(settings: dict[str, object]) -> None:
    """pyvesc writes ALIVE from a thread of its own, also while its main thread hangs, and a car's servo may be steered
    by another node than the one whose speed it is."""
    language = made(settings)
    language.wrote(packet(RPM, 1000), 0)
    for chunk in (packet(ALIVE, 0, 1), wrapped(bytes((ALIVE,))), codec.VALUES, packet(SERVO, 400, 2)):
        rows = language.wrote(chunk, 0)
        assert [row for row in rows if isinstance(row, DriverMotion) and row.renews] == [], chunk


def test_a_speed_for_one_motor_keeps_the_other_one_no_longer_than_the_board_does() -> None:
    """A driver may command each motor from a thread of its own, and one of them hangs."""
    language, board = made(), Vesc()
    found: tuple[float, ...] = ()
    for at_ms in range(0, 2000, 50):
        chunk = packet(RPM, 1000) + (behind(RPM, -700) if at_ms < 500 else b"")
        for at, value in enumerate(chunk):
            board.byte(at_ms * MS + at * BYTE_NS, value)
        (*_, row) = language.wrote(chunk, at_ms * MS)
        assert isinstance(row, DriverMotion)
        board.until(at_ms * MS + 10 * MS)
        found = tuple(row.speeds)
        assert found[0] == board.wheels[0] == 1000
        assert found[1] in (0, board.wheels[1])
        assert bool(found[1]) == (at_ms < 450 + MOTOR_NS // MS)
    assert found == board.wheels == (1000, 0)
    *refused, last = language.wrote(packet(RPM, 0), 2000 * MS)
    assert [row.what for row in refused if isinstance(row, DriverRefusal)] == ["the last speed of one motor"]
    assert isinstance(last, DriverMotion)
    assert (tuple(last.speeds), last.refused) == ((0, 0), True), "the driver has not ended driving"
    (last,) = language.wrote(behind(RPM, 0), 2000 * MS)
    assert isinstance(last, DriverMotion)
    assert not last.refused


def test_a_car_is_steered_for_as_long_as_the_guard_keeps_its_speed() -> None:
    """`guard.timeout_s` may be longer than the time after which one of two motors counts as silent."""
    language = made(CAR)
    language.wrote(packet(RPM, 1000), 0)
    for at_ms in range(100, 2500, 100):
        (row,) = language.wrote(packet(SERVO, 400, 2), at_ms * MS)
        assert isinstance(row, DriverMotion)
        assert (tuple(row.speeds), row.renews) == ((1000,), False)


@pytest.mark.parametrize(
    ("chunk", "what"),
    [
        (packet(DUTY, 20_000), "a duty cycle"),
        (packet(CURRENT, -2000), "a current"),
        (packet(POSITION, 90_000_000), "a position of the motor"),
        (packet(HANDBRAKE, 1000), "a handbrake current"),
        (behind(CURRENT, 1), "a current"),
        (packet(CURRENT_SHARE, 1000), "a share of the current"),
        (behind(DUTY, 20_000, EVERYBODY), "a duty cycle"),
        (wrapped(bytes((REBOOT,))), "a reboot"),
        (wrapped(bytes((FORWARD, 1, BOOT_LOADER))), "a jump to the boot loader"),
    ],
)
def test_what_would_turn_a_motor_without_a_speed_or_restart_it_stops_both(chunk: bytes, what: str) -> None:
    language = made()
    language.wrote(packet(RPM, 1000) + behind(RPM, 1000), 0)
    rows = language.wrote(chunk, 0)
    assert what in [row.what for row in rows if isinstance(row, DriverRefusal)]
    assert [(tuple(row.speeds), row.refused) for row in rows if isinstance(row, DriverMotion)] == [((0, 0), True)]


@pytest.mark.parametrize(
    ("chunk", "what"),
    [
        (behind(RPM, 1000, 9), "a packet for CAN id 9"),
        (wrapped(bytes((FORWARD,))), "a packet for the CAN"),
        (packet(MCCONF, 0), "command 13"),
        (wrapped(b"\x02"), "command 2"),
        (packet(SERVO, 500, 2), "the servo"),
        (wrapped(bytes((FORWARD, 1, 4))), "a question for the second VESC"),
        (b"m 100 100\r", "bytes that are not a packet"),
        (packet(RPM, 1000)[:-1] + b"\0", "bytes that are not a packet"),
    ],
)
def test_what_is_refused_is_named_and_moves_nothing(chunk: bytes, what: str) -> None:
    assert refusals(chunk) == [what]
    assert motions(chunk) == []


def longer(payload: bytes) -> bytes:
    """A packet whose length takes two bytes, as the firmware takes it from 255 bytes on."""
    crc = crc_hqx(payload, 0).to_bytes(2, "big")
    return b"\3" + len(payload).to_bytes(2, "big") + payload + crc + b"\3"


@pytest.mark.parametrize("size", [255, 256, 300, 512])
def test_a_long_packet_is_refused_by_its_name_or_taken_as_the_board_takes_it(size: int) -> None:
    settings = longer(bytes((MCCONF,)) + bytes(size - 1))
    assert refusals(settings) == ["command 13"]
    assert refusals(packet(RPM, 5) + settings + packet(RPM, 6)) == ["command 13"]
    speed = longer(bytes((RPM,)) + (900).to_bytes(4, "big") + bytes(size - 5))
    assert motions(speed) == [(900, 0)] == commanded(speed)
    assert refusals(speed) == []
    answer = bytes((0,)) + bytes(size - 1)
    (heard,) = made().heard(longer(answer), 0)
    assert codec.payloads(heard) == ([answer], b"")


def test_a_car_s_servo_and_speed_become_a_curve_within_its_limits() -> None:
    """As RoboRacer's ackermann_to_vesc: -1.2135 of the way for a radian, straight ahead at 0.5304."""
    settings = Settings(CAR)
    language, scale = made(CAR), Scale(settings, 1450.0, 1 / 1450.0)
    angle = 0.2
    place = int((-1.2135 * angle + 0.5304) * 1000)
    assert language.wrote(packet(SERVO, place, 2), 0) == []
    (row,) = language.wrote(packet(RPM, 4614), 0)
    assert isinstance(row, DriverMotion)
    assert row.steering_rad == pytest.approx(angle, abs=0.002)
    vx, vy, wz = scale.velocity(row.speeds, row.steering_rad)
    assert (vx, vy) == (pytest.approx(1.0, rel=0.01), 0.0)
    assert wz == pytest.approx(math.tan(angle) * vx / 0.33, rel=0.02)
    (turned,) = language.wrote(packet(SERVO, 530, 2), 0)
    assert isinstance(turned, DriverMotion)
    assert (turned.speeds, turned.renews) == (row.speeds, False)
    assert scale.velocity(turned.speeds, turned.steering_rad)[2] == pytest.approx(0.0, abs=0.01)
    assert refusals(behind(RPM, 1000), CAR) == ["a packet for CAN id 1"]


def test_a_driver_hears_the_answers_to_its_own_questions_alone() -> None:
    language, board = made(), Vesc(turns=True)
    asked = codec.FIRMWARE + wire_questions() + codec.VALUES
    for at, value in enumerate(asked, 1):
        board.byte(at * BYTE_NS, value)
    board.until(100_000_000)
    said = b"".join(data for _, data in board.said)
    heard = [found for value in said for found in language.heard(bytes((value,)), 0)]
    assert [each[2] for each in heard] == [0, 4]
    assert all(each in said for each in heard)


def wire_questions() -> bytes:
    return b"".join(codec.Motors((1,)).questions)


@pytest.mark.claim("GUARD-1")
def test_nothing_moves_that_the_board_itself_would_not_move() -> None:
    """After each packet each motor has the speed that the board has, or none."""
    random_ = random.Random(31)

    def one() -> bytes:
        erpm = random_.choice((0, 1, 673, 900, -5000, 99_999))
        return random_.choice(
            (packet(RPM, erpm), behind(RPM, erpm), packet(DUTY, 0), packet(CURRENT, erpm), packet(CURRENT_SHARE, 0))
        )

    moved = 0
    for _ in range(amount(1000, 1_000_000)):
        chunk = damaged(random_, one, (2, 3, 8), b"\2\3\0\x22", 9)
        moved += judged(chunk, motions, commanded)
    assert moved > 100
