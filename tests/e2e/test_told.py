"""Words for people and programs: status, why and the page say what is so, whatever it is, on a simulated machine."""

from __future__ import annotations

import re
from collections.abc import Callable
from math import radians
from typing import Any

import pytest

from failstop.messages import layout
from failstop.policy import causes
from failstop.policy.settings import Settings
from tests.support.simulated import MS, Simulated

# The commands as a user types them.


def test_a_session(simulated: Simulated) -> None:
    assert "blocked: disabled" in simulated.printed("status")
    refused = "failstop: refused: motion is disabled; next: `failstop enable`\n"
    assert simulated.command("drive", "0.1", "0", "0") == (2, "", refused)
    assert simulated.command("enable") == (0, "motion enabled\n", "")
    simulated.board.events()
    assert simulated.command("drive", "0.1", "0", "0", "--for", "0.3")[0] == 0
    assert any(event.is_motion for event in simulated.board.events())
    assert "hand near wheel" in simulated.printed("estop", "hand", "near", "wheel")
    for words in ("enable", "drive 0.1 0 0"):
        code, out, err = simulated.command(*words.split())
        assert (code, out, err.count("\n")) == (2, "", 1)
        assert err.startswith("failstop: refused: a stop is latched (stop request: hand near wheel")
        assert "; next: `failstop reset`, then `failstop enable`" in err
    screen = simulated.printed("status")
    assert "stop latched: stop request: hand near wheel" in screen
    assert "`failstop reset" in screen
    assert "motion still disabled" in simulated.printed("reset")
    assert simulated.printed("disable") == "motion disabled"


def test_status_json_has_what_is_promised(simulated: Simulated) -> None:
    simulated.set_off()
    simulated.robot.estop("for the record")
    simulated.board.wait_for(lambda event: event.is_stop)
    simulated.wait(0.1)
    state = simulated.json("status")
    promised = "name enabled estop blocked body_vel epoch device processes clients last_stop"
    assert set(promised.split()) <= state.keys()
    assert {"path", "state", "link"} <= state["device"].keys()
    assert set(state["processes"]) == {"supervisor", "port_owner", "gate", "telemetry", "stopper"}
    for process in state["processes"].values():
        assert {"pid", "state", "age_s", "restarts"} <= process.keys()
        assert process["state"] == "running"
    assert {"reason", "t", "written_s", "acknowledged_s", "observed_s"} <= state["last_stop"].keys()
    assert state["clients"][0]["name"] == "trial"


def test_without_a_service_each_command_says_how_to_start_it(simulated: Simulated) -> None:
    simulated.leave()
    simulated.end()
    for words in ("status", "enable", "disable", "reset", "drive 0 0 0"):
        code, _, err = simulated.command(*words.split())
        assert (code, err.count("\n")) == (3, 1), words
        assert "start it with `failstop run" in err


def test_a_differential_base_says_that_it_cannot_move_sideways() -> None:
    simulated = Simulated({"wheels.layout": "differential"})
    simulated.enable()
    code, _, err = simulated.command("drive", "0", "0.1", "0")
    assert code == 2
    assert "this base can't move sideways" in err
    assert simulated.command("drive", "0.1", "0", "0.1", "--for", "0.2")[0] == 0


def test_a_drive_that_another_source_has_taken_over_says_so() -> None:
    simulated = Simulated({"sources.teleop.priority": 10})
    simulated.enable()
    simulated.leave()
    with simulated.failstop.Robot(client="person", disable_on_exit=False) as person:
        drives = "drives as teleop, which has priority over cmd_vel"

        def drive() -> None:
            person.drive(0.1, 0.0, 0.0, manual=True, source="teleop", wait_s=0.0)

        drive()
        simulated.wait(0.1)
        drive()
        code, out, err = simulated.command("drive", "0.2", "0", "0", each=drive)
        for _ in range(5):
            drive()
            simulated.wait(0.05)
        assert simulated.turning(), "a command that was refused is no driver that has died"
        assert person.state.enabled
    assert (code, out) == (2, "")
    assert drives in err


