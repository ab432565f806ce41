"""The schedule: bursts after 20 and 100 ms, zero frames at 5 Hz while nothing moves; pings, and what the port owner
does with them; a machine that slept, noticed by the clock that went on."""

from __future__ import annotations

from typing import Any

import pytest

from failstop.board.handled import Answers
from failstop.board.rrc.board import BOARD
from failstop.messages import records
from failstop.procs.loop import NEVER, Timer
from failstop.procs.schedule import PING_GAP_NS, QUICK, QUICK_AGAIN, REFRESH, REPEAT, Pings, Repeats
from failstop.procs.suspend import SLEPT_NS, SuspendWatch
from failstop.supervisor.main import HEAR_NS
from tests.support.port_scene import MOTION, TICK, Scene
from tests.support.stage import MS, PortMachine

PERIOD = 500 * MS
T0 = 1000 * MS
BEGIN = 5_000 * MS


@pytest.mark.parametrize("count", [1, 2, 3, 4])
def test_pings_come_in_no_regular_order_and_none_is_left_out_for_long(count: int) -> None:
    """Else an answer to the ping before the last one would look the same as one to the last."""
    pings = Pings(count, PERIOD, Timer(), T0)
    drawn = []
    for turn in range(2_000):
        drawn.append(pings.index)
        pings.sent(T0 + turn * PERIOD)
    for index in range(count):
        assert abs(drawn.count(index) / len(drawn) - 1 / count) < 0.05
    runs = ["".join(map(str, drawn[at : at + 3])) for at in range(len(drawn) - 2)]
    assert count == 1 or not {each for each in runs if len(set(each)) == 1}
    for period in range(1, 9):
        alike = sum(map(int.__eq__, drawn, drawn[period:])) / len(drawn)
        assert count == 1 or alike < 0.7


def test_the_order_of_pings_comes_from_a_generator_of_full_period_and_its_published_values() -> None:
    """Marsaglia's xorshift with 13, 7 and 17 comes back to its start after 2^64 - 1 draws, but with other numbers it
    may do so after a few. These are its first values from 1."""
    pings = Pings(1 << 32, PERIOD, Timer(), now_ns=0)
    for value in (1082269761, 1152992998833853505, 11177516664432764457, 17678023832001937445):
        pings.sent(T0)
        assert pings.index == value >> 32


def test_an_index_that_would_come_for_the_third_time_gives_way_to_the_one_after_it() -> None:
    many, four = (Pings(count, PERIOD, Timer(), now_ns=0) for count in (1 << 32, 4))
    drawn, gave_way = [0], 0
    for _ in range(500):
        many.sent(T0)
        four.sent(T0)
        index = many.index % 4
        third = [index] * 2 == drawn[-2:]
        gave_way += third
        drawn.append((index + 1) % 4 if third else index)
        assert four.index == drawn[-1]
    assert gave_way > 10


@pytest.mark.parametrize("count", [4, 1])
def test_pings_have_a_period_and_one_that_was_refused_is_due_again(count: int) -> None:
    due = Timer()
    pings = Pings(count, PERIOD, due, T0, quick=0)
    for turn in range(6):
        now_ns = T0 + turn * PERIOD
        assert pings.due(now_ns)
        pings.sent(now_ns)
        assert not pings.due(now_ns + PERIOD - 1)
        assert due.ns == now_ns + PERIOD
    again, late_ns = pings.index, T0 + 6 * PERIOD
    pings.failed(late_ns)
    assert [pings.due(late_ns + PING_GAP_NS - 1), pings.due(late_ns + PING_GAP_NS)] == [False, True]
    assert pings.index == again
    none = Pings(0, PERIOD, Timer(), T0)
    none.stopped(T0)
    assert not none.due(T0 + PERIOD)


@pytest.mark.parametrize(("after_ns", "due_ns"), [(200 * MS, 200 * MS), (MS, PING_GAP_NS)], ids=["", "a flood"])
def test_a_ping_is_due_right_after_a_stop_but_for_the_gap(after_ns: int, due_ns: int) -> None:
    pings = Pings(4, PERIOD, Timer(), T0)
    pings.sent(T0)
    pings.stopped(T0 + after_ns)
    assert not pings.due(T0 + due_ns - 1)
    assert pings.due(T0 + due_ns)


