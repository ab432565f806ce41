"""The gate's decisions about the arm. Pure: takes the time and all events as arguments, and returns frames and texts.

While a stop is latched, the arm does not move. While motion of the wheels is enabled, the arm moves only if the board
can move arm and wheels together. A stop ends every movement. Enabling motion usually does too (see Arm.enable()).

A movement is a stream of short moves: in each period (arm.period_s), every joint gets one move that lasts about one
period. So if the gate dies, the arm stops at the end of its last move. Each frame has the moves of a few servos. If a
joint was stopped on its way to a goal, or if its torque may be off, its position is read before the joint moves again.
"""

from __future__ import annotations

from failstop.board.interface import ServoBus
from failstop.board.servos import LONGEST_MOVE_MS, MOST_MOVES, POSITION
from failstop.policy.causes import Cause
from failstop.policy.joints import Joint, from_settings, too_far
from failstop.policy.settings import Settings
from failstop.procs.gate.arm import goals
from failstop.procs.gate.arm.goals import Goal, Trajectory
from failstop.procs.gate.arm.reader import AGREE, QUIET_NS, ServoReader
from failstop.procs.gate.arm.stream import Space, Stream

ENDED = "the goals before it were ended: pause first"
SERVICE = 0
"""The session number of trajectories that the service itself makes, to the drive pose and to the tuck pose."""
TORQUE_APART_NS = 4_000_000
"""The shortest time between two frames that switch a servo's torque on or off."""
STEPS_APART_NS = 1_000_000
"""The shortest time between two calls of step(). Without this pause, an arm that has more work to do would keep the
gate awake all the time."""
NEAR = 0.5
"""After its planned time, a trajectory sends no further move if the commanded position of each joint is at most this
far from the joint's end position, in pulses. Frames contain whole pulses, so they can't bring a joint closer."""
LOST_NS = 2_000_000_000
"""A trajectory that takes this much longer than planned has failed."""
FIND_NS = 4_000_000_000
LIMP_NS = 300_000_000
"""While the arm waits for other joints, a joint without torque is read again after this time. To read eight joints
takes about half of it."""


