"""One driver's conversation: which motion counts until when, which answers help, and how it ended."""

from __future__ import annotations

import pytest

from failstop.board.driver import DriverAnswer, DriverFrame, DriverMotion, DriverRefusal
from failstop.guard.talk import Command, Talk

MS = 1_000_000
S = 1_000 * MS


class Words:
    """A language of words between blanks: a number is the speed of both wheels, `?` a question, `!` is refused,
    `#` is refused and stops the wheels, `~0.5` steers without a speed, and `=a1` is a frame of the kind `a`."""

    openers = 1
    patience_ns = 1 * S
    past_ns = 0

    def __init__(self) -> None:
        self.asked = 0
        self._speeds = [0.0, 0.0]

    def wrote(self, chunk: bytes, now_ns: int) -> list[DriverMotion | DriverAnswer | DriverFrame | DriverRefusal]:
        return [self._row(word) for word in chunk.split()]

    def _row(self, word: bytes) -> DriverMotion | DriverAnswer | DriverFrame | DriverRefusal:
        if word == b"?":
            self.asked += 1
            return DriverAnswer(b"%d\n" % self.asked)
        if word == b"!":
            return DriverRefusal("shouting", "nothing was done")
        if word == b"#":
            return DriverMotion([0.0, 0.0], refused=True)
        if word.startswith(b"~"):
            return DriverMotion(self._speeds, steering_rad=float(word[1:]), renews=False)
        if word.startswith(b"="):
            return DriverFrame(word, word[1:2].decode())
        self._speeds = [float(part) for part in word.split(b",")]
        return DriverMotion(self._speeds)

    def heard(self, chunk: bytes, now_ns: int) -> list[bytes]:
        return [chunk.upper()]

    def resume(self, before: Words) -> None:
        self.asked = before.asked


def talk(timeout_ms: int = 300, source_ms: int = 300) -> Talk:
    return Talk(Words(), 2, timeout_ms * MS, source_ms * MS)


def commands(made: Talk, until_ms: int, every_ms: int = 10) -> list[tuple[int, Command]]:
    """All that is handed to the service, with when."""
    times = range(0, until_ms, every_ms)
    return [(at_ms, command) for at_ms in times if (command := made.command(at_ms * MS))]


def counts_until_ms(found: list[tuple[int, Command]], source_ms: int = 300) -> float:
    """When the service stops the wheels for want of another command."""
    until = 0.0
    for at_ms, command in found:
        assert at_ms <= until or not until, "the service let the wheels stop, and a renewal started them again"
        until = command.t_ns / MS + source_ms
    return until


@pytest.mark.parametrize("timeout_ms", [50, 299, 300, 301, 350, 1000, 2500])
@pytest.mark.parametrize("source_ms", [50, 300, 2000])
def test_a_motion_counts_for_as_long_as_the_setting_says(timeout_ms: int, source_ms: int) -> None:
    made = talk(timeout_ms, source_ms)
    made.wrote(b"5,5", 0, 0)
    found = commands(made, 4000)
    assert counts_until_ms(found, source_ms) == timeout_ms
    assert all(command.speeds == (5.0, 5.0) for _, command in found)
    assert made.due_ns() is None


@pytest.mark.parametrize(("timeout_ms", "source_ms"), [(300, 300), (50, 300), (1000, 300)])
def test_steering_reaches_the_wheels_and_keeps_no_speed(timeout_ms: int, source_ms: int) -> None:
    made = talk(timeout_ms, source_ms)
    made.wrote(b"5,5", 0, 0)
    found: list[tuple[int, Command]] = []
    for at_ms in range(0, 3000, 10):
        made.wrote(b"~%g" % (at_ms / 1000), at_ms * MS, at_ms * MS)
        if command := made.command(at_ms * MS):
            found.append((at_ms, command))
    assert counts_until_ms(found, source_ms) == timeout_ms
    assert {command.speeds for _, command in found} == {(5.0, 5.0)}
    steered = [at_ms for at_ms, command in found if command.steering_rad == at_ms / 1000]
    assert steered == list(range(0, timeout_ms, 10)), "each angle while the speed counts, and none afterwards"
    assert made.silent_ns(3 * S) == 3 * S - timeout_ms * MS
    assert made.due_ns() is None


def test_an_angle_takes_effect_with_the_speed_of_the_same_chunk_and_with_the_next_one() -> None:
    made = talk()
    made.wrote(b"5,5 ~0.1", 0, 0)
    command = made.command(0)
    assert command
    assert (command.speeds, command.t_ns, command.steering_rad) == ((5.0, 5.0), 0, 0.1)
    made.wrote(b"~0.2", 1 * S, 1 * S)
    assert made.command(1 * S) is None


