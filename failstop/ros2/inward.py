"""Inward: receives commands, scans, stops and service calls from ROS, and passes them to the service. It runs in the
thread that spins the node."""

from __future__ import annotations

from math import isfinite
from time import monotonic_ns, time_ns
from typing import Any

from failstop.api.errors import FailstopError, NoAnswer, Refused
from failstop.api.robot import Robot
from failstop.policy import causes
from failstop.policy.causes import Cause
from failstop.ros2 import mirrors, report, words
from failstop.ros2.arm import ArmFace
from failstop.ros2.awake import Awake
from failstop.ros2.commanders import FRESH_NS, NAMELESS_NS, Commanders, Lag, Owed, reason, waited_ns, wrong_ends
from failstop.ros2.contract import (
    CLIENT,
    CMD_VEL,
    COMMAND_TYPES,
    ESTOP,
    ESTOP_LASTING,
    ESTOP_LOSSY,
    SCAN,
    SERVICES,
    STAMPED,
    Topic,
)
from failstop.ros2.fill import type_of
from failstop.ros2.graph import Graph, latch
from failstop.ros2.link import RobotLink
from failstop.ros2.scan import ScanWatch
from failstop.ros2.shared import Shared
from failstop.ros2.stamps import Stamps
from failstop.ros2.turn import Turn

WATCH_NS = 50_000_000
EARLY_NS = 20_000_000
SAY_NS = 1_000_000_000
INWARD_LOOK_NS = 500_000_000
STOP_NS = 1_000_000_000
"""How long the stop service waits for the proofs of its stop."""
LOG_NS = 5_000_000_000
"""The shortest time between two log lines about the same problem."""


