"""The bridge's plain functions: parameters, messages, the state as told, diagnostics, the scan, the files of DDS."""

from __future__ import annotations

import dataclasses
import json
import math
import os
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from failstop.api import snapshot
from failstop.api.errors import FailstopError, NoService
from failstop.api.snapshot import OLD_S, Ages, Device, GyroBias, Imu, Odometry, Pad, Scale
from failstop.api.state import Stop
from failstop.policy import causes
from failstop.policy.causes import Cause
from failstop.policy.layouts import WHEEL_NAMES
from failstop.policy.settings import BY_KEY, Settings
from failstop.ros2 import diagnostics, messages, mirrors, report, trajectory, transport, words
from failstop.ros2.commanders import Publisher
from failstop.ros2.scan import ScanLog, ScanWatch
from tests.support import states

S = 1_000_000_000
SCAN = "sensor_msgs/msg/LaserScan"


# Parameters.


def test_every_mirror_shows_settings_that_there_are() -> None:
    keys = {key for mirror in mirrors.TABLE for key in mirror.keys}
    assert keys - set(BY_KEY) == {"sources.cmd_vel.timeout_s"}
    assert keys <= set(Settings().flat())


@pytest.mark.parametrize(
    ("given", "line"),
    [
        ({"max_linear": 0.2}, ""),
        (
            {"max_linear": 1},
            "parameter max_linear = 1 has no effect, because 0.2 is in force: change limits.vx_mps and limits.vy_mps",
        ),
        ({"estop_key": 1.0}, ""),
        ({"accel_scale": [1.0, 1.0, 1.0]}, ""),
        (
            {"accel_scale": [1.0, 1.0, 1.1]},
            "parameter accel_scale = [1, 1, 1.1] has no effect, because [1, 1, 1] is in force",
        ),
        ({"device": "/dev//ttyACM0"}, ""),
        ({"device": "/dev/ttyACM1"}, "parameter device = /dev/ttyACM1 has no effect, because /dev/ttyACM0 is in force"),
        (
            {"pad_sounds": True},
            "parameter pad_sounds = true has no effect, because false is in force: change buzzer.tones",
        ),
        ({"drive_pan": 500}, "parameter drive_pan = 500 has no effect, because -1 is in force: change arm.drive_pan"),
        ({"somebody_elses": 1}, ""),
    ],
)
def test_two_places_for_one_setting_are_told_of(given: dict[str, object], line: str) -> None:
    lines = mirrors.differing(given, mirrors.values(Settings().flat()))
    assert len(lines) == bool(line)
    assert not line or lines[0].startswith(line)


# Messages.


def test_imu_values() -> None:
    values = messages.imu(Imu(5, (1.0, 2.0, 9.8), (0.1, 0.2, 0.3)), 3 * S + 7)
    assert dict(zip(messages.IMU_PLACES, values, strict=True)) == {
        "header.stamp": (3, 7),
        "angular_velocity": (0.1, 0.2, 0.3),
        "linear_acceleration": (1.0, 2.0, 9.8),
    }


def test_odometry_and_transform_agree() -> None:
    sample = Odometry(0, 1.0, 2.0, math.pi / 2, 0.2, 0.1, 0.3, 0.05, 0.2)
    stamp, pose, covariance, twist = messages.odometry(sample, S)
    assert messages.transform(sample, S) == (stamp, pose)
    assert stamp == (1, 0)
    assert pose[:5] == (1.0, 2.0, 0.0, 0.0, 0.0)
    assert 2 * math.atan2(*pose[5:]) == pytest.approx(math.pi / 2)
    assert twist == (0.2, 0.1, 0.0, 0.0, 0.0, 0.3)
    assert {at: value for at, value in enumerate(covariance) if value} == {0: 1e3, 7: 1e3, 35: 1e3}
    assert len(covariance) == 36


