"""The arm's faults: what goes wrong while it moves, and when it stands, by the word of the simulated board's servos.

Beside the table of table.py, whose rows are of turning wheels: an arm moves while the wheels stand.
"""

from __future__ import annotations

import contextlib
import dataclasses
import os
import signal
import subprocess
import sys
import time

from failstop.api.errors import FailstopError, Refused
from failstop.board.framing import BUS_SERVO
from failstop.board.servos import LONGEST_MOVE_MS, MOVE, STOP
from failstop.lab.faults.processes import DEADLINES_MS, HANG_OF
from failstop.lab.sim.client import Event
from failstop.lab.sim.servos import Leg
from failstop.lab.trial import Trial, wait_for, write_settings
from failstop.policy import causes
from failstop.shm.layout import PROCESSES, SUPERVISOR

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
BY_ITSELF_MS = float(LONGEST_MOVE_MS)
"""What a servo goes on for when nobody sends it anything any more."""
TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.policy.causes import Cause, Kind

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
        time.sleep(0.02)
"""
KILL, HANG, CLIENT_KILL, CLIENT_HANG, REQUEST, UNPLUG = (
    "kill",
    "hang",
    "client-kill",
    "client-hang",
    "request",
    "unplug",
)


@dataclasses.dataclass(frozen=True)
class ArmFault:
    """One row."""

    name: str
    cause: str
    what: str
    process: str = ""
    latched: Kind | None = None
    """The row of the cause that is latched; None: nothing is."""
    bar_ms: float = BY_ITSELF_MS
    """To the last joint at rest."""


def _rows() -> tuple[ArmFault, ...]:
    kills = [
        ArmFault(
            f"arm-kill-{process}",
            f"SIGKILL of the {process} while the arm follows",
            KILL,
            process,
            None if process == SUPERVISOR else causes.DIED,
            BY_ITSELF_MS + 5.0,
        )
        for process in PROCESSES
    ]
    hangs = [
        ArmFault(
            f"arm-hang-{process}",
            f"SIGSTOP of the {process} while the arm follows",
            HANG,
            process,
            None if process == SUPERVISOR else causes.HANGS,
            BY_ITSELF_MS + _deadline_ms(process),
        )
        for process in PROCESSES
    ]
    others = [
        ArmFault(
            "arm-client-killed", "SIGKILL of the client that moves the arm", CLIENT_KILL, bar_ms=BY_ITSELF_MS + 5.0
        ),
        ArmFault(
            "arm-client-hung", "SIGSTOP of the client that moves the arm", CLIENT_HANG, bar_ms=BY_ITSELF_MS + 500.0
        ),
        ArmFault(
            "arm-stop-request", "a stop request while the arm follows", REQUEST, "", causes.REQUESTED, BY_ITSELF_MS
        ),
        ArmFault("arm-usb-drop", "unplugged in mid-move", UNPLUG, "", causes.DEVICE_LOST, BY_ITSELF_MS),
    ]
    return (*kills, *hangs, *others)


def _deadline_ms(process: str) -> float:
    """By when its silence is answered while motion is disabled: nobody watches its lease then, its deadline counts."""
    return DEADLINES_MS.get(process, HANG_OF[process][1])


ROWS = _rows()


@dataclasses.dataclass(frozen=True)
class Rested:
    """What the servos did after a fault, ms from it."""

    fault: ArmFault
    rest_ms: float
    """To the last moment at which a joint turned."""
    stop_ms: float | None
    """To the arrival of the arm's stop, behind the first burst."""
    wheels_ms: float | None
    """To the execution of the wheels' first stop, behind what servos' frames still hold the receiver."""
    moves_after: int
    """Frames that moved servos, executed after that stop."""
    latched: Cause | None
    wrong: tuple[str, ...]


class ArmTrial(Trial):
    """Board, service with an arm, and a client of its own that moves all of its joints."""

    def __init__(self, name: str | None = None, changed: dict[str, object] | None = None) -> None:
        super().__init__(name)
        path = os.path.join(self._directory.name, "arm.toml")
        write_settings(path, {**SETTINGS, **(changed or {})})
        self.service._command += ["--config", path]
        self._follower: subprocess.Popen[bytes] | None = None

    def follow(self, seconds: float = 0.8) -> int:
        """Have a program of its own move every joint; returns its pid."""
        if self._follower is None:
            self._follower = subprocess.Popen([sys.executable, "-c", FOLLOWER, self.name], stderr=subprocess.DEVNULL)
        wait_for("the arm to follow", lambda: self._turns())
        time.sleep(seconds)
        return self._follower.pid

    def _turns(self) -> bool:
        arm = self.robot.state.arm
        return bool(arm and arm["mode"] == "follow" and arm["moving"])

    def stop_following(self) -> None:
        """End that program."""
        if self._follower:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self._follower.pid, signal.SIGCONT)
            self._follower.kill()
            self._follower.wait()
            self._follower = None

    def settle(self) -> None:
        """Whole again, nothing latched, nobody moves the arm."""
        self.stop_following()
        wait_for("the service to be whole", self._whole)
        if self.robot.state.estop:
            wait_for("a reset", self._reset)
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
TRIES = 3


