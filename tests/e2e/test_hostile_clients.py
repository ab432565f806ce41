"""Clients that die, hang, scribble, flood and hoard: the wheels do what they should or stand, in time, and the service
and everyone else's stop are unaffected."""

from __future__ import annotations

import itertools
import os
import random
import signal
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop import FailstopError, Robot
from failstop.api.client import Client, run
from failstop.files import instance
from failstop.lab.trial import Trial, wait_for, write_settings
from failstop.messages import layout, segments
from failstop.shm import claim
from failstop.supervisor import status
from tests.support.amounts import amount
from tests.support.shared_trial import IMU_HZ, goes_on, unheard
from tests.support.simulated import MS, Simulated

from .hostile_scene import MAX_RPS, Watch, drives_again, forward_or_still, hostile, latched, within_limits

KILLS = amount(60, 1000)


@pytest.fixture
def two_sources(name: str, tmp_path: Path) -> Iterator[Trial]:
    """A service with a source above the one that the trial's client drives."""
    config = tmp_path / "two-sources.toml"
    write_settings(str(config), {"sources.nav.priority": 10, status.LEASE: status.LEASE_WITHOUT_S})
    with Trial(name, ("--config", str(config)), imu_hz=IMU_HZ) as running:
        yield running


# Dying and hanging.


@pytest.mark.slow
def test_clients_killed_at_random_points_of_any_call(trial: Trial) -> None:
    dice = random.Random(7)
    watch = Watch(trial)
    claims = claim.open_claims(instance.claims_path(instance.find(trial.name)))
    trial.enable()
    with hostile(trial, "nursery") as nursery:
        nursery.says()
        events, longest_s = trial.board.events(), 0.025
        for turn in itertools.count():
            if turn >= KILLS:
                events += trial.board.events()
                if any(event.is_motion for event in events):
                    break
                longest_s *= 2  # on a busy machine they need longer to drive at all
            pid = int(nursery.asks())
            time.sleep(dice.uniform(0.0, longest_s))
            os.kill(pid, signal.SIGKILL)
            wait_for("the slot to be free", lambda: not any(claim.held(claims, i) for i in range(1, 8)))
            wait_for("the gate to see it", lambda: len(trial.robot.state.clients) == 1)
    os.close(claims)
    trial.board.wait_wheels(turning=False, timeout_s=5.0)
    events += trial.board.events()
    assert all(within_limits(event) for event in events if event.is_motor)
    watch.holds()
    drives_again(trial)


def test_a_client_that_hangs_while_driving(simulated: Simulated) -> None:
    simulated.enable()
    simulated.leave()
    client = simulated.driver("hangs", manual=True)
    simulated.board.wait_wheels(turning=True)
    simulated.lab.machine.kill(client, signal.SIGSTOP)
    hung_ns = simulated.now_ns()
    event = simulated.board.wait_for(lambda one: one.is_motor and not any(one.speeds) and one.arrival_ns > hung_ns)
    assert 280 * MS <= event.arrival_ns - hung_ns <= 301 * MS
    simulated.wait(0.1)
    assert simulated.robot.state.blocked == "cmd timeout"
    simulated.drive(0.2)
    assert simulated.turning(), "others may drive"
    assert simulated.robot.state.estop is None
    simulated.lab.machine.kill(client, signal.SIGCONT)
    simulated.drive(0.2)
    assert str(simulated.robot.state.estop).startswith("multiple cmd_vel publishers: "), "two at once may not"
    assert not simulated.turning()


# Wrong values.


@pytest.mark.claim("LIMIT-1")
@pytest.mark.parametrize("value", [1.7e308, -1e9])
def test_what_is_out_of_range_is_clamped(simulated: Simulated, value: float) -> None:
    simulated.enable()
    simulated.board.events()
    simulated.drive(0.6, (value, 0.0, 0.0))
    alone = simulated.board.events()
    assert simulated.board.wheels()[0] == pytest.approx(MAX_RPS if value > 0 else -MAX_RPS, rel=0.01)
    assert all(within_limits(event) for event in alone if event.is_motor)
    simulated.drive(0.6, (value, value, value))
    # All three add up on one wheel: 0.2 + 0.2 m/s and 1 rad/s at 0.174 m.
    most = (0.4 + 0.1744) / 0.2 * MAX_RPS
    events = [event for event in simulated.board.events() if event.is_motor]
    assert all(abs(speed) <= most and not event.wild for event in events for speed in event.speeds)
    assert simulated.robot.state.estop is None


def test_records_of_another_run(trial: Trial) -> None:
    watch = Watch(trial)
    trial.enable()
    with hostile(trial, "other_run") as client:
        client.says()
        trial.board.events()
        trial.drive(0.3)
        assert trial.robot.state.enabled, "its disable was not heard"
        assert trial.robot.state.estop is None, "nor its commands"
        goes_on(trial)
    watch.holds()


