"""Clients that die, scribble, flood and hoard: the wheels do what they should or stand, and the service and everyone
else's stop are unaffected. Other acts of theirs are rows of tests/faults."""

from __future__ import annotations

import contextlib
import fcntl
import itertools
import os
import random
import signal
import struct
import subprocess
import sys
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

import pytest

from failstop import FailstopError, Robot
from failstop.api.client import Client, send_stop
from failstop.files import instance
from failstop.messages import layout, records, segments
from failstop.shm import claim
from failstop.shm.segment import HEADER_BYTES
from failstop.supervisor import status
from failstop_lab.sim.client import Event
from failstop_lab.sim.model import Frame
from failstop_lab.trial import Trial, wait_for, write_settings
from tests.support.amounts import amount
from tests.support.pages import ROOT
from tests.support.shared_trial import IMU_HZ, goes_on
from tests.support.simulated import Simulated

KILLS = amount(60, 1000)
LONGEST_S = 30.0
MAX_RPS = 0.2 / (0.08 * 3.141592653589793) * 1.001


class Hostile:
    """One running program of hostile.py."""

    def __init__(self, process: subprocess.Popen[str]) -> None:
        self._process = process

    def says(self) -> str:
        """The next line that it says."""
        assert self._process.stdout is not None
        line = self._process.stdout.readline()
        assert line, "it has ended"
        return line.strip()

    def asks(self) -> str:
        """Send it a line, return its answer."""
        assert self._process.stdin is not None
        self._process.stdin.write("\n")
        self._process.stdin.flush()
        return self.says()


@contextlib.contextmanager
def hostile(trial: Trial, program: str, *words: object) -> Iterator[Hostile]:
    """A program of hostile.py that has begun; it is killed at the end. Nobody of the service dies, nor is killed for
    being late."""
    pids = trial.service.pids()
    command = [sys.executable, "-m", "tests.e2e.hostile", program, trial.name, *map(str, words)]
    with subprocess.Popen(command, cwd=ROOT, stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True) as process:
        # So that a test which waits for a line in vain fails.
        late = threading.Timer(LONGEST_S, process.kill)
        late.start()
        try:
            found = Hostile(process)
            found.says()
            yield found
        finally:
            late.cancel()
            process.kill()
    assert (trial.service.pids(), trial.robot.state.waiting_for) == (pids, None)


def within_limits(event: Event | Frame) -> bool:
    """No wheel faster than it may be, nothing written past the motor table."""
    return not event.wild and all(abs(speed) <= MAX_RPS for speed in event.speeds)


def forward_or_still(event: Event) -> bool:
    """Wheels that turn as vx > 0 alone turns them, or stand; a speed may differ in its last place
    (codec.motor_speeds)."""
    forward = [speed * sign for speed, sign in zip(event.speeds, (1, 1, -1, -1), strict=True)]
    return within_limits(event) and min(forward) >= 0 and max(forward) - min(forward) < 1e-5


def drives_again(trial: Trial) -> None:
    """Reset, enable, and the wheels turn. The death of a driver that a busy service notices only after the enable
    disables motion once more."""

    def enabled() -> bool:
        with contextlib.suppress(FailstopError):
            trial.enable()
            return True
        return False

    def turns() -> bool:
        if trial.robot.state.enabled or enabled():
            trial.drive(0.05)
        return trial.turning()

    wait_for("a motion enable", enabled)
    wait_for("the wheels to turn", turns)


# With real processes: memory that is torn, and pipes that are full.


@pytest.mark.slow
def test_clients_killed_in_any_call_damage_nothing(trial: Trial) -> None:
    dice = random.Random(7)
    claims = claim.open_claims(instance.claims_path(instance.find(trial.name)))
    trial.enable()
    with hostile(trial, "nursery") as nursery:
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
    drives_again(trial)


