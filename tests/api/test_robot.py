"""The Robot as programs use it: what drive() answers, waiting, why, threads, its end."""

from __future__ import annotations

import os
import signal
import threading
import time
from collections.abc import Callable

import pytest

from failstop import Block, Blocked, Driving, FailstopError, NoService, Preempted, Refused, Robot, TimedOut
from failstop_lab.machine.robot import SETTINGS as FILE
from failstop_lab.trial import Trial, wait_for
from tests.support.simulated import MS, Simulated


@pytest.fixture
def robot(trial: Trial) -> Robot:
    return trial.robot


def test_drive_says_what_holds_the_wheels(robot: Robot) -> None:
    answer = robot.drive(0.1, 0.0, 0.0, manual=True)
    assert answer == Blocked(Block.DISABLED, "disabled")
    assert not answer
    robot.enable()
    robot.drive(0.0, 0.0, 0.0, manual=True)
    wait_for("the sensor to be silent", lambda: (age_s := robot.state.scan_age_s) is None or age_s > 0.6)
    silent = Blocked(Block.NO_SCAN, "no scan")
    wait_for("the gate to take it", lambda: robot.drive(0.1, 0.0, 0.0) == silent)
    robot.sensed()
    wait_for("the wheels to turn", lambda: isinstance(robot.drive(0.1, 0.0, 0.0), Driving))
    robot.estop("a hand")
    robot.wait_for("latched", 5.0)
    answer = robot.drive(0.1, 0.0, 0.0, manual=True)
    assert isinstance(answer, Blocked)
    assert answer.block is Block.LATCHED
    assert answer.why.startswith("stop request: a hand (")


def test_drive_tells_the_velocity_that_the_ramp_has_reached(robot: Robot) -> None:
    robot.enable()
    reached = [0.0]
    while reached[-1] < 0.1:
        answer = robot.drive(0.1, 0.0, 0.0, manual=True)
        assert isinstance(answer, Driving)
        reached.append(answer.velocity.vx_mps)
        time.sleep(0.01)
        assert len(reached) < 200, reached
    assert reached == sorted(reached)
    assert reached[-1] == pytest.approx(0.1)


def test_wheel_speeds_are_a_command_like_any_other(robot: Robot) -> None:
    robot.enable()
    wheel_radps = 0.1 / 0.04
    forward = pytest.approx((0.1, 0.0, 0.0))
    wait_for(
        "the ramp to end",
        lambda: (
            isinstance(answer := robot.drive_wheels(*[wheel_radps] * 4, manual=True), Driving)
            and answer.velocity == forward
        ),
    )
    assert robot.state.wheels_radps == pytest.approx((wheel_radps,) * 4)
    with pytest.raises(ValueError, match=r"^2 speeds: this robot has 4 wheels: front_left, rear_left, front_r"):
        robot.drive_wheels(1.0, 1.0)
    with pytest.raises(ValueError, match="every value must be finite"):
        robot.drive_wheels(1.0, 1.0, float("nan"), 1.0)
    with pytest.raises(ValueError, match="this base is not steered"):
        robot.drive_wheels(1.0, 1.0, 1.0, 1.0, steering_rad=0.1)


def test_drive_names_who_goes_before(robot: Robot, trial: Trial) -> None:
    robot.enable()
    with Robot(trial.name, client="person") as person:
        assert person.drive(0.1, 0.0, 0.0, manual=True, source="teleop")
        answer = robot.drive(0.2, 0.0, 0.0, manual=True)
    assert answer == Preempted(f"person (pid {os.getpid()})", "teleop")
    assert not answer


def test_a_gate_that_takes_no_command_is_told_at_once() -> None:
    simulated = Simulated()
    simulated.enable()
    simulated.hold("gate", 0.05)
    began_ns = simulated.now_ns()
    answer = simulated.robot.drive(0.1, 0.0, 0.0, manual=True)
    assert simulated.now_ns() - began_ns <= 11 * MS
    assert (answer.block.name, answer.why) == (Block.NO_COMMAND.name, "the gate has not taken the command yet")
    assert not answer


def test_waiting_for_a_word_and_for_a_function(robot: Robot) -> None:
    assert robot.wait_for("ready", 5.0).waiting_for is None
    threading.Timer(0.05, robot.enable).start()
    assert robot.wait_for("enabled", 5.0).enabled
    threading.Timer(0.05, lambda: robot.estop("waited for")).start()
    found = robot.wait_for(lambda state: "waited for" in (state.estop or ""), 5.0)
    assert found.block is Block.LATCHED
    robot.wait_for("still", 5.0)
    with pytest.raises(ValueError, match=r"^wait_for\('stopt'\): unknown word; choose from ready, enabled"):
        robot.wait_for("stopt")  # type: ignore[arg-type]


