"""The black box: what is sampled, when a saver is started and with what, and what is told of its end."""

from __future__ import annotations

import os
from typing import Any

import msgpack
import pytest

from failstop.messages import box, layout
from failstop.supervisor.blackbox import (
    FINISH_S,
    GIVE_UP_NS,
    MOST_SAVERS,
    MOST_STOPS_WAITING,
    PATIENCE_NS,
    SAMPLE_NS,
    START_NS,
    STEP,
    TOO_OFTEN,
)
from failstop_lab.machine.kernel import TAKEDOWN_NS
from failstop_lab.machine.process import Process
from tests.support.stage import MS
from tests.support.supervisor_scene import Scene
from tests.support.why import why

T0 = 10**12
"""The machine's time at first."""
CAUSE = why("gate died")
KEPT: dict[str, object] = {"incidents.keep": 7, "incidents.max_mb": 8}


@pytest.fixture
def scene() -> Scene:
    """Its savers wait to be killed."""
    made = Scene(settings=KEPT)
    made.machine.programs["saver.py"] = made.wait
    return made


def latched(scene: Scene, epoch: int) -> None:
    """A stop is latched, at first."""
    scene.supervisor.blackbox.latched(scene.made_stop(CAUSE, layout.GATE, T0), epoch)


def follow(scene: Scene, t_ns: int = T0, *, ready: bool = True) -> None:
    scene.supervisor.blackbox.poll(t_ns, ready=ready)


def savers(scene: Scene) -> list[dict[str, str]]:
    """The words on the command line of each that was started."""
    return [words(process) for process in scene.born]


def words(saver: Process) -> dict[str, str]:
    return dict(word.split("=", 1) for word in saver.argv[1:])


def socket(saver: Process) -> Any:
    """Its end of the socket to the supervisor."""
    found = words(saver)
    assert found["hurry"] == found["result"]
    return saver.files[int(found["hurry"])]


def hastened(saver: Process) -> bool:
    """It is to copy now."""
    ended: bool = socket(saver).node.ended
    return ended


def ends(scene: Scene, saver: Process, said: bytes = msgpack.packb({"id": "0012"}), code: int = 0) -> None:
    """It says a word and ends, and a turn later that is known."""
    socket(saver).node.send(said)
    scene.machine.die(saver, code)
    scene.now_ns += TAKEDOWN_NS
    follow(scene)


def sampled(scene: Scene) -> list[list[tuple[float, float]]]:
    """Of each sample since the last call: each process's longest silence in ms, and how long before that was seen."""
    return [[(a / 1e3, b / 1e3) for a, b in box.unpack_beats(record)] for _, record in scene.boxed()]


def test_the_longest_silence_of_each_process_is_sampled_ten_times_a_second(scene: Scene) -> None:
    beats = {name: own.word("beat_ns") for name, own in scene.own.items()}
    beats[layout.SUPERVISOR].set(0)
    follow(scene)
    assert sampled(scene) == [[(0.0, 0.0)] * len(layout.PROCESS_NAMES)], "nobody has beaten yet"
    for elapsed_ms in (20, 90):
        follow(scene, T0 + elapsed_ms * MS)
        beats[layout.GATE].set(T0 + elapsed_ms * MS)
    beats[layout.SUPERVISOR].set(T0 + 95 * MS)
    follow(scene, T0 + SAMPLE_NS - 1)
    assert sampled(scene) == []
    beats[layout.STOPPER].set(T0 + 60 * MS)
    follow(scene, T0 + SAMPLE_NS)
    ((t_ns, record),) = scene.boxed()
    assert t_ns == T0 + SAMPLE_NS
    found = [(a / 1e3, b / 1e3) for a, b in box.unpack_beats(record)]
    assert dict(zip(layout.PROCESS_NAMES, found, strict=True)) == {
        "supervisor": (5.0, 0.0),
        "port_owner": (0.0, 0.0),
        "gate": (70.0, 10.0),
        "telemetry": (0.0, 0.0),
        "stopper": (40.0, 0.0),
    }


