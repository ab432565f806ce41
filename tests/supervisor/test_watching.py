"""The supervisor and processes that really die or fall silent: what it writes, kills, lets go and passes on."""

from __future__ import annotations

import os
import select
import signal
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import msgpack
import pytest

from failstop.board.burst import BURST
from failstop.policy import causes
from failstop.policy.processes import BY_NAME
from failstop.policy.settings import Settings
from failstop.procs import starved
from failstop.procs.loop import GONE, NEVER
from failstop.shm import heartbeat, layout, records, segment
from failstop.shm.heartbeat import STARTING
from failstop.shm.lifeline import pid_namespace
from failstop.shm.packing import pack
from failstop.supervisor import main
from failstop.supervisor import process_table as table_module
from failstop.supervisor.children import DEAD, DIED, KILLED, RUNNING, STARTING_NS, Fence
from failstop.supervisor.main import EXCUSE_NS, HELD_UP_NS, LATE_NS, TICK_NS, Supervisor
from failstop.supervisor.port import OwnPort
from failstop.supervisor.process_table import GATE_AGAIN_NS, STARVED_SHOWN_NS
from failstop.supervisor.status import TELL_EVERY_NS, Notify
from tests.support.supervisor_scene import MS
from tests.support.waiting import until
from tests.support.watching_scene import Watching

NOT_STARVED: dict[str, object] = {"starved": None, "starved_times": 0}


def shown(process: str, longest_ms: int, times: int) -> dict[str, object]:
    return {"starved": {"longest_ms": longest_ms, "process": process}, "starved_times": times}


def missing(supervisor: Supervisor) -> str:
    """What motion waits for."""
    return supervisor.status.missing(stopping=supervisor._unanswered is not None)


@pytest.fixture
def watching(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Watching]:
    made = Watching(tmp_path, monkeypatch)
    yield made
    made.close()


class Noted:
    """A word whose setting is noted."""

    def __init__(self, order: list[str], real_set: Callable[[int], None]) -> None:
        self.order, self.real_set = order, real_set

    def set(self, value: int) -> None:
        self.order.append("epoch")
        self.real_set(value)


def test_the_port_owner_s_death_is_answered_first_on_its_own_descriptor(
    watching: Watching, monkeypatch: pytest.MonkeyPatch
) -> None:
    order: list[str] = []
    real_burst, real_set = watching.port.burst, watching.supervisor.epochs._epoch_word.set
    monkeypatch.setattr(OwnPort, "burst", lambda _: (order.append("burst"), real_burst())[1])
    monkeypatch.setattr(watching.supervisor.epochs, "_epoch_word", Noted(order, real_set))
    watching.employ(layout.PORT_OWNER).kill()
    until(lambda: watching.supervisor.loop.wait(0), "the news of the death")
    watching.supervisor._tried_ns = watching.now_ns  # no zeros of its own just now
    assert watching.pass_time(0) == BURST
    assert order == ["burst", "epoch"], "nothing comes before the burst"
    assert watching.word("written_ns").get() == watching.now_ns
    assert watching.told() == {"reason": "port_owner died", "written_by": "supervisor", "written_us": 0.0}


def test_who_is_to_answer_an_epoch_is_woken(watching: Watching) -> None:
    watching.rung(layout.PORT_OWNER), watching.rung(layout.GATE)
    watching.gate_stops()
    watching.turn()
    assert watching.rung(layout.PORT_OWNER)
    assert watching.rung(layout.GATE)


