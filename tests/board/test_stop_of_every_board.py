"""The stop of every board, against the state machine of its receiver: whatever came before it, whoever else writes, and
with the gaps that a USB adapter forgets. A board in a folder of its own is judged here without a line for it."""

from __future__ import annotations

import random
from collections.abc import Iterable, Iterator, Sequence
from itertools import combinations, cycle, islice, pairwise, permutations, product

import pytest

from failstop.board.hoverboard import codec
from failstop.board.kinds import wire_of
from failstop.board.wire import TimedStop, Wire
from failstop_lab.boards.hoverboard import Hoverboard
from failstop_lab.boards.line import (
    ADAPTER_BAR_NS,
    AT_ONCE,
    BAR_NS,
    CROWD_BAR_NS,
    Receiver,
    ReceiverModel,
    Tick,
    TimedWrite,
    arrivals,
    model_of,
    play,
    stop_writes,
)
from tests.support.amounts import LONG, amount
from tests.support.boards import EVERY_KIND, wide

MS = 1_000_000
BEGIN_NS = 20 * MS
APART_NS = 5 * MS
"""Writers begin within this: they learn of a death within 0.2 ms, and may be late."""
ADAPTER_NS = MS
STALL_NS = 300 * MS
END_NS = BEGIN_NS + 2 * STALL_NS

every_board = pytest.mark.parametrize("kind", EVERY_KIND)


class Trial:
    """One board that drives and is stopped."""

    def __init__(self, kind: str, stop: TimedStop | None = None, baud: int = 0) -> None:
        """`baud`: of the board's firmware; 0: as usual."""
        self.wire: Wire = wire_of(kind)
        self.byte_ns = self.wire.port.at(baud or self.wire.port.baud).byte_ns
        self.model: ReceiverModel = model_of(kind)
        self.stop = stop or self.wire.stop
        self.fastest = self.wire.motion.apart / 2
        self.motion = [self.wire.motion.frame(speeds, self.fastest) for speeds in self._speeds()]
        self.frames = [
            *self.motion,
            *(question.ask for question in self.wire.questions),
            *(write.data for write in self.stop.writes),
            *self.wire.port.opening,
        ]

    def _speeds(self) -> Iterator[tuple[float, ...]]:
        for share in (1.0, 0.37, 0.1, 0.012):
            speed = self.fastest * share
            for left, right in ((speed, speed), (-speed, -speed), (speed, -speed / 2), (0.0, speed)):
                yield wide(left, right, self.wire.motion.wheels)

    def cuts(self) -> list[bytes]:
        """Bytes that may stand before a stop: none, every frame cut anywhere or whole, and the receiver's own."""
        cut = {frame[:end] for frame in self.frames for end in range(len(frame) + 1)}
        return sorted(cut | set(self.model.before))

    def stopped_ns(
        self,
        receiver: Receiver,
        before: bytes,
        writers: Sequence[tuple[int, int]],
        late: Sequence[TimedWrite] = (),
        tick: Tick = AT_ONCE,
    ) -> int:
        """When the wheels are told to stop for good, after the stop began and the last other byte was written.

        The board drives. The stops of the writers, (index, when each begins), follow `before` without a gap; `late` is
        what others write meanwhile. -1: they were not stopped.
        """
        byte_ns = self.byte_ns
        writes = [(0, self.motion[0]), (BEGIN_NS - len(before) * byte_ns, before), *late]
        for writer, begin_ns in writers:
            writes += stop_writes(self.stop, writer, begin_ns, byte_ns)
        play(receiver, arrivals(writes, byte_ns, tick), END_NS)
        assert self.model.fuses or all(
            abs(speed) <= self.fastest for _, speeds in receiver.commands for speed in speeds
        )
        moving = [index for index, (_, speeds) in enumerate(receiver.commands) if any(speeds)]
        stops = receiver.commands[moving[-1] + 1 if moving else 0 :]
        if not stops or any(receiver.wheels):
            return -1
        return max(0, stops[0][0] - max(BEGIN_NS, *(at_ns for at_ns, _ in late), 0))


class StalledLine(Tick):
    """An adapter that passes nothing on between two moments."""

    def __init__(self, from_ns: int, until_ns: int) -> None:
        super().__init__()
        self._stalled_ns = from_ns, until_ns

    def after(self, at_ns: int) -> int:
        from_ns, until_ns = self._stalled_ns
        return until_ns if from_ns <= at_ns < until_ns else at_ns


def meetings(stop: TimedStop, first: int, second: int) -> list[int]:
    """How much later the second writer begins when a write of its own begins together with one of the first's."""
    rows = stop.repeats_ns
    return [apart for a, b in product(rows[first], rows[second]) if 0 < (apart := a - b) < APART_NS] or [0]


