"""The supervisor and processes that die or fall silent: what it writes, kills, lets go and passes on."""

from __future__ import annotations

from typing import Any

import pytest

from failstop.board.rrc.burst import BURST
from failstop.messages import layout
from failstop.policy import causes
from failstop.policy.processes import HANG_NS, PROCESS_BY_NAME
from failstop.procs.loop import NEVER
from failstop.supervisor.children import GIVEN_UP, STARTING_NS
from failstop.supervisor.main import EXCUSE_NS, TICK_NS
from failstop.supervisor.process_table import GATE_AGAIN_NS
from tests.support.stage import MS
from tests.support.supervisor_scene import NOT_STARVED, Scene, others
from tests.support.why import why

S = 1_000_000_000


@pytest.fixture
def whole() -> Scene:
    """Every process runs, and the service was ready once."""
    made = Scene(*PROCESS_BY_NAME)
    made.supervisor.status.ever = True
    return made


def epochs(scene: Scene) -> list[int]:
    """The epoch in force at each write to the port, from now on."""
    found: list[int] = []
    scene.wire.on_bytes = lambda data: found.append(scene.word("epoch").get())
    return found


def test_the_port_owner_s_death_is_answered_first_on_its_own_descriptor(scene: Scene) -> None:
    seen = epochs(scene)
    scene.dies(layout.PORT_OWNER)
    assert scene.pass_time() == BURST
    assert (seen, scene.supervisor.epochs.number) == ([1], 2), "nothing comes before the burst"
    assert scene.word("written_ns").get() == scene.now_ns
    assert scene.told() == {"reason": "port_owner died", "written_by": "supervisor", "written_us": 0.0}


def test_the_supervisor_wakes_those_who_are_to_answer_an_epoch(scene: Scene) -> None:
    asked = (layout.PORT_OWNER, layout.GATE)
    for name in asked:
        scene.rung(name)
    scene.gate_stops()
    scene.turn()
    assert all(map(scene.rung, asked))


def test_whoever_sees_a_new_epoch_finds_a_service_that_is_not_ready(scene: Scene) -> None:
    scene.word("ready").set(1)
    scene.supervisor.epochs.raise_for([scene.made_stop(why("key1"), layout.GATE)], scene.now_ns)
    assert (scene.word("epoch").get(), scene.word("ready").get()) == (2, 0)


@pytest.mark.parametrize("name", list(PROCESS_BY_NAME))
def test_a_process_that_is_silent_is_killed_before_it_is_stopped_for(whole: Scene, name: str) -> None:
    process, deadline_ns = whole.employ(name), PROCESS_BY_NAME[name].deadline_ns
    lived: list[bool] = []
    whole.wire.on_bytes = lambda data: lived.append(not process.dead)
    assert whole.tick(deadline_ns - 1, beating=others(name)) == b""
    assert (process.dead, whole.supervisor.epochs.number) == (False, 1)
    wrote = whole.pass_time(1)
    assert (wrote, lived) == ((BURST, [False]) if name == layout.PORT_OWNER else (b"", []))
    assert (process.dead, whole.supervisor.epochs.number) == (True, 2)
    assert whole.cause()[1] == f"{name} hangs: {deadline_ns // MS} ms silent"
    fence = whole.supervisor.processes[name].fence
    assert fence.fields()["silent_ms"] == deadline_ns // MS


def test_an_event_that_cannot_happen_is_told_and_stopped_for_once(whole: Scene) -> None:
    whole.said()
    whole.supervisor.processes[layout.GATE].on(GIVEN_UP)
    whole.turn(MS)
    told = "internal error: gate: given up while running"
    assert (whole.cause(), whole.state(layout.GATE)) == ((2, told), "running")
    whole.answers(written_ns=whole.now_ns)
    whole.turn(MS)
    [(kind, _, text, fields)] = whole.said()
    assert (kind, fields["cause"]) == ("stop", "defect")
    assert text.startswith(f"STOP latched: {told}; stop frame written by the port owner")
    assert whole.supervisor.epochs.number == 2