@pytest.mark.parametrize(
    ("written", "drove"), [(b"5,5 ~0.1", True), (b"5,5 # ~0.1", True), (b"5,5 0,0 ~0.1", False), (b"~0.1", False)]
)
def test_steering_neither_begins_to_drive_nor_ends_it(written: bytes, drove: bool) -> None:
    made = talk()
    made.wrote(written, 0, 0)
    assert made.holds is drove
    assert made.ended(b"~0.2", 1) is drove


def test_the_newest_motion_counts_alone() -> None:
    made = talk()
    made.wrote(b"5,5 7,7 9,9", 10 * MS, 10 * MS)
    command = made.command(10 * MS)
    assert command
    assert command.speeds == (9.0, 9.0)
    assert any(command.speeds)
    made.wrote(b"0,0", 20 * MS, 20 * MS)
    command = made.command(20 * MS)
    assert command
    assert not any(command.speeds)


@pytest.mark.claim("GUARD-1")
def test_a_motion_is_as_old_as_the_moment_when_nothing_waited_to_be_read() -> None:
    """The guard was stopped for two seconds: what waited is two seconds old, for all that it knows."""
    made = talk()
    made.wrote(b"5,5 5,5 5,5", 2 * S, 0)
    command = made.command(2 * S)
    assert command
    assert command.t_ns + 300 * MS < 2 * S, "the service takes it for too old"


def test_after_a_stall_of_its_own_the_guard_renews_nothing() -> None:
    """To the service a command after a pause is a new one, and this driver wrote none."""
    made = talk(2500)
    made.wrote(b"5,5", 0, 0)
    assert made.command(0)
    assert made.command(100 * MS)
    made.wrote(b"~0.1", 1000 * MS, 100 * MS)
    assert made.command(1000 * MS) is None
    assert made.due_ns() is None, "else the guard would wake without end, and find nothing to do"
    made.wrote(b"~0.2", 1005 * MS, 1000 * MS)
    assert made.command(1005 * MS) is None
    assert made.command(2300 * MS) is None
    made.wrote(b"5,5", 2310 * MS, 2300 * MS)
    assert made.command(2310 * MS)
    assert made.due_ns() == 2410 * MS


def test_each_question_has_one_answer_in_order_and_after_a_stall_the_newest_alone() -> None:
    made = talk()
    assert made.wrote(b"? 3,3 ? ?", 10 * MS, 0) == [b"1\n", b"2\n", b"3\n"]
    assert made.wrote(b"? ? ?", 1300 * MS, 20 * MS) == [b"6\n"]
    assert made.wrote(b"?", 1310 * MS, 1300 * MS) == [b"7\n"]


@pytest.mark.parametrize(
    ("written", "unread", "drove"),
    [
        (b"5,5", b"", True),
        (b"5,5 0,0", b"", False),
        (b"", b"", False),
        (b"?", b"?", False),
        pytest.param(b"5,5", b"0,0", False, id="it stopped the wheels with its last words"),
        pytest.param(b"0,0", b"5,5", True, id="it would have driven"),
        pytest.param(b"5,5", b"0,0 5,5", True, id="it would have driven again"),
        pytest.param(b"5,5 #", b"", True, id="it was stopped for what it wrote last"),
        pytest.param(b"5,5", b"#", True, id="it would have been stopped"),
        pytest.param(b"5,5 # 0,0", b"", False, id="it was stopped, and let go"),
        pytest.param(b"#", b"#", False, id="it never drove"),
    ],
)
def test_a_driver_died_unless_its_last_motion_was_zero(written: bytes, unread: bytes, drove: bool) -> None:
    made = talk()
    made.wrote(written, 0, 0)
    before = made.motion
    assert made.ended(unread, 1) is drove
    assert made.motion == before, "what nobody had read moves nothing any more"


def test_silence_is_counted_from_when_its_motion_stopped_counting() -> None:
    made = talk()
    assert made.silent_ns(9 * S) == 0
    made.wrote(b"5,5", 0, 0)
    assert made.silent_ns(300 * MS) == 0
    assert made.silent_ns(700 * MS) == 400 * MS
    made.wrote(b"0,0", 800 * MS, 800 * MS)
    assert made.silent_ns(9 * S) == 0


def test_a_refusal_is_reported_once() -> None:
    made = talk()
    made.wrote(b"! ! ?", 0, 0)
    made.wrote(b"!", 1, 1)
    assert [row.what for row in made.refusals] == ["shouting"]


def test_a_late_answer_is_remembered_for_as_long_as_a_driver_may_end_because_of_it() -> None:
    made = talk()
    made.wrote(b"? 5,5", 900 * MS, 0)
    assert made.late(900 * MS) is None, "it was in time"
    made.wrote(b"5,5", 3 * S, 1 * S)
    assert made.late(3 * S) is None, "nobody asked"
    made.wrote(b"?", 6 * S, 4 * S)
    assert made.late(8 * S) == (2 * S, Words.patience_ns)
    assert made.late(10 * S) is None