def test_a_covariance_is_the_matrix_of_x_y_z_and_the_turns_about_them() -> None:
    sample = Odometry(0, 0, 0, 0, 0, 0, 0, 0.05, 0.2, "wheels", (1.0, 2.0, 3.0, 4.0, 5.0, 6.0))
    flat = messages.odometry(sample, S)[2]
    rows = [list(flat[at : at + 6]) for at in range(0, 36, 6)]
    assert rows == [list(column) for column in zip(*rows, strict=True)], "it is symmetric"
    at = {"x": 0, "y": 1, "th": 5}
    pairs = (("x", "x"), ("x", "y"), ("x", "th"), ("y", "y"), ("y", "th"), ("th", "th"))
    found = [rows[at[a]][at[b]] for a, b in pairs]
    assert found == [1.0, 2.0, 3.0, 4.0, 5.0, 6.0]
    assert sum(map(sum, rows)) == 1 + 4 + 6 + 2 * (2 + 3 + 5)


@pytest.mark.parametrize(("plugged", "status"), [("plugged", 1), ("unplugged", 2), ("unknown", 0)])
def test_battery_fields(plugged: str, status: int) -> None:
    assert messages.battery(11.9, plugged, 0)["voltage"] == 11.9
    assert messages.battery(11.9, plugged, 0)["power_supply_status"] == status
    assert messages.battery(11.9, plugged, 0)["present"] is True


def test_a_battery_that_the_board_does_not_report_is_not_present() -> None:
    for plugged in ("unknown", "plugged"):
        fields = messages.battery(None, plugged, 0)
        assert math.isnan(fields["voltage"])
        assert fields["present"] is False
        assert fields["power_supply_status"] == 0


def test_gamepad_values() -> None:
    _, axes, buttons = messages.gamepad(Pad(0, 0x8001, 3, (127, -128, 0, 64), "drive"), S)
    assert axes == pytest.approx([1.0, -128 / 127, 0.0, 64 / 127, 3.0])
    assert buttons == [1] + [0] * 14 + [1]