def test_still_is_never_about_an_older_stop() -> None:
    simulated = Simulated(imu_hz=110.0)
    robot, late = simulated.robot, simulated.failstop.TimedOut
    robot.estop("the first stop")
    robot.wait_for(lambda state: state.estop and state.last_stop.observed_s is not None, 5.0)
    simulated.set_off()
    with pytest.raises(late):
        robot.wait_for("still", 0.0)
    robot.disable()  # latches no stop, so the last stop and its proof are still the first stop's
    disabled_ns = simulated.now_ns()
    with pytest.raises(late):
        robot.wait_for("still", 0.0)
    state = robot.wait_for("still", 5.0)
    assert simulated.now_ns() - disabled_ns >= 500 * MS  # the IMU needs half a second of quiet
    assert (state.turning.does, state.turning.by) == ("still", "IMU")


def test_what_does_not_come_about_is_told_with_what_to_do(robot: Robot) -> None:
    with pytest.raises(TimedOut, match=r"^waited 0.05 s for 'moving': blocked: disabled; next: `failstop enable"):
        robot.wait_for("moving", 0.05)
    with pytest.raises(TimeoutError):
        robot.wait_for("enabled", 0.0)


def test_why_is_what_the_command_prints(robot: Robot) -> None:
    robot.estop("asked by a test")
    robot.wait_for("still", 5.0)
    found = robot.why()
    assert 'asked for a stop: "asked by a test"' in found.what
    assert found.proof.startswith("written by the port owner after ")
    assert found.do[1:] == tuple(f"`failstop {verb} --name {robot.name}`" for verb in ("reset", "enable"))
    assert [line.split()[0] for line in str(found).splitlines()][:3] == ["what", "proof", "do"]


def test_events_come_as_they_happen(robot: Robot) -> None:
    events = robot.events()
    threading.Timer(0.05, robot.enable).start()
    event = next(found for found in events if found.kind == "enabled")
    assert "motion enabled by trial" in event.text
    assert any(found.kind == "ready" for found in _so_far(robot)), "what was told before"
    assert robot.state.enabled


def _so_far(robot: Robot) -> list:
    found = []
    for event in robot.events(past=True):
        found.append(event)
        if event.kind == "enabled":
            break
    return found


# Its end.


def test_who_enabled_motion_takes_it_back_at_the_end(trial: Trial) -> None:
    with Robot(trial.name) as robot:
        robot.enable()
        assert trial.robot.state.enabled
    assert not trial.robot.state.enabled
    with pytest.raises(ZeroDivisionError):
        _enables_and_fails(trial.name)
    assert not trial.robot.state.enabled


def _enables_and_fails(name: str) -> None:
    with Robot(name) as robot:
        robot.enable()
        raise ZeroDivisionError


def test_motion_that_was_enabled_after_nobody_waited_for_the_answer_is_taken_back() -> None:
    simulated = Simulated()
    with simulated.failstop.Robot(answer_s=0.02) as robot:
        robot.sensed()
        simulated.hold("gate", 0.03)
        with pytest.raises(simulated.failstop.NoAnswer):
            robot.enable()
        simulated.robot.wait_for("enabled", 5.0)
    assert not simulated.robot.state.enabled


def test_motion_that_another_enabled_stays_so_though_one_is_refused(trial: Trial) -> None:
    trial.robot.enable()
    trial.robot.estop("held")
    trial.robot.wait_for("latched", 5.0)
    with Robot(trial.name) as robot:
        with pytest.raises(Refused):
            robot.enable()
        trial.robot.reset()
        trial.robot.enable()
    assert trial.robot.state.enabled


def test_motion_that_another_enabled_stays_so(trial: Trial) -> None:
    trial.robot.enable()
    with Robot(trial.name) as robot:
        robot.drive(0.0, 0.0, 0.0, manual=True)
    assert trial.robot.state.enabled
    with Robot(trial.name, disable_on_exit=False) as robot:
        robot.disable()
        robot.enable()
    assert trial.robot.state.enabled


@pytest.mark.parametrize("ended_by", ["a disable", "a stop", "a restart of the service"])
def test_motion_that_another_enabled_after_one_s_own_has_ended_stays_so(ended_by: str) -> None:
    simulated = Simulated()
    with simulated.failstop.Robot() as robot:
        robot.enable()
        if ended_by == "a disable":
            simulated.robot.disable()
        elif ended_by == "a stop":
            simulated.robot.estop("hand near wheel")
            simulated.robot.wait_for("latched", 5.0)
            simulated.robot.reset()
        else:
            simulated.end()
            simulated.start()
        simulated.enable()
    assert simulated.robot.state.enabled


