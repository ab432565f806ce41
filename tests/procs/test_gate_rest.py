"""While nothing ramps the gate looks around at every other tick, and at those between only shows that it lives."""

from __future__ import annotations

from itertools import pairwise

import pytest

from failstop.messages import box, records
from tests.support.gate_scene import SESSION, Scene
from tests.support.stage import MS, Dummy

PERIOD_NS = 20 * MS
REFRESH_NS = 200 * MS
LID: dict[str, object] = {"interlocks.lid.timeout_s": 1.0, "interlocks.lid.refusal": "the lid is open"}


def made(*, watched: bool = True, **settings: object) -> Scene:
    """The gate with one client, of which it can watch the process or not."""
    scene = Scene(dict(settings), clients=0)
    scene.join(0, SESSION, "program", Dummy(scene.machine, "program").pid if watched else 0)
    scene.turn()
    return scene


def drive(scene: Scene, vx_mps: float, seconds: float) -> tuple[list[int], list[int], list[int]]:
    """Wake-ups in a while in which the client repeats a command: when each beat, when it looked around, and when a
    frame for the wheels was sent."""
    ring, beat = scene.own.ring_reader("box"), scene.own.word("beat_ns")
    beats, looks, sent = [], [], []
    scene.on_motion = lambda frame: sent.append(scene.clock())
    until_ns = scene.clock() + round(seconds * 1e9)
    while scene.clock() < until_ns:
        scene.command(vx_mps)
        scene.wake()
        assert beat.get() == scene.clock()
        beats.append(scene.clock())
        looks += [entry[1] for entry in iter(ring.next, None) if box.unpack_gate(entry[2])]
    return beats, looks, sent


def most_apart_ns(times: list[int]) -> int:
    return max(after - before for before, after in pairwise(times))


def test_a_steady_drive_is_looked_after_at_every_other_tick_and_its_lease_at_each() -> None:
    scene = made()
    assert scene.ask(records.ENABLE)[0] == records.DONE
    drive(scene, 0.2, 1.0)
    beats, looks, sent = drive(scene, 0.2, 2.0)
    assert most_apart_ns(beats) <= PERIOD_NS
    assert most_apart_ns(looks) == 2 * PERIOD_NS
    assert len(looks) <= 0.6 * len(beats)
    assert REFRESH_NS <= most_apart_ns(sent) <= REFRESH_NS + PERIOD_NS
    for _ in range(2):
        scene.ask_for(records.ENABLE)
        scene.clients[0].ring()
        scene.wake()
        assert scene.answered()[0] == records.DONE, "news is heard at a beat too"
    scene.command(-0.2)
    scene.turn()
    _, looks, sent = drive(scene, -0.2, 0.2)
    assert most_apart_ns(looks) == most_apart_ns(sent) == PERIOD_NS, "a ramp needs each of them"


@pytest.mark.parametrize(
    ("watched", "settings"), [(False, {}), (True, LID)], ids=["a claim alone tells of its death", "an interlock"]
)
def test_what_is_told_by_no_bell_is_looked_for_at_each_tick(watched: bool, settings: dict[str, object]) -> None:
    assert most_apart_ns(drive(made(watched=watched, **settings), 0.2, 0.5)[1]) == PERIOD_NS


def test_without_a_client_it_sleeps_for_two_ticks_and_says_so_until_one_comes() -> None:
    scene = Scene(clients=0)
    busy, bell, slept_ns = scene.own.word("busy"), scene.bell("supervisor_bell"), []
    for _ in range(20):
        slept_ns.append(scene.gate.loop.due_ns() - scene.clock())
        scene.run(max(0.0, slept_ns[-1] / 1e9) or 0.001)
    assert set(slept_ns[4:]) == {2 * PERIOD_NS}
    assert not busy.get()
    bell.clear()
    scene.join(0, SESSION, "program")
    scene.turn()
    assert busy.get()
    assert scene.gate.loop.readable(bell.fd), "a lease needs the supervisor's own ticks to be shorter now"
