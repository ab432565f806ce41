"""The gate's shell, turn by turn: what it hands to the port owner and the supervisor, whom it refuses, which cause it
latches beside a supervisor that raises epochs, and how often it looks around."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from failstop.messages import box, layout, records
from failstop.procs.gate import main
from failstop.procs.gate.main import MOST_RINGS, NO_ARM
from failstop.procs.gate.remarks import EVERY_NS, MOST_AT_ONCE
from failstop.procs.gate.requests import UNSEEN
from failstop.supervisor.stops import Stop
from tests.support.gate_scene import SESSION, Scene
from tests.support.stage import MS, Dummy
from tests.support.why import why


def test_requests_are_answered_in_the_order_in_which_they_were_asked(scene: Scene) -> None:
    scene.ready(0)
    assert scene.ask(records.ENABLE)[1].startswith("not ready: ")
    scene.ready(1)
    for verb, refusal in ((records.ARM_TUCK, NO_ARM), (99, "unknown request 99")):
        assert scene.ask(verb) == (False, refusal)
    asked_ns = scene.clock() - 1
    assert scene.ask(records.DISABLE)[0]
    assert scene.ask(records.ENABLE, asked_ns) == (False, "a later request replaced it: ask again")
    assert scene.ask(records.DISABLE, scene.clock() + 10_000 * MS)[0]
    scene.turn(20 * MS)
    assert scene.ask(records.ENABLE)[0], "one that is dated in the future keeps nobody from enabling"
    scene.clients[0].succeed(13, "heir")
    assert scene.ask(records.DISABLE) == (True, "motion disabled"), "the next session, from its first request on"


def test_a_command_that_is_in_its_slot_before_an_enable_is_held_though_requests_are_heard_first(scene: Scene) -> None:
    """Else a program that commands in the same breath as somebody enables would drive off."""
    scene.turn()
    scene.command(0.1)
    assert scene.ask(records.ENABLE) == (
        True,
        "motion enabled; test (pid 0) must send zero or pause before it can drive "
        "(or end it, enable motion, and start it again)",
    )
    scene.drive(0.1)
    scene.tick()
    assert not any(scene.gate.core.velocity)
    scene.drive(0.0)
    scene.drive(0.1)
    scene.tick()
    assert any(scene.gate.core.velocity)


def test_the_answer_to_an_older_request_does_not_take_the_place_of_a_newer_one_s(scene: Scene) -> None:
    scene.turn()
    slot, now_ns = scene.gate.clients.slots[0], scene.clock()
    scene.gate.handle_request(now_ns, slot, now_ns, 7, records.RESET)
    scene.gate.handle_request(now_ns, slot, now_ns, 8, records.DISABLE)
    scene.decide()
    assert scene.replied() == (8, True, "motion disabled")


def test_a_stop_of_its_own_goes_to_the_port_owner_and_then_to_the_supervisor(scene: Scene) -> None:
    assert scene.ask(records.ENABLE)[0]
    assert records.MOTION in scene.drive(0.1)
    scene.ask(records.DISABLE)
    assert scene.asked == [records.WRITE_BURST], "a disable writes one too"
    assert scene.ask(records.ENABLE)[0]
    assert scene.drive(float("nan")) == [records.WRITE_BURST]
    assert "is not finite" in scene.stopped()


def test_a_supervisor_that_is_silent_while_motion_is_enabled_is_a_stop(scene: Scene) -> None:
    lease_ns = scene.settings.ns("gate.lease_s")
    scene.turn(10 * lease_ns, supervisor_beats=False)
    assert scene.latched() is None, "nothing was enabled"
    scene.turn()
    assert scene.ask(records.ENABLE)[0]
    assert scene.turn(lease_ns, supervisor_beats=False) == [records.MOTION]
    assert records.WRITE_BURST in scene.turn(20 * MS, supervisor_beats=False)
    assert scene.stopped().startswith("supervisor hangs: ")
    assert not scene.gate.core.enabled


def test_a_successor_keeps_the_speed_limit(scene: Scene) -> None:
    assert scene.ask(records.LIMIT) == (False, "a speed limit of 0 %: must be 5 to 100"), "none lies in the slot"
    scene.limit(30)
    assert scene.ask(records.LIMIT) == (True, "speed limited to 30 % of the settings'")
    scene.limit(3)
    assert not scene.ask(records.LIMIT)[0]
    scene.start_gate()
    assert scene.gate.core.limit == 30


def test_a_command_that_is_repeated_without_a_ring_does_not_time_out(scene: Scene) -> None:
    scene.turn()
    scene.ask_for(records.ENABLE)
    scene.turn()

    scene.command(0.2)
    scene.turn(MS)
    ends_ns = scene.gate.core.due_ns(scene.clock())
    assert ends_ns
    scene.clock.now_ns = ends_ns - 22 * MS
    scene.tick()
    scene.command(0.2)  # behind the tick's back
    scene.clock.now_ns = ends_ns
    scene.gate.turn({})
    assert scene.gate.core.blocked(scene.clock()) == ""
    assert scene.gate.core.due_ns(scene.clock()) == ends_ns + 298 * MS + 1


def test_a_request_is_told_by_its_client_s_name_when_it_changed_something(scene: Scene) -> None:
    for verb in (records.ENABLE, records.DISABLE):
        for _ in range(2):
            scene.ask(verb)
    assert scene.told() == ["motion enabled by test", "motion disabled by test"]
    scene.stop("key1")
    scene.ask(records.RESET)
    scene.stop("key1")
    scene.pad_resets()
    scene.turn()
    cleared = "latched stop cleared (was: key1); motion still disabled"
    assert scene.told() == [f"test: {cleared}", f"gamepad: {cleared}"], "the gamepad is no process"


def test_after_a_flood_of_refusals_how_many_were_left_out_is_told_once(scene: Scene) -> None:
    for number in range(MOST_AT_ONCE + 5):
        if number == MOST_RINGS - 1:
            scene.tick()  # or the gate would hear no more rings
        scene.ask(99)
    refused = "refused to 99, test: unknown request 99"
    assert scene.told() == [refused] * MOST_AT_ONCE
    left_out = "and 5 more requests, too many to log each one"
    for expected in ([refused, left_out], [refused]):
        scene.turn(EVERY_NS)
        scene.ask(99)
        assert scene.told() == expected


def restarted(scene: Scene, after_ns: int = 80 * MS) -> None:
    """The gate dies, which is a stop, and another one starts after a while."""
    scene.clock.now_ns += MS
    scene.stop("gate died")
    scene.clock.now_ns += after_ns
    scene.start_gate()
    scene.turn()


def test_a_flood_of_other_requests_does_not_hide_that_motion_was_enabled_and_disabled(scene: Scene) -> None:
    for number in range(MOST_AT_ONCE + 5):
        if number == MOST_RINGS - 1:
            scene.tick()
        scene.ask(99)
    scene.told()
    scene.turn(EVERY_NS // 2)
    for verb in (records.ENABLE, records.DISABLE):
        scene.ask(verb)
    assert scene.told() == ["motion enabled by test", "motion disabled by test"]


@pytest.mark.parametrize("waits", [True, False])
def test_a_reset_that_no_gate_has_heard_is_answered_by_the_next_one_while_it_waits(scene: Scene, waits: bool) -> None:
    scene.turn()
    scene.stop("gate died")
    scene.clock.now_ns += MS
    scene.ask_for(records.RESET)
    scene.clock.now_ns += records.ANSWER_WITHIN_NS + (0 if waits else 1)
    scene.start_gate()
    scene.turn()
    late = (records.REFUSED, "the gate restarted after you asked: ask again")
    assert scene.answered() == ((records.DONE, scene.answered()[1]) if waits else late)
    assert scene.latched() == (None if waits else "gate died")
    assert not scene.gate.core.enabled


def test_what_was_asked_of_a_gate_before_its_death_moves_nothing_by_the_next_one(scene: Scene) -> None:
    scene.limit(50)
    assert scene.ask(records.LIMIT)[0]
    before = scene.replied()
    scene.told()
    restarted(scene)
    assert (scene.replied(), scene.told()) == (before, []), "what was answered is not done again"
    scene.ask_for(records.ENABLE)
    restarted(scene)
    text = "asked before the last stop (gate died): deal with that stop, then ask again"
    assert scene.answered() == (records.REFUSED, text)


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


@pytest.mark.claim("CAUSE-1")
def test_the_first_cause_since_the_reset_is_latched(scene: Scene) -> None:
    assert [scene.tick(), scene.stop_and_tick("key1"), scene.stop_and_tick("device lost")] == [None, "key1", "key1"]


def test_a_stop_that_comes_with_the_decision_of_a_reset_is_latched_at_once(scene: Scene) -> None:
    scene.stop_and_tick("key1")
    scene.ask(records.RESET)
    assert scene.ask(records.ENABLE)[0]
    scene.latch.add([Stop(scene.clock(), layout.SUPERVISOR, why("device lost"))], 3, scene.clock())
    scene.ask(records.RESET, scene.clock() - 1)
    assert scene.latched() == "device lost"
    assert not scene.gate.core.enabled


def test_a_reset_whose_person_had_not_seen_the_newest_stop_is_refused(scene: Scene) -> None:
    scene.stop_and_tick("key1")
    scene.saw(2)
    scene.stop_and_tick("key2")
    assert scene.ask(records.RESET) == (False, UNSEEN)
    assert scene.latched() == "key1"
    scene.saw(3)
    assert scene.ask(records.RESET)[0]
    assert scene.latched() is None
    scene.stop_and_tick("key1")
    scene.saw(0)
    assert scene.ask(records.RESET)[0], "one that names no stop is of who asks alone"
    scene.stop_and_tick("key1")
    scene.ask(records.DISABLE)
    scene.saw(5)
    scene.stop("key2")
    scene.gate.handle_request(scene.clock(), scene.gate.clients.slots[0], scene.clock(), 9, records.RESET)
    scene.gate.requests.write()
    assert scene.replied()[1:] == (False, UNSEEN), "a stop that the gate has not followed yet is newer too"


@pytest.mark.claim("MOVE-2")
@given(st.lists(st.tuples(st.booleans(), st.integers(0, 3), st.integers(0, 2)), max_size=12))
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture])
def test_no_reset_clears_a_stop_that_its_person_had_not_seen(scene: Scene, steps: list[tuple[bool, int, int]]) -> None:
    epoch = scene.gate.epoch
    for stops, behind, ago in steps:
        scene.clock.now_ns += MS
        if stops:
            epoch += 1
            scene.stop(f"key{1 + epoch % 2}")
            scene.tick()
            continue
        was, seen = scene.latched(), max(0, epoch - behind)
        scene.saw(seen)
        done, _ = scene.ask(records.RESET, scene.clock() - ago)
        if done and was:
            assert seen in (0, epoch)
            assert scene.latched() is None
        elif seen not in (0, epoch):
            assert not done
            assert scene.latched() == was


@pytest.mark.parametrize("resets", [0, 1])
def test_a_successor_finds_what_is_latched_and_the_first_gate_nothing(scene: Scene, resets: int) -> None:
    scene.ask_for(records.RESET, asked_ns=scene.clock() - MS)
    for _ in range(main.LOOK_AT_ALL_EVERY):
        scene.tick()
    assert scene.answered() == (True, "no stop is latched")
    scene.stop("key1")
    scene.stop_and_tick("gate died")
    for _ in range(resets):
        scene.ask(records.RESET)
    scene.start_gate()
    assert scene.latched() == (None if resets else "key1")
    assert not scene.gate.core.enabled


def test_a_reset_that_its_predecessor_asked_for_is_nobody_s(scene: Scene) -> None:
    scene.stop_and_tick("key1")
    scene.gate.handle_request(0, scene.gate.clients.slots[0], scene.clock(), 1, records.RESET)
    scene.start_gate()
    scene.decide()
    assert scene.tick() is None, "but it is one all the same"
    assert scene.replied() == (0, records.UNDER_WAY, "")


def test_a_client_that_asks_for_resets_without_end_is_in_the_line_once(scene: Scene) -> None:
    mine, other = scene.gate.clients.slots[:2]
    scene.stop_and_tick("key1")
    for number in range(1000):
        scene.gate.handle_request(scene.clock(), mine, scene.clock(), number, records.RESET)
    scene.gate.handle_request(scene.clock(), other, scene.clock(), 1, records.RESET)
    assert scene.own.word("resets_asked").get() == 1
    scene.decide()
    assert scene.own.word("resets_asked").get() == 3
    assert scene.replied() == (999, True, "no stop is latched")
    assert scene.own.latest_reader("reply.1").read()


def test_a_damaged_cause_latches_too(scene: Scene) -> None:
    record = records.LATCH.pack(2, scene.clock(), scene.clock(), b"?")
    scene.views[layout.SUPERVISOR].latest_writer("latch").write(record, scene.clock())
    scene.raise_epoch(2)
    assert scene.tick() == "stopped by the supervisor"


@pytest.mark.parametrize("successor", [False, True])
@pytest.mark.parametrize(("after_ns", "granted"), [(-MS, False), (MS, True)])
def test_a_request_of_before_the_stop_is_refused(scene: Scene, successor: bool, after_ns: int, granted: bool) -> None:
    scene.stop("gate died")
    stopped_ns = scene.clock()
    if successor:
        scene.start_gate()
    assert scene.tick() == "gate died"
    if not granted:
        assert scene.ask(records.ENABLE, stopped_ns + after_ns)[1].startswith("asked before the last stop (gate died)")
    scene.ask_for(records.RESET, asked_ns=stopped_ns + after_ns)
    for _ in range(main.LOOK_AT_ALL_EVERY):
        latched = scene.tick()
    done, text = scene.answered()
    assert done == granted
    assert latched == (None if granted else "gate died")
    assert granted or text.startswith("asked before the last stop (gate died)")
    assert scene.ask(records.RESET)[0], "and now it does"


def test_frames_of_clients_that_are_no_motion_are_handed_on_ten_milliseconds_apart(scene: Scene) -> None:
    frames = scene.segment(layout.GATE).ring_reader("frames")
    client = scene.clients[0]

    def others() -> list[bytes]:
        found = []
        while entry := frames.next():
            _, kind, body = records.FRAME.unpack(entry[2])
            if kind == records.OTHER:
                found.append(body)
        return found

    scene.turn()
    others()
    seen = []
    for number in range(6):
        client.write("aux", records.AUX.pack(client.session, b"%d" % number))
        client.ring()
        scene.turn(5 * MS)
        seen += others()
    assert seen == [b"0", b"2", b"4"]
    scene.turn(50 * MS)
    assert others() == [], "none is handed on twice"