def test_a_burst_of_the_supervisor_s_own_is_in_it(scene: Scene) -> None:
    written_ns = T0 - 7
    scene.supervisor.blackbox.wrote(written_ns)
    assert scene.boxed() == [(written_ns, box.OWN_BURST_RECORD)], "as of when it was written"


def test_a_saver_is_started_a_while_after_a_latched_stop(scene: Scene) -> None:
    latched(scene, 7)
    assert [t_ns for t_ns, _ in scene.boxed()] == [T0], "a sample at once: what led to it"
    follow(scene, T0 + START_NS - 1)
    assert scene.born == []
    for times in (1, 2):
        follow(scene, T0 + times * START_NS)
    (saver,) = scene.born
    given = words(saver)
    listed = ",".join(f"{process}:{fd}" for process, fd in scene.run.readable.items())
    expected = {"name": "stage", "keep": "7", "max_mb": "8", "fds": listed, "cause": CAUSE.pack().hex()}
    assert given.items() >= {**expected, "cause_ns": str(T0), "epoch": "7", "until_ns": str(T0 + box.COPY_NS)}.items()
    assert int(given["offset_ns"]) == scene.machine.unix_ns + scene.machine.slept_ns
    assert saver.argv[0].endswith("/incidents/saver.py")
    assert saver.environ == scene.load("failstop.supervisor.starter").environment(scene.settings)
    assert set(saver.files) == {0, 1, 2, int(given["hurry"]), *scene.run.readable.values()}


@pytest.mark.parametrize(("after_s", "copied_s"), [(0.2, 2.2), (1.5, 2.2), (3.0, 3.7), (60.0, 15.0)])
def test_the_saver_copies_once_the_verdict_about_the_wheels_is_known(after_s: float, copied_s: float) -> None:
    scene = Scene(settings={"still.after_s": after_s})
    scene.machine.programs["saver.py"] = scene.wait
    latched(scene, 7)
    follow(scene, T0 + START_NS)
    assert [int(given["until_ns"]) for given in savers(scene)] == [T0 + round(copied_s * 1e9)]


def test_the_black_box_starts_few_savers_at_one_time_and_the_rest_as_these_end(scene: Scene) -> None:
    latched(scene, 7)
    follow(scene, T0 + START_NS)
    for epoch in range(8, 18):
        latched(scene, epoch)
    for _ in range(20):
        follow(scene, T0 + START_NS)
    assert [given["epoch"] for given in savers(scene)] == ["7", "8", "9", "10"]
    for done in range(7):
        scene.machine.die(scene.born[done], 0)
        scene.now_ns += TAKEDOWN_NS
        for _ in range(2):
            follow(scene, T0 + START_NS)
        assert len(scene.born) == done + 1 + MOST_SAVERS
    assert [given["epoch"] for given in savers(scene)] == [str(epoch) for epoch in range(7, 18)], "each has one"


def test_a_saver_that_is_on_time_does_not_wait_for_the_robot_to_rest(scene: Scene) -> None:
    scene.own[layout.PORT_OWNER].word("moving").set(1)
    latched(scene, 7)
    follow(scene, T0 + 2 * START_NS)
    assert [given["epoch"] for given in savers(scene)] == ["7"]


def test_a_late_saver_waits_until_nothing_moves(scene: Scene) -> None:
    moving = scene.own[layout.PORT_OWNER].word("moving")
    for epoch in range(7, 12):
        latched(scene, epoch)
    for _ in range(10):
        follow(scene, T0 + START_NS)
    ends(scene, scene.born[0])
    moving.set(1)
    follow(scene, T0 + 2 * START_NS + 1)
    assert len(scene.born) == MOST_SAVERS
    moving.set(0)
    follow(scene, T0 + 2 * START_NS + 2)
    assert savers(scene)[-1]["epoch"] == "11"