@pytest.mark.parametrize("lost", [1, 2, 3, 4])
def test_a_stop_is_acknowledged_before_the_service_gives_up_though_answers_were_lost_just_before(lost: int) -> None:
    """A telemetry that dies takes an answer with it. The next answer may then belong to the lost question too."""
    for seed in range(500):
        due, answers = Timer(), Answers()
        pings = Pings(4, PERIOD, due, T0 + 7_919 * seed, quick=0)

        def ask(pings: Pings = pings, due: Timer = due, answers: Answers = answers) -> tuple[int, int]:
            index, asked_ns = pings.index, due.ns
            answers.asked(index, asked_ns)
            pings.sent(asked_ns)
            return index, asked_ns

        for _ in range(lost):
            ask()
        stop_ns = due.ns - PERIOD // 2
        pings.stopped(stop_ns)
        proved_ns = 0
        while proved_ns < stop_ns and due.ns + MS < stop_ns + HEAR_NS:
            index, asked_ns = ask()
            proved_ns = answers.answered((index,), asked_ns + MS)
        assert proved_ns >= stop_ns, seed


def test_a_ping_that_was_put_off_is_due_then_whatever_is_stopped_meanwhile() -> None:
    pings = Pings(4, PERIOD, Timer(), T0)
    pings.wait(T0 + PERIOD)
    pings.stopped(T0 + MS)
    assert [pings.due(T0 + PERIOD - 1), pings.due(T0 + PERIOD)] == [False, True]


def test_the_first_pings_follow_each_other_so_that_an_answer_is_heard_soon() -> None:
    due, now_ns = Timer(), T0
    pings = Pings(4, PERIOD, due, T0, quick=2)
    found = []
    for _ in range(5):
        found.append(now_ns - T0)
        pings.sent(now_ns)
        now_ns = due.ns
    assert found == [0, PING_GAP_NS, 2 * PING_GAP_NS, 2 * PING_GAP_NS + PERIOD, 2 * PING_GAP_NS + 2 * PERIOD]


def test_another_port_is_asked_from_when_its_board_hears() -> None:
    due = Timer()
    pings = Pings(4, PERIOD, due, T0, quick=2)
    for _ in range(4):
        pings.sent(due.ns)
    hears_ns = due.ns + 3 * PERIOD
    pings.opened(hears_ns)
    found = []
    for _ in range(QUICK_AGAIN + 2):
        found.append(due.ns - hears_ns)
        pings.sent(due.ns)
    assert found == [*range(0, (QUICK_AGAIN + 1) * PING_GAP_NS, PING_GAP_NS), QUICK_AGAIN * PING_GAP_NS + PERIOD]


@pytest.mark.parametrize("count", [2, 4])
def test_a_board_that_hears_late_behind_a_new_port_is_soon_known_to_hear(count: int) -> None:
    """The pings of a second were lost with the old port, and those of a second behind the new one."""
    for seed in range(100):
        due, answers = Timer(), Answers()
        pings = Pings(count, PERIOD, due, T0 + 7_919 * seed)

        def ask(pings: Pings = pings, due: Timer = due, answers: Answers = answers) -> tuple[int, int]:
            asked = pings.index, due.ns
            answers.asked(*asked)
            pings.sent(due.ns)
            return asked

        while due.ns < T0 + 1_000 * MS:
            ask()
        opened_ns = due.ns
        pings.opened(opened_ns)
        while due.ns < opened_ns + 1_000 * MS:
            ask()
        proved_ns, hears_ns = 0, due.ns
        while proved_ns < opened_ns:
            index, asked_ns = ask()
            proved_ns = answers.answered((index,), asked_ns + MS)
        assert due.ns - hears_ns < 1_000 * MS, seed


def test_a_port_that_is_gone_is_asked_nothing() -> None:
    """Else the next board's answers would be taken for answers to these questions."""
    scene = Scene()
    settled(scene)
    scene.wire.unplug()
    scene.turn()
    before = len(scene.kept_writes())
    for _ in range(50):
        scene.put(BOARD.pings[0], kind=records.OTHER)
        scene.turn(TICK)
    assert len(scene.kept_writes()) == before, "neither by itself nor for a client"
    scene.replug(2)
    for _ in range(3):
        scene.turn(PING_GAP_NS)
    assert len(scene.kept_writes()) >= before + 2