def test_a_drive_that_the_board_does_not_obey_is_not_said_to_have_been_driven() -> None:
    simulated = Simulated(deaf=True)
    simulated.enable()
    assert (
        "unproven: the board has never answered; commanded for 0.3 s"
        in simulated.command("drive", "0.1", "0", "0", "--for", "0.3")[1]
    )


@pytest.mark.parametrize("years", [3, -3])
def test_a_clock_that_was_set_gives_no_wrong_age_and_hides_nothing(years: int) -> None:
    simulated = Simulated()
    simulated.set_off()
    simulated.robot.estop("hand near wheel")
    simulated.wait(2.5)
    simulated.lab.machine.unix_ns += years * 365 * 86400 * 10**9
    assert re.search(r"latched since \d\d:\d\d:\d\d, [23]\.\d s ago", simulated.printed("why"))
    assert re.search(r"\(\d\d:\d\d:\d\d, [23]\.\d s ago\)", simulated.printed("status"))
    assert "hand near wheel" in simulated.printed("events", "--since", "1m")
    assert simulated.printed("events", "--since", "9" * 320 + "d") == simulated.printed("events")
    assert re.search(r"since \d\d:\d\d:\d\d, [23]\.\d s ago", str(simulated.robot.why()))
    assert simulated.printed("events", "--since", "1s", "--kind", "stop") == ""


# Trips and refusals.


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


TRIPS: dict[str, tuple[Callable[[Simulated], object], str]] = {
    "a stop request": (lambda it: it.robot.estop("a hand"), "stop request: a hand (says it is trial, pid {pid})"),
    "a gamepad button": (lambda it: it.board.pad(0x0100), "gamepad button 0x0100"),
    "a key": (lambda it: it.board.key(1, 0x01), "key1"),
}


@pytest.mark.parametrize("trip", TRIPS)
def test_a_trip_stops_the_wheels_and_is_shown(simulated: Simulated, trip: str) -> None:
    act, reason = TRIPS[trip]
    simulated.set_off()
    fault_ns = simulated.now_ns()
    act(simulated)
    simulated.drive(0.2)
    simulated.stops(fault_ns, 2)
    latched(simulated.json("status"), reason.format(pid=simulated.pid))
    if trip == "a gamepad button":
        assert simulated.json("status")["pad_mode"] == "locked"


def test_a_second_publisher_is_shown_with_the_first(simulated: Simulated) -> None:
    simulated.set_off()
    with simulated.failstop.Robot(client="rival") as rival:
        sent_ns = simulated.now_ns()
        rival.drive(0.1, 0.0, 0.0)
        simulated.drive(0.2)
        simulated.stops(sent_ns, 21)
        found = simulated.json("status")
    who = f"trial (pid {simulated.pid}), a second Robot in the same program"
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
    simulated.enable()
    simulated.drive(0.1)
    assert simulated.turning()


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


# All that a state tells.


def rate_hz(simulated: Simulated, process: str, record: str) -> float:
    """The rate at which a record is new, in two seconds, by its own times."""
    reader = simulated.load("failstop.api.client").attach(simulated.name, process).latest_reader(record)
    found: list[int] = []
    for _ in range(2000):
        entry = reader.read()
        if entry and (not found or entry[1] > found[-1]):
            found.append(entry[1])
        simulated.wait(0.001)
    return (len(found) - 1) / (found[-1] - found[0]) * 1e9


def test_the_imu_is_new_as_often_as_the_board_reports() -> None:
    simulated = Simulated(imu_hz=110.0)
    simulated.wait_for("a sample", lambda: simulated.robot.state.imu is not None)
    assert rate_hz(simulated, layout.TELEMETRY, "imu") == pytest.approx(110.0, abs=1.0)