class Inward:
    """The subscriptions and services of the bridge."""

    def __init__(
        self, node: Any, qos: Any, group: Any, link: RobotLink, shared: Shared, settings: dict[str, Any]
    ) -> None:
        """`qos` makes rclpy's profile from a contract.Qos. `group` makes a callback group. `settings`: the bridge's own
        parameters."""
        self._node = node
        self._qos = qos
        self._group = group
        self._link = link
        self._shared = shared
        self.arm: ArmFace | None = None
        """The arm's part of the bridge. None until the service's settings are known. It stays None if they have no
        joints."""
        now_ns = monotonic_ns()
        self._accepted = COMMAND_TYPES[settings["cmd_vel_type"]]
        self._commanders = Commanders(self._accepted, settings["allowed_publishers"])
        self._lag = Lag()
        self._stamps = Stamps(lambda: int(node.get_clock().now().nanoseconds))
        self._received_ns = self._sent_ns = 0
        self._awake = Awake()
        self._epoch = 0
        """The epoch of the service's state at the last turn before the present pause."""
        self._scan = ScanWatch(0.5)
        self._timeout_s = 0.3
        self._run = ""
        self._asserts = False
        """True if the settings declare the bridge's interlock."""
        self._moving_ns = -STOP_NS
        """When the last command arrived that was not zero."""
        self._velocity = (0.0, 0.0, 0.0)
        self._unnamed_ns = 0
        """When a stop was requested for a command with NaN or infinity whose publisher had no name yet. 0 if there was
        none."""
        self._said_ns = self._looked_ns = now_ns - SAY_NS
        self._said: tuple[str, str] = ("", "")
        self._wrong_estop: list[str] = []
        self._complained_ns: dict[str, int] = {}
        self._type = self._accepted[0]
        # Subscribe to estop first, because subscriptions are served in this order.
        self._estop_topic = self._subscribe(ESTOP, self._estop).topic_name
        self._subscribe(ESTOP_LOSSY, self._estop)
        self._hears_lasting = False
        """True if there is a subscription that gets estop's last message from before it."""
        self._stopped_ns = 0
        """When the estop message was sent that was handled last. It is needed because several subscriptions receive the
        messages of a reliable publisher."""
        self._owed = Owed()
        """The stop of the last estop message, if no run of the service is known to have heard it."""
        self._subscription = self._subscribe(CMD_VEL, self._command, self._type)
        self._scan_topic = self._subscribe(SCAN, self._scanned, raw=True).topic_name
        self.graph = Graph(node, self._subscription.topic_name, self._commanders, shared)
        for service, answer in zip(SERVICES, (self._enable, self._reset, self._stop), strict=True):
            # Each has its own group, because all callbacks of one group wait while one of them has not ended.
            node.create_service(type_of(service.type), service.name, answer, callback_group=group())
        self._watch_ns = now_ns
        """When the watch must run next."""

    def _subscribe(self, topic: Topic, act: Any, kind: str = "", *, raw: bool = False) -> Any:
        found = type_of(kind or topic.type)
        return self._node.create_subscription(found, topic.name, act, self._qos(topic.qos), raw=raw)

    def _complain(self, what: str, line: str) -> None:
        """Log a warning, unless the same kind of warning was logged recently."""
        now_ns = monotonic_ns()
        if now_ns - self._complained_ns.get(what, -LOG_NS) >= LOG_NS:
            self._complained_ns[what] = now_ns
            self._node.get_logger().warning(line)

    def _latch(self, cause: str) -> bool:
        return latch(self._node, self._link, cause)

    # Commanders.

    def due_s(self) -> float:
        """How long until the watch must run, s."""
        return max(0, self._watch_ns - monotonic_ns()) / 1e9

    def turn(self) -> None:
        """Run the watch if it is due within EARLY_NS, so that the thread need not wake up only for the watch. Call this
        after every turn of the spinner."""
        if not self._awake.waited_ns():
            self._epoch = state.epoch if (state := self._shared.state) else 0
        if (now_ns := monotonic_ns()) >= self._watch_ns - EARLY_NS:
            self._watch_ns = now_ns + WATCH_NS
            self._watch()

    def received(self, wall_ns: int, sent_ns: int) -> None:
        """Note when the message for the next callback was received by DDS (`wall_ns`), and when its publisher sent it
        (`sent_ns`, by the publisher's clock). Both are wall clock times in ns; 0 if not known, or if this is never
        called."""
        self._received_ns, self._sent_ns = wall_ns, sent_ns

    def _waited_ns(self) -> int:
        """How long the current message has waited in its queue."""
        return waited_ns(self._received_ns, time_ns())

    def _watch(self) -> None:
        """Assert the bridge's interlock, and do everything else that is due from time to time. Runs at least 20 times a
        second, unless the executor hangs. Then the interlock expires."""
        now_ns = monotonic_ns()
        self._adopt_run()
        if self._owed.due(state := self._shared.state, now_ns):
            self._owed.asked(state, now_ns, sent=self._latch_again())
        if now_ns - self._looked_ns >= INWARD_LOOK_NS:
            self._looked_ns = now_ns
            self._scan.look(self.graph.publishers(self._scan_topic))
            publishers = self.graph.publishers(self._estop_topic)
            self._wrong_estop = wrong_ends(ESTOP.name, publishers, (ESTOP.type,), reliable=False)
            # With such a subscription, ROS warns that every other publisher of estop is not heard, so it is made only
            # if it is needed. It still gets the last message.
            if not self._hears_lasting and any(publisher.lasting for publisher in publishers):
                self._hears_lasting = True
                self._subscribe(ESTOP_LASTING, self._estop)
        self._resubscribe()
        if self._unnamed_ns and now_ns - self._unnamed_ns > NAMELESS_NS:
            self._unnamed_ns = 0
        elif self._unnamed_ns and self._commanders.count and causes.NOT_KNOWN not in self._commanders.names():
            self._latch_not_finite(now_ns)
        if self.arm:
            self.arm.poll(now_ns)
        try:
            if self._asserts and self._commanders.holds(now_ns):
                self._link.call(lambda robot: robot.assert_interlocks(CLIENT))
            self._say(now_ns)
        except FailstopError as error:
            self._complain("service", str(error))

    def _resubscribe(self) -> None:
        """Subscribe to the message type that cmd_vel's publisher offers. One subscription can receive only one type."""
        wanted = self._commanders.wanted_type(self._type)
        if wanted != self._type:
            self._node.destroy_subscription(self._subscription)
            self._type = wanted
            self._subscription = self._subscribe(CMD_VEL, self._command, wanted)
            self._node.get_logger().info(f"cmd_vel is read as {wanted} now, because its publisher offers that")

    def _adopt_run(self) -> None:
        """If the service was restarted, read its settings and connect again."""
        settings = self._shared.settings
        if self._run == self._shared.run or settings is None:
            return
        if self._run:
            self._link.close()
        self._run = self._shared.run
        self._timeout_s = mirrors.command_timeout_s(settings)
        self._scan.timeout_s = float(settings["scan.timeout_s"])
        self._scan.needed = settings["scan.gate"] == "on"
        if self.arm is None and any(key.startswith("joints.") for key in settings):
            common = (self._node, self._qos, self._group, self._link, self._shared)
            self.arm = ArmFace(*common, self._stamps, self._waited_ns, self._awake)
        if self.arm:
            self.arm.goal_timeout_s = float(settings["arm.goal_timeout_s"])
            self.arm.unwatched_s = float(settings["arm.unwatched_s"])
        self._asserts = f"interlocks.{CLIENT}.timeout_s" in settings

    def _say(self, now_ns: int) -> None:
        """Report to the service what the bridge sees, at each change and every second."""
        scan, wrong = self._scan.says(now_ns)
        commanders = self._commanders
        names = commanders.names() if commanders.count else ""
        wrong = [*commanders.wrong(), *self._stamps.wrong(now_ns), *wrong, *self._wrong_estop]
        said = (report.says(names, scan), "; ".join(wrong))
        if said == self._said and now_ns - self._said_ns < SAY_NS:
            return
        self._shared.publishers = tuple(publisher.node for publisher in commanders.publishers)
        self._shared.sees, self._shared.wrong = (said[0],), tuple(wrong)
        self._said, self._said_ns = said, now_ns
        self._link.call(lambda robot: robot.say(*said))

    # Topics.

    def _command(self, message: Any) -> None:
        now_ns, waited_ns = monotonic_ns(), self._waited_ns()
        self.graph.ask(self._link, now_ns)
        twist = message.twist if self._type == STAMPED else message
        (vx, vy, vz), (wx, wy, wz) = _axes(twist.linear), _axes(twist.angular)
        velocity = (vx, vy, wz)
        if not all(map(isfinite, (*velocity, vz, wx, wy))):
            self._latch_not_finite(now_ns)
            return
        late = self._late(message)
        if any(velocity):
            # A zero velocity is never refused, even if it is late, because it may stop the robot.
            if late:
                self._complain("late", f"cmd_vel is refused: {late}")
                return
            self._moving_ns, self._velocity = now_ns, velocity
            if waited_ns > self._timeout_s * 1e9:
                self._complain("waited", f"cmd_vel is refused: {words.waited(waited_ns / 1e9)}")
                return
            if not self._commanders.passes(now_ns - waited_ns):
                return
        try:
            self._link.call(lambda robot: robot.drive(*velocity, wait_s=0.0))
        except FailstopError as error:
            self._complain("service", f"cmd_vel moves nothing: {error}")

    def _latch_not_finite(self, now_ns: int) -> None:
        """Request a stop because of a command with NaN or infinity. If the publisher's name is not known yet, the watch
        requests the stop once more with the name."""
        who = self._commanders.names()
        self._unnamed_ns = now_ns if causes.NOT_KNOWN in who else 0
        self._latch(reason(causes.ROS_NOT_FINITE, who))

    def _late(self, message: Any) -> str:
        """If the command is too old, return the reason for refusing it. Empty if it is not too old."""
        late_ns = self._lag.late_ns(self._commanders.publishers, self._sent_ns, self._received_ns or time_ns())
        if late_ns > self._timeout_s * 1e9:
            return words.repaired(late_ns / 1e9)
        if self._type != STAMPED:
            return ""
        who = self._commanders.names()
        return self._stamps.late(CMD_VEL.name, who, message.header.stamp, self._timeout_s, monotonic_ns())

    def _scanned(self, _message: bytes) -> None:
        if self._waited_ns() > FRESH_NS:
            return
        self._scan.heard(monotonic_ns())
        try:
            self._link.call(Robot.sensed)
        except FailstopError as error:
            self._complain("service", f"scans are not passed on: {error}")

    def _estop(self, message: Any) -> None:
        if message.data and not (self._sent_ns and self._sent_ns == self._stopped_ns):
            self._stopped_ns = self._sent_ns
            state = self._shared.state
            self._owed.asked(state, monotonic_ns(), sent=self._latch(words.TOPIC_CAUSE))

    def _latch_again(self) -> bool:
        """Request the stop of the last estop message again. Returns False if there is nothing to stop."""
        try:
            self._link.stop(words.TOPIC_CAUSE)
        except FailstopError as error:
            self._complain("estop", f"{words.TOPIC_CAUSE}, and there is still nothing to stop: {error}")
            return False
        self._complain("estop again", f"{words.TOPIC_CAUSE}: the stop was requested again")
        return True

    # Services.

    async def _enable(self, request: Any, response: Any) -> Any:
        """Enable or disable motion. With an arm this takes seconds, so the executor does other work meanwhile."""
        if not request.data:
            if self.arm:
                self.arm.give_up()
            return self._answer(response, lambda: self._link.call(Robot.disable, at_once=True) and words.DISABLED)
        try:
            self._awake.check_request()
        except Refused as error:
            response.success, response.message = False, words.refused(error)
            return response
        if self.arm:
            ended = self.arm.begin(Robot.enable)
            while not ended():
                await Turn()
            return self._answer(response, lambda: ended.result() and words.ENABLED)
        return self._answer(response, lambda: self._link.call(Robot.enable, at_once=True) and words.ENABLED)

    def _reset(self, _request: Any, response: Any) -> Any:
        return self._answer(response, self._ask_reset)

    def _ask_reset(self) -> str:
        self._awake.check_request()
        # After a pause, only the stop from before it is reset, because the caller can't have seen a newer one.
        seen = self._epoch if self._awake.waited_ns() else 0
        now_ns = monotonic_ns()
        self.graph.ask(self._link, now_ns)
        if cause := self._commanders.cause(now_ns):
            raise Refused(cause)
        if self.arm and (cause := self.arm.rivals()):
            raise Refused(cause)
        if now_ns - self._moving_ns < self._timeout_s * 1e9:
            who = self._commanders.names()
            raise Refused(words.still_commands(who, self._velocity, self._timeout_s))
        return words.reset(self._link.call(lambda robot: _reset(robot, seen)))

    def _answer(self, response: Any, act: Any) -> Any:
        try:
            response.success, response.message = True, act()
            self._shared.asked += 1
        except Refused as error:
            response.success, response.message = False, words.refused(error)
        except NoAnswer:
            self._latch(words.NO_ANSWER)
            response.success, response.message = False, words.NO_ANSWER
        except FailstopError as error:
            response.success, response.message = False, words.refused(error)
        return response

    async def _stop(self, _request: Any, response: Any) -> Any:
        """Request a stop at once. Then wait for its proofs, while the executor does other work."""
        asked_ns = monotonic_ns()
        before = self._shared.state
        try:
            self._link.stop(words.SERVICE_CAUSE)
        except FailstopError as error:
            response.success, response.message = False, words.refused(error)
            return response
        while not (known := report.proof(before, self._shared.state, final=monotonic_ns() - asked_ns >= STOP_NS)):
            await Turn()
        response.success, response.message = known
        return response


def _axes(vector: Any) -> tuple[float, float, float]:
    return vector.x, vector.y, vector.z


def _reset(robot: Robot, seen: int) -> Cause | None:
    """Reset the latched stop. Returns its cause. `seen`: the epoch of the only stop that may be reset, or 0 for any."""
    was = robot.state.cause
    robot.reset(seen=seen)
    return was
