"""The arm's faults (arm_table.py): each brought about, and when the arm stood, by the word of the simulated board's
servos."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import signal
import subprocess
import time

from failstop import helpers
from failstop.api.errors import FailstopError, Refused
from failstop.board.rrc.framing import BUS_SERVO
from failstop.board.servos import LONGEST_MOVE_NS, SERVO_MOVE, SERVO_STOP
from failstop.messages.layout import SUPERVISOR
from failstop.policy.causes import Cause
from failstop.policy.layouts import BOARDS
from failstop.setup.ending import end_with_parent
from failstop_lab.boards.traits import HAS_ARM_BESIDE, traits_of
from failstop_lab.faults import arm_table as table
from failstop_lab.faults.arm_table import ArmFault
from failstop_lab.faults.fault import fits
from failstop_lab.sim.client import Event
from failstop_lab.sim.servos import Leg
from failstop_lab.stopped import judge as stopped_by
from failstop_lab.trial import READY_S, Stopped, Trial, TrialError, wait_for, write_settings

JOINTS = {"base": (1, 500, 500), "shoulder": (2, 963, 793), "elbow": (3, 46, 51), "wrist": (4, 131, 160)}
JOINTS |= {"roll": (5, 498, 499), "gripper": (10, 629, 499)}
"""Servo, tuck, drive."""
SETTINGS: dict[str, object] = {
    "restart.deaths": 100_000,
    "restart.backoff_s": 0.001,
    **{
        f"joints.{name}.{key}": value
        for name, row in JOINTS.items()
        for key, value in zip(("servo", "tuck", "drive"), row, strict=True)
    },
    "joints.gripper.judged": "off",
}
BESIDE: dict[str, object] = {
    "restart.deaths": 100_000,
    "restart.backoff_s": 0.001,
    "arm.auto_tuck": "off",
    **{f"joints.{name}.servo": servo for servo, name in enumerate(JOINTS, 1)},
}
"""Settings for an arm on the wheels' bus, as LeKiwi's: without poses."""
FOLLOWER = """
import sys, time
from failstop.api.robot import Robot
with Robot(sys.argv[1], client="follower") as robot:
    begun = time.monotonic()
    arm = robot.arm
    while True:
        t = (time.monotonic() - begun) % 8.0
        angle = 0.4 * min(t, 8.0 - t) - 0.8
        arm.follow(dict.fromkeys(arm.joints, angle))
        if sys.argv[2:] == ["drives"]:
            robot.sensed()
            robot.drive(0.1, 0.0, 0.0, wait_s=0.0)
        time.sleep(0.02)
"""
POSER = """
import contextlib, sys
from failstop.api.errors import Refused
from failstop.api.robot import Robot
with Robot(sys.argv[1], client="poser") as robot, contextlib.suppress(Refused):
    robot.enable()
"""
ELBOW = 3
HEALTHY = {"temperature_c": 35}


@dataclasses.dataclass(frozen=True)
class Rested:
    """The servos' acts after a fault, ms from it."""

    fault: ArmFault
    rest_ms: float | None
    """To the last moment at which a joint turned; None: it was about motion that is not enabled."""
    stop_ms: float | None
    """To the arrival of the arm's stop, behind the first burst."""
    wheels_ms: float | None
    """To the execution of the wheels' first stop, behind what servos' frames still hold the receiver."""
    moves_after: int
    """Frames that moved servos, executed after that stop."""
    latched: Cause | None
    wrong: tuple[str, ...]
    fault_ns: int = 0
    events: tuple[Event, ...] = ()
    again: tuple[str, ...] = ()
    """Why each of the tries before was not counted."""


MOVES_S = READY_S
"""Within so long the program has moved the arm."""


class NeverMoved(TrialError):
    """The arm did not begin to move, so nothing was made to fail."""