def test_a_stop_that_gets_no_file_gets_a_word(scene: Scene) -> None:
    for epoch in range(7, 7 + MOST_STOPS_WAITING + 1):
        latched(scene, epoch)
    why, step = f"{MOST_STOPS_WAITING} earlier stops still wait to be saved", TOO_OFTEN
    assert scene.said() == [lost(why, step)]
    for _ in range(20):
        follow(scene, T0 + START_NS)
    follow(scene, T0 + START_NS + GIVE_UP_NS)
    assert scene.said() == [], "not yet"
    for _ in range(20):
        follow(scene, T0 + START_NS + GIVE_UP_NS + 1)
    driven = lost("too many stops at once, and then the robot drove again", TOO_OFTEN)
    assert scene.said() == [driven] * (MOST_STOPS_WAITING - MOST_SAVERS)
    for epoch in range(30, 32):
        latched(scene, epoch)
    scene.supervisor.blackbox.finish()
    waiting = lost("the service ended while earlier stops were being saved", TOO_OFTEN)
    assert scene.said() == [waiting] * 2 + [lost(LEFT)] * MOST_SAVERS
    assert len(scene.born) == MOST_SAVERS


def test_the_black_box_saves_nothing_where_that_is_off() -> None:
    scene = Scene(settings={"incidents.save": "off"})
    latched(scene, 7)
    left_behind(scene, len(layout.PROCESS_NAMES))
    scene.supervisor.blackbox.begin()
    follow(scene, T0 + START_NS)
    assert scene.born == []


SAVED = ("incident", "notice", "incident 0012 saved; next: `failstop incident show 0012 --name stage`", {"id": "0012"})


LEFT = "the service ended while it was being written, so the file may be missing"


def lost(why: str, step: str = STEP) -> tuple[str, str, str, dict[str, Any]]:
    """The event that tells of an incident which was not saved."""
    return "incident", "warning", f"incident not saved: {why}; next: {step}", {"reason": f"{why}; next: {step}"}


@pytest.mark.parametrize(
    ("said", "code", "told"),
    [
        ({"id": "0012"}, 0, [SAVED]),
        ({"id": "0012"}, 3, [lost("the saver ended with code 3")]),
        ({}, 0, []),
        ({}, 3, [lost("the saver ended with code 3")]),
        ({"wrong": "no room\n"}, 1, [lost("no room?")]),
        ({"wrong": 7}, 1, [lost("7")]),
        (b"\xff", 1, [lost("the saver ended with code 1")]),
        (["id"], 0, [lost("the saver ended with code 0")]),
        (b"", 3, [lost("the saver ended with code 3")]),
        (b"", 0, [lost("the saver ended with code 0")]),
        (b"", -9, [lost("the saver was killed by signal 9")]),
    ],
)
def test_people_are_told_how_a_saver_ended(scene: Scene, said: object, code: int, told: list[Any]) -> None:
    latched(scene, 7)
    follow(scene, T0 + START_NS)
    ends(scene, scene.born[0], said if isinstance(said, bytes) else msgpack.packb(said), code)
    assert scene.said() == told


def test_a_saver_that_can_not_be_started_leaves_nothing_open(scene: Scene) -> None:
    scene.refuse("spawn", OSError(11, "Resource temporarily unavailable"))
    before = scene.fds()
    latched(scene, 7)
    follow(scene, T0 + START_NS)
    assert scene.fds() == before
    assert scene.said() == [lost("cannot start the saver: [Errno 11] Resource temporarily unavailable")]


def test_the_supervisor_closes_what_a_saver_had_and_does_not_wait_for_its_word(scene: Scene) -> None:
    before = scene.fds()
    latched(scene, 7)
    follow(scene, T0 + START_NS)
    (saver,) = scene.born
    assert len(scene.fds()) == len(before) + 1
    socket(saver).references += 1  # another process has it too
    scene.machine.die(saver, 0)
    scene.now_ns += TAKEDOWN_NS
    follow(scene)
    assert scene.fds() == before
    assert scene.said() == [lost("the saver ended with code 0")]


def left_behind(scene: Scene, count: int) -> list[int]:
    """Segments of a dead run."""
    fds = [scene.os.dup(0) for _ in range(count)]
    scene.run.left = dict(zip(layout.PROCESS_NAMES, fds, strict=False))
    return fds


