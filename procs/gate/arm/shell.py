"""The arm's part of the gate's loop. It reads the clients' goals and requests, and sends frames and replies.

A request that takes time gets several replies: first its progress (records.UNDER_WAY), and at the end DONE or REFUSED.
"""

from __future__ import annotations

from failstop.board.interface import ServoBus
from failstop.data import Data
from failstop.messages import box, records
from failstop.messages.packing import Note
from failstop.policy import causes
from failstop.policy.causes import Cause, Reply, refused
from failstop.policy.joints import too_far
from failstop.policy.settings import PAD_SOURCE
from failstop.procs.context import Context
from failstop.procs.gate.arm import goals
from failstop.procs.gate.arm.core import SERVICE, ArmCore
from failstop.procs.gate.arm.goals import Goal, Trajectory
from failstop.procs.gate.clients import Slot, newest_number
from failstop.procs.gate.core import WHEELS_ENABLED
from failstop.procs.gate.requests import Request, Requests
from failstop.procs.gate.rings import Frames

NOT_IN_POSE = "arm is not in the drive pose"
REPORT_NS = 200_000_000
"""How often a client that waits for a trajectory gets a report of its progress."""
BOX_NS = 100_000_000
"""How often the arm's goal is recorded in the black box while the arm is active."""
GOAL_MODES = {records.ARM_FOLLOW: goals.FOLLOW, records.ARM_JOG: goals.JOG}
LONGEST_S = 600.0
PAD_PUBLISHER = -1
"""The session number of the gamepad's goals. No client has this number."""


class Waiter(Data):
    """A client that waits for the end of a trajectory. `enables`: True if the client wants motion of the wheels enabled
    when the arm has arrived."""

    request: Request
    trajectory: Trajectory
    enables: bool = False
    reported_ns: int = 0