def fence(scene: Scene, *names: str) -> None:
    """Processes hang, and are killed for it."""
    for name in names:
        scene.employ(name)
    longest_ns, *_ = deadlines = sorted((PROCESS_BY_NAME[name].deadline_ns for name in names), reverse=True)
    scene.tick(longest_ns - deadlines[-1], beating=(layout.PORT_OWNER,))
    scene.tick(deadlines[-1])
    scene.events()


def stories(scene: Scene) -> dict[str, tuple[str, dict[str, Any]]]:
    """Events of those that were fenced."""
    told = [event for event in scene.events() if event["kind"] == "fenced"]
    return {event["fields"]["process"]: (event["text"], event["fields"]) for event in told}


def test_a_fenced_port_owner_is_stopped_for_again_first_when_it_is_gone(scene: Scene) -> None:
    """Bytes that it had begun to write as it was killed may have come after the first burst."""
    fence(scene, layout.PORT_OWNER)
    seen = epochs(scene)
    assert scene.pass_time(MS) == BURST
    assert (seen, scene.supervisor.epochs.number) == ([2], 3)


KILLED, STOPPED = "killed after 0.0 ms", "killed after 0.0 ms, stop written after 0.0 ms"
GONE, AGAIN = "gone after 1.0 ms", "gone after 1.0 ms, stop again after 1.0 ms"


@pytest.mark.parametrize(
    ("fenced", "lost", "told"),
    [
        ((layout.PORT_OWNER,), False, {layout.PORT_OWNER: f"{STOPPED}, {AGAIN}"}),
        # The second burst could not be written, and zeros that were only tried are none.
        ((layout.PORT_OWNER,), True, {layout.PORT_OWNER: f"{STOPPED}, {GONE}"}),
        # The stop that was written since is none of a gate's fence.
        ((layout.GATE,), False, {layout.GATE: f"{KILLED}, {GONE}"}),
        (
            (layout.GATE, layout.PORT_OWNER),
            False,
            {layout.GATE: f"{KILLED}, {GONE}", layout.PORT_OWNER: f"{STOPPED}, {AGAIN}"},
        ),
    ],
)
def test_a_fence_is_told_of_with_the_stops_that_were_written_for_it(
    scene: Scene, fenced: tuple[str, ...], lost: bool, told: dict[str, str]
) -> None:
    fence(scene, *fenced)
    if lost:
        scene.port.close()
    elif layout.PORT_OWNER not in fenced:
        assert scene.pass_time() == BURST
    wrote = scene.pass_time(MS)
    assert (wrote == b"") is lost
    found = stories(scene)
    for process, text in told.items():
        assert found[process][0] == f"{process} was fenced: {text}"
        assert found[process][1]["gone_us"] == 1000.0
        assert found[process][1].get("again_us") == (1000.0 if AGAIN in text else None)


def test_a_death_of_another_has_the_supervisor_s_stop_without_a_port_owner(scene: Scene) -> None:
    scene.dies(layout.GATE)
    assert scene.pass_time() == BURST
    assert scene.told() == {"reason": "gate died", "written_by": "supervisor", "written_us": 0.0}
    assert scene.word("written_ns").get() == scene.word("beat_ns").get() == scene.now_ns


def test_a_ring_wakes_the_supervisor_once(scene: Scene) -> None:
    for bell in (scene.run.bells[layout.SUPERVISOR], scene.supervisor.processes.early.bell):
        bell.ring()
        assert bell.fd in scene.supervisor.loop.wait(0)
        scene.pass_time()
        assert scene.supervisor.loop.wait(0) == {}


def test_the_supervisor_stops_five_times_a_second_while_no_port_owner_runs(scene: Scene) -> None:
    scene.dies(layout.PORT_OWNER)
    assert scene.pass_time() == BURST
    written = [scene.pass_time(20 * MS).count(BURST) for _ in range(100)]
    assert sum(written) == 10
    assert set(written) == {0, 1}


