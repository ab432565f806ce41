"""Lines of `failstop sim --verbose`: few, and nothing that matters is left out."""

from __future__ import annotations

from failstop.board.rrc import codec
from failstop.board.rrc.board import BOARD
from failstop.board.rrc.framing import BUZZER, MOTOR
from failstop_lab.sim.model import Frame, Speeds
from failstop_lab.sim.teller import Teller

FAST: Speeds = (0.8, 0.8, -0.8, -0.8)
STANDING: Speeds = (0.0,) * 4


class Told:
    """Frames at times of one's choice, and the lines that come of them."""

    def __init__(self) -> None:
        self.lines: list[str] = []
        self._teller = Teller(self.lines.append)
        self._speeds = STANDING

    def motor(self, at_s: float, speeds: Speeds) -> None:
        self._speeds = speeds
        self._frame(at_s, codec.motor_speeds(speeds, 2.0))

    def ping(self, at_s: float) -> None:
        self._frame(at_s, BOARD.pings[0])

    def other(self, at_s: float, func: int) -> None:
        self._frame(at_s, bytes((0, 0, func, 0, 0)))

    def _frame(self, at_s: float, raw: bytes) -> None:
        at_ns = round(at_s * 1e9)
        self._teller.frame(Frame(0, at_ns, at_ns, raw[2], raw[4:-1], self._speeds, ()))


def ramp(told: Told, begin_s: float, seconds: float) -> float:
    """From rest to full speed in ticks of 20 ms; returns its end."""
    ticks = round(seconds / 0.02)
    for tick in range(1, ticks + 1):
        share = tick / ticks
        told.motor(begin_s + tick * 0.02, (0.8 * share, 0.8 * share, -0.8 * share, -0.8 * share))
    return begin_s + seconds


def test_a_drive_is_its_start_its_speed_and_its_end() -> None:
    told = Told()
    end_s = ramp(told, 0.0, 0.4)
    for repeat in range(1, 6):
        told.motor(end_s + 0.2 * repeat, FAST)
    told.motor(2.0, STANDING)
    assert [line[13:24] for line in told.lines] == ["wheels turn", "wheels turn", "wheels stop"]
    assert told.lines[1].endswith(" +0.800   +0.800   -0.800   -0.800 rps")
    assert told.lines[2].startswith("    1.980 s  ")


def test_a_long_ramp_is_a_line_a_second_and_a_turn_back_is_told_at_once() -> None:
    told = Told()
    end_s = ramp(told, 0.0, 4.0)
    assert 4 <= len(told.lines) <= 5
    told.motor(end_s + 0.02, (-0.1, -0.1, 0.1, 0.1))
    assert told.lines[-1].split()[4] == "-0.100"


def test_a_burst_is_told_at_once_and_its_repetitions_and_zero_frames_are_counted() -> None:
    told = Told()
    told.motor(0.0, FAST)
    for burst_s in (1.0, 1.02, 1.1):
        for frame in range(4):
            told.motor(burst_s + frame * 0.001, STANDING)
            assert [line[13:24] for line in told.lines[1:]] == ["wheels stop", "stop burst"][
                : frame // 2 + 1
            ] or burst_s > 1
    assert told.lines[2].startswith("    1.002 s")
    for zero in range(60):
        told.motor(1.4 + zero * 0.2, STANDING)
        if zero % 2:
            told.ping(1.45 + zero * 0.2)
    told.other(14.0, BUZZER)
    told.motor(30.0, STANDING)
    assert [line[13:] for line in told.lines[3:]] == [
        "in the last 10 s: 1 motion frame, 55 stop frames, 21 pings",
        "in the last 20 s: 17 stop frames, 9 pings, 1 buzzer frame",
    ]


def test_nothing_but_pings_at_rest_is_a_line_each_ten_seconds() -> None:
    told = Told()
    for ping in range(61):
        told.ping(ping * 0.5)
    assert told.lines == [f"{at:9.3f} s  in the last 10 s: 20 pings" for at in (10, 20, 30)]


def test_a_write_outside_the_table_is_told() -> None:
    lines: list[str] = []
    Teller(lines.append).frame(Frame(0, 0, 0, MOTOR, b"", STANDING, ((7, 1.5),)))
    assert lines == ["    0.000 s  written OUTSIDE the motor table: 7 = 1.5"]
