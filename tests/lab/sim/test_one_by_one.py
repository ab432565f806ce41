"""Frames for one motor each, as the commands that judges know."""

from __future__ import annotations

import pytest

from failstop_lab.boards.one_by_one import JOINED_NS, OneByOne

MS = 1_000_000


class Three(OneByOne):
    def __init__(self, *, joined: bool = True) -> None:
        super().__init__(joined=joined)
        self.wheels = (0.0, 0.0, 0.0)  # type: ignore[misc]

    def tell(self, motor: int, speed: float, at_ns: int) -> None:
        self.pass_commands(at_ns)
        self.wheels = tuple(speed if each == motor else was for each, was in enumerate(self.wheels))  # type: ignore[misc]
        self.commanded(motor, at_ns)


@pytest.fixture
def board() -> Three:
    return Three()


def test_frames_for_all_motors_in_their_order_are_one_command(board: Three) -> None:
    for motor in range(3):
        board.tell(motor, 1.0, motor * MS)
    assert board.commands == [(2 * MS, (1.0, 1.0, 1.0))]


def test_a_stop_that_ends_before_the_last_motor_is_a_command_that_leaves_it_turning(board: Three) -> None:
    for motor in range(3):
        board.tell(motor, 1.0, 0)
    board.tell(0, 0.0, 10 * MS)
    board.tell(1, 0.0, 10 * MS)
    board.pass_commands(10 * MS + JOINED_NS)
    assert len(board.commands) == 1, "the frame for the last motor may still come"
    board.pass_commands(10 * MS + JOINED_NS + 1)
    assert board.commands[1:] == [(10 * MS, (0.0, 0.0, 1.0))]


def test_a_motor_that_was_left_out_is_seen_when_the_next_command_begins(board: Three) -> None:
    board.tell(0, 1.0, 0)
    board.tell(2, 1.0, MS)
    assert board.commands == [(0, (1.0, 0.0, 0.0)), (MS, (1.0, 0.0, 1.0))]


def test_frames_may_be_kept_apart() -> None:
    board = Three(joined=False)
    for motor in range(3):
        board.tell(motor, 1.0, motor)
    assert [speeds for _, speeds in board.commands] == [(1.0, 0.0, 0.0), (1.0, 1.0, 0.0), (1.0, 1.0, 1.0)]