def test_what_is_not_known_is_not_told(simulated: Simulated) -> None:
    """No orientation estimate; of the battery the voltage and no percentage."""
    simulated.wait_for("the battery", lambda: simulated.robot.state.battery_v is not None)
    found = simulated.robot.state.as_dict()
    assert set(found["imu"]) == {"t_ns", "acceleration_mps2", "rate_radps", "rate_variance"}
    assert {key for key in found if "battery" in key or "percent" in key} == {"battery_v", "battery_ns"}
    assert found["plugged"] == "unknown", "until a step is seen"


def test_the_state_has_everything() -> None:
    simulated = Simulated(imu_hz=110.0)
    simulated.wait_for("the bias", lambda: (found := simulated.robot.state.gyro_bias) and found.calibrated)
    simulated.enable()
    simulated.drive(0.6)
    simulated.board.pad()
    simulated.drive(0.1)
    state = simulated.robot.state
    assert (state.enabled, state.estop, state.blocked) == (True, None, None)
    assert state.body_vel == pytest.approx((0.2, 0.0, 0.0))
    assert 0 <= state.scan_age_s < 0.13
    assert (state.gyro_bias.calibrated, state.gyro_bias.tracking) == (True, False), "frozen while driving"
    assert (state.pad_mode, state.plugged) == ("locked", "unknown")
    assert state.sources[0].who == f"trial (pid {simulated.pid})", "the publisher"
    assert (state.device.state, state.device.link) == ("open", "alive")
    assert all(row.pid > 0 and row.age_s >= 0 and row.restarts == 0 for row in state.processes.values())
    assert (state.odometry.pose_variance, state.imu.rate_variance) == (1e3, pytest.approx(0.0012**2))
    assert (state.odometry.twist_std_mps, state.odometry.twist_std_radps) == (0.05, 0.2)
    assert 5 < state.battery_v < 15
    assert all(abs(rate) < 0.2 for rate in state.imu.rate_radps)
    assert "gyro" in simulated.said


def test_the_state_is_new_10_times_a_second_though_nothing_happens(simulated: Simulated) -> None:
    for process, record in ((layout.GATE, "state"), (layout.TELEMETRY, "bias"), (layout.TELEMETRY, "odometry")):
        assert rate_hz(simulated, process, record) >= 10, record


# Parts that a robot has or lacks.


NO_IMU = "not observed: the robot has no IMU"


def drive(robot: Simulated, vx: float, wz: float) -> None:
    robot.enable()
    robot.drive(0.8, (vx, 0.0, wz))


@pytest.mark.parametrize(("vx", "wz", "side"), [(0.2, 0.3, "left"), (0.2, -0.3, "right"), (-0.2, 0.3, "right")])
def test_a_steered_base_tells_the_angle_that_is_commanded(vx: float, wz: float, side: str) -> None:
    """Positive turns the wheels to the left; backward that turns the robot to the right."""
    robot = Simulated({"wheels.layout": "ackermann"})
    drive(robot, vx, wz)
    state = robot.robot.state
    assert state.steering_rad == pytest.approx(radians(15) if side == "left" else -radians(15), abs=radians(1))
    assert f"steering  15 degrees to the {side}" in robot.command("status")[1]
    assert robot.load("failstop.web.view").live(state, None)[5] == f"15 degrees to the {side}"
    robot.drive(0.4, (vx, 0.0, 0.0))
    assert robot.robot.state.steering_rad == 0.0
    robot.robot.disable()
    assert robot.robot.state.steering_rad is None


def test_what_is_not_steered_has_no_angle() -> None:
    robot = Simulated()
    drive(robot, 0.2, 0.3)
    assert (robot.robot.state.moving, robot.robot.state.steering_rad) == (True, None)


def test_a_robot_without_an_imu_says_so_and_waits_for_none() -> None:
    robot = Simulated({"board.imu": "off"}, imu_hz=0.0)
    drive(robot, 0.2, 0.0)
    robot.robot.estop("enough")
    robot.wait_for("its outcome", lambda: NO_IMU in robot.said, 1.0)
    assert "bias" not in robot.said
    assert NO_IMU in robot.printed("status")
    assert "no IMU" in robot.printed("status").partition("sensor")[2]
    assert robot.json("why")["proof"].endswith(f"{NO_IMU}; now: not known: nothing reports what the wheels do")
    shown = robot.load("failstop.web.view").view(robot.robot.state, [], 0.0)
    assert (shown["imu"], shown["stop"]["observed"], shown["stop"]["lacks"]["observed"]) == (False, "", "no IMU")