@pytest.mark.claim("MEMORY-1")
def test_scribbling_over_slots(name: str, tmp_path: Path) -> None:
    """Over the velocities of the client that drives, over a slot of its own, over everyone's: nothing moves that should
    not, and nobody of the service dies."""
    config = tmp_path / "two-sources.toml"
    write_settings(str(config), {"sources.nav.priority": 10, status.LEASE: status.LEASE_WITHOUT_S})
    with Trial(name, ("--config", str(config)), imu_hz=IMU_HZ) as trial:
        trial.enable()
        trial.drive(0.5)
        trial.board.events()
        events = scribbled(trial, "garble", 0)
        assert len(events) >= 3
        # A garbled command that counted would slow the wheels down along the ramp until the next one.
        speeds = [event.speeds[0] for event in events]
        assert all(after == 0 or after > before - 1e-5 for before, after in itertools.pairwise(speeds))
        goes_on(trial)  # a whole command counts again
        scribbled(trial, "scribble")
        goes_on(trial)  # in another slot, of another source
        assert trial.robot.state.estop is None
        scribbled(trial, "scribble", *range(layout.CLIENT_SLOTS))
        trial.leave()
        trial.board.wait_wheels(turning=False, timeout_s=5.0)
        with pytest.raises(FailstopError, match="8 of them damaged by a client: restart the service"):
            Client(trial.name, "late")


def scribbled(trial: Trial, program: str, *words: object) -> list[Event]:
    """The motor frames while that program scribbles and the trial's client drives."""
    with hostile(trial, program, *words):
        trial.drive(1.0)
    events = [event for event in trial.board.events() if event.is_motor]
    assert all(forward_or_still(event) for event in events)
    return events


def test_a_flood_of_the_bell_keeps_no_stop_away(trial: Trial) -> None:
    trial.enable()
    with hostile(trial, "flood"):
        goes_on(trial)
        trial.board.events()
        asked_ns = time.monotonic_ns()
        send_stop(trial.name, "somebody else")
        trial.board.wait_for(lambda one: one.is_stop and one.arrival_ns >= asked_ns, 10.0)
        wait_for("the latch", lambda: trial.robot.state.estop is not None)
    drives_again(trial)


def test_a_lock_on_the_whole_claims_file_keeps_no_stop_away(trial: Trial) -> None:
    whole = struct.pack("hhqqi4x", fcntl.F_WRLCK, os.SEEK_SET, 0, 0, 0)
    fd = claim.open_claims(instance.claims_path(instance.find(trial.name)))
    trial.enable()
    with pytest.raises(BlockingIOError):  # the driver's claim is in its way
        fcntl.fcntl(fd, fcntl.F_OFD_SETLK, whole)
    trial.leave()
    fcntl.fcntl(fd, fcntl.F_OFD_SETLK, whole)
    with pytest.raises(FailstopError, match="all 8 client slots"):
        Client(trial.name, "late")
    with Robot(trial.name, client="observer") as observer:
        assert observer.state.clients == ()
        observer.estop("still heard")
        observer.wait_for("latched", 10.0)
    os.close(fd)
    drives_again(trial)


# On the simulated machine.


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


class Group:
    """Files of a simulated service that a member of the group may open."""

    def __init__(self, simulated: Simulated) -> None:
        self.on, self._load, self._simulated = simulated.os, simulated.load, simulated
        self.directory = f"/run/failstop/{simulated.name}"
        self.claim = self._load("failstop.shm.claim")

    def path(self, index: int) -> str:
        """The memory of a slot."""
        return segments.path_of(self._load("failstop.api.client").run(self._simulated.name)[0], f"client.{index}")

    def slot(self, index: int) -> int:
        found: int = self.on.open(self.path(index), os.O_RDWR)
        return found

    def claims(self) -> int:
        found: int = self.claim.open_claims(f"{self.directory}/claims")
        return found

    def client(self, who: str) -> Any:
        """A client that is not a Robot."""
        return self._load("failstop.api.client").Client(self._simulated.name, who)


@pytest.fixture
def group(simulated: Simulated) -> Group:
    return Group(simulated)


