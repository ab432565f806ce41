"""The arm's part of the gate's loop: clients' goals and requests in, frames and replies out.

A request that takes time has more than one reply: how far it is (records.UNDER_WAY), and in the end DONE or REFUSED.
"""

from __future__ import annotations

from failstop.messages import box, records
from failstop.messages.packing import Note
from failstop.messages.records import CAUSE
from failstop.policy import causes
from failstop.policy.joints import PULSES_PER_RAD, too_far
from failstop.policy.reply import Reply
from failstop.procs.context import Context
from failstop.procs.gate.arm import goals
from failstop.procs.gate.arm.core import ENABLED, SERVICE, ArmCore
from failstop.procs.gate.arm.goals import Goal, Journey
from failstop.procs.gate.clients import Slot, seen
from failstop.procs.gate.core import IS_LATCHED
from failstop.procs.gate.sources import PAD
from failstop.procs.loop import Timer

TYPE_CHECKING = False
if TYPE_CHECKING:
    from typing import Any

    from failstop.procs.gate.main import Gate

NOT_IN_POSE = "arm is not in the drive pose"
TELL_NS = 200_000_000
"""How often who waits is told how far it is."""
BOX_NS = 100_000_000
"""How often the black box is told what it is to do, while it does anything."""
MODES = {records.ARM_FOLLOW: goals.FOLLOW, records.ARM_JOG: goals.JOG}
LONGEST_S = 600.0
PAD_PUBLISHER = -1
"""The gamepad's session: no client's."""


class Waiter:
    """A client that waits for the end of a journey, and whether it wants motion to be enabled then."""

    def __init__(self, slot: Slot, number: int, journey: Journey, *, enables: bool = False) -> None:
        self.slot = slot
        self.session = slot.session
        self.number = number
        self.journey = journey
        self.enables = enables
        self.told_ns = 0