def test_a_dead_run_s_saver_copies_and_takes_processor_time_when_this_run_is_ready(scene: Scene) -> None:
    fds = left_behind(scene, len(layout.PROCESS_NAMES))
    scene.supervisor.blackbox.begin()
    (given,) = savers(scene)
    assert given["until_ns"] == str(T0 + PATIENCE_NS)
    assert given["fds"] == ",".join(f"{process}:{fd}" for process, fd in zip(layout.PROCESS_NAMES, fds, strict=True))
    assert not scene.fds() & set(fds), "they are the saver's now"
    latched(scene, 7)
    follow(scene, T0 + START_NS, ready=False)
    dead, live = scene.born
    assert not hastened(dead)
    follow(scene, T0 + START_NS)
    assert hastened(dead)
    assert not hastened(live)
    follow(scene, T0 + START_NS)
    assert not hastened(live)


def test_a_dead_run_s_saver_that_is_killed_costs_nothing_but_the_incident(scene: Scene) -> None:
    """As the one process that the kernel takes when memory is short."""
    left_behind(scene, len(layout.PROCESS_NAMES))
    scene.supervisor.blackbox.begin()
    scene.machine.die(scene.born[0], -9)
    scene.now_ns += TAKEDOWN_NS
    for ready in (False, True):
        follow(scene, ready=ready)
    kind, level, text, fields = lost("the saver was killed by signal 9")
    assert scene.said() == [(kind, level, text, {**fields, "run": "before"})]


def test_a_dead_run_whose_incident_could_not_be_saved_is_named(scene: Scene) -> None:
    left_behind(scene, len(layout.PROCESS_NAMES))
    scene.supervisor.blackbox.begin()
    follow(scene)
    ends(scene, scene.born[0], msgpack.packb({"wrong": "no room", "ended": "supervisor died"}), 1)
    ((kind, level, text, fields),) = scene.said()
    assert (kind, level) == ("incident", "warning")
    assert text.startswith("incident not saved: no room")
    assert (fields["run"], fields["ended"]) == ("before", "supervisor died")


def test_a_dead_run_that_is_not_whole_is_not_saved(scene: Scene) -> None:
    fds = left_behind(scene, len(layout.PROCESS_NAMES) - 1)
    scene.supervisor.blackbox.begin()
    assert scene.born == []
    assert not scene.fds() & set(fds)


def test_the_end_of_the_service_saves_at_once_what_waits(scene: Scene) -> None:
    def saves(process: Process, argv: list[str]) -> int:
        fd = int(words(process)["hurry"])
        scene.system["select"].select([fd], [], [])
        scene.os.write(fd, msgpack.packb({"id": "0012"}))
        return 0

    scene.machine.programs["saver.py"] = saves
    latched(scene, 7)
    latched(scene, 8)
    scene.supervisor.blackbox.finish()
    assert [given["epoch"] for given in savers(scene)] == ["7", "8"]
    assert [event["text"] for event in scene.events()] == [SAVED[2]] * 2, "and told of"
    assert scene.now_ns < T0 + 100 * MS, "nothing else is waited for"


def test_the_end_hastens_each_saver_without_a_descriptor_to_wait_with(scene: Scene) -> None:
    for epoch in (7, 8):
        latched(scene, epoch)
        follow(scene, T0 + START_NS)
    scene.refuse("pidfd_open", OSError(24, os.strerror(24)))
    scene.supervisor.blackbox.finish()
    assert list(map(hastened, scene.born)) == [True, True]


def test_the_end_of_the_service_does_not_wait_for_a_saver_that_hangs(scene: Scene) -> None:
    for epoch in (7, 8):
        latched(scene, epoch)
    scene.supervisor.blackbox.finish()
    assert scene.now_ns == T0 + round(FINISH_S * 1e9), "for all of them together"
    assert list(map(hastened, scene.born)) == [True, True]
    assert scene.said() == [lost(LEFT)] * 2
    for saver in scene.born:
        ends(scene, saver)
    assert scene.said() == [SAVED] * 2