@pytest.mark.parametrize("epoch", [1, 7])
def test_a_supervisor_that_was_held_up_stops_motion_and_kills_nobody(whole: Scene, epoch: int) -> None:
    """It only tells of it where motion was enabled long ago: another stop has ended that."""
    whole.enabled(epoch=epoch)
    whole.pass_time(HANG_NS)
    if epoch == 1:
        assert whole.cause() == (2, "supervisor was held up for 250 ms")
    else:
        assert whole.starved() == [("supervisor", 250, 1)]
    assert whole.supervisor.epochs.number == (2 if epoch == 1 else 1)
    assert not any(child.fence for child in whole.supervisor.children)


@pytest.mark.parametrize(
    ("gap_ns", "was_ready", "excused", "epoch"),
    [
        (EXCUSE_NS - 1, True, False, 1),
        (EXCUSE_NS, True, True, 1),
        (HANG_NS - 1, True, True, 1),
        (HANG_NS, False, True, 1),
        (HANG_NS, True, True, 2),
    ],
)
def test_a_supervisor_is_held_up_from_a_gap_on(
    scene: Scene, gap_ns: int, was_ready: bool, excused: bool, epoch: int
) -> None:
    scene.employ(layout.TELEMETRY)
    scene.supervisor.status.ever = was_ready
    scene.enabled()
    scene.pass_time()
    scene.pass_time(gap_ns)
    assert (scene.supervisor.processes[layout.TELEMETRY].excused_ns == scene.now_ns) is excused
    assert scene.supervisor.epochs.number == epoch


def suspended(scene: Scene) -> None:
    """A signal has let it go on."""
    scene.me.continued = True


@pytest.mark.parametrize("gap_ns", [EXCUSE_NS, HANG_NS])
def test_a_suspended_supervisor_knows_what_others_take_for_a_hang(scene: Scene, gap_ns: int) -> None:
    scene.supervisor.status.ever = True
    scene.enabled()
    scene.pass_time()
    suspended(scene)
    for name in (layout.PORT_OWNER, layout.GATE):
        scene.raises(name, causes.HANGS(layout.SUPERVISOR, 61), late_ns=61 * MS)
    scene.pass_time(gap_ns)
    assert scene.cause()[1] == str(causes.SUPERVISOR_SUSPENDED(gap_ns / 1e9))
    scene.pass_time(MS)
    told = [kind for kind, *_ in scene.said()]
    assert "stop_also" not in told, "all three are one cause"
    assert "starved" not in told


def test_a_supervisor_tells_that_it_was_suspended_while_nothing_could_move(scene: Scene) -> None:
    scene.supervisor.status.ever = True
    scene.pass_time()
    suspended(scene)
    scene.pass_time(HANG_NS + 10 * MS + 1)
    ((kind, _, text, fields),) = scene.said()
    assert (kind, text, fields) == ("suspended", "supervisor was suspended for 0.3 s by a signal", {"silent_ms": 260})
    assert scene.supervisor.processes.starved_record() == NOT_STARVED
    assert scene.supervisor.epochs.number == 1


def test_a_supervisor_that_was_held_up_waits_for_no_signal(scene: Scene) -> None:
    """It looks whether one has come."""
    waited_s: list[float] = []
    scene.system["signal"].sigtimedwait = lambda wanted, timeout_s: waited_s.append(timeout_s)
    scene.pass_time(EXCUSE_NS)
    assert waited_s == [0]


def test_a_signal_without_a_gap_explains_no_hang(scene: Scene) -> None:
    scene.supervisor.status.ever = True
    scene.enabled()
    scene.pass_time()
    hang = causes.HANGS(layout.SUPERVISOR, 61)
    scene.raises(layout.PORT_OWNER, hang)
    suspended(scene)
    scene.pass_time(EXCUSE_NS - 1)
    assert scene.cause()[1] == str(hang)