def settled(scene: Scene) -> int:
    """How often it has asked when the quick pings of the start are over."""
    for _ in range(60):
        scene.turn(TICK)
    assert len(scene.asked) > QUICK
    return len(scene.asked)


def test_the_port_owner_asks_twice_a_second_and_after_each_stop(scene: Scene) -> None:
    before = settled(scene)
    for _ in range(100):
        scene.turn(TICK)
    assert len(scene.asked) == before + 4
    scene.drive()
    scene.turn(100 * MS)
    before = len(scene.asked)
    scene.wire.port.under_way = len(BOARD.burst)  # the stop is still under way
    scene.ask_to_stop(b"x")
    scene.turn()
    assert len(scene.asked) == before + 1
    assert scene.word("asked_ns") >= scene.word("written_ns")
    *_, (_, asked_ns, kept) = scene.kept_writes()
    assert asked_ns == scene.word("asked_ns")
    assert records.WROTE.unpack(kept) == (scene.asked[-1], ())


def test_a_ping_is_kept_with_the_time_before_its_write_because_its_answer_proves_no_more(scene: Scene) -> None:
    settled(scene)
    scene.machine.look_ns = 1000
    scene.turn(PERIOD)
    *_, (_, kept_ns, _) = scene.kept_writes()
    assert kept_ns == scene.word("asked_ns")


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


def test_a_ping_that_is_not_taken_is_not_counted_and_motion_goes_behind_one_alone(scene: Scene) -> None:
    scene.turn()
    for more, wrote in ((0, MOTION), (1, b"")):
        scene.wire.port.under_way = len(BOARD.pings[0]) + more
        assert scene.forward(elapsed_ns=TICK) == wrote
    asked = list(scene.asked)
    asked_ns = scene.word("asked_ns")
    scene.wire.port.under_way = 5000
    for _ in range(3):
        scene.owner.wire.burst()
    scene.turn(PERIOD)
    assert scene.asked == asked
    assert scene.word("asked_ns") == asked_ns
    scene.wire.port.under_way = 0
    scene.turn(PING_GAP_NS)
    assert len(scene.asked) == len(asked) + 1, "it is asked again soon"


@pytest.mark.parametrize(("more", "asks"), [(0, 1), (1, 0)])
def test_a_ping_goes_behind_two_bursts_under_way_and_behind_no_more(scene: Scene, more: int, asks: int) -> None:
    before = settled(scene)
    scene.turn()
    scene.wire.port.under_way = 1
    for data in (BOARD.burst, BOARD.burst, bytes(more)):
        assert not data or scene.owner.wire.frame(data, backlog=3 * len(BOARD.burst))
    scene.turn(PERIOD)
    assert len(scene.asked) == before + asks


@pytest.mark.parametrize("when", ["before the look", "between the look and the write"])
def test_a_machine_that_slept_is_stopped_for(scene: Scene, when: str) -> None:
    def sleep() -> None:
        scene.machine.slept_ns += 12_300 * MS

    scene.drive()
    if when == "before the look":
        sleep()
    else:
        scene.at_next("ioctl", sleep)
    scene.put()
    wrote = scene.turn(TICK)
    assert wrote.startswith(BOARD.burst)
    assert MOTION not in wrote
    assert scene.reasons() == ["the machine was suspended for 12.3 s"]
    scene.put()
    assert MOTION not in scene.turn(TICK), "not before a newer epoch"


def written(repeats: Repeats, start_ms: int, end_ms: int) -> list[tuple[int, int]]:
    """Repeats that come due from start to end, asked every millisecond: (ms, what)."""
    times = range(start_ms, end_ms)
    return [(ms, what) for ms in times if (what := repeats.pop(BEGIN + ms * MS))]


@pytest.fixture
def due() -> Timer:
    return Timer()


@pytest.fixture
def repeats(due: Timer) -> Repeats:
    made = Repeats(due, BOARD.repeats_ns[0], BEGIN)
    assert written(made, 0, 450) == [(0, REFRESH), (200, REFRESH), (400, REFRESH)], "before any stop"
    made.restart(BEGIN)
    return made