def random_trial(trial: Trial, rng: random.Random, cuts: list[bytes], writers: Sequence[int], tick: Tick) -> int:
    """Writers that begin some time apart, in any order, behind any cut; among three one still writes a frame of motion.
    Half of them begin so that later writes of two meet."""
    writers = rng.sample(writers, len(writers))
    apart = [rng.randrange(APART_NS) for _ in writers]
    if rng.random() < 0.5:
        apart[1] = max(0, rng.choice(meetings(trial.stop, *writers[:2])) + rng.randrange(-MS, MS))
    begins = [BEGIN_NS, *(BEGIN_NS + later_ns for later_ns in apart[1:])]
    late = [(BEGIN_NS + rng.randrange(MS), rng.choice(trial.motion))] if len(writers) > 2 else []
    receiver = trial.model.any_state(rng)
    return trial.stopped_ns(receiver, rng.choice(cuts), list(zip(writers, begins, strict=True)), late, tick)


@pytest.mark.claim("BOARD-2")
@every_board
def test_one_writer_stops_the_wheels_after_every_cut(kind: str) -> None:
    trial = Trial(kind)
    rng = random.Random(kind)
    writers = range(len(trial.stop.repeats_ns))
    for before, writer in zip(trial.cuts() * len(writers), cycle(writers), strict=False):
        stopped_ns = trial.stopped_ns(trial.model.any_state(rng), before, [(writer, BEGIN_NS)])
        assert 0 <= stopped_ns <= trial.model.cut_ns, (before, writer)


@pytest.mark.parametrize(("kind", "baud"), [(kind, baud) for kind in EVERY_KIND for baud in wire_of(kind).other_bauds])
def test_a_stop_holds_at_the_other_baud_rates_of_a_board(kind: str, baud: int) -> None:
    """After every cut, of one writer and of three that do not see each other."""
    trial = Trial(kind, baud=baud)
    rng = random.Random(kind)
    every = [(writer, BEGIN_NS + rng.randrange(3_000_000)) for writer in range(len(trial.stop.repeats_ns))]
    for before in trial.cuts():
        for writers in ([(0, BEGIN_NS)], every):
            stopped_ns = trial.stopped_ns(trial.model.any_state(rng), before, writers)
            assert 0 <= stopped_ns <= trial.model.cut_ns, (before, writers)