@pytest.mark.parametrize("noticed", [layout.PORT_OWNER, layout.SUPERVISOR])
def test_a_death_that_the_port_owner_has_noticed_too_is_one_cause(noticed: str) -> None:
    scene = Scene(layout.PORT_OWNER)
    scene.dies(layout.GATE)
    if noticed == layout.PORT_OWNER:
        scene.raises(noticed, why("gate died"), written_ns=scene.now_ns + 7_000, late_ns=1_000)
    scene.turn()
    scene.answers(written_ns=scene.now_ns + 7_000)
    scene.turn()
    told = [event for event in scene.events() if event["kind"] == "stop"]
    assert [(event["fields"]["reason"], event["fields"]["noticed_by"]) for event in told] == [("gate died", noticed)]
    assert scene.told()["written_us"] == (6.0 if noticed == layout.PORT_OWNER else 7.0)


def die_too_often(scene: Scene, name: str) -> None:
    while scene.state(name) != "down":
        scene.dies(name)
        scene.pass_time()


@pytest.mark.parametrize("name", others(layout.PORT_OWNER))
def test_a_reset_starts_one_anew_that_is_down(scene: Scene, name: str) -> None:
    die_too_often(scene, name)
    scene.answers(written_ns=scene.now_ns)
    scene.ask_reset(1)
    scene.tick(200 * MS)
    assert scene.state(name) == "down", "a reset from before it was down is not for it"
    scene.ask_reset()
    scene.pass_time(20 * MS)
    assert scene.state(name) == "starting"
    scene.dies(name)
    scene.pass_time()
    assert scene.state(name) == "starting", "its deaths from before the reset are forgotten"


def test_a_gate_that_is_down_is_tried_again_since_it_hears_the_resets(scene: Scene) -> None:
    die_too_often(scene, layout.GATE)
    down_ns = scene.now_ns
    text = "gate died too often, so it stays down and the wheels stay stopped"
    again = "it is restarted in 60 s, because only it can hear a reset"
    assert scene.events()[-1]["text"] == f"{text}; {again}"
    while scene.state(layout.GATE) == "down" and scene.now_ns < down_ns + 2 * GATE_AGAIN_NS:
        scene.pass_time(200 * MS)
    assert scene.state(layout.GATE) == "starting"
    assert scene.supervisor.processes[layout.GATE].started_ns == down_ns + GATE_AGAIN_NS


def times_started(scene: Scene) -> int:
    return sum(process.name == layout.TELEMETRY for process in scene.born)


def test_the_wait_before_a_restart_is_kept(scene: Scene) -> None:
    for _ in range(2):
        scene.dies(layout.TELEMETRY)
        scene.pass_time()
    second_ns = scene.now_ns
    assert times_started(scene) == 2, "the first at once, the second not yet"
    scene.tick(400 * MS)
    backoff_ns = scene.settings.ns("restart.backoff_s")
    assert times_started(scene) == 3
    started_ns = scene.supervisor.processes[layout.TELEMETRY].started_ns
    assert backoff_ns <= started_ns - second_ns <= backoff_ns + 20 * MS


def test_a_process_has_its_time_from_its_start_whatever_was_beaten_before(scene: Scene) -> None:
    gate = scene.supervisor.processes[layout.GATE]
    scene.supervisor.processes.start(gate)
    for beaten_ns in (0, scene.now_ns - 10 * S, scene.now_ns + 10 * S):
        scene.gate.word("beat_ns").set(beaten_ns)
        assert gate.overdue_ns() == scene.now_ns + STARTING_NS
    assert STARTING_NS <= 10_000 * MS


def test_the_supervisor_sleeps_until_what_is_due_next(scene: Scene) -> None:
    assert scene.next_ns() == scene.now_ns + TICK_NS
    scene.employ(layout.GATE)
    overdue_ns = scene.now_ns + PROCESS_BY_NAME[layout.GATE].deadline_ns
    scene.tick(PROCESS_BY_NAME[layout.GATE].deadline_ns - MS)
    assert scene.next_ns() == overdue_ns, "who hangs is not waited for until a tick"
    scene.beat(layout.GATE)
    scene.pass_time()
    restart = scene.supervisor.processes[layout.TELEMETRY].restart
    restart.set(scene.now_ns + 3 * MS)
    assert scene.next_ns() == scene.now_ns + 3 * MS
    restart.set(NEVER)
    scene.port.close()
    assert scene.next_ns() == scene.now_ns + TICK_NS, "a lost port is the opener's to look for"