class ArmTrial(Trial):
    """Board, service with an arm, and a client of its own that moves all of its joints."""

    def __init__(
        self, name: str | None = None, changed: dict[str, object] | None = None, kind: str = BOARDS[0]
    ) -> None:
        traits = traits_of(kind)
        super().__init__(name, kind="" if kind == BOARDS[0] else kind)
        self.beside = HAS_ARM_BESIDE in traits.parts
        """The program that moves the arm drives the wheels too."""
        path = os.path.join(self._directory.name, "arm.toml")
        write_settings(path, {**traits.settings, **(BESIDE if self.beside else SETTINGS), **(changed or {})})
        self.service._command += ["--config", path]
        self._follower: subprocess.Popen[bytes] | None = None

    def follow(self, seconds: float = 0.8) -> int:
        """Have a program of its own move every joint, and where the arm may move beside them the wheels; returns its
        pid."""
        if self.beside:
            self.enable()
        return self._begin(FOLLOWER, "follow", seconds, *["drives"] * self.beside)

    def pose(self) -> int:
        """Have a program of its own enable motion, which brings the arm to its drive pose from far away."""
        for servo in range(1, 6):
            self.board.servo(servo, position=500)
        return self._begin(POSER, "trajectory", 0.3)

    def _begin(self, program: str, mode: str, seconds: float, *words: str) -> int:
        if self._follower is None:
            command = helpers.python("-c", program, self.name, *words)
            self._follower = subprocess.Popen(command, stderr=subprocess.DEVNULL, preexec_fn=end_with_parent)
        try:
            wait_for("the arm to move", lambda: self._turns(mode), MOVES_S)
        except TrialError as error:
            raise NeverMoved(str(error)) from None
        if self.beside:
            self.board.wait_wheels(turning=True, timeout_s=READY_S)
        time.sleep(seconds)
        return self._follower.pid

    def _turns(self, mode: str) -> bool:
        arm = self.robot.state.arm
        return bool(arm and arm.mode == mode and arm.moving)

    def stop_following(self) -> None:
        """End that program."""
        if self._follower:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self._follower.pid, signal.SIGCONT)
            self._follower.kill()
            self._follower.wait()
            self._follower = None

    def settle(self) -> None:
        """Whole again, nothing latched, motion disabled, nobody moves the arm."""
        self.stop_following()
        wait_for("the service to be whole", self._whole)
        if self.robot.state.estop:
            wait_for("a reset", self.reset)
        self.robot.disable()
        self.leave()

    def drive_pose(self) -> None:
        """Put the joints there by hand, so that motion is enabled without a way to go."""
        for servo, _, drive in JOINTS.values():
            self.board.servo(servo, position=drive)

    def _whole(self) -> bool:
        with contextlib.suppress(FailstopError):
            return self.robot.state.waiting_for is None
        return False

    def close(self) -> None:
        self.stop_following()
        super().close()


NOT_TURNING = "no joint was turning at the fault"
NOT_DRIVING = "the wheels were not turning at the fault"
STRIKES = 3


def strike(trial: ArmTrial, fault: ArmFault) -> Rested:
    """One fault, judged by the servos; the trial is settled again afterwards, with a new run where it ended. One that
    came while nothing turned, because the machine did not run the client or the robot was stopped before it, is tried
    again, STRIKES times in all, unless something else was wrong too."""
    again: tuple[str, ...] = ()
    while True:
        last = len(again) == STRIKES - 1
        try:
            rested = dataclasses.replace(_strike(trial, fault), again=again)
        except NeverMoved as error:
            if last:
                raise
            trial.settle()
            again = (*again, str(error))
            continue
        if not rested.wrong or set(rested.wrong) - {NOT_TURNING, NOT_DRIVING} or last:
            return rested
        again = (*again, "; ".join(rested.wrong))


def _strike(trial: ArmTrial, fault: ArmFault) -> Rested:
    if fault.what == table.SERVO_FAULT:
        return _refuse(trial, fault)
    assert fault.bar_ms is not None
    client = trial.pose() if fault.what == table.POSING else trial.follow()
    pids = trial.service.pids()
    legs, mark, turned = trial.board.joint_legs(), trial.board.info()["executed"], trial.turning()
    fault_ns = time.monotonic_ns()
    _begin(trial, fault, client, pids)
    time.sleep(fault.bar_ms / 1000 + 0.4)
    events, track = trial.board.events(mark), trial.board.joint_track(max(0, legs - 12))
    if fault.what == table.HANG:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pids[fault.process], signal.SIGCONT)
    if fault.what == table.UNPLUG:
        trial.board.replug()
    if fault.process == SUPERVISOR:
        trial.stop_following()
        trial.leave()
        trial.service.kill()
        trial.service.start()
    latched = _latched(trial, fault)
    if trial.beside:
        stopped = stopped_by(events, fault_ns, turned)
        rested = judge_beside(fault, stopped, track, latched, trial.board.limp(), tuple(events))
    else:
        rested = judge(fault, fault_ns, events, track, latched)
    trial.settle()
    return rested


def _refuse(trial: ArmTrial, fault: ArmFault) -> Rested:
    """Enable with a faulty servo, far from its pose: motion is refused, and no wheel moves."""
    trial.settle()
    mark = trial.board.info()["executed"]
    trial.board.servo(ELBOW, position=500, **dict(fault.servo))
    wrong = []
    try:
        trial.robot.enable()
        trial.drive(0.1)
        wrong.append("enabled")
    except Refused as error:
        if not error.reason.startswith(f"arm is not in the drive pose: joint elbow{fault.refused}"):
            wrong.append(f"refused: {error}")
    finally:
        trial.board.servo(ELBOW, **{name: HEALTHY.get(name, False) for name, _ in fault.servo})
    if moved := sum(event.is_motion for event in trial.board.events(mark)):
        wrong.append(f"{moved} motion frames")
    trial.settle()
    return Rested(fault, None, None, None, moved, None, tuple(wrong))