def test_wheels_turn_as_far_as_they_were_told() -> None:
    wheels = messages.Wheels()
    assert wheels.fields(0)[0] == [], "nobody has said how many there are"
    for count in (4, 3, 2):
        wheels.update(snapshot.Wheels((2 * math.pi,) * count), 0)
        assert wheels.fields(0)[1][1:] == ([0.0] * count, [2 * math.pi] * count)
        wheels.update(snapshot.Wheels((0.0,) * count), S // 2)
        names, (_, position, velocity) = wheels.fields(0)
        assert names == [f"wheel_{name.replace(' ', '_')}" for name in WHEEL_NAMES[count]]
        assert position == pytest.approx([math.pi] * count)
        assert velocity == [0.0] * count
        wheels.update(None, 9 * S)
        assert wheels.fields(0)[1][1:] == (pytest.approx([math.pi] * count), [0.0] * count)


def test_wheels_turn_as_far_as_they_are_measured_to() -> None:
    """Told to turn, and held: the joints say what the board reports, and not what it was told."""
    wheels, told = messages.Wheels(), snapshot.Wheels((3.0, 3.0))
    wheels.update(told, 0)
    wheels.update(told, S, turning=snapshot.Turning())
    assert wheels.fields(S)[1][1:] == ([3.0, 3.0], [3.0, 3.0]), "nothing is reported"
    seen = snapshot.Turning("turning", "wheels", age_s=0.02, speeds_radps=snapshot.Wheels((0.0, 2.5)),
                            turned_rad=snapshot.Wheels((0.25, 7.0)))  # fmt: skip
    for at_s in (2, 3):
        wheels.update(told, at_s * S, turning=seen)
        assert wheels.fields(at_s * S)[1][1:] == ([0.25, 7.0], [0.0, 2.5])
    wheels.update(told, 4 * S, turning=dataclasses.replace(seen, age_s=0.8))
    _, position, velocity = wheels.fields(4 * S)[1]
    assert position == [0.25, 7.0]
    assert all(map(math.isnan, velocity)), "an old report says nothing of how fast they turn now"
    wheels.update(None, 5 * S)
    _, position, velocity = wheels.fields(5 * S)[1]
    assert position == [0.25, 7.0]
    assert all(map(math.isnan, velocity)), "without a service nobody measures them"
    wheels.update(told, 6 * S, turning=snapshot.Turning())
    wheels.update(told, 7 * S, turning=snapshot.Turning())
    assert wheels.fields(7 * S)[1][1:] == ([3.25, 10.0], [3.0, 3.0]), "the next service has no report yet"


def test_measured_wheels_go_on_where_they_were_when_the_service_is_restarted() -> None:
    wheels, told = messages.Wheels(), snapshot.Wheels((0.0, 0.0))

    def position(run: str, *turned_rad: float) -> list[float]:
        turned = snapshot.Wheels(turned_rad) if turned_rad else None
        seen = snapshot.Turning("still", "wheels", age_s=0.02, speeds_radps=turned and told, turned_rad=turned)
        wheels.update(told, S, turning=seen, run=run)
        return list(wheels.fields(S)[1][1])

    assert position("a", 100.0, 50.0) == [100.0, 50.0], "the bridge began later than the service"
    wheels.update(None, S)
    assert position("b") == [100.0, 50.0], "no report yet"
    assert position("b", 0.0, 0.0) == [100.0, 50.0]
    assert position("b", 1.0, -2.0) == [101.0, 48.0]
    assert position("c", 0.5, 0.0) == [101.5, 48.0], "a restart that nobody saw"
    assert position("c", 0.25, 1.0) == [101.25, 49.0]


def test_a_steered_base_stays_steered_as_it_was_told_last() -> None:
    wheels = messages.Wheels()
    for told, shown in ((None, None), (0.3, 0.3), (None, 0.3), (-0.1, -0.1)):
        wheels.update(snapshot.Wheels((0.0, 0.0)), 0, told)
        names, (_, position, velocity) = wheels.fields(0)
        assert dict(zip(names, position, strict=True)).get("steering") == shown
        assert len(names) == len(velocity)


# The state.


def own(reason: str) -> Cause:
    """The cause of a stop that this process has asked for as the bridge."""
    words.asked(reason)
    return causes.REQUESTED(reason, "ros2", os.getpid())


def test_state_values() -> None:
    bias = GyroBias((0.01, 0.0, -0.01), tracking=True, calibrated=True)
    given = states.latched(own("estop topic"), scan_age_s=0.12345, gyro_bias=bias, plugged="plugged")
    found = report.as_json(given, ["/nav"], ["a", "b"])
    assert found["estop"] == "estop topic"
    assert found["blocked"] == "estop: estop topic"
    assert found["plugged"] is True
    assert found["scan_age"] == 0.12
    assert found["gyro_bias_dps"] == [0.573, 0.0, -0.573]
    assert found["gyro_bias_tracking"] is True
    assert found["wrong"] == "a; b"
    assert (found["arm_enabled"], found["arm_moving"], found["arm_holding"]) == (False, False, False)
    assert not found["arm_pose"]
    assert not found["servo_silent"]
    json.dumps(found)
    driving = report.as_json(states.driving(body_vel=(0.20004, 0.0, 0.0)), [], [])
    assert driving["body_vel"] == [0.2, 0.0, 0.0]
    assert (driving["blocked"], driving["estop"], driving["plugged"], driving["wrong"]) == (None, None, None, None)
    assert driving["driver"] == "nav (pid 42) as cmd_vel"


def test_typed_status() -> None:
    found = report.status(states.latched(causes.KEY(1)))
    assert (found["latched"], found["estop"], found["blocked"]) == (True, "key1", "estop: key1")
    assert found["last_stop_written_s"] == pytest.approx(0.00021)
    assert found["last_stop_observed_s"] == pytest.approx(0.3)
    assert math.isnan(report.status(states.state())["last_stop_written_s"])
    assert math.isnan(report.status(states.state())["scan_age_s"])


def test_typed_status_without_a_service() -> None:
    """It says what ~/state and ~/emergency_stop say then, with the same fields as ever."""
    none = NoService("no service")
    found, known = report.status_without_state(none), report.without_state(none)
    assert list(found) == list(report.status(states.state()))
    assert {key: found[key] for key in ("enabled", "blocked", "link")} == {
        key: known[key] for key in ("enabled", "blocked", "link")
    }
    assert found["wheels"] == known["wheels"]["does"] == "unknown"
    assert found["latched"] is report.latched(None) is True
    assert all(math.isnan(value) for key, value in found.items() if key.endswith("_s"))


def test_nobody_knows_that_nothing_is_latched_without_a_state() -> None:
    assert report.latched(None)
    assert report.latched(states.latched())
    assert not report.latched(states.state())


def test_the_proof_of_a_stop_grows() -> None:
    before, asked_for = states.driving(), own("stop service")
    assert report.proof(before, before) is None
    assert report.proof(before, None) is None
    asked = states.latched(asked_for, epoch=2, last_stop=states.stop(acknowledged_s=None, observed_s=None))
    assert report.proof(before, asked) is None
    assert report.proof(before, asked, final=True) == (
        True,
        "stop latched (stop service): written after 0.2 ms, not acknowledged yet, wheels not seen still yet",
    )
    blind = states.latched(asked_for, epoch=2, last_stop=states.stop(observed_s=None, observed_by=""))
    assert report.proof(before, blind) == (
        True,
        "stop latched (stop service): written after 0.2 ms, acknowledged after 4.4 ms, "
        "not observed: the robot has no IMU",
    )
    seen = states.latched(asked_for, epoch=2, last_stop=states.stop())
    assert report.proof(before, seen) == (
        True,
        "stop latched (stop service): written after 0.2 ms, acknowledged after 4.4 ms, observed after 300 ms",
    )


@pytest.mark.parametrize(
    ("stop", "done", "said"),
    [
        (states.stop(observed_s=0.0), True, "acknowledged after 4.4 ms, no shaking seen before or after"),
        (states.stop(sent=False), False, "the board accepts no bytes"),
        (states.stop(believed=False), False, "written after 0.2 ms to "),
        (states.stop(written_s=None), False, "could NOT be written: use the POWER SWITCH"),
        (None, False, "the stop was requested, but the service has not confirmed it yet"),
    ],
)
def test_a_stop_counts_as_done_once_it_is_known_to_be_written(stop: Stop | None, done: bool, said: str) -> None:
    asked_for = own("stop service")
    now = states.latched(asked_for, epoch=2, last_stop=stop) if stop else None
    known = report.proof(states.driving(), now, final=True)
    assert known
    assert known[0] is done
    assert said in known[1]


UNCONFIRMED = "the stop was requested, but the service has not confirmed it yet"


def test_an_older_stop_proves_nothing_until_the_service_has_heard_the_request() -> None:
    before = states.latched(epoch=2)
    assert report.proof(before, before) is None
    assert report.proof(before, before, final=True) == (False, UNCONFIRMED)
    assert report.proof(before, dataclasses.replace(before, epoch=3)) == (
        True,
        "stop latched (key1): written after 0.2 ms, acknowledged after 4.4 ms, observed after 300 ms; "
        "this stop was latched before the request",
    )


@pytest.mark.parametrize("older", [True, False])
@pytest.mark.parametrize(
    ("changed", "says"),
    [
        ({"device": Device("/dev/x", "lost", "alive")}, "the port /dev/x is lost, so no stop reaches the board"),
        ({"device": Device("/dev/x", "open", "deaf")}, "the board does not hear, so a stop may not reach the wheels"),
        ({"turning": states.TURNS_ON}, "the wheels turn although they are told to stop"),
        ({"turning": states.TURNS}, "the wheels are told to stop, but still turn"),
    ],
)
def test_proofs_do_not_count_against_what_is_seen_now(changed: dict[str, Any], says: str, older: bool) -> None:
    before = states.latched(epoch=2) if older else states.driving(epoch=2)
    now = states.latched(epoch=3, **changed)
    assert report.proof(before, now) is None, "the stop may still take effect"
    known = report.proof(before, now, final=True)
    assert known
    assert not known[0]
    assert known[1].startswith(f"stop latched (key1), but {says}")
    assert known[1].endswith(": use the POWER SWITCH")


def test_own_name_and_number_are_left_out_of_reasons() -> None:
    forged, another = (causes.REQUESTED(*of) for of in (("button", "ros2", 12), ("hand near", "failstop estop", 12)))
    assert words.plain(forged) == "stop request: button (says it is ros2, pid 12)", "anybody can say so"
    assert words.plain(own("estop topic")) == "estop topic"
    assert report.blocked(states.latched(own("estop topic"))) == "estop: estop topic"
    assert words.plain(another) == "stop request: hand near (says it is failstop estop, pid 12)"
    assert (
        report.blocked(states.latched(another)) == "estop: stop request: hand near (says it is failstop estop, pid 12)"
    )
    assert words.plain(causes.PIPED("estop topic (ros2, pid 12)")) == "stop request: estop topic (ros2, pid 12)"
    assert words.plain(None) == ""
    assert report.blocked(states.state()) == "disabled"
    assert report.blocked(states.driving()) is None


# Diagnostics.


def test_a_link_without_a_port_is_no_link_to_a_board_that_came_back() -> None:
    rows = diagnostics.statuses("base", states.state(device=Device("/dev/x", "lost", "unheard")), "", [], [])
    (link,) = (row for row in rows if row["name"] == "base: link")
    assert link["level"] == diagnostics.ERROR
    assert link["message"].startswith("the port /dev/x is lost, so no stop reaches the board")


def test_diagnostics_of_a_service_that_is_well() -> None:
    rows = diagnostics.statuses("base", states.driving(), "", ["cmd_vel: /nav"], [])
    assert {row["level"] for row in rows} == {diagnostics.OK}
    assert rows[0]["name"] == "base: stop layer"
    assert rows[-1]["message"] == "cmd_vel: /nav"
    assert all(isinstance(pair["value"], str) for row in rows for pair in row["values"])


@pytest.mark.parametrize(
    ("changed", "name", "level"),
    [
        ({"age_s": 0.9}, "stop layer", diagnostics.STALE),
        ({"device": Device("/dev/x", "lost", "alive")}, "port", diagnostics.ERROR),
        ({"device": Device("/dev/x", "open", "deaf")}, "link", diagnostics.ERROR),
        ({"device": Device("/dev/x", "open", "unproven")}, "link", diagnostics.WARN),
        ({"battery_v": 9.0}, "battery", diagnostics.WARN),
        ({"battery_v": None}, "battery", diagnostics.OK),
        ({"battery_v": 9.0, "ages": Ages(battery_s=OLD_S)}, "battery", diagnostics.STALE),
        ({"device": Device("/dev/x", "open", "silent")}, "link", diagnostics.ERROR),
        ({"servos": {"rear wheel (servo 8)": (0.1, 41)}}, "rear wheel (servo 8)", diagnostics.OK),
        ({"arm": states.arm("base")}, "arm", diagnostics.OK),
        ({"arm": states.arm("base", wrong=("joint base is silent",))}, "arm", diagnostics.WARN),
        ({}, "speeds", diagnostics.OK),
        ({"scale": Scale(wrong=("the wheels turn twice as fast",))}, "speeds", diagnostics.WARN),
        ({"device": Device("/dev/x", "open", "unproven")}, "stop layer", diagnostics.WARN),
        ({"device": Device("/dev/x", "open", "unproven"), "age_s": 0.9}, "stop layer", diagnostics.STALE),
        ({"processes": {"gate": states.process(state="down")}}, "process gate", diagnostics.ERROR),
        ({"processes": {"gate": states.process(state="waiting")}}, "process gate", diagnostics.WARN),
        ({"processes": {"gate": states.process(realtime=False)}}, "real-time rights", diagnostics.WARN),
    ],
)
def test_diagnostics_of_what_is_not(changed: dict[str, object], name: str, level: int) -> None:
    rows = diagnostics.statuses("base", states.state(**changed), "", [], [])
    assert {row["name"].partition(": ")[2]: row["level"] for row in rows}[name] == level


def test_diagnostics_warn_of_a_board_that_obeys_no_command() -> None:
    unheeded = states.driving(device=Device("/dev/x", "open", "alive", unheeded_s=9.0))
    row = diagnostics.statuses("base", unheeded, "", [], [])[0]
    assert row["level"] == diagnostics.WARN
    assert "unproven: the board has reported for 9.0 s that it obeys a command of zero" in row["message"]


def test_diagnostics_of_an_arm_name_every_fault() -> None:
    wrong = ("joint base (servo 1) is silent", "joint elbow (servo 3) is hot")
    rows = diagnostics.statuses("base", states.state(arm=states.arm("base", wrong=wrong)), "", [], [])
    [arm] = [row for row in rows if row["name"] == "base: arm"]
    assert arm["message"] == "; ".join(wrong)


def test_diagnostics_of_a_latch_name_the_next_command() -> None:
    row = diagnostics.statuses("base", states.latched(causes.KEY(1)), "", [], [])[0]
    assert row["level"] == diagnostics.ERROR
    assert "next: `failstop reset`" in row["message"]


def test_diagnostics_change_with_levels_and_words_and_not_with_ages() -> None:
    one = diagnostics.statuses("base", states.state(), "", [], [])
    processes = {name: states.process(age_s=0.009) for name in states.state().processes}
    other = diagnostics.statuses("base", states.state(processes=processes), "", [], [])
    assert one != other
    assert not diagnostics.changed(one, other)
    assert diagnostics.changed(one, diagnostics.statuses("base", states.latched(), "", [], []))


# The scan.


def test_what_is_heard_of_the_sensor() -> None:
    watch = ScanWatch(0.5)
    assert watch.says(S)[1] == ["nobody publishes scan: start the lidar's node, or remap its topic"]
    watch.look([Publisher("/ld19", SCAN, False)])
    assert watch.says(S) == ("scan: /ld19", ["/ld19 publishes scan, but has sent nothing yet"])
    watch.heard(S)
    assert watch.says(S + S // 2) == ("scan: /ld19", [])
    assert watch.says(S + S // 2 + 1)[1] == ["/ld19 publishes scan, but is silent"]
    watch.look([Publisher("/depth", "sensor_msgs/msg/PointCloud2")])
    assert watch.says(S)[1] == ["/depth publishes PointCloud2 on scan, which is LaserScan"]


def test_a_robot_that_needs_no_sensor_has_no_problem_without_one() -> None:
    watch = ScanWatch(0.5)
    watch.needed = False
    assert watch.says(S) == ("nobody publishes scan", [])
    watch.look([Publisher("/ld19", SCAN, False)])
    assert watch.says(S) == ("scan: /ld19", [])
    watch.heard(S)
    assert watch.says(9 * S) == ("scan: /ld19", []), "silent"
    watch.look([Publisher("/depth", "sensor_msgs/msg/PointCloud2")])
    assert watch.says(S)[1] == ["/depth publishes PointCloud2 on scan, which is LaserScan"]


def test_scan_lines() -> None:
    log = ScanLog(0)
    assert log.update(None, 0.1, 0.5, S) == ""
    assert log.update("no scan", 0.62, 0.5, S) == "wheels held: no LiDAR scan for 0.6 s while commanded"
    assert log.update("no scan", 0.64, 0.5, S) == "", "once"
    assert log.update("cmd timeout", 0.9, 0.5, S) == "", "the command ended, the sensor is still silent"
    assert log.update("no scan", 0.95, 0.5, S) == ""
    assert log.update(None, 0.1, 0.5, S) == "LiDAR scan back: wheels released"
    assert log.update(None, 0.1, 0.5, S) == ""
    assert ScanLog(0).update("no scan", None, 0.5, 2 * S) == "wheels held: no LiDAR scan for 2.0 s while commanded"


# The files of DDS.


def _trajectory(names: list[str], *rows: tuple[float, list[float]]) -> SimpleNamespace:
    points = [
        SimpleNamespace(positions=angles, time_from_start=SimpleNamespace(sec=int(t_s), nanosec=round(t_s % 1 * 1e9)))
        for t_s, angles in rows
    ]
    return SimpleNamespace(joint_names=names, points=points)


def test_a_trajectory_as_the_arm_takes_it() -> None:
    begin, end = (0.0, [0.1, 0.2]), (1.5, [0.3, 0.4])
    assert trajectory.way(_trajectory(["a", "b"], begin, end)) == [(1.5, {"a": 0.3, "b": 0.4})]
    assert trajectory.way(_trajectory(["a", "b"], begin)) == [(0.0, {"a": 0.1, "b": 0.2})]


@pytest.mark.parametrize(
    ("names", "rows", "words"),
    [
        (["a", "a"], [(1.0, [0.0, 0.0])], "named twice"),
        (["a"], [], "at least one"),
        ([], [(1.0, [])], "at least one"),
        (["a", "b"], [(1.0, [0.0])], "without a position"),
    ],
)
def test_a_trajectory_that_makes_no_sense(names: list[str], rows: list[tuple[float, list[float]]], words: str) -> None:
    with pytest.raises(FailstopError, match=words):
        trajectory.way(_trajectory(names, *rows))


ANYWHERE, HERE_ALONE = "udp_only.xml", "udp_only_localhost.xml"


@pytest.mark.parametrize(
    ("given", "file"),
    [
        ({}, ANYWHERE),
        ({"ROS_LOCALHOST_ONLY": "0"}, ANYWHERE),
        ({"ROS_LOCALHOST_ONLY": "1"}, HERE_ALONE),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}, HERE_ALONE),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_LOCALHOST_ONLY": "0"}, HERE_ALONE),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_STATIC_PEERS": ""}, HERE_ALONE),
        (
            {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_LOCALHOST_ONLY": "1", "ROS_STATIC_PEERS": "a"},
            HERE_ALONE,
        ),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "ROS_LOCALHOST_ONLY": "1"}, HERE_ALONE),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "SUBNET", "ROS_STATIC_PEERS": "a;b"}, ANYWHERE),
        ({"ROS_AUTOMATIC_DISCOVERY_RANGE": "OFF"}, ANYWHERE),
    ],
)
def test_fast_dds_takes_udp_alone(given: dict[str, str], file: str) -> None:
    environment = {**given, "HOME": "/"}
    transport.udp_alone(environment)
    assert environment.get("ROS_LOCALHOST_ONLY") is None
    # With either variable rmw_fastrtps would put its own transports, shared memory among them, in the profile's place.
    assert environment.get("ROS_AUTOMATIC_DISCOVERY_RANGE") != "LOCALHOST"
    if file is ANYWHERE:
        kept = {key: value for key, value in given.items() if key != "ROS_LOCALHOST_ONLY"}
        assert {key: environment[key] for key in kept} == kept
    (path,) = {environment[name] for name in transport.PROFILES}
    assert Path(path).name == file
    assert "<useBuiltinTransports>false" in Path(path).read_text()


def test_localhost_and_further_hosts_are_left_to_ros() -> None:
    given = {"ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST", "ROS_STATIC_PEERS": "192.0.2.7"}
    environment = dict(given)
    transport.udp_alone(environment)
    assert environment == given


@pytest.mark.parametrize(
    "given", [{transport.PROFILES[0]: "/own.xml"}, {transport.PROFILES[1]: "/own.xml"}, {"RMW_IMPLEMENTATION": "x"}]
)
def test_a_profile_of_the_users_own_and_another_dds_are_left_alone(given: dict[str, str]) -> None:
    environment = {**given, "ROS_LOCALHOST_ONLY": "1"}
    transport.udp_alone(environment)
    assert environment == {**given, "ROS_LOCALHOST_ONLY": "1"}