@pytest.mark.parametrize(
    ("kind", "imu"),
    [
        ("arduino", False),
        ("damiao", False),
        ("feetech", False),
        ("hoverboard", False),
        ("ugv", True),
        ("vesc", False),
    ],
)
def test_of_each_board_it_is_known(kind: str, imu: bool) -> None:
    assert Settings({"board.kind": kind}).on("board.imu") is imu


# A board that has never answered.


UNPROVEN = "unproven: the board has never answered"


@pytest.fixture
def mute() -> Simulated:
    """A service whose board hears nothing and says nothing of it."""
    return Simulated(deaf=True)


def test_every_screen_says_that_nothing_proves_the_stop(mute: Simulated) -> None:
    assert mute.printed("status").startswith(f"wheels TOLD TO STOP, {UNPROVEN}")
    assert mute.json("why")["what"].startswith(f"TOLD TO STOP, {UNPROVEN}; motion has been disabled")
    shown = mute.load("failstop.web.view").view(mute.robot.state, [], 0.0)
    assert (shown["word"], shown["role"]) == ("TOLD TO STOP, UNPROVEN", "bad")
    code, out, err = mute.command("enable")
    assert (code, out) == (0, "motion enabled\n")
    assert err.startswith(f"failstop: {UNPROVEN}, so no stop is known to reach the wheels")


def test_its_first_answer_ends_that(mute: Simulated) -> None:
    mute.board.deaf(False)
    mute.wait_for("an answer", lambda: mute.robot.state.device.link == "alive")
    assert mute.command("status")[1].startswith("wheels    TOLD TO STOP  ")
    assert mute.command("enable")[2] == ""


def test_its_end_is_no_error(mute: Simulated) -> None:
    """A board without pings is such a one, or one with another firmware."""
    assert mute.end() == 0
    assert "nobody knows whether the board hears (link unproven)" in mute.said


# Words of a client.


def test_words_of_a_client_reach_people(simulated: Simulated) -> None:
    with simulated.failstop.Robot(client="eyes") as robot:
        robot.say("looks ahead", "nobody feeds the lidar")
        simulated.wait_for("its words", lambda: any(client.sees for client in robot.state.clients))
        (client,) = (client for client in robot.state.clients if client.name == "eyes")
        assert (client.sees, client.wrong) == ("looks ahead", "nobody feeds the lidar")
        assert 0 <= client.said_s < 0.25, "looked at every ten periods, and at rest a period later"
        status, why = simulated.printed("status"), simulated.printed("why")
        assert "says eyes: looks ahead" in status
        assert "eyes: nobody feeds the lidar" in status
        assert "also eyes: nobody feeds the lidar" in why
        robot.say("looks ahead")
        simulated.wait_for("that it is well", lambda: not any(client.wrong for client in robot.state.clients))
        robot.say("looks ahead", "it is dark")
        simulated.wait_for("what is wrong", lambda: any(client.wrong for client in robot.state.clients))
    simulated.wait_for("its end", lambda: "no longer" in simulated.printed("events", "--kind", "said"))
    assert simulated.robot.state.clients == ()
    _, told, _ = simulated.command("events", "--kind", "said")
    said = [line.partition(") ")[2] or line.partition("): ")[2] for line in told.splitlines()]
    assert said == ["nobody feeds the lidar", "looks ahead", "it is dark", "no longer reports: it is dark"]
    with simulated.failstop.Robot(client="ears") as robot:
        robot.say("listens")
        simulated.wait_for("its words", lambda: any(client.sees for client in robot.state.clients))
    simulated.wait_for("its end", lambda: simulated.robot.state.clients == ())
    assert "has gone" not in simulated.printed("events", "--kind", "said"), "it has closed its robot, and lives on"