def test_a_session_played_back_after_its_end_moves_nothing(simulated: Simulated, group: Group) -> None:
    simulated.set_off()
    (driver,) = simulated.robot.state.clients
    fd, claims = group.slot(driver.slot), group.claims()
    memory = group.on.pread(fd, layout.SEGMENT_BY_NAME["client.0"].size, 0)
    bell = simulated.load("failstop.shm.bell")
    to_bell = bell.open_pipe_to_write(f"{group.directory}/bell")
    with simulated.failstop.Robot(client="observer") as observer:
        simulated.leave()
        simulated.wait(0.1)
        simulated.board.events()
        assert group.claim.acquire(claims, driver.slot)
        for _ in range(25):
            group.on.pwrite(fd, memory, 0)
            bell.send(to_bell, bytes([driver.slot]))
            simulated.wait(0.02)
            assert (observer.state.clients, observer.state.enabled) == ((), True)
    assert not any(event.is_motion for event in simulated.board.events())


DAMAGE: dict[str, Callable[[Group], object]] = {
    "a head of zeros": lambda group: group.on.pwrite(group.slot(0), bytes(HEADER_BYTES), 0),
    "no byte": lambda group: group.on.ftruncate(group.slot(0), 0),
    "a part": lambda group: group.on.ftruncate(group.slot(0), 200),
    "no name": lambda group: group.on.unlink(group.path(0)),
}


@pytest.mark.parametrize("damage", DAMAGE)
def test_a_damaged_slot_is_passed_over(simulated: Simulated, group: Group, damage: str) -> None:
    DAMAGE[damage](group)
    simulated.set_off()
    assert simulated.robot.state.clients[0].slot == 1


def test_who_is_connected_drives_on_without_bell_and_claims(simulated: Simulated, group: Group) -> None:
    simulated.set_off()
    for name in ("bell", "claims"):
        group.on.unlink(f"{group.directory}/{name}")
    simulated.drive(0.3)
    assert simulated.turning()
    with pytest.raises(simulated.failstop.FailstopError, match=r"is ending: try again$"):
        group.client("late")
    simulated.robot.estop("still heard")
    simulated.robot.wait_for("latched", 1.0)


def test_a_flood_of_disabling_is_no_flood_of_the_wire(simulated: Simulated, group: Group) -> None:
    simulated.set_off()
    disabler = group.client("disabler")
    for _ in range(1000):
        disabler.ask(records.DISABLE)
        simulated.wait(0.0002)
    assert not simulated.robot.state.enabled
    # A burst has four frames, and one goes out every 20 ms; twice as many with their repeats.
    assert len(simulated.board.events()) <= 2 * 4 * 10
    simulated.drive(0.5)
    assert len(simulated.board.events()) < 50, "the repeats of the last burst, and a zero five times a second"


@pytest.mark.parametrize("greets", [True, False])
def test_slots_that_one_program_hoards_are_free_when_it_dies(simulated: Simulated, group: Group, greets: bool) -> None:
    """A further client is told, who has a slot drives on, and a stop is heard."""
    held: list[object] = []

    def hoard(_: object) -> None:
        claims = group.claims()
        held.extend(
            group.client(f"filler {index}") if greets else group.claim.acquire(claims, index)
            for index in range(1, layout.CLIENT_SLOTS)
        )
        simulated.wait(100.0)

    simulated.set_off()
    hoarder = simulated.program("hoarder.py", hoard)
    simulated.drive(0.2)
    assert (all(held), len(held), simulated.turning()) == (True, layout.CLIENT_SLOTS - 1, True)
    code, _, err = simulated.command("enable")
    assert (code, err.count("\n")) == (1, 1)
    assert "all 8 client slots" in err
    assert "close a client" in err
    assert simulated.command("estop", "even", "so")[0::2] == (0, "")
    simulated.lab.machine.die(hoarder, -9)
    simulated.wait(0.1)
    assert simulated.command("reset")[0] == 0


def test_a_claim_that_another_takes_over_at_once_drives_nothing(simulated: Simulated, group: Group) -> None:
    """No news of the driver's leaving: the command timeout is what is left."""
    simulated.set_off()
    (driver,) = simulated.robot.state.clients

    def inherit(_: object) -> None:
        claims = group.claims()
        while not group.claim.acquire(claims, driver.slot):
            simulated.wait(0.00001)
        simulated.wait(100.0)

    simulated.program("heir.py", inherit)
    simulated.drive(0.1)
    simulated.leave()
    simulated.board.wait_wheels(turning=False, timeout_s=0.35)
