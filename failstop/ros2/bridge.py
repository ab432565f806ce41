"""The bridge: its node, its parameters, its two threads, and how it starts and ends."""

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
"""How long to wait at the start for a service, s. Its settings are shown as parameters."""
POLL_S = 0.05


class Bridge:
    """The running bridge."""

    def __init__(self, rclpy: Any, name: str) -> None:
        """`rclpy`: the module, after rclpy.init(). Raises FailstopError if a parameter has a value that is not
        allowed."""
        from rclpy.callback_groups import ReentrantCallbackGroup

        self._rclpy = rclpy
        self._node = rclpy.create_node(NODE)
        self._shared = Shared()
        self._links = (RobotLink(name), RobotLink(name))
        self._shown: dict[str, mirrors.ParameterValue] = {}
        self._given: dict[str, object] = {}
        self._mirrored = ""
        self._own = False
        own = self._declare()
        self._inward = Inward(self._node, _profile, ReentrantCallbackGroup, self._links[1], self._shared, own)
        self._outward = Outward(self._node, _profile, self._links[0], self._shared, self._inward.graph, own)

    def _declare(self) -> dict[str, Any]:
        """Declare every parameter. Returns the values of the bridge's own parameters."""
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
        """The service's settings. If no service answers in time, their defaults."""
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
        """Set the parameters that show settings. Logs a warning for each parameter that was started with another
        value."""
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
        # rclpy's own parameters, such as use_sim_time, may be set.
        known = [found.name for found in parameters if found.name in self._shown or _is_own(found.name)]
        if not known:
            return SetParametersResult(successful=True)
        return SetParametersResult(successful=False, reason=mirrors.refusal(known[0]))

    def run(self) -> None:
        """Run until a signal arrives or the ROS context ends."""
        from rclpy.executors import ExternalShutdownException

        spinner = Spinner(self._node, self._inward.received)
        # The objects made so far stay, so the garbage collector need not visit them again and again.
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
            # Close this connection first, because the bridge's commands end with it.
            self._links[1].close(failed or self._shared.failed)
            if self._inward.arm:
                self._inward.arm.close()
            self._outward.end()
            spinner.close()
            self._node.destroy_node()
        if self._shared.failed:
            raise self._shared.failed

    def _mirror_settings(self) -> None:
        """After a restart of the service, update the parameters that show its settings."""
        if self._mirrored != self._shared.run and self._shared.settings is not None:
            self._mirrored = self._shared.run
            shown = mirrors.values(self._shared.settings)
            if shown != self._shown:
                self._show(shown)

    def end(self, _number: int, _frame: object) -> None:
        """The signal handler: end at the next turn of the loop, within 50 ms."""
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
    """A Qos of contract.py as rclpy's QoSProfile."""
    from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy

    return QoSProfile(
        history=HistoryPolicy.KEEP_LAST,
        depth=qos.depth,
        reliability=ReliabilityPolicy.RELIABLE if qos.reliable else ReliabilityPolicy.BEST_EFFORT,
        durability=DurabilityPolicy.TRANSIENT_LOCAL if qos.transient_local else DurabilityPolicy.VOLATILE,
    )


def main(name: str, ros_arguments: Sequence[str]) -> int:
    """Run the bridge for the service of this name. Returns the exit code. Raises FailstopError."""
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
