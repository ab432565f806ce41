"""The schedule: bursts after 20 and 100 ms, zero frames at 5 Hz while nothing moves; pings, and what the port owner
does with them."""

from __future__ import annotations

import pytest

from failstop.board.rrc.board import BOARD
from failstop.messages import layout
from failstop.procs.loop import NEVER, Timer
from failstop.procs.schedule import PING_GAP_NS, QUICK, REFRESH, REPEAT, Pings, Repeats
from tests.support.port_scene import MOTION, TICK, Scene
from tests.support.stage import MS

PERIOD = 500 * MS
T0 = 1000 * MS
BEGIN = 5_000 * MS


@pytest.fixture
def scene() -> Scene:
    return Scene()


def test_pings_take_their_indices_in_turn() -> None:
    due = Timer()
    pings = Pings(4, PERIOD, due, T0, quick=0)
    found = []
    for turn in range(6):
        assert pings.due(T0 + turn * PERIOD)
        found.append(pings.index)
        pings.sent(T0 + turn * PERIOD)
        assert not pings.due(T0 + (turn + 1) * PERIOD - 1)
        assert due.ns == T0 + (turn + 1) * PERIOD
    assert found == [0, 1, 2, 3, 0, 1]


@pytest.mark.parametrize(("after_ns", "due_ns"), [(200 * MS, 200 * MS), (MS, PING_GAP_NS)], ids=["", "a flood"])
def test_a_ping_is_due_right_after_a_stop_but_for_the_gap(after_ns: int, due_ns: int) -> None:
    pings = Pings(4, PERIOD, Timer(), T0)
    pings.sent(T0)
    pings.stopped(T0 + after_ns)
    assert not pings.due(T0 + due_ns - 1)
    assert pings.due(T0 + due_ns)


def test_a_ping_that_the_port_did_not_take_is_tried_again_after_the_gap() -> None:
    pings = Pings(4, PERIOD, Timer(), T0)
    pings.failed(T0)
    assert not pings.due(T0 + PING_GAP_NS - 1)
    assert pings.due(T0 + PING_GAP_NS)
    assert pings.index == 0


def test_a_board_with_one_ping_is_asked_that_and_one_without_never() -> None:
    due = Timer()
    pings = Pings(1, PERIOD, due, T0, quick=0)
    assert pings.due(T0)
    pings.sent(T0)
    assert (pings.index, due.ns) == (0, T0 + PERIOD)
    none = Pings(0, PERIOD, Timer(), T0)
    none.stopped(T0)
    assert not none.due(T0 + PERIOD)


def test_the_first_pings_follow_each_other_so_that_an_answer_is_heard_soon() -> None:
    due, now_ns = Timer(), T0
    pings = Pings(4, PERIOD, due, T0, quick=2)
    found = []
    for _ in range(5):
        found.append(now_ns - T0)
        pings.sent(now_ns)
        now_ns = due.ns
    assert found == [0, PING_GAP_NS, 2 * PING_GAP_NS, 2 * PING_GAP_NS + PERIOD, 2 * PING_GAP_NS + 2 * PERIOD]


def settled(scene: Scene) -> int:
    """How often it has asked when the quick pings of the start are over."""
    for _ in range(60):
        scene.turn(TICK)
    assert len(scene.asked) > QUICK
    return len(scene.asked)


def test_the_port_owner_asks_twice_a_second(scene: Scene) -> None:
    before = settled(scene)
    for _ in range(100):
        scene.turn(TICK)
    assert len(scene.asked) == before + 4
    assert scene.asked == [index % 4 for index in range(before + 4)]


def test_the_port_owner_asks_after_each_stop(scene: Scene) -> None:
    """While the stop is still under way."""
    settled(scene)
    scene.drive()
    scene.turn(100 * MS)
    before = len(scene.asked)
    scene.wire.port.under_way = len(BOARD.burst)
    scene.ask_to_stop(b"x")
    scene.turn()
    assert len(scene.asked) == before + 1
    index = scene.asked[-1]
    assert scene.word(f"ping_{index}") >= scene.word("written_ns")


def test_it_wakes_to_ask_whether_a_stop_was_heard_and_not_at_the_tick_after(scene: Scene) -> None:
    scene.turn()
    scene.turn(PING_GAP_NS - 5 * MS)
    scene.raise_epoch(2)
    scene.turn()
    assert scene.next_ns() == scene.clock() + 5 * MS
    before = len(scene.asked)
    scene.turn(5 * MS)
    assert len(scene.asked) == before + 1


def test_a_board_without_pings_keeps_the_port_owner_no_more_awake() -> None:
    def without_pings(scene: Scene) -> None:
        type(scene.board).pings = ()

    scene = Scene(before=without_pings)
    scene.turn()
    scene.turn()
    assert scene.next_ns() == scene.clock() + TICK