def _begin(trial: ArmTrial, fault: ArmFault, client: int, pids: dict[str, int]) -> None:
    if fault.what in (table.KILL, table.HANG):
        os.kill(pids[fault.process], signal.SIGKILL if fault.what == table.KILL else signal.SIGSTOP)
    elif fault.what in (table.CLIENT_KILL, table.CLIENT_HANG):
        os.kill(client, signal.SIGKILL if fault.what == table.CLIENT_KILL else signal.SIGSTOP)
    elif fault.what in (table.STOP_REQUEST, table.POSING):
        trial.robot.estop("the arm's fault row")
    elif fault.what == table.SECOND:
        trial.robot.arm.follow({"base": 0.1})
    else:
        trial.board.unplug()


def _latched(trial: ArmTrial, fault: ArmFault) -> Cause | None:
    if fault.latched:
        with contextlib.suppress(Exception):
            wait_for("the latch", lambda: bool(trial.robot.state.estop), 3.0)
    return trial.robot.state.cause


def judge(fault: ArmFault, fault_ns: int, events: list[Event], track: list[Leg], latched: Cause | None) -> Rested:
    """The word of the board's servos; it asks the code under test nothing but what it latched."""
    # Of zero frames there are five a second while the wheels stand: the arm's stop follows a burst alone.
    arms = [event for event in events if event.func == BUS_SERVO and event.arrival_ns >= fault_ns]
    stop = next((event for event in arms if event.data[0] == SERVO_STOP), None)
    moves = [event for event in arms if event.data[0] == SERVO_MOVE]
    after = sum(stop is not None and event.executed_ns > stop.executed_ns for event in moves)
    wrong = []
    if stop is None and fault.what != table.UNPLUG:
        wrong.append("the arm was not stopped")
    rest_ms = max([0.0, *((_turned_ns(leg, track) - fault_ns) / 1e6 for leg in track)])
    if fault.limit_ms is not None and rest_ms > fault.limit_ms:
        wrong.append(f"a joint turned until {rest_ms:.0f} ms, the limit is {fault.limit_ms:.0f}")
    if moved := sum(event.is_motion for event in events):
        wrong.append(f"{moved} motion frames")
    if after:
        wrong.append(f"{after} moves after the stop")
    if not fits(latched, fault.latched) if fault.latched else latched:
        wrong.append(f"latched: {latched}")
    if not any(leg.begin_ns < fault_ns < leg.end_ns and leg.begin != leg.end for leg in track):
        wrong.append(NOT_TURNING)
    stop_ms = None if stop is None else (stop.arrival_ns - fault_ns) / 1e6
    wheels = next((event for event in events if event.is_stop and event.arrival_ns >= fault_ns), None)
    wheels_ms = None if wheels is None else (wheels.executed_ns - fault_ns) / 1e6
    return Rested(fault, rest_ms, stop_ms, wheels_ms, after, latched, tuple(wrong), fault_ns, tuple(events))


def judge_beside(
    fault: ArmFault,
    stopped: Stopped,
    track: list[Leg],
    latched: Cause | None,
    limp: list[int],
    events: tuple[Event, ...],
) -> Rested:
    """The word of servos on the wheels' bus, which no stop is written to: the wheels are at zero, and every joint
    stands at its last goal and holds."""
    wrong, fault_ns = [], stopped.fault_ns
    wheels_ms = None if stopped.executed_ns is None else stopped.executed_ns / 1e6
    if fault.wheels_limit_ms is not None:
        if wheels_ms is None:
            wrong.append("the wheels were not stopped")
        elif wheels_ms > fault.wheels_limit_ms:
            wrong.append(f"the wheels were stopped after {wheels_ms:.0f} ms, the limit is {fault.wheels_limit_ms:.0f}")
        if stopped.motion_after:
            wrong.append(f"{stopped.motion_after} motion frames after the stop")
    legs = [leg for leg in track if leg.begin != leg.end]
    rest_ms = max([0.0, *((leg.end_ns - fault_ns) / 1e6 for leg in legs)])
    if fault.limit_ms is not None and rest_ms > fault.limit_ms:
        wrong.append(f"a joint turned until {rest_ms:.0f} ms, the limit is {fault.limit_ms:.0f}")
    wrong += [f"servo {servo} has let go" for servo in limp]
    if not fits(latched, fault.latched) if fault.latched else latched:
        wrong.append(f"latched: {latched}")
    wrong += [] if stopped.was_turning else [NOT_DRIVING]
    # A servo is soon at each goal, and waits there for the next.
    if not any(leg.begin_ns < fault_ns < leg.end_ns + LONGEST_MOVE_NS for leg in legs):
        wrong.append(NOT_TURNING)
    stop_ms = None if stopped.stop_ns is None else stopped.stop_ns / 1e6
    return Rested(fault, rest_ms, stop_ms, wheels_ms, stopped.motion_after, latched, tuple(wrong), fault_ns, events)


def _turned_ns(leg: Leg, track: list[Leg]) -> int:
    """When a servo stopped to turn in this leg: at its end, or where the next one began."""
    if leg.begin == leg.end:
        return 0
    following = [other.begin_ns for other in track if other.servo == leg.servo and other.begin_ns > leg.begin_ns]
    return min([leg.end_ns, *following])