def test_a_motion_that_was_replaced_by_a_stop_says_why_until_the_next_one() -> None:
    made = talk()
    made.wrote(b"5,5 !", 0, 0)
    assert made.refused == "", "the wheels turn"
    made.wrote(b"! #", 1, 1)
    assert made.refused == "shouting: nothing was done"
    made.wrote(b"?", 2, 2)
    assert made.refused == "shouting: nothing was done"
    made.wrote(b"5,5", 3, 3)
    assert made.refused == ""


def test_zeros_in_place_of_a_motion_say_that_the_driver_has_not_let_go() -> None:
    made = talk()
    for at_ms, written, stands_in in (
        (0, b"#", False),  # it has commanded no motion yet
        (20, b"5,5", False),
        (40, b"#", True),
        (60, b"0,0", False),
        (80, b"#", False),
        (100, b"nan,1", True),
    ):
        made.wrote(written, at_ms * MS, at_ms * MS)
        command = made.command(at_ms * MS)
        assert command
        assert command.stands_in is stands_in, written


def restarted(written: bytes, at_ms: int = 0) -> Talk:
    """The conversation with the same driver behind a new start of the service."""
    before = talk()
    before.wrote(written, at_ms * MS, at_ms * MS)
    made = talk()
    made.resume(before)
    return made


def moves(made: Talk, written: bytes, at_ms: int) -> bool:
    made.wrote(written, at_ms * MS, at_ms * MS)
    command = made.command(at_ms * MS)
    assert command
    assert command.stands_in is (made.holds and not any(command.speeds))
    return any(command.speeds)


def test_a_driver_that_was_driving_at_a_restart_moves_nothing_until_it_lets_go() -> None:
    made = restarted(b"5,5")
    assert [moves(made, b"5,5", at_ms) for at_ms in range(20, 2000, 20)] == [False] * 99
    assert made.withheld
    assert not moves(made, b"#", 2000), "that is not its own zero"
    assert not moves(made, b"5,5", 2020)
    assert not moves(made, b"0,0", 2040)
    assert moves(made, b"5,5", 2060)
    assert not made.withheld


@pytest.mark.parametrize(("after_ms", "driven"), [(300, False), (301, True)])
def test_or_until_it_pauses(after_ms: int, driven: bool) -> None:
    made = restarted(b"5,5", at_ms=1000)
    assert moves(made, b"5,5", 1000 + after_ms) is driven
    again = restarted(b"5,5")
    assert not moves(again, b"5,5", 20)
    assert moves(again, b"5,5", 20 + after_ms) is driven


@pytest.mark.parametrize("written", [b"0,0", b"?", b"5,5 0,0"])
def test_one_that_was_not_driving_at_a_restart_drives_at_once(written: bytes) -> None:
    assert moves(restarted(written), b"5,5", 20)


@pytest.mark.parametrize("written", [b"nan,1", b"inf,0", b"1", b"1,2,3"])
def test_a_language_that_says_nonsense_stops_the_wheels(written: bytes) -> None:
    made = talk()
    made.wrote(b"5,5", 0, 0)
    made.wrote(written, 1, 1)
    command = made.command(1)
    assert command
    assert not any(command.speeds)
    assert len(made.refusals) == 1


def test_frames_that_are_no_motion_go_out_apart_and_of_each_kind_the_newest() -> None:
    made = talk()
    made.wrote(b"=a1 =b1 =a2", 0, 0)
    found = [(at_ms, frame.data) for at_ms in range(0, 100, 5) if (frame := made.frame(at_ms * MS))]
    assert found == [(0, b"=a2"), (20, b"=b1")]
    assert made.due_ns() is None
    made.wrote(b"=a3", 30 * MS, 30 * MS)
    assert made.due_ns() == 40 * MS


def test_a_flood_of_frames_is_bounded() -> None:
    made = talk()
    made.wrote(b" ".join(b"=%c" % number for number in range(48, 91)), 0, 0)
    assert sum(bool(made.frame(at_ms * MS)) for at_ms in range(0, 2000, 5)) == 8


def test_a_driver_that_must_let_go_first_must_still_do_so_when_another_program_closes_the_port() -> None:
    before, restarted, after = talk(), talk(), talk()
    before.wrote(b"0.2,0.2", 0, 0)
    restarted.resume(before)
    after.adopt(restarted)
    after.wrote(b"0.2,0.2", 100 * MS, 100 * MS)
    (command,) = [command for at_ms, command in commands(after, 110) if at_ms >= 100]
    assert (command.speeds, command.stands_in) == ((0, 0), True)
    after.wrote(b"0,0", 200 * MS, 200 * MS)
    assert not after.withheld