@pytest.mark.parametrize("name", list(BY_NAME))
def test_who_is_silent_for_its_deadline_is_killed_first_and_the_port_owner_answered_for(
    watching: Watching, name: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    order: list[str] = []
    real_burst = watching.port.burst
    dummy = watching.employ(name)
    watching.world.play("kill", lambda pid, number: (order.append("kill"), os.kill(pid, number)))
    monkeypatch.setattr(OwnPort, "burst", lambda _: (order.append("burst"), real_burst())[1])
    watching.supervisor._tried_ns = watching.now_ns + BY_NAME[name].deadline_ns  # no zeros of its own just now
    watching.supervisor._turned_ns = watching.now_ns + BY_NAME[name].deadline_ns - MS  # it was not held up itself
    watching.pass_time(BY_NAME[name].deadline_ns - 1)
    assert order == []
    watching.pass_time(1)
    assert order[:2] == (["kill", "burst"] if name == layout.PORT_OWNER else ["kill"])
    assert watching.supervisor.epoch == 2
    deadline_ms = BY_NAME[name].deadline_ns // MS
    assert watching.cause()[1] == f"{name} hangs: {deadline_ms} ms silent"
    found = watching.supervisor.processes[name].fence
    assert found
    assert found.fields()["silent_ms"] == deadline_ms
    until(lambda: os.waitid(os.P_PID, dummy.pid, os.WEXITED | os.WNOWAIT | os.WNOHANG), "its end")


def fence(watching: Watching, name: str) -> None:
    """A process hangs, is killed for it, and the news of its death is there."""
    watching.employ(name)
    watching.supervisor._turned_ns = watching.now_ns + BY_NAME[name].deadline_ns - MS  # it was not held up itself
    watching.pass_time(BY_NAME[name].deadline_ns)
    until(lambda: watching.supervisor.loop.wait(0), "the news of the death")
    watching.events()


def fenced(watching: Watching) -> dict[str, Any]:
    """What was told of it."""
    (found,) = (event for event in watching.events() if event["kind"] == "fenced")
    return found


def test_a_fenced_port_owner_is_stopped_for_again_when_it_is_gone_before_anything_else(
    watching: Watching, monkeypatch: pytest.MonkeyPatch
) -> None:
    """What it had begun to write as it was killed may have come after the first burst."""
    fence(watching, layout.PORT_OWNER)
    order: list[str] = []
    real_burst, real_set = watching.port.burst, watching.supervisor.epochs._epoch_word.set
    monkeypatch.setattr(OwnPort, "burst", lambda _: (order.append("burst"), real_burst())[1])
    monkeypatch.setattr(watching.supervisor.epochs, "_epoch_word", Noted(order, real_set))
    assert watching.pass_time(MS) == BURST
    assert order == ["burst", "epoch"]
    told = fenced(watching)
    assert told["text"] == (
        "port_owner was fenced: killed after 0.0 ms, stop written after 0.0 ms, "
        "gone after 1.0 ms, stop again after 1.0 ms"
    )
    assert (told["fields"]["gone_us"], told["fields"]["again_us"]) == (1000.0, 1000.0)


def test_a_stop_that_nobody_wrote_is_not_told_of(watching: Watching) -> None:
    """The first burst after the fence was written, the second could not be, and zeros that were only tried are none."""
    fence(watching, layout.PORT_OWNER)
    watching.port.close()
    assert watching.pass_time(MS) == b""
    assert fenced(watching)["text"] == (
        "port_owner was fenced: killed after 0.0 ms, stop written after 0.0 ms, gone after 1.0 ms"
    )


def test_of_another_that_was_fenced_no_stop_is_told_though_one_was_written_since(watching: Watching) -> None:
    fence(watching, layout.GATE)
    watching.supervisor._burst()
    watching.pass_time(MS)
    assert fenced(watching)["text"] == "gate was fenced: killed after 0.0 ms, gone after 1.0 ms"


def test_of_two_that_were_fenced_together_the_stop_is_the_port_owner_s(watching: Watching) -> None:
    watching.employ(layout.GATE)
    fence(watching, layout.PORT_OWNER)
    gate = watching.supervisor.processes[layout.GATE]
    gate.fence = Fence(watching.now_ns, watching.now_ns, 0)
    gate.on(KILLED)
    os.kill(gate.pid, signal.SIGKILL)
    assert gate.life
    assert gate.life.wait(20.0)
    watching.pass_time(MS)
    stories = {event["fields"]["process"]: event["text"] for event in watching.events() if event["kind"] == "fenced"}
    assert stories[layout.PORT_OWNER].endswith("gone after 1.0 ms, stop again after 1.0 ms")
    assert stories[layout.GATE].endswith("gone after 1.0 ms")


def test_the_death_of_another_is_no_stop_that_was_written(watching: Watching) -> None:
    watching.employ(layout.GATE).kill()
    until(lambda: watching.supervisor.loop.wait(0), "the news of the death")
    watching.supervisor._tried_ns = watching.now_ns  # no zeros of its own just now
    assert watching.pass_time(0) == BURST
    assert watching.told() == {"reason": "gate died", "written_by": "supervisor", "written_us": 0.0}
    assert watching.word("written_ns").get() == watching.now_ns


def test_a_ring_wakes_it_once(watching: Watching) -> None:
    for bell in (watching.run.bells[layout.SUPERVISOR], watching.supervisor.processes.early.bell):
        bell.ring()
        assert bell.fd in watching.supervisor.loop.wait(0)
        watching.pass_time(0)
        assert watching.supervisor.loop.wait(0) == {}


def test_while_no_port_owner_runs_the_stop_is_written_five_times_a_second(watching: Watching) -> None:
    watching.employ(layout.PORT_OWNER).kill()
    until(lambda: watching.supervisor.loop.wait(0), "the news of the death")
    assert watching.pass_time(0) == BURST
    written = [watching.pass_time(20 * MS).count(BURST) for _ in range(100)]
    assert sum(written) == 10
    assert set(written) == {0, 1}


def test_one_that_was_held_up_stops_motion_and_kills_nobody(watching: Watching) -> None:
    for name in BY_NAME:
        watching.employ(name)
    watching.supervisor.status.ever = True
    watching.enabled()
    watching.pass_time(HELD_UP_NS)
    assert watching.supervisor.epoch == 2
    cause = watching.supervisor.epochs._latch_record
    entry = segment.attach(watching.run.memory, layout.SUPERVISOR).latest_reader("latch").read()
    assert cause is not None
    assert entry is not None
    assert str(causes.read(records.LATCH.unpack(entry[2])[3])) == "supervisor was held up for 250 ms"
    assert not any(child.fence for child in watching.supervisor.children)


@pytest.mark.parametrize(
    ("gap_ns", "was_ready", "excused", "epoch"),
    [
        (EXCUSE_NS - 1, True, False, 1),
        (EXCUSE_NS, True, True, 1),
        (HELD_UP_NS - 1, True, True, 1),
        (HELD_UP_NS, False, True, 1),
        (HELD_UP_NS, True, True, 2),
    ],
)
def test_from_when_on_it_was_held_up(
    watching: Watching, gap_ns: int, was_ready: bool, excused: bool, epoch: int
) -> None:
    watching.employ(layout.TELEMETRY)
    watching.supervisor.status.ever = was_ready
    watching.enabled()
    watching.pass_time(0)
    watching.pass_time(gap_ns)
    assert (watching.supervisor.processes[layout.TELEMETRY].excused_ns == watching.now_ns) is excused
    assert watching.supervisor.epoch == epoch


@pytest.mark.parametrize("gap_ns", [EXCUSE_NS, HELD_UP_NS])
def test_one_that_was_suspended_knows_what_others_take_for_a_hang(watching: Watching, gap_ns: int) -> None:
    watching.supervisor.status.ever = True
    watching.enabled()
    watching.pass_time(0)
    watching.world.play("continued", lambda: True)
    for process in (watching.port_owner, watching.gate):
        cause = causes.HANGS(layout.SUPERVISOR, 61).pack()
        process.ring_writer("stops").put(records.STOPPED.pack(1, watching.now_ns + 61 * MS, 0, cause))
    watching.pass_time(gap_ns)
    latched = watching.supervisor.epochs.latch.stop
    assert latched is not None
    assert latched.cause == causes.SUPERVISOR_SUSPENDED(gap_ns / 1e9)
    watching.pass_time(MS)
    watching.supervisor._events.flush()
    told = [event["kind"] for event in watching.events()]
    assert "stop_also" not in told, "all three are one cause"
    assert "starved" not in told


def test_one_that_was_suspended_while_nothing_could_move_tells_of_that(watching: Watching) -> None:
    watching.supervisor.status.ever = True
    watching.pass_time(0)
    watching.world.play("continued", lambda: True)
    watching.pass_time(HELD_UP_NS)
    watching.supervisor._events.flush()
    (event,) = watching.events()
    assert (event["kind"], event["text"]) == ("suspended", "supervisor was suspended for 0.2 s by a signal")
    assert event["fields"] == {"silent_ms": 250}
    assert watching.supervisor.processes.starved_record() == NOT_STARVED
    assert watching.supervisor.epoch == 1


def test_what_it_was_continued_for_without_a_gap_explains_none(watching: Watching) -> None:
    watching.supervisor.status.ever = True
    watching.enabled()
    watching.pass_time(0)
    watching.notice("supervisor hangs: 61 ms silent")
    watching.world.play("continued", lambda: True)
    watching.pass_time(EXCUSE_NS - 1)
    assert watching.supervisor.epochs.latch.stop is not None
    assert watching.supervisor.epochs.latch.stop.cause.kind is not causes.SUPERVISOR_SUSPENDED


def test_a_death_that_the_port_owner_has_noticed_too_is_one_cause(watching: Watching) -> None:
    supervisor, gate = watching.supervisor, watching.supervisor.processes[layout.GATE]
    watching.notice("gate died", written_ns=watching.now_ns + 7)
    for noticed_by, written_ns in ((layout.PORT_OWNER, watching.now_ns + 7), (layout.SUPERVISOR, 5)):
        gate.state = RUNNING
        (stop,) = supervisor._collect([gate], watching.now_ns, 5)
        assert (stop.t_ns, stop.noticed_by, str(stop.cause)) == (watching.now_ns, noticed_by, "gate died")
        assert stop.written_ns == written_ns
        assert gate.state == DEAD


def test_its_own_beat_tells_the_epoch_that_it_has_raised(watching: Watching) -> None:
    watching.gate_stops()
    watching.pass_time(MS)
    assert watching.word("beat_ns").get() == watching.now_ns
    assert watching.word("beat_epoch").get() == watching.supervisor.epoch == 2


def test_one_that_was_held_up_while_nothing_could_move_only_tells(watching: Watching) -> None:
    for name in BY_NAME:
        watching.employ(name)
    watching.supervisor.status.ever = True
    watching.enabled(epoch=7)  # long ago: another stop has ended it
    watching.pass_time(HELD_UP_NS)
    assert watching.supervisor.epoch == 1
    assert watching.starved() == [("supervisor", 250, 1)]
    assert not any(child.fence for child in watching.supervisor.children)


SPARED = [name for name in BY_NAME if name != layout.PORT_OWNER]


@pytest.fixture
def starving(watching: Watching, monkeypatch: pytest.MonkeyPatch) -> Watching:
    """Every process runs, and whoever is silent is starved."""
    for name in BY_NAME:
        watching.employ(name)
    watching.supervisor.status.ever = True
    watching.world.play("starved", lambda *_: True)
    return watching


def test_who_is_starved_while_motion_is_disabled_is_left_alone_until_it_beats(starving: Watching) -> None:
    supervisor = starving.supervisor
    starving.port_open()
    segment.attach(starving.run.memory, layout.STOPPER, write=True).word("port_number").set(1)
    starving.answers()
    for _ in range(40):
        starving.pass_time(20 * MS)
    assert (supervisor.epoch, starving.word("ready").get()) == (1, 0)
    assert not any(child.fence for child in supervisor.children)
    assert missing(supervisor) == ", ".join(BY_NAME)
    assert not supervisor._listening(starving.now_ns), "nobody hears the board"
    for beat in starving.beats.values():
        beat.set(starving.now_ns)
    for _ in range(2):
        starving.pass_time(0)
    assert missing(supervisor) == ""
    assert starving.starved() == [("port_owner", 800, 1)], "one for all of ten seconds"
    assert supervisor.processes.starved_record() == shown("port_owner", 800, 4)


@pytest.mark.parametrize("name", SPARED)
def test_who_is_starved_while_motion_is_enabled_is_stopped_for_once_and_left_alone(
    starving: Watching, name: str
) -> None:
    starving.enabled()
    child = starving.supervisor.processes[name]
    while starving.supervisor.epoch == 1:
        starving.beat_but(name)
    _, standing = starving.cause()
    assert standing == f"{name} hangs: {child.row.deadline_ns // MS} ms silent (the machine is starved)"
    for _ in range(80):
        starving.beat_but(name)
    assert starving.supervisor.epoch == 2, "it is disabled now"
    assert not child.fence


@pytest.mark.parametrize("sign", ["enabled", "moving"])
def test_a_starved_port_owner_is_fenced_while_it_may_move(starving: Watching, sign: str) -> None:
    if sign == "enabled":
        starving.enabled()
    else:
        starving.port_owner.word("moving").set(1)
    port_owner = starving.supervisor.processes[layout.PORT_OWNER]
    for _ in range(10):
        starving.beat_but(layout.PORT_OWNER)
    assert port_owner.fence
    assert "burst_us" in port_owner.fence.fields()
    _, standing = starving.cause()
    assert standing == "port_owner hangs: 100 ms silent (the machine is starved)"


def test_nobody_is_spared_for_ever_and_none_is_down_for_it(starving: Watching) -> None:
    processes = starving.supervisor.processes
    for _ in range(6):
        starving.employ(layout.TELEMETRY)
        processes[layout.TELEMETRY].restart.set(NEVER)
        turns = 0
        while not processes[layout.TELEMETRY].fence:
            starving.beat_but(layout.TELEMETRY)
            turns += 1
        deadline_ns = BY_NAME[layout.TELEMETRY].deadline_ns
        assert starved.LONGEST_NS <= turns * 10 * MS - deadline_ns <= starved.LONGEST_NS + deadline_ns
        until(lambda: starving.supervisor.loop.wait(0), "the news of its death")
        starving.pass_time(0)
        assert processes[layout.TELEMETRY].state == "waiting"


def test_who_has_just_beaten_after_all_is_left_alone(watching: Watching, monkeypatch: pytest.MonkeyPatch) -> None:
    watching.employ(layout.GATE)
    watching.world.play("starved", lambda *_: watching.gate.word("beat_ns").set(watching.now_ns))
    for _ in range(30):
        watching.pass_time(20 * MS)
    assert (watching.supervisor.epoch, watching.supervisor.processes.starved_record()) == (1, NOT_STARVED)


def die_too_often(watching: Watching, name: str) -> None:
    child = watching.supervisor.processes[name]
    while child.state != "down":
        child.restart.set(NEVER)
        watching.employ(name).kill()
        until(lambda: watching.supervisor.loop.wait(0), "the news of the death")
        watching.pass_time(0)


@pytest.mark.parametrize("name", SPARED)
def test_a_reset_starts_one_anew_that_is_down(watching: Watching, name: str, monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[str] = []
    die_too_often(watching, name)
    child = watching.supervisor.processes[name]
    monkeypatch.setattr(
        table_module.ProcessTable, "start", lambda _, found: (started.append(name), found.restart.set(NEVER))
    )
    watching.answers(written_ns=watching.now_ns)
    watching.ask_reset(1)
    for _ in range(10):
        watching.pass_time(20 * MS)
    assert (started, child.state) == ([], "down"), "a reset from before it was down is not for it"
    watching.ask_reset()
    watching.pass_time(20 * MS)
    assert started == [name]
    watching.employ(name).kill()
    until(lambda: watching.supervisor.loop.wait(0), "the news of the death")
    watching.pass_time(0)
    assert child.state == "waiting", "its deaths from before the reset are forgotten"


def test_a_gate_that_is_down_is_tried_again_since_it_hears_the_resets(
    watching: Watching, monkeypatch: pytest.MonkeyPatch
) -> None:
    started: list[int] = []
    die_too_often(watching, layout.GATE)
    down_ns = watching.now_ns
    text = watching.events()[-1]["text"]
    assert text.endswith("; it is restarted in 60 s, since nobody else could hear a reset")
    monkeypatch.setattr(
        table_module.ProcessTable,
        "start",
        lambda _, child: (started.append(watching.now_ns), child.restart.set(NEVER)),
    )
    while not started and watching.now_ns < down_ns + 2 * GATE_AGAIN_NS:
        assert watching.supervisor.processes[layout.GATE].state == "down"
        watching.pass_time(200 * MS)
    assert started == [down_ns + GATE_AGAIN_NS]


def test_not_ready_before_the_stop_is_answered_and_its_own_port_is_open(watching: Watching) -> None:
    for name in BY_NAME:
        watching.employ(name)
    watching.port_open()
    stopper = segment.attach(watching.run.memory, layout.STOPPER, write=True)
    stopper.word("port_number").set(1)
    watching.answers()
    watching.turn()
    assert watching.word("ready").get() == 1
    watching.supervisor.epochs.number = 2
    assert missing(watching.supervisor) == "a stop being carried out", "answered for an older epoch only"
    watching.answers()
    assert missing(watching.supervisor) == ""
    watching.supervisor.handover.lost({watching.port.fd: GONE}, watching.now_ns)
    assert missing(watching.supervisor) == "the port"


@pytest.mark.parametrize("sign", ["record", "hang-up"])
def test_a_port_that_has_gone_is_let_go_and_the_stopper_told(watching: Watching, sign: str) -> None:
    fd = watching.port.fd
    watching.rung(layout.STOPPER)
    if sign == "record":
        lost = records.PORT.pack(1, time.monotonic_ns(), records.PORT_LOST, "/dev/board")
        watching.port_owner.latest_writer("port").write(lost)
    else:
        os.close(watching.master)
        watching.master = os.open("/dev/null", os.O_RDONLY)
        until(lambda: watching.supervisor.loop.wait(0), "the hang-up")
    watching.pass_time(0)
    with pytest.raises(OSError, match="Bad file descriptor"):
        os.fstat(fd)
    assert watching.port.fd == -1
    assert watching.rung(layout.STOPPER)


def test_the_wait_before_a_restart_is_kept(watching: Watching, monkeypatch: pytest.MonkeyPatch) -> None:
    started: list[int] = []
    monkeypatch.setattr(
        table_module.ProcessTable,
        "start",
        lambda _, child: (started.append(watching.now_ns), child.restart.set(NEVER)),
    )
    for _ in range(2):
        watching.employ(layout.TELEMETRY).kill()
        until(lambda: watching.supervisor.loop.wait(0), "the news of the death")
        watching.pass_time(0)
    second_ns = watching.now_ns
    assert len(started) == 1, "the first at once, the second not yet"
    for _ in range(20):
        watching.pass_time(20 * MS)
    backoff_ns = Settings().ns("restart.backoff_s")
    assert len(started) == 2
    assert backoff_ns <= started[1] - second_ns <= backoff_ns + 20 * MS


def test_nobody_listens_while_telemetry_is_down(watching: Watching) -> None:
    watching.employ(layout.PORT_OWNER)
    watching.employ(layout.TELEMETRY)
    assert watching.supervisor._listening(watching.now_ns)
    watching.supervisor.processes[layout.TELEMETRY].on(DIED)
    assert not watching.supervisor._listening(watching.now_ns)


@pytest.mark.parametrize("held_up", [layout.PORT_OWNER, layout.TELEMETRY, layout.SUPERVISOR])
def test_who_was_held_up_did_not_listen_unless_something_may_move(watching: Watching, held_up: str) -> None:
    supervisor = watching.supervisor
    for name in (layout.PORT_OWNER, layout.TELEMETRY):
        watching.employ(name)
        watching.beats[name].set(watching.now_ns - LATE_NS * (name == held_up))
        supervisor.processes[name].started_ns = 0
    supervisor._watched_ns = watching.now_ns - LATE_NS * (held_up == layout.SUPERVISOR)
    assert not supervisor._listening(watching.now_ns)
    assert supervisor._listening(watching.now_ns - 1)
    watching.enabled()
    assert supervisor._listening(watching.now_ns)


def test_a_process_that_never_says_that_it_runs_is_killed(watching: Watching) -> None:
    watching.employ(layout.TELEMETRY)
    segment.attach(watching.run.memory, layout.TELEMETRY, write=True).word("beat_state").set(STARTING)
    child = watching.supervisor.processes[layout.TELEMETRY]
    child.state = "starting"
    assert child.overdue_ns() == watching.now_ns + STARTING_NS
    assert STARTING_NS <= 10_000 * MS


def test_one_that_starts_has_its_time_from_its_start_whatever_the_one_before_it_has_beaten(watching: Watching) -> None:
    watching.employ(layout.GATE)
    gate = watching.supervisor.processes[layout.GATE]
    watching.gate.word("beat_state").set(STARTING)
    gate.state = "starting"
    for beaten_ns in (watching.now_ns - 10**10, watching.now_ns + 10**10):
        watching.beats[layout.GATE].set(beaten_ns)
        assert gate.overdue_ns() == gate.started_ns + STARTING_NS


def test_it_sleeps_until_what_is_due_next(watching: Watching) -> None:
    supervisor = watching.supervisor
    assert watching.next_ns() == watching.now_ns + TICK_NS
    watching.employ(layout.GATE)
    overdue_ns = watching.now_ns + BY_NAME[layout.GATE].deadline_ns
    supervisor._turned_ns = overdue_ns - 2 * MS  # it was not held up itself
    watching.pass_time(BY_NAME[layout.GATE].deadline_ns - MS)
    assert watching.next_ns() == overdue_ns, "who hangs is not waited for until a tick"
    watching.beats[layout.GATE].set(watching.now_ns)
    watching.pass_time(0)
    supervisor.processes[layout.TELEMETRY].restart.set(watching.now_ns + 3 * MS)
    assert watching.next_ns() == watching.now_ns + 3 * MS
    supervisor.processes[layout.TELEMETRY].restart.set(NEVER)
    watching.port.close()
    assert watching.next_ns() == watching.now_ns + TICK_NS, "a lost port is the opener's to look for"


def test_a_starving_machine_is_told_of_at_most_every_ten_seconds(watching: Watching) -> None:
    found = watching.supervisor.processes
    assert found.starved_record() == NOT_STARVED
    for at_s, name, silent_ns in ((0, "gate", 300 * MS), (9.999, "stopper", 900_400_000), (10, "gate", 300 * MS)):
        found.tell_starved(name, silent_ns, watching.now_ns + round(at_s * 1e9))
    watching.supervisor._events.flush()
    first, second = watching.events()
    text = f"the machine starves the service: gate was not run for 300 ms; {found._advice}"
    assert (first["kind"], first["text"]) == ("starved", text)
    assert first["fields"] == {"process": "gate", "silent_ms": 300, "times": 1}
    assert second["fields"] == {"process": "gate", "silent_ms": 300, "times": 3}
    assert found.starved_record() == shown("stopper", 900, 3)


def test_a_machine_that_starved_the_service_once_is_not_told_of_for_ever(watching: Watching) -> None:
    found = watching.supervisor.processes
    found.tell_starved("gate", 900 * MS, watching.now_ns)
    watching.now_ns += STARVED_SHOWN_NS - 1
    found.tell_starved("stopper", 100 * MS, watching.now_ns)
    watching.now_ns += 1
    assert found.starved_record() == shown("gate", 900, 2), "the longest of those that are shown"
    watching.now_ns += STARVED_SHOWN_NS - 1
    assert found.starved_record() == {**NOT_STARVED, "starved_times": 2}
    found.tell_starved("stopper", 50 * MS, watching.now_ns)
    assert found.starved_record() == shown("stopper", 50, 3), "what is forgotten is no measure any more"


def read(watching: Watching, record: str) -> tuple[int, Any]:
    """A record of the supervisor's: its number, and what is in it."""
    entry = segment.attach(watching.run.memory, layout.SUPERVISOR).latest_reader(record).read()
    assert entry is not None
    return entry[0], msgpack.unpackb(entry[2])


def test_what_clients_are_told_of_the_settings(watching: Watching) -> None:
    assert read(watching, "settings")[1] == Settings().flat()
    rules = {"sources": ["cmd_vel"], "interlocks": [], "lease_ns": 60 * MS, "pid_namespace": pid_namespace()}
    assert read(watching, "rules")[1] == rules


def test_the_process_table_is_written_anew_when_it_changes(watching: Watching) -> None:
    watching.employ(layout.PORT_OWNER).kill()
    until(lambda: watching.supervisor.loop.wait(0), "the news of the death")
    watching.pass_time(0)
    watching.supervisor.processes[layout.PORT_OWNER].restart.set(NEVER)
    gate = watching.employ(layout.GATE)
    watching.pass_time(MS)
    number, table = read(watching, "processes")
    never = {"pid": 0, "state": "waiting", "restarts": 0, "last_exit": None}
    assert table == {
        "waiting_for": "port_owner, stopper, telemetry",
        **NOT_STARVED,
        "processes": {
            "port_owner": {**never, "restarts": 1, "last_exit": "killed by SIGKILL"},
            "stopper": never,
            "gate": {**never, "pid": gate.pid, "state": "running"},
            "telemetry": never,
        },
    }
    watching.pass_time(MS)
    assert read(watching, "processes")[0] == number


class Heard(Notify):
    """A service manager that notes what it hears."""

    def __init__(self) -> None:
        super().__init__("/nowhere")
        self.said: list[str] = []

    def say(self, message: str) -> bool:
        self.said += message.split("\n")
        return True


def test_what_the_service_manager_is_told(watching: Watching) -> None:
    heard = Heard()
    watching.supervisor.status.notify = heard
    watching.pass_time(0)
    assert heard.said == ["STATUS=motion disabled, waiting for port_owner, stopper, gate, telemetry"]
    for name in BY_NAME:
        watching.employ(name)
    watching.port_open()
    segment.attach(watching.run.memory, layout.STOPPER, write=True).word("port_number").set(1)
    watching.answers()
    watching.pass_time(TELL_EVERY_NS - MS)
    assert watching.supervisor.status.ever
    told = [(event["kind"], event["fields"].get("what")) for event in watching.events()]
    assert told[:3] == [("ready", None), ("rights", "SCHED_FIFO"), ("rights", "robust futexes")]
    assert len(heard.said) == 1, "it is told ten times a second"
    watching.pass_time(MS)
    assert heard.said[1:] == ["READY=1", "STATUS=ready, motion disabled"]
    state = {"enabled": True, "epoch": 1, "blocked": "no scan", "sources": []}
    watching.gate.latest_writer("state").write(pack(state))
    watching.pass_time(TELL_EVERY_NS)
    assert heard.said[3:] == ["STATUS=motion enabled; blocked: no scan"]
    watching.gate_stops("bumper")
    watching.pass_time(TELL_EVERY_NS)
    watching.answers(written_ns=watching.now_ns)
    watching.pass_time(TELL_EVERY_NS)
    assert heard.said[4:] == [
        "STATUS=stop latched: stop request: bumper; waiting for a stop being carried out",
        "STATUS=stop latched: stop request: bumper",
    ]


def test_who_is_down_is_in_the_status(watching: Watching) -> None:
    heard = Heard()
    die_too_often(watching, layout.TELEMETRY)
    watching.supervisor.status.notify = heard
    watching.pass_time(MS)
    (said,) = heard.said
    assert said.startswith("STATUS=stop latched: telemetry died; telemetry died too often and is down until a reset")


class Ending(Watching):
    """Every process runs; the port owner has stopped already for the end that is to come."""

    def __init__(self, directory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        super().__init__(directory, monkeypatch)
        for name in BY_NAME:
            self.employ(name)
        self.telemetry = segment.attach(self.run.memory, layout.TELEMETRY, write=True)
        self.pass_time(0)
        self.port_owner.word("written_ns").set(self.now_ns)
        self.port_owner.word("stopped_epoch").set(2)
        self.events()

    def sleep(self, seconds: float) -> None:
        super().sleep(seconds)
        for beat in self.beats.values():
            beat.set(self.now_ns)

    def answer(self, sent_ns: int) -> None:
        """The board has answered a ping a millisecond after it was sent."""
        self.port_owner.word("ping_0").set(sent_ns)
        self.telemetry.word("pong").set(records.pong(sent_ns + MS, 0))

    def end(self) -> tuple[bool, list[tuple[str, str]]]:
        """Told to end: (did it end well, what people were told)."""
        self.supervisor.end(signal.SIGTERM, None)
        well = self.supervisor.finish()
        told = [(event["kind"], event["text"]) for event in self.events() if event["kind"] != "link"]
        return well, told

    def wrote(self, count: int) -> bool:
        """True when it wrote so many bursts itself, and nothing else."""
        data = b""
        while len(data) < count * len(BURST) and select.select([self.master], [], [], 20.0)[0]:
            data += os.read(self.master, 65536)
        return data == count * BURST


@pytest.fixture
def ending(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Ending]:
    made = Ending(tmp_path, monkeypatch)
    yield made
    made.close()


STOPPING = ("stopping", "service is stopping; stop frame written by the port owner after 0 us")


def test_the_end_is_a_stop_that_is_heard_then_every_process_ended_then_another_stop(ending: Ending) -> None:
    ending.rung(layout.SUPERVISOR)
    ending.answer(ending.now_ns)
    began_ns = ending.now_ns
    well, told = ending.end()
    assert well
    assert ending.rung(layout.SUPERVISOR), "it does not sleep over it"
    assert ending.supervisor.ending
    assert told == [
        STOPPING,
        ("stopped", "stopped; the stop was written twice, acknowledged by the board after 1.0 ms"),
    ]
    assert ending.wrote(1)
    assert ending.now_ns == began_ns, "it waits for nothing that is known"
    assert [child.state for child in ending.supervisor.children] == ["waiting"] * len(BY_NAME)
    assert ending.word("beat_state").get() == heartbeat.STOPPING
    assert ending.supervisor.blackbox._savers == {}, "an end in order is no incident"


def test_a_board_that_has_never_answered_is_waited_for_a_while_and_is_no_failure(ending: Ending) -> None:
    began_ns = ending.now_ns
    well, told = ending.end()
    assert well
    assert told[1][1].endswith("whether the board hears is not known (link unproven)")
    assert ending.now_ns == began_ns + main.HEAR_NS
    assert ending.word("beat_ns").get() > began_ns, "its own beat goes on: nobody stops for its silence"


def test_a_board_that_does_not_hear_the_last_stop_is_a_failure(ending: Ending) -> None:
    ending.answer(ending.now_ns - 1)
    well, told = ending.end()
    assert not well
    assert told[1][1].endswith("NOT acknowledged by the board (link alive); wheels that turn: POWER SWITCH")
    assert ending.wrote(1)


def test_a_board_that_goes_deaf_at_the_end_is_told_of(ending: Ending) -> None:
    deaf_ns = Settings().ns("link.deaf_s")
    ending.answer(ending.now_ns - 2 * deaf_ns)
    ending.pass_time(0)
    ending.port_owner.word("ping_1").set(ending.now_ns - deaf_ns)
    well, told = ending.end()
    assert not well
    assert told[1][1].endswith("NOT acknowledged by the board (link deaf); wheels that turn: POWER SWITCH")


def test_a_second_stop_that_can_not_be_written_is_a_failure(ending: Ending) -> None:
    ending.fill()
    ending.answer(ending.now_ns)
    well, told = ending.end()
    assert not well
    assert told[1][1].startswith("stopped; the second stop could NOT be written, acknowledged")


def test_a_second_stop_that_the_kernel_keeps_is_a_failure(ending: Ending) -> None:
    ending.world.play("unsent_bytes", lambda _: len(BURST))
    ending.answer(ending.now_ns)
    well, told = ending.end()
    assert not well, "what it holds is dropped with the port"
    assert told[1][1].startswith("stopped; the second stop was handed over, NOT sent")


def test_an_end_without_a_port_owner_is_stopped_for_by_the_supervisor_and_waits_for_no_answer(
    ending: Ending,
) -> None:
    ending.supervisor.processes[layout.PORT_OWNER].kill(20.0)
    ending.port_owner.word("stopped_epoch").set(1)
    began_ns = ending.now_ns
    well, told = ending.end()
    assert well
    assert told[0] == ("stopping", "service is stopping; stop frame written by the supervisor after 0 us")
    assert ending.wrote(2)
    assert ending.now_ns == began_ns