# Threads.


def test_each_of_many_threads_gets_its_own_answer(trial: Trial) -> None:
    robot = trial.robot
    robot.estop("held")
    robot.wait_for("latched", 5.0)
    wrong: list[object] = []

    def ask(call: Callable[[], str], granted: str) -> None:
        for _ in range(25):
            try:
                said = call()
            except Refused as error:
                said = str(error)
            if granted not in said:
                wrong.append((granted, said))

    calls: list[tuple[Callable[[], str], str]] = [
        (robot.disable, "motion disabled"),
        (robot.enable, "next: `failstop reset"),
    ]
    threads = [threading.Thread(target=ask, args=calls[number % 2]) for number in range(6)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join(60)
    assert not wrong
    assert robot.state.cause is not None


def test_threads_that_drive_and_look_at_once(trial: Trial) -> None:
    robot = trial.robot
    robot.enable()
    errors: list[BaseException] = []
    over = threading.Event()

    def again(call: Callable[[], object]) -> None:
        try:
            while not over.is_set():
                call()
        except BaseException as error:
            errors.append(error)

    calls = (
        lambda: robot.drive(0.1, 0.0, 0.0, manual=True),
        lambda: robot.state.as_dict(),
        robot.sensed,
        robot.samples,
        robot.why,
        lambda: robot.say("looks"),
    )
    threads = [threading.Thread(target=again, args=(call,)) for call in calls]
    for thread in threads:
        thread.start()
    try:
        trial.board.wait_wheels(turning=True, timeout_s=5.0)
        for _ in range(5):
            robot.disable()
            assert not robot.state.enabled
            robot.enable()
    finally:
        over.set()
        for thread in threads:
            thread.join(10)
    assert not errors


def test_what_waited_for_a_thread_s_request_was_asked_before_the_stop_meanwhile(trial: Trial) -> None:
    """The gate hangs in front of the first, and is killed for that: a reset of before must not clear it."""
    robot = Robot(trial.name)
    robot.limit_speed(1.0)
    told: list[str] = []

    def ask(call: Callable[[], str]) -> None:
        try:
            told.append(call())
        except FailstopError as error:
            told.append(str(error))

    gate = trial.service.pids()["gate"]
    os.kill(gate, signal.SIGSTOP)
    first = threading.Thread(target=ask, args=(lambda: robot.limit_speed(0.5),))
    first.start()
    wait_for("the first to be sent", lambda: robot._pending is not None)
    second = threading.Thread(target=ask, args=(robot.reset,))
    second.start()
    first.join(10)
    second.join(10)
    assert told[0] == "speed limited to 50 % of the settings'", "the next gate answers"
    assert "asked before the last stop (gate " in told[1]
    assert trial.robot.state.cause
    robot.close()


def test_the_end_of_a_robot_is_met_by_its_other_threads(trial: Trial) -> None:
    robot = Robot(trial.name)
    told: list[str] = []

    def wait() -> None:
        try:
            robot.wait_for("moving")
        except Exception as error:
            told.append(str(error))

    thread = threading.Thread(target=wait)
    thread.start()
    wait_for("it to wait", lambda: thread.is_alive())
    robot.close()
    thread.join(5)
    assert told == [f"this Robot of {trial.name!r} is closed: make a new one"]


def test_a_service_that_is_not_there_is_not_waited_for_by_a_robot_of_one_run(trial: Trial) -> None:
    with pytest.raises(NoService):
        Robot(f"{trial.name}-none")


def test_the_arm_is_that_of_the_service_that_runs() -> None:
    """Joints are servos by the settings, which a new start may have corrected."""
    simulated = Simulated({"joints.base.servo": 1, "joints.elbow.servo": 2})
    with simulated.failstop.Robot() as robot:
        arm = robot.arm
        assert {name: joint.servo for name, joint in arm.joints.items()} == {"base": 1, "elbow": 2}
        simulated.leave()
        simulated.end()
        simulated.lab.write(FILE, "[joints.base]\nservo = 2\n[joints.elbow]\nservo = 1\n")
        simulated.start()
        assert {name: joint.servo for name, joint in arm.joints.items()} == {"base": 2, "elbow": 1}


def test_drive_waits_for_no_answer_where_it_is_told_to(robot: Robot) -> None:
    robot.enable()
    wait_for("earlier commands to be old", lambda: not robot.state.sources)
    assert robot.drive(0.1, 0.0, 0.0, manual=True, wait_s=0.0) is not None
    wait_for("the wheels to turn", lambda: bool(robot.drive(0.1, 0.0, 0.0, manual=True, wait_s=0.0)))
    with pytest.raises(ValueError, match="finite"):
        robot.drive(float("nan"), 0.0, 0.0)
