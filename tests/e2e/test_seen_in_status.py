"""Every trip and every refusal as `failstop status --json` shows it, and the stop as the board saw it, on a simulated
machine."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from failstop.lab.stopped import judge
from failstop.messages import layout
from failstop.policy import causes
from tests.support.simulated import FORWARD, MS, Simulated


def latched(found: dict[str, Any], reason: str) -> None:
    """Status says it in each of its places."""
    assert found["estop"] == reason
    assert found["blocked"] == f"estop: {reason}"
    assert found["enabled"] is False
    assert found["body_vel"] == [0.0, 0.0, 0.0]
    assert found["last_stop"]["reason"] == reason
    assert found["last_stop"]["cause"] == found["cause"]
    name, arguments = found["cause"]["name"], {key: value for key, value in found["cause"].items() if key != "name"}
    assert str(causes.of(name, arguments)) == reason


def stopped(simulated: Simulated, fault_ns: int, latest_ms: float) -> None:
    """The board: stopped by then, and nothing moved after it."""
    simulated.drive(0.2)
    found = judge(simulated.board.events(), fault_ns, was_turning=True)
    assert found.stop_ns is not None
    assert found.stop_ns <= latest_ms * MS
    assert found.still_ns is not None
    assert found.motion_after == 0
    assert not simulated.turning()


def test_nothing_blocks(simulated: Simulated) -> None:
    simulated.enable()
    simulated.drive(0.5)
    found = simulated.json("status", each=lambda: simulated.lab.drive(simulated.robot, 0.02, FORWARD))
    assert (found["enabled"], found["estop"], found["blocked"]) == (True, None, None)
    assert found["body_vel"] == pytest.approx(FORWARD)
    assert [(row["source"], row["state"]) for row in found["sources"]] == [("cmd_vel", "drives")]
    assert 0 <= found["scan_age_s"] < 0.03


TRIPS: dict[str, tuple[Callable[[Simulated], object], str]] = {
    "a stop request": (lambda it: it.robot.estop("a hand"), "stop request: a hand (trial, pid {pid})"),
    "a gamepad button": (lambda it: it.board.pad(0x0100), "gamepad button 0x0100"),
    "a key": (lambda it: it.board.key(1, 0x01), "key1"),
}


@pytest.mark.parametrize("trip", TRIPS)
def test_a_trip_stops_the_wheels_and_is_shown(simulated: Simulated, trip: str) -> None:
    act, reason = TRIPS[trip]
    simulated.set_off()
    fault_ns = simulated.now_ns()
    act(simulated)
    stopped(simulated, fault_ns, 2)
    latched(simulated.json("status"), reason.format(pid=simulated.pid))
    if trip == "a gamepad button":
        assert simulated.json("status")["pad_mode"] == "locked"


def test_a_second_publisher_is_shown_with_the_first(simulated: Simulated) -> None:
    simulated.set_off()
    with simulated.failstop.Robot(client="rival") as rival:
        sent_ns = simulated.now_ns()
        rival.drive(0.1, 0.0, 0.0)
        stopped(simulated, sent_ns, 21)
        found = simulated.json("status")
    who = f"trial (pid {simulated.pid}), rival (pid {simulated.pid})"
    latched(found, f"multiple cmd_vel publishers: {who}")
    assert {client["name"] for client in found["clients"]} == {"trial", "rival"}


@pytest.mark.parametrize("process", [layout.GATE, layout.STOPPER])
def test_the_death_of_a_process_is_shown(simulated: Simulated, process: str) -> None:
    simulated.enable()
    before = simulated.json("status")
    killed = simulated.kill(process)
    assert killed.was_turning
    assert killed.stop_ns is not None
    assert killed.stop_ns <= 8 * MS
    assert killed.motion_after == 0
    simulated.recover(process, before["processes"][process]["pid"])
    found = simulated.json("status")
    latched(found, f"{process} died")
    row, was = found["processes"][process], before["processes"][process]
    assert row["pid"] != was["pid"]
    assert row["restarts"] == was["restarts"] + 1
    assert (row["state"], row["last_exit"]) == ("running", "killed by SIGKILL")
    assert 0 <= row["age_s"] < 1
    with pytest.raises(simulated.failstop.Refused, match=r"a stop is latched \(.* died\)"):
        simulated.robot.enable()
    simulated.robot.reset()
    assert simulated.robot.state.blocked == "disabled"
    simulated.drive(0.1)
    assert not simulated.turning(), "a reset must not enable motion"
    simulated.robot.enable()
    simulated.drive(0.1)
    assert simulated.turning()


def test_the_death_of_the_supervisor_ends_the_service(simulated: Simulated) -> None:
    """Once its last process has ended, the service is gone and says so; the one that is started then is disabled."""
    simulated.enable()
    before = simulated.json("status")
    killed = simulated.kill(layout.SUPERVISOR)
    assert killed.was_turning
    assert killed.stop_ns is not None
    assert killed.stop_ns <= 8 * MS
    assert killed.motion_after == 0
    simulated.wait_for("the last process to end", lambda: not simulated.living())
    code, out, err = simulated.command("status", "--json")
    assert (code, out) == (3, "")
    assert "supervisor died" in err
    assert "next: `failstop run" in err
    simulated.start()
    found = simulated.json("status")
    assert (found["enabled"], found["blocked"]) == (False, "disabled")
    assert found["processes"]["supervisor"]["pid"] != before["processes"]["supervisor"]["pid"]


def test_the_first_cause_is_kept_and_a_reset_clears_the_latch_alone(simulated: Simulated) -> None:
    simulated.set_off()
    simulated.board.key(1, 0x01)
    simulated.robot.wait_for("latched", 1.0)
    epoch = simulated.robot.state.epoch
    simulated.board.pad(0x0200)
    simulated.wait_for("the second stop", lambda: simulated.robot.state.epoch > epoch)
    assert simulated.json("status")["estop"] == "key1"
    simulated.kill("gate")
    simulated.recover("gate", simulated.pids()["gate"] - 1)
    assert simulated.json("status")["estop"] == "key1", "over a restart of the gate too"
    assert simulated.command("reset") == (0, "latched stop cleared (was: key1); motion still disabled\n", "")
    found = simulated.json("status", each=lambda: simulated.drive(0.02))
    assert (found["enabled"], found["estop"], found["blocked"]) == (False, None, "disabled")
    assert not simulated.turning()


# Refusals.


def test_what_is_refused_while_latched(simulated: Simulated) -> None:
    simulated.board.key(1, 0x01)
    simulated.robot.wait_for("latched", 1.0)
    refused = "failstop: refused: a stop is latched (key1); next: `failstop reset`, then `failstop enable`"
    code, out, err = simulated.command("enable")
    assert (code, out, err.count("\n")) == (2, "", 1)
    assert err.startswith(refused)
    assert simulated.command("drive", "0.1", "0", "0") == (2, "", f"{refused}\n")
    assert simulated.json("status")["blocked"] == "estop: key1"
    assert not simulated.turning()


def test_drive_is_refused_while_disabled(simulated: Simulated) -> None:
    refusal = "failstop: refused: motion is disabled; next: `failstop enable`\n"
    assert simulated.command("drive", "0.1", "0", "0") == (2, "", refusal)
    assert simulated.json("status")["blocked"] == "disabled"
    assert not simulated.turning()


def test_enable_is_refused_while_the_port_is_gone(simulated: Simulated) -> None:
    """A latch for the loss first; its reset does not bring the port back."""
    simulated.set_off()
    simulated.board.unplug()
    simulated.robot.wait_for("latched", 1.0)
    simulated.wait(0.1)
    found = simulated.json("status")
    latched(found, "device lost")
    assert found["device"]["state"] == "lost"
    assert simulated.command("reset")[0] == 0
    code, _, err = simulated.command("enable")
    assert code == 2
    assert err.startswith("failstop: refused: not ready: ")
    assert simulated.json("status")["blocked"] == "disabled"
    simulated.board.events()
    simulated.board.replug()
    assert simulated.board.wait_for(lambda event: event.is_motor).is_stop
    simulated.wait_for("a service that is whole", lambda: simulated.robot.state.waiting_for is None)
    assert not simulated.turning()
    assert simulated.json("status")["device"]["state"] == "open"


def test_a_variance_comes_with_what_is_measured(simulated: Simulated) -> None:
    simulated.wait_for("a sample", lambda: simulated.robot.state.imu is not None)
    found = simulated.json("status")
    assert found["imu"]["rate_variance"] == pytest.approx(0.0012**2)
    assert found["odometry"]["pose_variance"] == 1e3