@pytest.mark.claim("BOARD-2")
@every_board
def test_one_writer_stops_the_wheels_in_every_state_of_the_receiver(kind: str) -> None:
    """Short: some of the states, each with the next cut; long: each state with a dozen of them."""
    trial = Trial(kind)
    cuts = trial.cuts()
    pairs: Iterable[tuple[Receiver, bytes]]
    if LONG:
        few = cuts[:: max(1, len(cuts) // 12)]
        pairs = ((receiver, cut) for cut in few for receiver in trial.model.every_state())
    else:
        pairs = zip(islice(trial.model.every_state(), 0, None, 37), cycle(cuts), strict=False)
    for receiver, before in pairs:
        assert 0 <= trial.stopped_ns(receiver, before, [(0, BEGIN_NS)]) <= trial.model.pending_ns, before


@pytest.mark.claim("BOARD-2")
@every_board
@pytest.mark.parametrize("adapter", [False, True], ids=["wire", "adapter"])
def test_writers_that_do_not_see_each_other_stop_the_wheels(kind: str, adapter: bool) -> None:
    trial = Trial(kind)
    rng = random.Random(f"{kind} {adapter}")
    cuts = trial.cuts()
    groups = [*combinations(range(len(trial.stop.repeats_ns)), 2), tuple(range(len(trial.stop.repeats_ns)))]
    for _ in range(amount(150, 60_000)):
        tick = Tick(ADAPTER_NS, rng.randrange(ADAPTER_NS)) if adapter else AT_ONCE
        writers = rng.choice(groups)
        bar_ns = ADAPTER_BAR_NS if adapter else trial.model.cut_ns if len(writers) == 2 else CROWD_BAR_NS
        assert 0 <= random_trial(trial, rng, cuts, writers, tick) <= bar_ns


@pytest.mark.claim("BOARD-2")
@every_board
def test_a_stop_whose_writer_died_after_any_byte_is_finished_by_another(kind: str) -> None:
    """Between the frames of two motors too: the first one has stopped then, and the other one has not."""
    trial = Trial(kind)
    rng = random.Random(kind)
    cuts = trial.cuts()
    whole = b"".join(write.data for write in trial.stop.writes)
    for _ in range(amount(100, 10_000)):
        other = rng.randrange(len(trial.stop.repeats_ns))
        left = [(BEGIN_NS, whole[: rng.randrange(len(whole) + 1)])]
        writers = [(other, BEGIN_NS + rng.randrange(APART_NS))]
        stopped_ns = trial.stopped_ns(trial.model.any_state(rng), rng.choice(cuts), writers, left)
        assert 0 <= stopped_ns <= CROWD_BAR_NS


@pytest.mark.parametrize("kind", [kind for kind in EVERY_KIND if wire_of(kind).stop.after_ns])
def test_beside_the_first_one_pair_of_two_writers_early_stops_touches_at_most(kind: str) -> None:
    """Stops that touch are lost, and a feedback frame may take one more. Either of the two may begin."""
    wire = wire_of(kind)
    lasts_ns = (len(wire.stop.writes[0].data) + 1) * wire.port.byte_ns
    rows = wire.stop.repeats_ns
    for (first, second), apart_ns in product(permutations(range(len(rows)), 2), range(0, APART_NS, MS // 100)):
        pairs = product(rows[first], (at_ns + apart_ns for at_ns in rows[second]))
        early = [pair for pair in pairs if max(pair) <= BAR_NS - lasts_ns]
        touch = [pair for pair in early if abs(pair[0] - pair[1]) < lasts_ns and pair != (0, apart_ns)]
        assert len(touch) <= 1, (first, second, apart_ns)


def test_no_two_hoverboard_repeats_in_a_row_fall_on_the_same_place_of_its_feedback() -> None:
    """It sends feedback every two main loops, of 5.00 to 5.13 ms, and would drop the second stop like the first."""
    wire = wire_of("hoverboard")
    lasts_ns = len(wire.stop.writes[0].data) * wire.port.byte_ns
    for row in wire.stop.repeats_ns:
        for apart_ns in (later - sooner for sooner, later in pairwise(row)):
            for period_ns in range(10 * MS, 10 * MS + MS * 26 // 100, MS // 50):
                assert min(apart_ns % period_ns, -apart_ns % period_ns) > lasts_ns, (row, apart_ns)


@every_board
def test_a_stop_holds_behind_any_backlog(kind: str) -> None:
    """As many frames as may be unanswered, and all writers' repeats; where that is proved, sent at once after a stall,
    which shows in the time since its end."""
    trial = Trial(kind)
    rng = random.Random(kind)
    others = [*trial.motion, *(question.ask for question in trial.wire.questions)]
    writers = [(writer, BEGIN_NS) for writer in range(len(trial.stop.repeats_ns))]
    for _ in range(amount(80, 10_000)):
        frames = [rng.choice(others) for _ in range(rng.randint(0, trial.wire.pace.unanswered or 8))]
        backlog = b"".join(frames)
        cut = backlog[: rng.randint(0, len(backlog))] if rng.random() < 0.5 else backlog
        tick = Tick(STALL_NS, BEGIN_NS + STALL_NS - 1) if trial.model.stalls and rng.random() < 0.5 else AT_ONCE
        allowed_ns = CROWD_BAR_NS if tick is AT_ONCE else STALL_NS + CROWD_BAR_NS
        assert 0 <= trial.stopped_ns(trial.model.any_state(rng), cut, writers, tick=tick) <= allowed_ns


@pytest.mark.claim("BOARD-2")
@every_board
@pytest.mark.parametrize("writers", [1, 2])
def test_a_stop_holds_when_the_adapter_stalls_from_its_first_write(kind: str, writers: int) -> None:
    """For up to 0.3 s. What it kept goes out in one lump, which some boards drop; of the repeats behind it one must
    stand alone, and the board's own report may take one more."""
    trial = Trial(kind)
    rng = random.Random(f"{kind} {writers}")
    for _ in range(amount(150, 20_000)):
        stall_ns = rng.randrange(STALL_NS)
        stalls = StalledLine(BEGIN_NS, BEGIN_NS + stall_ns)
        those = rng.sample(range(len(trial.stop.repeats_ns)), writers)
        begins = [(writer, BEGIN_NS + rng.randrange(APART_NS) * bool(at)) for at, writer in enumerate(those)]
        stopped_ns = trial.stopped_ns(trial.model.any_state(rng), b"", begins, tick=stalls)
        assert 0 <= stopped_ns <= stall_ns + ADAPTER_BAR_NS, (those, stall_ns)


@every_board
def test_control_a_stop_that_looks_enough_is_lost(kind: str) -> None:
    trial = Trial(kind, model_of(kind).not_enough)
    rng = random.Random(kind)
    cuts = trial.cuts()
    lost = 0
    for _ in range(200):
        begins = [(writer, BEGIN_NS + rng.randrange(MS // 5)) for writer in range(len(trial.stop.repeats_ns))]
        lost += trial.stopped_ns(trial.model.any_state(rng), rng.choice(cuts), begins) < 0
    assert lost > 20, f"not_enough of its receiver is no control: {lost} of 200 were lost"


def test_control_two_pieces_pass_the_hoverboard_s_xor_as_one_frame() -> None:
    """A cut stop, the first half of another, and then the end of a feedback frame, which makes the receiver look."""
    receiver = Hoverboard()
    for value in codec.STOP[:4] + codec.STOP[:4]:
        receiver.received(value)
    receiver.look()
    assert receiver.commands == [(0, (-1000.0, -1000.0))]