def test_bursts_and_then_zero_frames_follow_a_stop_and_begin_anew_with_the_next(repeats: Repeats) -> None:
    assert repeats.pop(BEGIN + 20 * MS - 1) == 0
    assert written(repeats, 0, 650) == [(20, REPEAT), (100, REPEAT), (200, REFRESH), (400, REFRESH), (600, REFRESH)]
    repeats.restart(BEGIN + 650 * MS)
    assert written(repeats, 650, 700) == [(670, REPEAT)]
    repeats.restart(BEGIN + 700 * MS)
    assert written(repeats, 700, 950) == [(720, REPEAT), (800, REPEAT), (900, REFRESH)]


def test_the_first_zero_does_not_fall_on_the_last_repeat(due: Timer) -> None:
    """Two frames at the same time would be one to the board, because it needs a gap between them."""
    repeats = Repeats(due, (20 * MS, 200 * MS), BEGIN)
    repeats.restart(BEGIN)
    assert written(repeats, 0, 500) == [(20, REPEAT), (200, REPEAT), (400, REFRESH)]


def test_motion_ends_the_repeats_also_those_that_are_overdue(repeats: Repeats, due: Timer) -> None:
    found: list[tuple[int, int]] = []
    now_ns = BEGIN
    while len(found) < 5:
        assert due.ns > now_ns, "a wake-up that is over already would spin"
        now_ns = due.ns
        found.append(((now_ns - BEGIN) // MS, repeats.pop(now_ns)))
    assert found == [(20, REPEAT), (100, REPEAT), (200, REFRESH), (400, REFRESH), (600, REFRESH)]
    repeats.end()
    assert due.ns == NEVER
    assert written(repeats, 700, 2_000) == []
    repeats.restart(BEGIN + 5_000 * MS)
    late_ns = BEGIN + 6_000 * MS
    assert [repeats.pop(late_ns) for _ in range(4)] == [REPEAT, REPEAT, REFRESH, 0], "each is written"
    repeats.restart(BEGIN + 7_000 * MS)
    repeats.end()
    assert repeats.pop(BEGIN + 9_000 * MS) == 0


def told(machine: PortMachine, watch: Any, *slept_ms: float) -> list[float]:
    """Answers at one look after the other; the machine has slept for so long in all by each."""
    found = []
    for ms in slept_ms:
        machine.machine.slept_ns = round(ms * MS)
        found.append(watch.slept_ns() / MS)
    return found


def watch(machine: PortMachine) -> Any:
    return machine.load("failstop.procs.suspend").SuspendWatch()


@pytest.mark.parametrize(
    ("before_ms", "slept_ms", "told_ms"),
    [
        (7, (7, 3007, 3007), [0, 3000, 0]),
        (0, (60, 120), [60, 60]),
        (0, (3, 0, (SLEPT_NS - 1) / MS), [0, 0, 0]),
    ],
    ids=["once", "two as two", "jitter is none"],
)
def test_a_watch_tells_a_sleep_with_its_length(
    machine: PortMachine, before_ms: int, slept_ms: tuple[float, ...], told_ms: list[float]
) -> None:
    machine.machine.slept_ns = before_ms * MS
    assert told(machine, watch(machine), *slept_ms) == told_ms


def test_a_watch_takes_the_best_of_its_first_three_looks(machine: PortMachine) -> None:
    """Two of them are held up between the clocks."""
    held_up_ns = iter((0, 0, 60 * MS, 0, 0, 60 * MS))
    look = machine.system["time"].monotonic_ns

    def held_up() -> int:
        machine.machine.now_ns += next(held_up_ns, 0)
        return int(look())

    machine.system["time"].monotonic_ns = held_up
    assert told(machine, watch(machine), 0, 0) == [0, 0]
    assert list(held_up_ns) == []


def test_a_start_that_was_held_up_does_not_look_like_a_sleep_for_ever(machine: PortMachine) -> None:
    machine.machine.look_ns = 40 * MS
    made = watch(machine)
    machine.machine.look_ns = 0
    assert told(machine, made, 0, 45) == [0, 0]


def test_being_held_up_between_the_clocks_makes_the_reading_smaller(machine: PortMachine) -> None:
    machine.machine.look_ns = 900 * MS
    assert machine.load("failstop.procs.suspend").gained_ns() == -900 * MS


def test_this_machine_does_not_sleep_now() -> None:
    watched = SuspendWatch()
    assert [watched.slept_ns() for _ in range(1000)] == [0] * 1000
