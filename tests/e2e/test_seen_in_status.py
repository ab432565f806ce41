"""Every block reason, every trip and every refusal as `failstop status --json` shows it, and the stop as the board saw
it. One service for all of them."""

from __future__ import annotations

import itertools
import json
import os
import signal
import subprocess
import sys
import time
from collections.abc import Iterator

import pytest

from failstop import Robot, TimedOut, instances
from failstop.lab.trial import Trial, wait_for
from failstop.shm import instance, layout

from .seen import EVERY_S, FORWARD, LATEST_MS, Seen, is_zero, latched, pid_of, stopped

CONFIG = """
[restart]
deaths = 100000
backoff_s = 0.001
[interlocks.arm]
timeout_s = 2.0
refusal = "arm is not in the drive pose"
"""


@pytest.fixture(scope="module")
def service(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Trial]:
    config = tmp_path_factory.mktemp("seen") / "seen.toml"
    config.write_text(CONFIG)
    with Trial(f"e2e-{os.getpid()}-seen", ("--config", str(config))) as running:
        yield running


@pytest.fixture
def seen(service: Trial) -> Iterator[Seen]:
    yield Seen(service)
    service.board.pad_silent()
    service.leave()


# Block reasons.


def test_nothing_blocks(seen: Seen) -> None:
    seen.enable()
    seen.trial.drive(0.5)
    found = seen.status(each=seen.command_on)
    assert (found["enabled"], found["estop"], found["blocked"]) == (True, None, None)
    assert found["body_vel"] == pytest.approx(FORWARD)
    assert [(row["source"], row["state"]) for row in found["sources"]] == [("cmd_vel", "drives")]
    assert 0 <= found["scan_age_s"] < 0.5


def test_estop(seen: Seen) -> None:
    seen.enable()
    code, out, _ = seen.command("estop", "hand", "near", "wheel")
    assert code == 0
    found = seen.status()
    assert found["estop"].startswith("stop request: hand near wheel (failstop estop, pid ")
    assert found["estop"] in out
    latched(found, found["estop"])


def test_disabled(seen: Seen) -> None:
    seen.set_off()
    asked_ns = time.monotonic_ns()
    assert seen.trial.robot.disable() == "motion disabled"
    seen.trial.drive(0.1)
    stopped(seen, asked_ns)
    found = seen.status()
    assert (found["enabled"], found["estop"], found["blocked"]) == (False, None, "disabled")


def test_cmd_timeout(seen: Seen) -> None:
    """The deadman: the zero frame comes 0.3 s after the last command."""
    seen.set_off()
    last_ns = time.monotonic_ns()
    seen.command_on()
    zero = seen.trial.board.wait_for(lambda event: is_zero(event) and event.arrival_ns > last_ns, 2.0)
    assert 300e6 <= zero.arrival_ns - last_ns < 1000e6
    found = seen.status()
    assert (found["enabled"], found["estop"], found["blocked"]) == (True, None, "cmd timeout")
    assert found["body_vel"] == [0.0, 0.0, 0.0]


def test_no_scan(seen: Seen) -> None:
    """The sensor is silent, the client goes on: zero 0.5 s after the last delivery, and motion again by itself."""
    seen.set_off()
    seen.trial.robot.sensed()
    silent_ns = time.monotonic_ns()

    def command_alone() -> None:
        seen.trial.robot.drive(*FORWARD)

    while time.monotonic_ns() < silent_ns + 700_000_000:
        command_alone()
        time.sleep(EVERY_S)
    found = seen.status(each=command_alone)
    assert (found["enabled"], found["estop"], found["blocked"]) == (True, None, "no scan")
    assert found["body_vel"] == [0.0, 0.0, 0.0]
    assert found["scan_age_s"] > 0.5
    zero = next(event for event in seen.trial.board.events() if is_zero(event))
    assert 400e6 < zero.arrival_ns - silent_ns < 650e6
    seen.trial.drive(0.2)
    assert seen.trial.moving()
    assert seen.status(each=seen.command_on)["blocked"] is None


@pytest.mark.parametrize("blocked", ["estop: stop request: a test", "disabled", "cmd timeout"])
def test_zero_frames_go_out_at_5_hz_whatever_blocks(seen: Seen, blocked: str) -> None:
    seen.enable()
    if blocked == "disabled":
        seen.trial.robot.disable()
    elif blocked != "cmd timeout":
        seen.trial.robot.estop("a test")
    wait_for("the block", lambda: (seen.trial.robot.state.blocked or "").startswith(blocked))
    assert seen.status()["blocked"].startswith(blocked)
    seen.trial.board.events()
    since_ns = time.monotonic_ns()
    seen.trial.board.wait_for(lambda event: is_zero(event) and event.arrival_ns > since_ns + 800_000_000, 3.0)
    motor = [event for event in seen.trial.board.events() if event.is_motor]
    assert all(map(is_zero, motor))
    assert all(after.arrival_ns - before.arrival_ns < 400e6 for before, after in itertools.pairwise(motor))
    assert len(motor) >= 3