class Arm:
    def __init__(
        self,
        context: Context,
        bus: ServoBus,
        frames: Frames,
        requests: Requests,
        notes: list[Note],
        now_ns: int,
    ) -> None:
        settings = context.settings
        self.core = ArmCore(settings, bus, now_ns)
        self._beside = bus.beside_wheels
        self._stops = bool(bus.stops(settings.servos()))
        """True if the stop burst stops the servos too."""
        self._frames, self._requests, self._notes = frames, requests, notes
        self._box = context.own.ring_writer("arm_box")
        self._boxed, self._boxed_ns = ("", ""), 0
        """The mode and the program that were last recorded in the black box, and when that was."""
        telemetry = context.segment("telemetry")
        self._answers = telemetry.ring_reader("servos")
        self._pad = telemetry.latest_reader("pad_arm")
        self._pad_seq = newest_number(self._pad)
        self._pad_joint = ""
        self._by_servo = {joint.servo: joint for joint in self.core.joints}
        self._waiter: Waiter | None = None
        self._tucks = settings.on("arm.auto_tuck") and any(joint.tuck >= 0 for joint in self.core.joints)
        self._tuck_after_ns, self._notice_s = settings.ns("arm.auto_tuck_s"), settings["arm.tuck_notice_s"]
        self._tuck_announced = False
        self._tucking: Trajectory | None = None
        """The automatic trajectory to the tuck pose, or None. It is kept until its end was handled."""
        self._hot_c, self._low_mv = int(settings["arm.hot_c"]), int(settings["arm.low_mv"])
        self._joint_notes: dict[str, str] = {}
        """The last note about each joint."""

    def hear(self, closed: str, now_ns: int) -> Cause | None:
        """Handle the servos' answers and the gamepad. Returns the cause to stop for, or None. `closed`, here and in
        other methods: why the arm accepts no goal now, or an empty text."""
        while entry := self._answers.next():
            self.core.answer(*records.SERVO.unpack(entry[2]), entry[1])
        return self._hear_pad(closed, now_ns)

    def step(self, now_ns: int) -> None:
        frame, hold = self.core.step(now_ns)
        if hold:
            self._halt(now_ns)
        if frame:
            self._frames.put(records.ARM, frame, now_ns)

    def _halt(self, now_ns: int) -> None:
        """End the arm's movement. The wheels may be turning if the board can move arm and wheels together. So if a
        burst would stop only the wheels, write none: each servo stops at its last goal."""
        if self._stops or not self._beside:
            self._frames.stop(now_ns)
        else:
            self._frames.drop_arm(now_ns)

    def finish_turn(self, closed: str, now_ns: int) -> None:
        """Tuck the arm if nobody has used it for a while, and report what has changed. Call it at the end of each
        turn."""
        self._update_tuck(closed, now_ns)
        self._report_joints()
        self._keep(now_ns)

    def _keep(self, now_ns: int) -> None:
        """Record the arm's goal in the black box when the mode or the moving program changes, and ten times per second
        while the arm follows a goal."""
        followed = self.core.followed
        what = (followed.mode, followed.who) if followed else ("", "")
        if what != self._boxed or (followed and now_ns - self._boxed_ns >= BOX_NS):
            self._boxed, self._boxed_ns = what, now_ns
            ends = followed.ends.items() if followed else ()
            self._box.put(box.pack_arm(*what, [(joint.servo, end) for joint, end in ends]), now_ns)

    def client_gone(self, session: int, now_ns: int) -> None:
        """Handle a client that has left or died. If the arm moves for this client, stop it, even on the way to the
        drive pose for an enable."""
        self.core.pause(session)
        if self.core.moved_by(session):
            self.core.drop("its client has gone")
            self._halt(now_ns)
        elif self._waiter and self._waiter.request.session == session:
            self._give_up("given up: its client has gone", now_ns)

    def _give_up(self, why: str, now_ns: int) -> None:
        if self.core.drop(why):
            self._halt(now_ns)

    def goal(
        self, slot: Slot, t_ns: int, mode: int, values: dict[int, float], closed: str, now_ns: int
    ) -> Cause | None:
        """Accept a new goal of a stream. Returns the cause to stop for, or None."""
        if mode not in GOAL_MODES or not set(values) <= set(self._by_servo):
            self.core.refused = f"a goal of {slot.who()} for joints that the arm does not have"
            return None
        ends = {self._by_servo[servo]: value for servo, value in values.items()}
        return self._accept(Goal(GOAL_MODES[mode], slot.session, slot.who(), t_ns, ends), closed, now_ns)

    def _accept(self, goal: Goal, closed: str, now_ns: int) -> Cause | None:
        """Accept a goal. Returns the cause to stop for if another program sends goals too, otherwise None. A refused
        goal is not kept, so it never conflicts with another program's goal."""
        if rival := self._rival(goal.session, goal.who, now_ns):
            return rival
        self.core.accept(goal, closed, now_ns)
        return None

    def _rival(self, session: int, who: str, now_ns: int) -> Cause | None:
        other = self.core.publisher(session, now_ns)
        return causes.TWO_MOVE_THE_ARM(other, causes.rival_of(other, who)) if other else None

    def _hear_pad(self, closed: str, now_ns: int) -> Cause | None:
        """Handle the gamepad's joint mode like any program that sends goals. The joint stops when the stick is let
        go."""
        entry = self._pad.read()
        if entry is None or entry[0] == self._pad_seq:
            return None
        self._pad_seq, t_ns, payload = entry
        index, share = records.PAD_ARM.unpack(payload)
        if index >= len(self.core.joints):
            return None
        joint = self.core.joints[index]
        self._pad_joint = joint.name
        if share:
            rate = share * joint.speed_radps
            return self._accept(Goal(goals.JOG, PAD_PUBLISHER, PAD_SOURCE, t_ns, {joint: rate}), closed, now_ns)
        self.core.pause(PAD_PUBLISHER)
        if self.core.moved_by(PAD_PUBLISHER):
            self._give_up("let go", now_ns)
        return None

    def hold(self, request: Request, now_ns: int) -> Reply:
        """Carry out a client's request to stop the arm where it is."""
        self.core.stop(f"held by {request.who}", but=request.session)
        self._halt(now_ns)
        return Reply(records.DONE, "arm held")

    def move(self, request: Request, now_ns: int) -> Reply | Cause:
        """Carry out a client's request to move, read or release the arm. Returns the reply, or the cause to stop
        for."""
        if rival := self._rival(request.session, request.who, now_ns):
            return rival
        if request.verb == records.ARM_RELEASE:
            self._halt(now_ns)
            self.core.release(now_ns)
            return Reply(records.DONE, "arm released: its torque is off")
        if request.verb == records.ARM_READ:
            self.core.forget()
            trajectory: Trajectory | str = Trajectory("read", request.session, request.who, self.core.joints, [])
        else:
            trajectory = self._trajectory(request)
        if isinstance(trajectory, str):
            return refused(trajectory)
        return self._execute(Waiter(request, trajectory), "preempted", now_ns)

    def _trajectory(self, request: Request) -> Trajectory | str:
        """Return the requested trajectory, or a text that says why the request can't be carried out."""
        if request.verb in (records.ARM_DRIVE, records.ARM_TUCK):
            purpose = goals.DRIVE if request.verb == records.ARM_DRIVE else goals.TUCK
            return self.core.pose(purpose, request.session, request.who) or f"the settings have no {purpose} pose"
        if (path := request.about("arm_path")) is None:
            return "no trajectory came with the request"
        _, share, servos, rows = path
        if not set(servos) <= set(self._by_servo) or len(set(servos)) < len(servos) or not 0.0 < share <= 1.0:
            return "a trajectory for joints that the arm does not have"
        if not all(0.0 <= t_s <= LONGEST_S for t_s, _ in rows) or (len(rows) > 1 and not rows[0][0]):
            return f"a trajectory's times go up from more than 0 to {LONGEST_S:g} s"
        joints = [self._by_servo[servo] for servo in servos]
        way: list[goals.Waypoint] = []
        for t_s, angles in rows:
            aims = dict(zip(joints, angles, strict=True))
            if fault := too_far(aims):
                return fault if len(rows) == 1 else f"{fault} (at {t_s:g} s)"
            way.append((t_s, {joint: joint.pulses(angle) for joint, angle in aims.items()}))
        return goals.too_fast_between(way) or Trajectory(goals.MOVE, request.session, request.who, joints, way, share)

    def _execute(self, waiter: Waiter, why: str, now_ns: int) -> Reply:
        """Begin a trajectory for a waiting client. `why`: the text for the client that moved the arm before."""
        if self.core.execute(waiter.trajectory, now_ns, why):
            self._halt(now_ns)
        self.answer_waiter(now_ns)
        self._waiter = waiter
        return Reply(records.UNDER_WAY, waiter.trajectory.progress(now_ns))

    def answer_waiter(self, now_ns: int) -> Request | None:
        """Report the progress and the result to the client that waits for a trajectory. If the client wants motion
        enabled and the arm has reached its drive pose, return its request. The caller must then enable motion and
        reply. Otherwise return None."""
        waiter = self._waiter
        if waiter is None:
            return None
        request, trajectory = waiter.request, waiter.trajectory
        if not trajectory.done:
            if now_ns - waiter.reported_ns >= REPORT_NS:
                waiter.reported_ns = now_ns
                self._requests.answer(request, Reply(records.UNDER_WAY, trajectory.progress(now_ns)))
            return None
        self._waiter = None
        if request.slot is None or request.slot.session != request.session:
            return None
        if waiter.enables and not trajectory.dropped:
            if not (fault := self._out_of_pose(trajectory)):
                return request
            self._requests.answer(request, refused(f"{NOT_IN_POSE}: {fault}"))
        else:
            fault, there = trajectory.outcome, Reply(records.DONE, "arm is there")
            self._requests.answer(request, refused(fault, trajectory.stopped_for) if fault else there)
        return None

    def enable(self, request: Request, now_ns: int) -> Reply | None:
        """Send the arm to its drive pose, because a client wants motion enabled. Returns the client's first reply: the
        progress or a refusal. When the arm has arrived, answer_waiter() returns the client's request.

        Returns None if the settings have no drive pose. Motion may then be enabled at once. The arm stops where it is,
        unless the board can move arm and wheels together.
        """
        if self.core.letting_go:
            return refused("the arm is being released: ask again in a moment")
        waiter = self._waiter
        if waiter and waiter.enables and waiter.request.session != request.session:
            return refused(f"{waiter.request.who} is enabling motion")
        reply = None
        if trajectory := self.core.pose(goals.DRIVE, SERVICE, request.who):
            self.core.end_goals()  # so that the stream's next goal does not end this trajectory
            reply = self._execute(Waiter(request, trajectory, enables=True), WHEELS_ENABLED, now_ns)
        elif self._beside:
            return None
        else:
            self._give_up(WHEELS_ENABLED, now_ns)
        self.core.forget()
        return reply

    def _out_of_pose(self, trajectory: Trajectory) -> str:
        """Return why motion can't be enabled after the trajectory to the drive pose. Empty if motion can be enabled.
        This judges the joints' measured positions. If no servo of the drive pose answers, the setting arm.absent
        decides."""
        core = self.core
        absent = all(joint.silent for joint in core.joints if joint.drive >= 0)
        if absent and core.ignore_absent:
            return ""
        fault = trajectory.outcome or core.off(core.judged(goals.DRIVE))
        return f'{fault}; without the arm: arm.absent = "ignore"' if fault and absent else fault

    def _update_tuck(self, closed: str, now_ns: int) -> None:
        """Tuck the arm if nobody has used it for a while. The time counts from when the arm last followed a goal or
        accepted no goals."""
        core = self.core
        if self._tucking and self._tucking.done:
            if self._tucking.outcome and not self._tucking.dropped:
                self._add_note(f"the arm did not tuck itself: {self._tucking.outcome}", "warning")
            self._tucking = None
        if core.active_ns and (closed or core.followed):
            core.active_ns = now_ns
        left_s = self._tuck_left_s(now_ns)
        if left_s is None or left_s > self._notice_s:
            self._tuck_announced = False
        elif not (trajectory := core.pose(goals.TUCK, SERVICE, "auto-tuck")):
            return
        elif not core.off(trajectory.ends):
            core.active_ns = 0  # it is already tucked
        elif not self._tuck_announced:
            self._tuck_announced = True
            self._add_note(f"nobody uses the arm, so it goes to its tuck pose in {self._notice_s:g} s")
        elif left_s <= 0.0:
            core.execute(trajectory, now_ns)
            core.active_ns = 0
            self._tucking = trajectory

    def _tuck_left_s(self, now_ns: int) -> float | None:
        """Return the seconds until the arm tucks itself. None if the setting is off, or if there is nothing to tuck
        (see ArmCore.active_ns)."""
        active_ns = self.core.active_ns
        return max(0.0, (active_ns + self._tuck_after_ns - now_ns) * 1e-9) if self._tucks and active_ns else None

    def _add_note(self, text: str, level: str = "") -> None:
        self._notes.append(Note("arm", text, level=level))

    def _report_joints(self) -> None:
        """Report each fault of a servo when it begins, and again when it is over."""
        for joint in self.core.joints:
            text = ""
            if joint.silent:
                text = "does not answer"
            elif joint.temperature_c >= self._hot_c:
                text = f"is hot: {self._hot_c} degrees or more; at 85 it lets go"
            elif joint.supply_mv and joint.supply_mv < self._low_mv:
                text = f"has less than {self._low_mv} mV; with little less it lets go"
            if text != self._joint_notes.get(joint.name, "") and (text or joint.known):
                self._joint_notes[joint.name] = text
                self._add_note(
                    f"joint {joint.name} (servo {joint.servo}) {text or 'is fine again'}", "warning" if text else ""
                )

    def state(self, closed: str, now_ns: int) -> dict[str, object]:
        """Return the arm's part of the state that the gate publishes, for people and programs."""
        core = self.core
        trajectory, followed = core.trajectory, core.followed
        left_s, pose = self._tuck_left_s(now_ns), core.pose_name()
        return {
            "mode": followed.mode if followed else "",
            "phase": trajectory.phase if trajectory else "",
            "moving": core.streaming(),
            "by": followed.who if followed else "",
            "refused": core.why_not(now_ns),
            "closed": closed,
            "released": core.released,
            "silent": [joint.servo for joint in core.joints if joint.silent],
            "joints": [joint.state() for joint in core.joints],
            "auto_tuck_s": None if left_s is None or followed or pose == goals.TUCK else round(left_s),
            "wrong": [f"joint {name} {text}" for name, text in self._joint_notes.items() if text],
            "pose": pose,
            "pad_joint": self._pad_joint if core.moved_by(PAD_PUBLISHER) else None,
            "tucks": left_s is not None and left_s <= self._notice_s and not followed,
        }