def test_a_session_played_back_after_its_end(trial: Trial) -> None:
    trial.enable()
    trial.drive(0.3)
    with hostile(trial, "replay", 0) as client, Robot(trial.name, client="observer") as observer:
        client.says()
        goes_on(trial)
        trial.leave()
        assert client.says() == "True", "it has the claim"
        played_ns = time.monotonic_ns()
        until_s = time.monotonic() + 0.5
        while time.monotonic() < until_s:  # while it plays back
            assert observer.state.clients == ()
            assert observer.state.enabled
            time.sleep(0.005)
    assert not any(event.is_motion and event.arrival_ns > played_ns for event in trial.board.events())


# Scribbling, truncating, removing.


@pytest.mark.claim("MEMORY-1")
def test_scribbling_over_slots(two_sources: Trial) -> None:
    """Over the velocities of the client that drives, over a slot of its own, over everyone's: nothing moves that should
    not, and nobody of the service dies."""
    trial, watch = two_sources, Watch(two_sources)
    trial.enable()
    garbled(trial)
    scribbled_in_its_own(trial)
    watch.holds()
    scribbled_everywhere(trial)
    watch.holds()


def garbled(trial: Trial) -> None:
    trial.drive(0.5)
    trial.board.events()
    with hostile(trial, "garble", 0) as client:
        client.says()
        trial.drive(0.6)
        assert trial.robot.state.estop is None
    events = [event for event in trial.board.events() if event.is_motor]
    assert len(events) >= 3
    assert all(forward_or_still(event) for event in events)
    # A garbled command that counted would slow the wheels down along the ramp until the next one.
    speeds = [event.speeds[0] for event in events]
    assert all(after == 0 or after > before - 1e-5 for before, after in itertools.pairwise(speeds))
    goes_on(trial)  # a whole command counts again


def scribbled_in_its_own(trial: Trial) -> None:
    with hostile(trial, "scribble") as client:
        client.says()
        trial.board.events()
        trial.drive(1.0)
        goes_on(trial)  # in another slot, of another source
        assert trial.robot.state.estop is None
    events = [event for event in trial.board.events() if event.is_motor]
    assert all(forward_or_still(event) for event in events)


def scribbled_everywhere(trial: Trial) -> None:
    with hostile(trial, "scribble", *range(layout.CLIENT_SLOTS)) as client:
        client.says()
        trial.drive(1.0)
    events = [event for event in trial.board.events() if event.is_motor]
    assert all(forward_or_still(event) for event in events)
    trial.leave()
    trial.board.wait_wheels(turning=False, timeout_s=5.0)
    with pytest.raises(FailstopError, match="8 of them damaged by a client: restart the service"):
        Client(trial.name, "late")


def halted(trial: Trial) -> str:
    """The latch, or that motion is disabled."""
    state = trial.robot.state
    return state.estop or ("" if state.enabled else "disabled")


def test_a_slot_s_memory_of_another_size_and_one_without_a_name(fresh: Trial) -> None:
    watch = Watch(fresh)
    for damaged, size in enumerate((0, 200, 1 << 40)):
        slot = damaged + 1
        drives_again(fresh)
        with hostile(fresh, "resize", size) as client:
            assert int(client.says()) == slot
            fresh.drive(0.1)
            if size > 1000:
                assert latched(fresh).startswith("multiple cmd_vel publishers: "), "it is a client like any other"
            else:
                wait_for("the gate to see it", lambda: len(fresh.robot.state.clients) == 1)
                # A gate that is held up may greet it before the cut and find its command after it: then that counts,
                # and so does its end where the other's command was late.
                wait_for("the wheels to turn, or that", lambda: fresh.drive(0.02) or fresh.turning() or halted(fresh))
                assert halted(fresh) in ("", "disabled") or halted(fresh).startswith("multiple cmd_vel publishers: ")
        later = Client(fresh.name, "later")
        assert later.slot == (slot if size > 1000 else slot + 1), "the damaged slot is passed over"
        later.close()
    drives_again(fresh)
    os.unlink(segments.path_of(run(fresh.name)[0], f"client.{slot}"))
    later = Client(fresh.name, "later")
    assert later.slot == slot + 1, "so is one whose name the service's own user has removed"
    later.close()
    watch.holds()


@pytest.mark.skipif(os.getuid() != 0, reason="needs root to become another user")
def test_nothing_can_be_removed_or_replaced_by_the_group(fresh: Trial) -> None:
    fresh.enable()
    before = sorted(os.listdir(instance.find(fresh.name)))
    with hostile(fresh, "vandal") as client:
        assert int(client.says()) > len(layout.SEGMENTS) + 3
        done = set(client.says().split(", "))
    # Its own slots' memory and the claims' content are the group's to write; neither can hurt.
    assert done <= {f"truncate failstop.{run(fresh.name)[0]}.client.{i}" for i in range(layout.CLIENT_SLOTS)} | {
        "truncate claims"
    }
    assert sorted(os.listdir(instance.find(fresh.name))) == before
    fresh.leave()
    fresh.board.wait_wheels(turning=False, timeout_s=5.0)