# Noticer.


def test_a_stop_request(seen: Seen) -> None:
    seen.set_off()
    asked_ns = time.monotonic_ns()
    seen.trial.robot.estop("a hand")
    seen.trial.drive(0.2)
    stopped(seen, asked_ns)
    latched(seen.status(), f"stop request: a hand (trial, pid {os.getpid()})")


@pytest.mark.parametrize("value", [float("nan"), float("inf")])
def test_a_command_that_is_not_finite(seen: Seen, value: float) -> None:
    """Past the client's own check, as a program in another language might."""
    seen.set_off()
    sent_ns = time.monotonic_ns()
    seen.trial.robot._client().command(0.0, value, 0.0, manual=False, source="cmd_vel")
    wait_for("the latch", lambda: seen.trial.robot.state.estop is not None)
    seen.trial.drive(0.2)
    stopped(seen, sent_ns)
    latched(seen.status(), f"command from trial (pid {os.getpid()}) is not finite")


def test_a_second_publisher(seen: Seen) -> None:
    seen.set_off()
    with Robot(seen.trial.name, client="rival") as rival:
        sent_ns = time.monotonic_ns()
        rival.drive(0.1, 0.0, 0.0)
        seen.trial.drive(0.2)
        stopped(seen, sent_ns)
        found = seen.status()
    who = f"trial (pid {os.getpid()}), rival (pid {os.getpid()})"
    latched(found, f"multiple cmd_vel publishers: {who}")
    assert {client["name"] for client in found["clients"]} == {"trial", "rival"}


def test_a_gamepad_button(seen: Seen) -> None:
    """One frame, as real taps are."""
    seen.set_off()
    pressed_ns = time.monotonic_ns()
    seen.trial.board.pad(0x0100)
    seen.trial.drive(0.2)
    stopped(seen, pressed_ns)
    found = seen.status()
    latched(found, "gamepad button 0x0100")
    assert found["pad_mode"] == "locked"


def test_a_board_key(seen: Seen) -> None:
    seen.set_off()
    pressed_ns = time.monotonic_ns()
    seen.trial.board.key(1, 0x01)
    seen.trial.drive(0.2)
    stopped(seen, pressed_ns)
    latched(seen.status(), "key1")


def test_the_death_of_the_driving_client_stops_at_once_and_disables_motion(seen: Seen) -> None:
    seen.enable()
    code = (
        f"from failstop import Robot\nimport time\nwith Robot({seen.trial.name!r}, client='mortal') as r:\n"
        "    while True: r.sensed(); r.drive(0.2, 0, 0); time.sleep(0.02)"
    )
    client = subprocess.Popen([sys.executable, "-c", code])
    try:
        seen.trial.board.wait_for(lambda event: event.is_motion and event.speeds[0] > 0.3, 10.0)
        killed_ns = time.monotonic_ns()
    finally:
        client.send_signal(signal.SIGKILL)
        client.wait()
    zero = seen.trial.board.wait_for(lambda event: is_zero(event) and event.arrival_ns > killed_ns, 2.0)
    assert zero.arrival_ns - killed_ns < LATEST_MS * 1e6, "long before the command timeout"
    found = seen.status()
    assert (found["enabled"], found["estop"], found["blocked"]) == (False, None, "disabled")
    assert found["sources"] == []
    assert "mortal" not in [client["name"] for client in found["clients"]]


@pytest.mark.parametrize("process", [name for name in layout.PROCESSES if name != layout.SUPERVISOR])
def test_the_death_of_a_process(seen: Seen, process: str) -> None:
    seen.enable()
    before = seen.status()
    killed = seen.trial.kill(process)
    assert killed.was_moving
    assert killed.stop_ns is not None
    assert killed.stop_ns < LATEST_MS * 1e6
    assert killed.motion_after == 0
    seen.trial.recover(process, pid_of(before, process))
    found = seen.status()
    latched(found, f"{process} died")
    assert pid_of(found, process) != pid_of(before, process)
    row = found["processes"][process]
    assert row["restarts"] == before["processes"][process]["restarts"] + 1
    assert (row["state"], row["last_exit"]) == ("running", "killed by SIGKILL")
    assert 0 <= row["age_s"] < 1