class Arm:
    """The arm of a gate whose robot has one."""

    def __init__(self, gate: Gate, context: Context, due: Timer, now_ns: int) -> None:
        """`due`: when to turn without any news."""
        settings = context.settings
        self.core = ArmCore(settings, gate.core, now_ns)
        self._gate = gate
        self._box = context.own.ring_writer("arm_box")
        self._boxed, self._boxed_ns = ("", ""), 0
        """The last entry of the black box, and its time."""
        telemetry = context.segment("telemetry")
        self._answers = telemetry.ring_reader("servos")
        self._pad = telemetry.latest_reader("pad_arm")
        self._pad_seq = seen(self._pad)
        self._pad_joint = ""
        self._by_servo = {joint.servo: joint for joint in self.core.joints}
        self._waiter: Waiter | None = None
        self._tucks = settings.on("arm.auto_tuck")
        self._tuck_after_ns, self._notice_s = settings.ns("arm.auto_tuck_s"), settings["arm.tuck_notice_s"]
        self._tuck_announced = False
        self._tucking: Journey | None = None
        """Its way, until people have been told how it ended."""
        self._hot_c, self._low_mv = int(settings["arm.hot_c"]), int(settings["arm.low_mv"])
        self._told: dict[str, str] = {}
        """The last news of each joint for people."""
        self._due = due

    # The gate's turn.

    def turn(self, now_ns: int) -> None:
        """Answers of the servos, then whatever is due."""
        core, gate = self.core, self._gate.core
        while entry := self._answers.next():
            core.answer(*records.SERVO.unpack(entry[2]), entry[1])
        self._follow_pad(now_ns)
        if not gate.enabled:
            self._step(now_ns)
        self._answer_waiter(now_ns)
        self._follow_tuck(now_ns)
        self._tell_joints()
        self._keep(now_ns)
        self._due.set(now_ns + TELL_NS if gate.enabled else core.due_ns)

    def _keep(self, now_ns: int) -> None:
        """For the black box: what it is to do, at each change of mode and mover, and ten times a second meanwhile."""
        followed = self.core.followed
        what = (followed.mode, followed.who) if followed else ("", "")
        if what != self._boxed or (followed and now_ns - self._boxed_ns >= BOX_NS):
            self._boxed, self._boxed_ns = what, now_ns
            ends = followed.ends.items() if followed else ()
            self._box.put(box.pack_arm(*what, [(joint.servo, end) for joint, end in ends]), now_ns)

    def _step(self, now_ns: int) -> None:
        frame, hold = self.core.step(now_ns)
        if hold:
            self._hold(now_ns)
        if frame:
            self._gate.send(records.ARM, frame, now_ns)

    def _hold(self, now_ns: int) -> None:
        """Stop it where it is, by the write that stops everything: the wheels stand while an arm moves."""
        self._gate.send(records.STOP, b"", now_ns)

    # News.

    def client_gone(self, session: int, now_ns: int) -> None:
        """A client has left or died: what it moved is held, what it waited for is given up."""
        self.core.pause(session)
        if self.core.moved_by(session):
            self.core.drop("its client has gone")
            self._hold(now_ns)
        elif self._waiter and self._waiter.session == session:
            self._give_up("given up: its client has gone", now_ns)

    def _give_up(self, why: str, now_ns: int) -> None:
        if self.core.drop(why):
            self._hold(now_ns)

    def goal(self, slot: Slot, now_ns: int) -> None:
        """A new goal of a stream, if the slot has one."""
        if (found := slot.new("arm_goal")) is None:
            return
        t_ns, mode, values = found
        if mode not in MODES or not set(values) <= set(self._by_servo):
            self.core.refused = f"a goal of {slot.who()} for joints that the arm does not have"
            return
        if self._rivals(slot.session, slot.who(), now_ns):
            return
        ends = {self._by_servo[servo]: value for servo, value in values.items()}
        self.core.take(Goal(MODES[mode], slot.session, slot.who(), t_ns, ends), now_ns)

    def _follow_pad(self, now_ns: int) -> None:
        """The gamepad in its joint mode is a publisher like any other. A joint that it lets go of is held."""
        entry = self._pad.read()
        if entry is None or entry[0] == self._pad_seq:
            return
        self._pad_seq, t_ns, payload = entry
        index, share = records.PAD_ARM.unpack(payload)
        if index >= len(self.core.joints):
            return
        joint = self.core.joints[index]
        self._pad_joint = joint.name
        if not share:
            self.core.pause(PAD_PUBLISHER)
        goal = Goal(goals.JOG, PAD_PUBLISHER, PAD, t_ns, {joint: share * joint.speed / PULSES_PER_RAD})
        if share and not self._rivals(PAD_PUBLISHER, PAD, now_ns):
            self.core.take(goal, now_ns)
        elif not share and self.core.moved_by(PAD_PUBLISHER):
            self._give_up("let go", now_ns)

    def _rivals(self, session: int, who: str, now_ns: int) -> bool:
        """A second publisher of goals latches."""
        other = self.core.publisher(session, now_ns)
        if other and not self.core.closed:
            self._gate.stop(causes.TWO_MOVE_THE_ARM(other, who), now_ns)
        return bool(other)

    def _said(self, done: int, text: str) -> Reply:
        return Reply(done, text, self._gate.core.latch if CAUSE in text else None)

    def request(self, slot: Slot, number: int, verb: int, now_ns: int) -> Reply:
        """A client's request about the arm."""
        if verb == records.ARM_HOLD:
            self.core.end_streams(slot.session)
            self._give_up(f"held by {slot.who()}", now_ns)
            self.core.letting_go.clear()
            self._hold(now_ns)
            return Reply(records.DONE, "arm held")
        if closed := self.core.closed:
            return self._said(records.REFUSED, closed)
        if self._rivals(slot.session, slot.who(), now_ns):
            return self._said(records.REFUSED, IS_LATCHED)
        if verb == records.ARM_RELEASE:
            self._hold(now_ns)
            self.core.release(now_ns)
            return Reply(records.DONE, "arm released: its torque is off")
        if verb == records.ARM_READ:
            self.core.forget()
            journey: Journey | str = Journey("read", slot.session, slot.who(), self.core.joints, [])
        else:
            journey = self._journey(slot, verb)
        if isinstance(journey, str):
            return Reply(records.REFUSED, journey)
        return self._travel(Waiter(slot, number, journey), "preempted", now_ns)

    def _journey(self, slot: Slot, verb: int) -> Journey | str:
        """The way that is asked for, or why there is none."""
        if verb in (records.ARM_DRIVE, records.ARM_TUCK):
            purpose = goals.DRIVE if verb == records.ARM_DRIVE else goals.TUCK
            return self.core.pose(purpose, slot.session, slot.who()) or f"the settings have no {purpose} pose"
        if verb != records.ARM_MOVE or (path := slot.latest("arm_path")) is None:
            return "no trajectory came with the request"
        _, share, servos, rows = path
        if not set(servos) <= set(self._by_servo) or len(set(servos)) < len(servos) or not 0.0 < share <= 1.0:
            return "a trajectory for joints that the arm does not have"
        if not all(0.0 <= t_s <= LONGEST_S for t_s, _ in rows) or (len(rows) > 1 and not rows[0][0]):
            return f"a trajectory's times go up from more than 0 to {LONGEST_S:g} s"
        joints = [self._by_servo[servo] for servo in servos]
        way: list[goals.Row] = []
        for t_s, angles in rows:
            aims = dict(zip(joints, angles, strict=True))
            if fault := too_far(aims):
                return fault if len(rows) == 1 else f"{fault} (at {t_s:g} s)"
            way.append((t_s, {joint: joint.pulses(angle) for joint, angle in aims.items()}))
        return goals.too_fast_between(way) or Journey(goals.MOVE, slot.session, slot.who(), joints, way, share)

    def _travel(self, waiter: Waiter, why: str, now_ns: int) -> Reply:
        """Begin a journey for who waits; `why`: what whoever moved the arm before is told."""
        if self.core.travel(waiter.journey, now_ns, why):
            self._hold(now_ns)
        self._answer_waiter(now_ns)
        self._waiter = waiter
        return Reply(records.UNDER_WAY, waiter.journey.progress(now_ns))

    def _answer_waiter(self, now_ns: int) -> None:
        """Tell who waits how far it is, and how it ended."""
        waiter = self._waiter
        if waiter is None:
            return
        journey = waiter.journey
        if not journey.done:
            if now_ns - waiter.told_ns >= TELL_NS:
                waiter.told_ns = now_ns
                self._answer(waiter, Reply(records.UNDER_WAY, journey.progress(now_ns)), now_ns)
            return
        self._waiter = None
        if waiter.slot.session != waiter.session:
            return
        if waiter.enables and not journey.dropped:
            self._enable_in_pose(waiter, now_ns)
        else:
            done = records.REFUSED if journey.outcome else records.DONE
            self._answer(waiter, self._said(done, journey.outcome or "arm is there"), now_ns)

    def _answer(self, waiter: Waiter, reply: Reply, now_ns: int) -> None:
        self._gate.requests.reply(waiter.slot, waiter.session, waiter.number, reply, now_ns)

    # Enabling motion.

    def enable(self, slot: Slot, number: int, now_ns: int) -> Reply | None:
        """To the drive pose, and then the gate enables motion, if that is what was read back. None: the settings have
        no drive pose, so the arm stands where it is, and motion may be enabled now."""
        if self.core.letting_go:
            return Reply(records.REFUSED, "the arm is being released: ask again in a moment")
        waiter = self._waiter
        if waiter and waiter.enables and waiter.session != slot.session:
            return Reply(records.REFUSED, f"{waiter.slot.who()} is enabling motion")
        journey = self.core.pose(goals.DRIVE, SERVICE, slot.who())
        reply = None
        if journey is None:
            self._give_up(ENABLED, now_ns)
        else:
            reply = self._travel(Waiter(slot, number, journey, enables=True), ENABLED, now_ns)
        self.core.forget()
        return reply

    def _enable_in_pose(self, waiter: Waiter, now_ns: int) -> None:
        """The end of the way to the drive pose: what was read back decides."""
        core = self.core
        absent = all(joint.silent for joint in core.joints if joint.drive >= 0)
        fault = "" if absent and core.ignore_absent else waiter.journey.outcome or core.off_pose(goals.DRIVE)
        if fault:
            hint = '; without the arm: arm.absent = "ignore"' if absent else ""
            self._answer(waiter, Reply(records.REFUSED, f"{NOT_IN_POSE}: {fault}{hint}"), now_ns)
        else:
            self._gate.requests.enable_now(waiter.slot, waiter.number, now_ns)

    # For people.

    def _follow_tuck(self, now_ns: int) -> None:
        """An arm that is left alone tucks itself; it is not left alone while it moves, or may not."""
        core = self.core
        if self._tucking and self._tucking.done:
            if self._tucking.outcome and not self._tucking.dropped:
                self._tell(f"the arm did not tuck itself: {self._tucking.outcome}", "warning")
            self._tucking = None
        if core.active_ns and (core.closed or core.followed):
            core.active_ns = now_ns
        left_s = self._tuck_left_s(now_ns)
        if left_s is None or left_s > self._notice_s:
            self._tuck_announced = False
        elif not (journey := core.pose(goals.TUCK, SERVICE, "auto-tuck")):
            return
        elif not core.off(journey.ends):
            core.active_ns = 0  # it is there
        elif not self._tuck_announced:
            self._tuck_announced = True
            self._tell(f"the arm was left alone: it goes to its tuck pose in {self._notice_s:g} s")
        elif left_s <= 0.0:
            core.travel(journey, now_ns)
            core.active_ns = 0
            self._tucking = journey

    def _tuck_left_s(self, now_ns: int) -> float | None:
        """Until it tucks itself; None: it does not, since it was not used, or it is switched off."""
        active_ns = self.core.active_ns
        return max(0.0, (active_ns + self._tuck_after_ns - now_ns) * 1e-9) if self._tucks and active_ns else None

    def _tell(self, text: str, level: str = "") -> None:
        self._gate.core.notes.append(Note("arm", text, level=level))

    def _tell_joints(self) -> None:
        """Tell of a servo's fault, once, and that it is well again."""
        for joint in self.core.joints:
            text = ""
            if joint.silent:
                text = "does not answer"
            elif joint.temperature_c >= self._hot_c:
                text = f"is hot: {self._hot_c} degrees or more; at 85 it lets go"
            elif joint.supply_mv and joint.supply_mv < self._low_mv:
                text = f"has less than {self._low_mv} mV; with little less it lets go"
            if text != self._told.get(joint.name, "") and (text or joint.known):
                self._told[joint.name] = text
                self._tell(
                    f"joint {joint.name} (servo {joint.servo}) {text or 'is well again'}", "warning" if text else ""
                )

    def state(self, now_ns: int) -> dict[str, Any]:
        """Its part of the gate's state: what people and programs are told."""
        core = self.core
        way, followed = core.way, core.followed
        left_s, pose = self._tuck_left_s(now_ns), core.pose_name()
        return {
            "mode": followed.mode if followed else "",
            "phase": way.phase if way else "",
            "moving": core.streaming(),
            "by": followed.who if followed else "",
            "refused": _without_cause(core.why_not()),
            "closed": _without_cause(core.closed),
            "released": core.released,
            "silent": [joint.servo for joint in core.joints if joint.silent],
            "joints": [joint.state() for joint in core.joints],
            "auto_tuck_s": None if left_s is None or followed or pose == goals.TUCK else round(left_s),
            "wrong": [f"joint {name} {text}" for name, text in self._told.items() if text],
            "pose": pose,
            "pad_joint": self._pad_joint if core.moved_by(PAD_PUBLISHER) else None,
            "tucks": left_s is not None and left_s <= self._notice_s and not followed,
        }


def _without_cause(text: str) -> str:
    """For the state, which tells the cause elsewhere."""
    return text.removesuffix(f" ({CAUSE})")