class ArmCore:
    """Decides how the arm moves. It holds the joints, the goal that the arm follows, and the next question to the
    servos."""

    def __init__(self, settings: Settings, bus: ServoBus, now_ns: int) -> None:
        self._bus = bus
        self.joints = from_settings(settings)
        self._timeout_ns = settings.ns("arm.goal_timeout_s")
        self._pose_speed = settings["arm.pose_speed"]
        self.tolerance = int(settings["arm.drive_tolerance"])
        self.ignore_absent = settings.text("arm.absent") == "ignore"
        self._reader = ServoReader(self.joints, now_ns)
        self._looks = bool(self.joints) and bool(bus.look([self.joints[0].servo]))
        self._space = Space(settings, self.joints)
        self._stream = Stream(settings, bus, self._space)
        self._trajectory: Trajectory | None = None
        self._goal: Goal | None = None
        self._ended: dict[int, int] = {}
        """The sessions whose stream of goals was ended or refused, for example by a stop, each with the time of its
        last goal. Their goals count again after a pause."""
        self._torque_ns = 0
        """The time when the servos' bus is free again after the last torque command."""
        self.due_ns = now_ns
        """The time when step() must be called next, even if nothing happens before. Each call of step() sets a later
        time."""
        self._left: dict[Joint, float] = {}
        """The last goal of each joint of an ended stream that may still be moving to this goal. Always empty if
        ServoBus.holds_by_goal is False."""
        self._rest_ns = now_ns
        """The time of the last step at which the arm was not about to begin a movement."""
        self.letting_go: list[Joint] = []
        """The joints whose torque must still be switched off."""
        self.active_ns = 0
        """The time when the arm was last moved, or asked to move. 0 if there is nothing to tuck, because nobody has
        used the arm, its torque is off, or it was sent to its tuck pose."""
        self.released = False
        self.refused = ""
        """The reason why the last goal of a stream was refused. Empty if it was accepted."""

    @property
    def trajectory(self) -> Trajectory | None:
        """The trajectory that the arm follows. None if no trajectory was begun, or if the last one is over."""
        return self._trajectory if self._trajectory and not self._trajectory.done else None

    @property
    def followed(self) -> Trajectory | Goal | None:
        """The goal or trajectory that the arm follows now, or None."""
        return self.trajectory or self._goal

    def publisher(self, session: int, now_ns: int) -> str:
        """Return the name of a client whose goal or trajectory counts now. The client of `session` is left out. Empty
        if there is no such client."""
        if (trajectory := self.trajectory) and trajectory.session not in (SERVICE, session):
            return trajectory.who
        goal = self._goal
        return goal.who if goal and goal.session != session and self._fresh(goal, now_ns) else ""

    def moved_by(self, session: int) -> bool:
        """Return True if the current trajectory or the newest goal of a stream comes from this session, even if the arm
        can't follow it."""
        return any(asked and asked.session == session for asked in (self.trajectory, self._goal))

    def _fresh(self, goal: Goal, now_ns: int) -> bool:
        return now_ns - goal.t_ns <= self._timeout_ns

    def accept(self, goal: Goal, closed: str, now_ns: int) -> None:
        """Accept a goal of a stream, or set `refused` to the reason why not. Call it only if no other program sends
        goals. `closed`: why the arm accepts no goals now, or an empty text."""
        goal.t_ns = min(goal.t_ns, now_ns)
        check = too_far if goal.mode == goals.FOLLOW else goals.too_fast
        self.refused = self._shut(goal, closed) or check(goal.ends)
        if self.refused:
            return
        if (trajectory := self.trajectory) and trajectory.session == SERVICE:
            self.drop("preempted")
        if goal.mode == goals.FOLLOW:
            goal.ends = {joint: joint.pulses(angle) for joint, angle in goal.ends.items()}
        else:
            goal.ends = {joint: joint.turned(rate) for joint, rate in goal.ends.items()}
        self._reader.hurry(now_ns)
        self._goal = goal
        self.active_ns, self.released = now_ns, False

    def _shut(self, goal: Goal, closed: str) -> str:
        """Return why this goal of a stream does not count now, or an empty text if it counts. A reset must not move the
        arm. So after a stop, a client that never stopped sending goals must pause first, for example by letting go of a
        key."""
        ended_ns = self._ended.pop(goal.session, None)
        if not closed and (ended_ns is None or goal.t_ns - ended_ns > self._timeout_ns):
            return ""
        self._ended[goal.session] = goal.t_ns
        return closed or ENDED

    def pause(self, session: int) -> None:
        self._ended.pop(session, None)

    def execute(self, trajectory: Trajectory, now_ns: int, why: str = "preempted") -> bool:
        """Begin a trajectory. This ends any other movement. `why`: the reason for the client whose movement ends.
        Returns True if a stop must be written because the arm may still be moving."""
        was = self.drop(why)
        self._trajectory = trajectory
        trajectory.since_ns = now_ns
        for joint in trajectory.joints:
            joint.misses = 0  # ask silent servos again
        self._reader.hurry(now_ns)
        if trajectory.ends:  # reading where the arm is uses it as little as looking at it
            self.active_ns, self.released = now_ns, False
        return was

    def pose(self, purpose: str, session: int, who: str) -> Trajectory | None:
        """Return a trajectory to the pose `purpose` (drive or tuck), for execute(). None if the settings have no such
        pose."""
        ends = self._ends(purpose)
        return Trajectory(purpose, session, who, list(ends), [(0.0, ends)], self._pose_speed) if ends else None

    def _ends(self, purpose: str) -> dict[Joint, float]:
        return {joint: float(end) for joint in self.joints if (end := getattr(joint, purpose)) >= 0}

    def drop(self, why: str, cause: Cause | None = None) -> bool:
        """Forget all goals. Returns True if a stop must be written because the arm may still be moving. `why`: the
        reason for the client whose trajectory ends. `cause`: the cause of a latched stop, or None."""
        was = self.streaming()
        if trajectory := self.trajectory:
            trajectory.finish(why, dropped=True)
            trajectory.stopped_for = cause
        self._goal = None
        self._end_stream()
        return was

    def stop(self, why: str, cause: Cause | None = None, but: int | None = None) -> None:
        """Forget all goals, like drop(). The caller must always write a stop, because a servo may still complete an
        earlier move. The client of a dropped stream must pause before its goals count again, unless its session is
        `but`. Servos that release() has not switched off yet keep their torque."""
        self.end_goals(but)
        self.letting_go.clear()
        self.drop(why, cause)

    def end_goals(self, but: int | None = None) -> None:
        """Forget the goal of a stream. Its client must pause before its goals count again, unless its session is
        `but`."""
        if self._goal and self._goal.session != but:
            self._ended[self._goal.session] = self._goal.t_ns
        self._goal = None

    def _end_stream(self) -> None:
        if self._bus.holds_by_goal:
            self._left |= {joint: joint.position for joint in self._stream.joints}
        self._stream.end()

    def forget(self) -> None:
        """Forget where the joints are, so that each joint is read again before it moves."""
        for joint in self.joints:
            joint.forget()

    def release(self, now_ns: int) -> None:
        """Switch off the torque of all servos, one after another."""
        self.drop("released")
        self.forget()
        for joint in self.joints:
            joint.loaded = False
        self._left.clear()
        self.active_ns, self.released = 0, True
        self.letting_go, self._torque_ns = self.joints.copy(), now_ns + TORQUE_APART_NS

    def streaming(self) -> bool:
        """Return True while joints get moves. Afterwards, a servo may still complete its last move."""
        return self._stream.on

    def step(self, now_ns: int) -> tuple[bytes, bool]:
        """Do the next piece of the arm's work, such as a move or a question to a servo. Returns (frame, hold). If
        `hold` is True, first stop the arm. Then send `frame`, unless it is empty. Each call returns at most one frame,
        so a stop never has to wait long behind the arm's frames."""
        found = self._go_on(now_ns)
        self.due_ns = max(self._next_ns(), now_ns + STEPS_APART_NS)
        return found

    def _go_on(self, now_ns: int) -> tuple[bytes, bool]:
        if self.letting_go:
            return self._let_go(now_ns), False
        hold = self._end_stale(now_ns)
        self._forget_limp(now_ns)
        wanted = self._advance_trajectory(now_ns)
        joints = self._to_stream()
        if joints and not self._stream.on:
            if unknown := self._unknown(joints):
                wanted = wanted or self._read_for(unknown, now_ns)
            elif not all(joint.loaded for joint in joints) or now_ns < self._free_ns():
                return self._load(joints, now_ns), hold
            else:
                self._begin(joints, now_ns)
        elif not set(joints) <= set(self._stream.joints):
            self._end_stream()
            return b"", True
        if self._stream.on and (followed := self.followed):
            return self._move(followed, now_ns, hold) if now_ns >= self._stream.due_ns else (self._look(now_ns), hold)
        if frame := self._hold_back(now_ns):
            return frame, hold
        wanted = wanted or [joint for joint in self.joints if not joint.known]
        question = self._reader.ask([joint for joint in wanted if not joint.silent], now_ns)
        return self._bus.read(question[0].servo, question[1]) if question else b"", hold

    def _forget_limp(self, now_ns: int) -> None:
        """If the arm is about to begin a movement, forget where those of its joints are whose torque may be off, unless
        they were read just now. Somebody may have moved such a joint by hand since it was read, and it would jump back
        to that position."""
        if self._stream.on or not (followed := self.followed):
            self._rest_ns = now_ns
            return
        since_ns = max(self._rest_ns, now_ns - LIMP_NS)
        for joint in self._space.wanted(list(followed.ends)):
            if joint.known and not joint.loaded and joint.measured_ns <= since_ns:
                joint.forget()

    def _hold_back(self, now_ns: int) -> bytes:
        """Return a frame that stops joints of an ended stream on their way to their last goals, or an empty frame. The
        frame commands each of these joints to its measured position. If one frame has no room for all joints, the next
        calls return the rest. Servos are read only after that, because nothing can be read while a joint moves."""
        if any(not (joint.known or joint.silent) for joint in self._left):
            return b""
        behind = {joint: goal for joint, goal in self._left.items() if abs(joint.position - goal) > AGREE}
        now = [joint for joint in behind if joint.known][:MOST_MOVES]
        self._left = {joint: behind[joint] for joint in behind if joint.known and joint not in now}
        if not now:
            return b""
        self._reader.moved(now_ns)
        return self._bus.move([(joint.servo, round(joint.position)) for joint in now], LONGEST_MOVE_MS)

    def _unknown(self, joints: list[Joint]) -> list[Joint]:
        return [joint for joint in self._space.wanted(joints) if not joint.known]

    def _read_for(self, unknown: list[Joint], now_ns: int) -> list[Joint]:
        """Return these joints, which must be read before the arm can begin what it follows. A trajectory fails if that
        takes too long, although all of its own joints were found: with collision checks the others must be read too."""
        return _read_first(self.trajectory, unknown, now_ns) if self.trajectory else unknown

    def _free_ns(self) -> int:
        """Return the time when the servos' bus is free again after the last question and the last torque command."""
        return max(self._torque_ns, self._reader.free_ns())

    def _to_stream(self) -> list[Joint]:
        if (trajectory := self.trajectory) and trajectory.phase not in (goals.LOADING, goals.ON_ITS_WAY):
            return []
        return list(self.followed.ends) if self.followed else []

    def _next_ns(self) -> int:
        """Return the time when step() next has something to do. A time in the past means at once."""
        if self.letting_go:
            return self._torque_ns
        if self._stream.on:
            return min(self._stream.due_ns, self._reader.look_ns) if self._looks else self._stream.due_ns
        joints = self._to_stream()
        return self._free_ns() if joints and not self._unknown(joints) else self._reader.due_ns()

    def _end_stale(self, now_ns: int) -> bool:
        """Forget a goal that was not renewed in time. Returns True if the goal was moving the arm."""
        if self._goal is None or self._fresh(self._goal, now_ns):
            return False
        self._goal = None
        return not self.trajectory and self.drop("not renewed")

    def _advance_trajectory(self, now_ns: int) -> list[Joint]:
        """Begin the next phase of the trajectory if its current phase is over. Returns the joints that must be read
        before it can continue."""
        trajectory = self.trajectory
        if trajectory is None:
            return []
        silent = [joint for joint in trajectory.joints if joint.silent]
        # Ask all servos before reporting silent ones. If all are silent, the arm is missing; if some are, a cable is
        # bad.
        asked = all(joint.known or joint in silent for joint in trajectory.joints)
        if silent and (asked or trajectory.phase != goals.FINDING):
            trajectory.finish(_no_answer(silent))
            self._end_stream()
            return []
        if trajectory.phase == goals.FINDING:
            if unknown := [joint for joint in trajectory.joints if not joint.known]:
                return _read_first(trajectory, unknown, now_ns)
            if not trajectory.ends:
                trajectory.finish()
                return []
            trajectory.phase = goals.LOADING
        if trajectory.phase == goals.ON_ITS_WAY:
            self._watch_end(trajectory, now_ns)
        elif trajectory.phase == goals.SETTLING and now_ns >= trajectory.since_ns + QUIET_NS:
            trajectory.phase, trajectory.since_ns = goals.CHECKING, now_ns
            self._reader.hurry(now_ns)
        if trajectory.phase == goals.CHECKING:
            return self._check_end(trajectory, now_ns)
        return []

    def _watch_end(self, trajectory: Trajectory, now_ns: int) -> None:
        there = all(abs(joint.position - end) <= NEAR for joint, end in trajectory.ends.items())
        if trajectory.left_s(now_ns) <= 0.0 and there:
            self._end_stream()
            trajectory.phase, trajectory.since_ns = goals.SETTLING, now_ns
        elif now_ns - trajectory.begun_ns > trajectory.length_s * 1e9 + LOST_NS:
            self._end_stream()
            trajectory.finish("it did not get there in time")

    def _check_end(self, trajectory: Trajectory, now_ns: int) -> list[Joint]:
        """Finish the trajectory if all of its joints were read after they stopped. The trajectory fails if a joint is
        too far from its end position. Returns the joints that must still be read."""
        if unread := [joint for joint in trajectory.joints if joint.measured_ns < trajectory.since_ns]:
            return _read_first(trajectory, unread, now_ns)
        trajectory.finish(self.off(trajectory.ends))
        return []

    def off(self, ends: dict[Joint, float]) -> str:
        """Return a text about the first joint that is too far from its position in `ends`, or that was not read. Empty
        if all joints are in place."""
        for joint, end in ends.items():
            if joint.measured is None or abs(joint.measured - end) > self.tolerance:
                by = "was not read" if joint.measured is None else f"is {abs(joint.measured - end):.0f} pulses off"
                return f"joint {joint.name} (servo {joint.servo}) {by}"
        return ""

    def _load(self, joints: list[Joint], now_ns: int) -> bytes:
        """Return a frame that switches on the torque of one of these joints, the first whose torque is off. Returns an
        empty frame if the servos' bus is not free yet."""
        if now_ns < self._free_ns():
            return b""
        joint = next(joint for joint in joints if not joint.loaded)
        joint.loaded = True
        self._torque_ns = now_ns + TORQUE_APART_NS
        return self._bus.torque(joint.servo, True, round(joint.position))

    def _let_go(self, now_ns: int) -> bytes:
        if now_ns < self._torque_ns:
            return b""
        self._torque_ns = now_ns + TORQUE_APART_NS
        return self._bus.torque(self.letting_go.pop(0).servo, False, 0)

    def _begin(self, joints: list[Joint], now_ns: int) -> None:
        """Give each of these joints a move in every period from now on. If the trajectory can't begin at their present
        positions, end it as failed instead."""
        if trajectory := self.trajectory:
            if fault := trajectory.begin(now_ns):
                trajectory.finish(fault)
                return
            trajectory.phase = goals.ON_ITS_WAY
        self._left = {joint: goal for joint, goal in self._left.items() if joint not in joints}
        self._stream.begin(joints, now_ns)

    def _move(self, followed: Trajectory | Goal, now_ns: int, hold: bool) -> tuple[bytes, bool]:
        """Return the moves that are due, as (frame, hold) like step(). If the arm would hit something, a trajectory
        ends, and the returned `hold` is True. A goal of a stream is kept instead, and the arm waits where it is.
        Otherwise `hold` is returned unchanged."""
        frame, hit = self._stream.move(followed, now_ns)
        if hit and isinstance(followed, Trajectory):
            followed.finish(hit)
            self._end_stream()
            return b"", True
        self.active_ns = now_ns
        self._reader.moved(now_ns)
        return frame, hold

    def _look(self, now_ns: int) -> bytes:
        """Return a frame that asks moving joints for their positions. Empty if the board has no such frame, or if it is
        too early to ask again."""
        joints = self._reader.look(now_ns)
        return self._bus.look([joint.servo for joint in joints]) if joints else b""

    def answer(self, servo: int, what: int, value: int | None, t_ns: int) -> None:
        if self._looks and self._stream.on and what == POSITION and value is not None:
            self._reader.seen(servo, value, t_ns)
            return
        if (joint := self._reader.answer(servo, what, value, t_ns)) and not self._stream.on:
            # If a servo was turned beyond the range of its moves, use the nearest position within the range.
            joint.position = float(max(0, min(joint.measured or 0, joint.highest)))
            joint.known = True

    def pose_name(self) -> str:
        """Return the name of the pose in which the joints were last read: drive or tuck. Empty if they were in neither
        pose, or if their positions are not known."""
        for purpose in (goals.DRIVE, goals.TUCK):
            judged = self.judged(purpose)
            if judged and all(joint.known for joint in judged) and not self.off(judged):
                return purpose
        return ""

    def judged(self, purpose: str) -> dict[Joint, float]:
        """Return the position that each joint must have in the pose `purpose` (drive or tuck). Joints that are not
        judged (Joint.judged) are left out."""
        return {joint: end for joint, end in self._ends(purpose).items() if joint.judged}

    def why_not(self, now_ns: int) -> str:
        """Return why the last goal of a stream was not accepted, or why the arm can't move toward this goal. Empty if
        there is no such reason."""
        return self.refused or self._stream.blocked or self._why_not_begun(now_ns)

    def _why_not_begun(self, now_ns: int) -> str:
        """Return which joints keep a stream from beginning, or an empty text. Joints that are just being read are no
        reason."""
        if self._goal is None or self._stream.on or self.trajectory:
            return ""
        unknown = self._unknown(list(self._goal.ends))
        if silent := [joint for joint in unknown if joint.silent]:
            return _no_answer(silent)
        return _unread(unknown) if unknown and now_ns - self._rest_ns > FIND_NS else ""


def _read_first(trajectory: Trajectory, joints: list[Joint], now_ns: int) -> list[Joint]:
    """Return these joints, which must be read before the trajectory can continue. After FIND_NS, the trajectory
    fails."""
    if now_ns - trajectory.since_ns > FIND_NS:
        trajectory.finish(_unread(joints))
    return joints


def _unread(joints: list[Joint]) -> str:
    return f"{_named(joints)}: where it is can't be read"


def _no_answer(joints: list[Joint]) -> str:
    return f"{_named(joints)}: no answer from {_listed('servo', [str(joint.servo) for joint in joints])}"


def _named(joints: list[Joint]) -> str:
    return _listed("joint", [joint.name for joint in joints])


def _listed(what: str, names: list[str]) -> str:
    return f"{what}{'s' if len(names) > 1 else ''} {', '.join(names)}"