def test_names_removed_by_the_service_s_own_user(fresh: Trial) -> None:
    directory = instance.find(fresh.name)
    fresh.enable()
    fresh.drive(0.1)
    os.unlink(instance.bell_path(directory))
    os.unlink(instance.claims_path(directory))
    goes_on(fresh)  # who is connected
    with pytest.raises(FailstopError, match="is going away"):
        Client(fresh.name, "late")
    fresh.robot.estop("still heard")
    assert "still heard" in latched(fresh)


# Flooding.


@pytest.mark.parametrize("words", [("ring",), ("flood", "bell")], ids=["ring", "bell"])
def test_floods_of_the_bell(trial: Trial, words: tuple[str, ...]) -> None:
    watch = Watch(trial)
    trial.enable()
    with hostile(trial, "stops") as asker, hostile(trial, *words) as flood:
        asker.says()
        flood.says()
        goes_on(trial)
        watch.stop_arrives(asker)
    watch.holds()
    drives_again(trial)


def test_a_flood_of_the_stop_pipe(trial: Trial) -> None:
    watch = Watch(trial)
    trial.enable()
    trial.drive(0.2)
    trial.board.events()
    begun_ns = time.monotonic_ns()
    with hostile(trial, "flood", "stop") as flood:
        flood.says()
        trial.board.wait_for(lambda one: one.is_stop and one.arrival_ns >= begun_ns, 10.0)
        latched(trial)
        trial.drive(0.1)
        assert not trial.turning()
    wait_for("the last of it to be heard", lambda: not unheard(trial.name))
    watch.holds()
    drives_again(trial)


def test_a_flood_of_disabling_does_not_flood_the_wire(trial: Trial) -> None:
    trial.enable()
    trial.drive(0.2)
    with hostile(trial, "disable_flood") as flood:
        flood.says()
        flood.says()
        trial.drive(0.1)
        before = trial.board.info()["executed"]
        trial.drive(0.5)
        # The repeats of the last burst, and a zero five times a second.
        assert trial.board.info()["executed"] - before < 50


def test_a_flood_of_commands_of_an_unknown_source_does_not_flood_the_log(trial: Trial) -> None:
    trial.enable()
    with hostile(trial, "unknown_source") as flood:
        flood.says()
        flood.says()
        goes_on(trial)
    assert 0 < trial.service.said().count("no source 'nowhere'") < 50


def test_nobody_drives_in_the_gamepad_s_place(trial: Trial) -> None:
    """The gamepad is above every source: an impostor would have the wheels at once."""
    trial.enable()
    with hostile(trial, "as_the_gamepad") as impostor:
        impostor.says()
        trial.drive(0.4, (-0.1, 0.0, 0.0))
        goes_on(trial, (-0.1, 0.0, 0.0))
        assert trial.robot.state.sources[0].source == "cmd_vel"
    assert not any(event.is_motor and event.speeds[0] > 0 for event in trial.board.events())
    assert "the source 'gamepad' is the board's gamepad alone" in trial.service.said()


# Hoarding.


@pytest.mark.parametrize("program", ["hold_all", "claim_bytes"])
def test_all_slots_held_by_one_that_hangs(trial: Trial, program: str) -> None:
    """A further client is told; a stop is heard; and all is free when the hoarder dies."""
    trial.enable()
    with hostile(trial, program) as hoarder:
        assert int(hoarder.says()) == layout.CLIENT_SLOTS - 1
        os.kill(hoarder.pid, signal.SIGSTOP)
        with pytest.raises(FailstopError, match=r"all 8 client slots .* are taken.*close a client"):
            Client(trial.name, "one too many")
        goes_on(trial)  # who has a slot
        with hostile(trial, "stops") as asker:
            asker.says()
            Watch(trial).stop_arrives(asker)
        hoarder.kill()
    Client(trial.name, "after it").close()
    drives_again(trial)


def test_a_lock_on_the_whole_claims_file(trial: Trial) -> None:
    trial.enable()
    trial.drive(0.1)
    with hostile(trial, "lock_everything") as locker:
        assert locker.says() == "EAGAIN", "the driver's claim is in its way"
    trial.leave()
    with hostile(trial, "lock_everything") as locker:
        assert locker.says() == "locked"
        with pytest.raises(FailstopError, match="all 8 client slots"):
            Client(trial.name, "late")
        with Robot(trial.name, client="observer") as observer:
            assert observer.state.clients == ()
            observer.estop("still heard")
            wait_for("the latch", lambda: observer.state.estop is not None)
    drives_again(trial)


def test_a_claim_that_another_takes_over_at_once(trial: Trial) -> None:
    trial.enable()
    trial.drive(0.2)
    with hostile(trial, "heir", 0) as heir:
        heir.says()
        goes_on(trial)
        trial.leave()
        heir.says()
        # No news of the driver's leaving: the command timeout is what is left.
        trial.board.wait_wheels(turning=False, timeout_s=5.0)
    drives_again(trial)