def test_the_death_of_the_supervisor(seen: Seen) -> None:
    """Once its last process has ended, the service is gone and says so; the one that is started then is disabled."""
    before = seen.status()
    seen.enable()
    killed = seen.trial.kill(layout.SUPERVISOR)
    assert killed.was_moving
    assert killed.stop_ns is not None
    assert killed.stop_ns < LATEST_MS * 1e6
    assert killed.motion_after == 0
    wait_for("the last process to end", lambda: not any(map(instances.running, instance.places(seen.trial.name))), 5.0)
    code, out, err = seen.command("status", "--json")
    assert (code, out) == (3, "")
    assert "supervisor died" in err
    assert "next: `failstop run" in err
    seen.trial.recover(layout.SUPERVISOR, pid_of(before, layout.SUPERVISOR))
    found = seen.status()
    assert (found["enabled"], found["blocked"]) == (False, "disabled")
    assert pid_of(found, layout.SUPERVISOR) != pid_of(before, layout.SUPERVISOR)


def test_the_first_cause_is_kept_and_a_reset_clears_the_latch_alone(seen: Seen) -> None:
    seen.set_off()
    seen.trial.board.key(1, 0x01)
    wait_for("the latch", lambda: seen.trial.robot.state.estop is not None)
    epoch = seen.trial.robot.state.epoch
    seen.trial.board.pad(0x0200)
    wait_for("the second stop", lambda: seen.trial.robot.state.epoch > epoch)
    assert seen.status()["estop"] == "key1"
    assert seen.command("reset") == (0, "latched stop cleared (was: key1); motion still disabled\n", "")
    found = seen.status(each=seen.command_on)
    assert (found["enabled"], found["estop"], found["blocked"]) == (False, None, "disabled")
    assert not seen.trial.moving()


# Refusals.


def test_enable_is_refused_while_latched(seen: Seen) -> None:
    seen.trial.board.key(1, 0x01)
    wait_for("the latch", lambda: seen.trial.robot.state.estop is not None)
    reason = seen.status()["estop"]
    steps = [f"`failstop {verb} --name {seen.trial.name}`" for verb in ("reset", "enable")]
    refused = f"failstop: refused: a stop is latched ({reason}); next: {steps[0]}, then {steps[1]}"
    assert seen.refused("enable").startswith(refused)
    assert seen.refused("drive", "0.1", "0", "0") == refused
    assert seen.status()["blocked"] == f"estop: {reason}"
    assert not seen.trial.moving()


def test_enable_is_refused_without_the_interlock(seen: Seen) -> None:
    """Nobody asserts it any more: its loss disables, and then enabling is refused."""
    seen.enable()
    wait_for("the interlock to lapse", lambda: not seen.trial.robot.state.enabled)
    todo = ["see to the interlock (arm is not in the drive pose)", f"`failstop enable --name {seen.trial.name}`"]
    refused = seen.refused("enable")
    assert refused == f"failstop: refused: arm is not in the drive pose; next: see to that interlock, then {todo[1]}"
    assert json.loads(seen.command("why", "--json")[1])["do"] == todo
    with pytest.raises(TimedOut, match=r"see to the interlock \(arm is not in the drive pose\)"):
        seen.trial.robot.wait_for("ready", 0.0)
    found = seen.status()
    assert (found["enabled"], found["estop"], found["blocked"]) == (False, None, "disabled")


def test_drive_is_refused_while_disabled(seen: Seen) -> None:
    seen.enable()
    seen.trial.robot.disable()
    refusal = f"failstop: refused: motion is disabled; next: `failstop enable --name {seen.trial.name}`"
    assert seen.refused("drive", "0.1", "0", "0") == refusal
    assert seen.status()["blocked"] == "disabled"
    assert not seen.trial.moving()


def test_enable_is_refused_while_the_port_is_gone(seen: Seen) -> None:
    """A latch for the loss first; its reset does not bring the port back."""
    seen.set_off()
    seen.trial.board.unplug()
    try:
        wait_for("the latch", lambda: seen.trial.robot.state.estop is not None)
        found = seen.status()
        latched(found, "device lost")
        assert found["device"]["state"] == "lost"
        assert seen.command("reset")[0] == 0
        assert seen.refused("enable").startswith("failstop: refused: not ready: ")
        assert seen.status()["blocked"] == "disabled"
    finally:
        back_ns = time.monotonic_ns()
        seen.trial.board.replug()
    assert seen.trial.board.wait_for(lambda event: event.is_motor and event.arrival_ns > back_ns, 3.0).is_stop
    wait_for("a service that is whole", lambda: seen.trial.robot.state.waiting_for is None)
    assert not seen.trial.moving()
    assert seen.status()["device"]["state"] == "open"


# What else it tells.


def test_a_variance_comes_with_what_is_measured(seen: Seen) -> None:
    wait_for("a sample", lambda: seen.trial.robot.state.imu is not None)
    found = seen.status()
    assert found["imu"]["rate_variance"] == pytest.approx(0.0012**2)
    assert found["odometry"]["pose_variance"] == 1e3
