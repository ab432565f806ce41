"""Heartbeats: what a process says of itself, and what its successor takes back; a barrier, which orders stores."""

from __future__ import annotations

from types import SimpleNamespace

from failstop.messages import segments
from failstop.shm import heartbeat, segment
from failstop.shm.heartbeat import BEAT_RUNNING, BEAT_STARTING, BEAT_STOPPING, Heartbeat, HeartbeatReader
from failstop.shm.words import Word

RUN = 3


def both(name: str) -> tuple[segment.Segment, HeartbeatReader]:
    segments.create(name, "gate", RUN).close()
    return segments.attach(name, "gate", RUN, write=True), HeartbeatReader(segments.attach(name, "gate", RUN))


def test_before_the_first_beat_nobody_runs(name: str) -> None:
    _, seen = both(name)
    assert heartbeat.STATES[seen.state.get()] == "absent"
    assert not seen.running(0)
    assert not seen.running(77)
    assert seen.age_ns(5_000) == 5_000


def test_beats(name: str) -> None:
    own, seen = both(name)
    beats = Heartbeat(own, 77, heartbeat.REALTIME | heartbeat.MEMORY_LOCKED, 1_000)
    assert (seen.pid.get(), seen.rights.get(), seen.state.get(), seen.ns.get()) == (77, 3, BEAT_STARTING, 1_000)
    assert not seen.running(77)
    beats.state(BEAT_RUNNING, 5_000)
    assert seen.running(77)
    assert not seen.running(78)
    for now_ns, worst_ns in [(5_001, 1), (5_050, 49), (5_060, 49)]:
        beats.beat(now_ns)
        assert (seen.ns.get(), seen.worst_ns.get()) == (now_ns, worst_ns), "a start that took long was no silence"
    assert seen.age_ns(5_100) == 40
    assert seen.age_ns(5_000) == 0
    beats.state(BEAT_STOPPING, 6_000)
    assert seen.ns.get() == 6_000
    assert not seen.running(77)


def test_a_successor_starts_anew(name: str) -> None:
    own, seen = both(name)
    beats = Heartbeat(own, 77, heartbeat.REALTIME, 1_000)
    beats.state(BEAT_RUNNING, 1_000)
    beats.beat(9_000)
    Heartbeat(own, 78, 0, 20_000)
    assert (seen.pid.get(), seen.state.get(), seen.rights.get(), seen.ns.get()) == (78, BEAT_STARTING, 0, 20_000)
    assert seen.worst_ns.get() == 0
    assert not seen.running(77)
    assert not seen.running(78)


def test_a_new_pid_is_never_seen_beside_its_predecessor_s_state(name: str) -> None:
    """The pid is published after everything that makes the old state untrue, the time last."""
    own, seen = both(name)
    beats = Heartbeat(own, 77, 0, 1_000)
    beats.state(BEAT_RUNNING, 1_000)
    beats.beat(9_000)
    order: list[int] = []

    class Recording(segment.Segment):
        def word(self, of: str) -> Word:
            place = self.spec.offsets[of]
            assert self.mapped is not None

            class Recorded(Word):
                def set(self, value: int) -> None:
                    super().set(value)
                    order.append(place)
                    assert not seen.running(78)

            return Recorded(self.mapped, place)

    Heartbeat(Recording(own.spec, own.incarnation, own.mapped), 78, 0, 20_000)
    names = [name for place in order for name, at in own.spec.offsets.items() if at == place]
    assert names.index("beat_pid") > names.index("beat_state")
    assert names[-1] == "beat_ns"
    assert set(names) == {record for record in own.spec.records if record.startswith("beat_")}


def test_a_barrier_releases_before_it_acquires(on: SimpleNamespace) -> None:
    """The other way around orders nothing: model/aarch64/barrier-control-reversed.litmus."""
    done = []

    class Lock:
        def acquire(self) -> None:
            done.append("acquire")

        def release(self) -> None:
            done.append("release")

    on.system["_thread"].allocate_lock = Lock
    barrier = on.load("failstop.shm.words").Barrier()
    assert done == ["acquire"], "held from the start"
    barrier()
    barrier()
    assert done[1:] == ["release", "acquire"] * 2

    class View:
        def __getitem__(self, where: slice) -> bytes:
            return bytes(where.stop - where.start)

        def __setitem__(self, where: slice, data: bytes) -> None:
            done.append("store")

    writer = on.load("failstop.shm.cell").RingWriter(View(), 0, 8, 2, 1)
    done.clear()
    writer.put(b"x")
    assert done == ["release", "acquire", "store"], "before what its entry's reader sees"