def test_a_ping_that_the_port_does_not_take_is_not_counted(scene: Scene) -> None:
    scene.turn()
    asked = list(scene.asked)
    words = [scene.word(f"ping_{index}") for index in range(layout.PINGS)]
    scene.wire.port.under_way = 5000
    for _ in range(3):
        scene.owner.wire.burst()
    scene.turn(PERIOD)
    assert scene.asked == asked
    assert [scene.word(f"ping_{index}") for index in range(layout.PINGS)] == words
    scene.wire.port.under_way = 0
    scene.turn(PING_GAP_NS)
    assert len(scene.asked) == len(asked) + 1, "and it is asked again soon"


def test_motion_goes_on_behind_a_ping_and_behind_nothing_else(scene: Scene) -> None:
    scene.turn()
    scene.wire.port.under_way = len(BOARD.pings[0])
    assert scene.forward(elapsed_ns=TICK) == MOTION
    scene.wire.port.under_way = len(BOARD.pings[0]) + 1
    assert scene.forward(elapsed_ns=TICK) == b""


def test_a_machine_that_slept_is_stopped_for(scene: Scene) -> None:
    scene.drive()
    scene.machine.slept_ns += 12_300 * MS
    assert scene.turn(TICK).startswith(BOARD.burst)
    assert scene.reasons() == ["the machine was suspended for 12.3 s"]
    scene.put()
    assert MOTION not in scene.turn(TICK), "not before a newer epoch"


def test_a_sleep_between_the_look_and_the_write_is_stopped_for(scene: Scene) -> None:
    def sleep() -> None:
        scene.machine.slept_ns += 5_000 * MS

    scene.drive()
    scene.at_next("ioctl", sleep)
    scene.put()
    wrote = scene.turn(TICK)
    assert wrote.startswith(BOARD.burst)
    assert MOTION not in wrote
    assert scene.reasons() == ["the machine was suspended for 5.0 s"]


class Schedule(Repeats):
    """Repeats with their deadline in sight."""

    def __init__(self) -> None:
        self.next = Timer()
        super().__init__(self.next, BOARD.repeats_ns[0], BEGIN)


def written(repeats: Repeats, start_ms: int, end_ms: int) -> list[tuple[int, int]]:
    """Repeats that come due from start to end, asked every millisecond: (ms, what)."""
    times = range(start_ms, end_ms)
    return [(ms, what) for ms in times if (what := repeats.take(BEGIN + ms * MS))]


@pytest.fixture
def repeats() -> Schedule:
    made = Schedule()
    made.restart(BEGIN)
    return made


def test_before_any_stop_zero_frames_go_out() -> None:
    assert written(Schedule(), 0, 450) == [(0, REFRESH), (200, REFRESH), (400, REFRESH)]


def test_bursts_and_then_zero_frames_follow_a_stop_and_begin_anew_with_the_next(repeats: Schedule) -> None:
    assert repeats.take(BEGIN + 20 * MS - 1) == 0
    assert written(repeats, 0, 650) == [(20, REPEAT), (100, REPEAT), (200, REFRESH), (400, REFRESH), (600, REFRESH)]
    repeats.restart(BEGIN + 650 * MS)
    assert written(repeats, 650, 700) == [(670, REPEAT)]
    repeats.restart(BEGIN + 700 * MS)
    assert written(repeats, 700, 950) == [(720, REPEAT), (800, REPEAT), (900, REFRESH)]


def test_motion_ends_the_repeats_also_those_that_are_overdue(repeats: Schedule) -> None:
    assert written(repeats, 0, 30) == [(20, REPEAT)]
    repeats.end()
    assert repeats.next.ns == NEVER
    assert written(repeats, 30, 2_000) == []
    repeats.restart(BEGIN + 5_000 * MS)
    assert written(repeats, 5_000, 5_250) == [(5_020, REPEAT), (5_100, REPEAT), (5_200, REFRESH)]
    repeats.end()
    assert repeats.take(BEGIN + 9_000 * MS) == 0


def test_overdue_bursts_are_each_written(repeats: Schedule) -> None:
    late = BEGIN + 1_000 * MS
    assert [repeats.take(late) for _ in range(4)] == [REPEAT, REPEAT, REFRESH, 0]


def test_waking_at_the_deadline_is_enough(repeats: Schedule) -> None:
    found: list[tuple[int, int]] = []
    now_ns = BEGIN
    while len(found) < 5:
        assert repeats.next.ns > now_ns, "a wake-up that is over already would spin"
        now_ns = repeats.next.ns
        found.append(((now_ns - BEGIN) // MS, repeats.take(now_ns)))
    assert found == [(20, REPEAT), (100, REPEAT), (200, REFRESH), (400, REFRESH), (600, REFRESH)]