def strike(trial: ArmTrial, fault: ArmFault) -> Rested:
    """One fault, judged by the servos; the trial is settled again afterwards, with a new run where it ended. One that
    came while nothing turned, since the machine did not run the client, is tried again, TRIES times in all."""
    for _ in range(TRIES):
        rested = _strike(trial, fault)
        if NOT_TURNING not in rested.wrong:
            break
    return rested


def _strike(trial: ArmTrial, fault: ArmFault) -> Rested:
    client = trial.follow()
    pids = trial.service.pids()
    legs, mark = trial.board.joint_legs(), trial.board.info()["executed"]
    fault_ns = time.monotonic_ns()
    _begin(trial, fault, client, pids)
    time.sleep(fault.bar_ms / 1000 + 0.4)
    events, track = trial.board.events(mark), trial.board.joint_track(max(0, legs - 12))
    if fault.what == HANG:
        with contextlib.suppress(ProcessLookupError):
            os.kill(pids[fault.process], signal.SIGCONT)
    if fault.what == UNPLUG:
        trial.board.replug()
    if fault.process == SUPERVISOR:
        trial.stop_following()
        trial.leave()
        trial.service.kill()
        trial.service.start()
    latched = _latched(trial, fault)
    rested = judge(fault, fault_ns, events, track, latched)
    trial.settle()
    return rested


def _begin(trial: ArmTrial, fault: ArmFault, client: int, pids: dict[str, int]) -> None:
    if fault.what in (KILL, HANG):
        os.kill(pids[fault.process], signal.SIGKILL if fault.what == KILL else signal.SIGSTOP)
    elif fault.what in (CLIENT_KILL, CLIENT_HANG):
        os.kill(client, signal.SIGKILL if fault.what == CLIENT_KILL else signal.SIGSTOP)
    elif fault.what == REQUEST:
        trial.robot.estop("the arm's fault row")
    else:
        trial.board.unplug()


def _latched(trial: ArmTrial, fault: ArmFault) -> Cause | None:
    if fault.latched:
        with contextlib.suppress(Exception):
            wait_for("the latch", lambda: bool(trial.robot.state.estop), 3.0)
    return trial.robot.state.cause


def judge(fault: ArmFault, fault_ns: int, events: list[Event], track: list[Leg], latched: Cause | None) -> Rested:
    """What the board's servos say; it asks the code under test nothing but what it latched."""
    # Of zero frames there are five a second while the wheels stand: the arm's stop follows a burst alone.
    arms = [event for event in events if event.func == BUS_SERVO and event.arrival_ns >= fault_ns]
    stop = next((event for event in arms if event.data[0] == STOP), None)
    moves = [event for event in arms if event.data[0] == MOVE]
    after = sum(stop is not None and event.executed_ns > stop.executed_ns for event in moves)
    wrong = []
    if stop is None and fault.what != UNPLUG:
        wrong.append("the arm was not stopped")
    rest_ms = max([0.0, *((_turned_ns(leg, track) - fault_ns) / 1e6 for leg in track)])
    if rest_ms > 1.5 * fault.bar_ms + 100.0:
        wrong.append(f"a joint turned until {rest_ms:.0f} ms, the limit is {1.5 * fault.bar_ms + 100.0:.0f}")
    if after:
        wrong.append(f"{after} moves after the stop")
    if fault.latched is not (latched and latched.kind) or (
        fault.latched and fault.process not in ("", *_process(latched))
    ):
        wrong.append(f"latched: {latched}")
    if not any(leg.begin_ns < fault_ns < leg.end_ns and leg.begin != leg.end for leg in track):
        wrong.append(NOT_TURNING)
    stop_ms = None if stop is None else (stop.arrival_ns - fault_ns) / 1e6
    wheels = next((event for event in events if event.is_stop and event.arrival_ns >= fault_ns), None)
    wheels_ms = None if wheels is None else (wheels.executed_ns - fault_ns) / 1e6
    return Rested(fault, rest_ms, stop_ms, wheels_ms, after, latched, tuple(wrong))


def _process(cause: Cause | None) -> tuple[object, ...]:
    """Whose death or silence it is; of no process, whatever the row says."""
    return tuple(cause.named().get("process", "") for cause in (cause,) if cause)


def _turned_ns(leg: Leg, track: list[Leg]) -> int:
    """When a servo stopped to turn in this leg: at its end, or where the next one began."""
    if leg.begin == leg.end:
        return 0
    following = [other.begin_ns for other in track if other.servo == leg.servo and other.begin_ns > leg.begin_ns]
    return min([leg.end_ns, *following])


SERVO_FAULTS = {
    "silent": "joint elbow: no answer from servo 3",
    "blocked": "joint elbow (servo 3) is ",
    "unloaded": "joint elbow (servo 3) is ",
    "hot": "joint elbow (servo 3) is ",
}
"""What an enable is refused with, after `arm is not in the drive pose: `."""


def refused_for(trial: ArmTrial, fault: str) -> str:
    """Enable with a faulty servo; returns what is wrong with the answer, or nothing."""
    values = {"temperature_c": 90} if fault == "hot" else {fault: True}
    trial.board.servo(3, position=500, **values)
    try:
        trial.robot.enable()
    except Refused as error:
        expected = f"arm is not in the drive pose: {SERVO_FAULTS[fault]}"
        return "" if str(error.args[0]).startswith(expected) else str(error)
    finally:
        trial.board.servo(3, **({"temperature_c": 35} if fault == "hot" else {fault: False}))
    return "enabled"
