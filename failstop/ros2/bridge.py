"""The bridge: the node, its parameters, its two threads, and how it begins and ends."""

from __future__ import annotations

import gc
import signal
from collections.abc import Sequence
from time import monotonic, sleep
from typing import Any

from failstop.api.errors import FailstopError
from failstop.policy.settings import Settings
from failstop.ros2 import mirrors
from failstop.ros2.contract import NODE, SETTINGS, Parameter, Qos
from failstop.ros2.inward import Inward
from failstop.ros2.link import RobotLink
from failstop.ros2.mirrors import MIRROR_BY_NAME
from failstop.ros2.outward import Outward
from failstop.ros2.shared import Shared
from failstop.ros2.spinner import Spinner
from failstop.shm import futex

CONNECT_S = 1.0
"""How long the start waits for a service, whose settings the parameters show."""
POLL_S = 0.05


class Bridge:
    """Everything that there is while it runs."""

    def __init__(self, rclpy: Any, name: str) -> None:
        """`rclpy`: initialised. Raises FailstopError for parameters that make no sense."""
        from rclpy.callback_groups import ReentrantCallbackGroup

        self._rclpy = rclpy
        self._node = rclpy.create_node(NODE)
        self._shared = Shared()
        self._links = (RobotLink(name), RobotLink(name))
        self._shown: dict[str, mirrors.ParameterValue] = {}
        self._given: dict[str, object] = {}
        self._mirrored = 0
        self._own = False
        own = self._declare()
        self._inward = Inward(self._node, _profile, ReentrantCallbackGroup, self._links[1], self._shared, own)
        self._outward = Outward(self._node, _profile, self._links[0], self._shared, self._inward.graph, own)

    def _declare(self) -> dict[str, Any]:
        """Declare every parameter; returns the bridge's own."""
        from rcl_interfaces.msg import ParameterDescriptor
        from rclpy.exceptions import InvalidParameterTypeException

        own: dict[str, Any] = {}
        for setting in SETTINGS:
            try:
                given = self._node.declare_parameter(setting.name, setting.default).value
            except InvalidParameterTypeException:
                raise FailstopError(f"parameter {setting.name}: {_expected(setting)} is expected") from None
            own[setting.name] = _checked(setting, given)
        shown = mirrors.values(self._settings())
        for name, value in shown.items():
            text = ", ".join(MIRROR_BY_NAME[name].keys)
            descriptor = ParameterDescriptor(description=f"shows {text}" if text else "", dynamic_typing=True)
            given = self._node.declare_parameter(name, value, descriptor).value
            if given != value:
                self._given[name] = list(given) if isinstance(given, Sequence) and not isinstance(given, str) else given
        self._node.add_on_set_parameters_callback(self._refuse)
        self._show(shown)
        return own

    def _settings(self) -> mirrors.RobotSettings:
        """The service's settings; the defaults while there is no service."""
        until_s = monotonic() + CONNECT_S
        while True:
            try:
                return self._links[1].call(lambda robot: robot.settings)
            except FailstopError as error:
                if monotonic() > until_s:
                    self._node.get_logger().warning(f"{error}; the bridge waits for it")
                    return Settings().flat()
            sleep(POLL_S)

    def _show(self, shown: dict[str, mirrors.ParameterValue]) -> None:
        """Set the mirrors, and tell of each that somebody wants otherwise."""
        from rclpy.parameter import Parameter

        self._shown = shown
        for line in mirrors.differing(self._given, shown):
            self._node.get_logger().warning(line)
        self._own = True
        self._node.set_parameters([Parameter(name, value=value) for name, value in shown.items()])
        self._own = False

    def _refuse(self, parameters: Sequence[Any]) -> Any:
        from rcl_interfaces.msg import SetParametersResult

        if self._own or not parameters:
            return SetParametersResult(successful=True)
        # Parameters of rclpy's own, such as use_sim_time, are nobody's business here.
        known = [found.name for found in parameters if found.name in self._shown or _is_own(found.name)]
        if not known:
            return SetParametersResult(successful=True)
        return SetParametersResult(successful=False, reason=mirrors.refusal(known[0]))

    def run(self) -> None:
        """Until a signal, or the end of the ROS context."""
        from rclpy.executors import ExternalShutdownException

        spinner = Spinner(self._node, self._inward.received)
        # Objects made so far stay: the collector need not go through rclpy again and again.
        gc.collect()
        gc.freeze()
        self._outward.start()
        failed: BaseException | None = None
        try:
            while not self._shared.ending and self._rclpy.ok():
                spinner.turn(self._inward.due_s())
                self._inward.turn()
                self._mirror_settings()
        except (KeyboardInterrupt, ExternalShutdownException):
            pass
        except BaseException as error:
            failed = error
            raise
        finally:
            # First its claim: what it commanded ends with it.
            self._links[1].close(failed or self._shared.failed)
            if self._inward.arm:
                self._inward.arm.close()
            self._outward.end()
            spinner.close()
            self._node.destroy_node()
        if self._shared.failed:
            raise self._shared.failed

    def _mirror_settings(self) -> None:
        """A service that was started anew may have other settings."""
        if self._mirrored != self._shared.run and self._shared.settings is not None:
            self._mirrored = self._shared.run
            shown = mirrors.values(self._shared.settings)
            if shown != self._shown:
                self._show(shown)

    def end(self, _number: int, _frame: object) -> None:
        """Signal handler: end at the next turn, which comes within 50 ms."""
        self._shared.ending = True


def _is_own(name: str) -> bool:
    return any(setting.name == name for setting in SETTINGS)


def _expected(setting: Parameter) -> str:
    if setting.allowed:
        return f"one of {', '.join(setting.allowed)}"
    return {bool: "true or false", str: "a text", list: "a list of texts"}[type(setting.default)]


def _checked(setting: Parameter, value: Any) -> Any:
    if setting.allowed and value not in setting.allowed:
        raise FailstopError(f"parameter {setting.name} = {value!r}: {_expected(setting)} is expected")
    return value


def _profile(qos: Qos) -> Any:
    """A contract's Qos as rclpy has it."""
    from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=qos.depth,
        reliability=ReliabilityPolicy.RELIABLE if qos.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if qos.transient_local else DurabilityPolicy.VOLATILE,
    )


def main(name: str, ros_arguments: Sequence[str]) -> int:
    """Run the bridge to the service of that name. Raises FailstopError."""
    import rclpy
    from rclpy.signals import SignalHandlerOptions

    futex.leave_no_dump()
    try:
        rclpy.init(args=["failstop", *ros_arguments], signal_handler_options=SignalHandlerOptions.NO)
    except Exception as error:
        raise FailstopError(f"ROS does not start: {_first_line(error)}") from None
    try:
        bridge = Bridge(rclpy, name)
        for number in (signal.SIGINT, signal.SIGTERM):
            signal.signal(number, bridge.end)
        bridge.run()
    finally:
        rclpy.try_shutdown()
    return 0


def _first_line(error: Exception) -> str:
    return next(iter(str(error).splitlines()), type(error).__name__)
