"""Failstop: a robot for LeRobot that has LeKiwi's names and drives through a failstop service.

It only sends commands. The service owns the motor port, limits the commands, and stops the wheels and the arm if this
program dies or stops sending. Numbers have LeKiwi's units: m/s and deg/s for the base, 0 to 100 for the gripper, and
degrees or -100 to 100 for the other joints (option `use_degrees`).
"""

from __future__ import annotations

import contextlib
import logging
import sys
from collections.abc import Callable, Collection
from functools import cached_property
from typing import Any

from lerobot.cameras.utils import make_cameras_from_configs
from lerobot.robots import Robot
from lerobot.utils.constants import HF_LEROBOT_CALIBRATION, ROBOTS
from lerobot.utils.errors import DeviceAlreadyConnectedError, DeviceNotConnectedError

from failstop import Block, Blocked, Driving, FailstopError, Preempted, Refused, State
from failstop import Robot as Service
from lerobot_robot_failstop import keys
from lerobot_robot_failstop.config_failstop import DEFAULT_SERVICE, FailstopConfig
from lerobot_robot_failstop.units import Reach, Scale, Unit, base_numbers, base_velocity

CALIBRATED_AS = "lekiwi"
"""The name under which LeRobot stores the calibration that LeKiwi's own host has written."""
FRESH_S = 0.1
"""How old a joint's reading may be, s, to be used as an observation. If it is older, the position to which the joint
was sent is used instead."""
VELOCITIES = ("x.vel", "y.vel", "theta.vel")
logger = logging.getLogger(__name__)


def _why_not(answer: Driving | Preempted | Blocked) -> str:
    """Why the wheels do not obey. Empty if they do, or if the gate has not decided yet."""
    if isinstance(answer, Preempted):
        return f"{answer.by} drives"
    return answer.why if isinstance(answer, Blocked) and answer.block is not Block.NO_COMMAND else ""


class RobotStopped(RuntimeError):
    """A stop is latched. The message says why, how it is proven, and what to do."""


class Failstop(Robot):  # type: ignore[misc]
    """A LeKiwi that drives through a failstop service on this computer."""

    config_class = FailstopConfig
    name = "lekiwi_client"
    """LeRobot compares this name with the robot of a dataset that is continued. It must be this name, because only for
    it does LeRobot accept a leader arm and a keyboard at the same time."""

    def __init__(self, config: FailstopConfig) -> None:
        if config.calibration_dir is None:
            config.calibration_dir = HF_LEROBOT_CALIBRATION / ROBOTS / CALIBRATED_AS
        super().__init__(config)
        self.config = config
        self.cameras = make_cameras_from_configs(config.cameras)
        self._service: Service | None = None
        self._scales: dict[str, Scale] = {}
        self._level = 0
        self._told = dict.fromkeys(("wheels", "arm"), "")
        """For the wheels and the arm, the last reason that was logged."""

    @property
    def _numbers(self) -> dict[str, type]:
        return dict.fromkeys((*(f"arm_{joint}.pos" for joint in self.config.joints), *VELOCITIES), float)

    @cached_property
    def observation_features(self) -> dict[str, Any]:
        """The type of each number, and the shape of each camera's image."""
        pictures = {name: (camera.height, camera.width, 3) for name, camera in self.config.cameras.items()}
        return {**self._numbers, **pictures}

    @cached_property
    def action_features(self) -> dict[str, type]:
        """The type of each number."""
        return self._numbers

    @property
    def is_connected(self) -> bool:
        """True between connect() and disconnect()."""
        return self._service is not None

    @property
    def is_calibrated(self) -> bool:
        """True if LeRobot's calibration file has every joint."""
        return all(f"arm_{joint}" in self.calibration for joint in self.config.joints)

    def calibrate(self) -> None:
        """Raise RuntimeError with instructions. Only LeRobot's own `lekiwi` robot can calibrate, because the service
        owns the port."""
        raise RuntimeError(
            "failstop takes a calibration over and makes none: stop the service, calibrate by `lerobot-calibrate"
            f" --robot.type=lekiwi --robot.id={self.id} --robot.port=PORT`, and start it again"
        )

    def configure(self) -> None:
        """Do nothing, because failstop's settings configure the robot."""

    def connect(self, calibrate: bool = True) -> None:
        """Connect to the service, read where the arm is, and open the cameras. With the option `enable`, also enable
        motion. Raises DeviceAlreadyConnectedError if it is connected, ValueError if the calibration does not fit the
        settings, and DeviceNotConnectedError if no service runs, the arm can't be read, or motion can't be enabled."""
        if self.is_connected:
            raise DeviceAlreadyConnectedError(f"{self} is connected already")
        with contextlib.ExitStack() as undo:
            try:
                service = undo.enter_context(contextlib.closing(Service(self.config.service, client="lerobot")))
                self._scales = self._scaled(service)
                self._read_arm(service)
                for camera in self.cameras.values():
                    camera.connect()
                    undo.callback(camera.disconnect)
                if self.config.enable:
                    service.enable()
            except FailstopError as error:
                raise DeviceNotConnectedError(f"{self}: {error}") from error
            undo.pop_all()
            self._service = service
        if calibrate and not self.is_calibrated:
            logger.info("%s has no calibration file: its joints' ranges are those of failstop's settings", self)

    def _scaled(self, service: Service) -> dict[str, Scale]:
        """Return the scale that converts the numbers of each LeRobot joint. Raises ValueError if the joints or the
        calibration don't fit failstop's settings."""
        declared = service.arm.joints if self.config.joints else {}
        found = {}
        for name, of_settings in self.config.joints.items():
            if of_settings not in declared:
                raise ValueError(
                    f"failstop's settings have no joint {of_settings!r} for arm_{name}: they name {', '.join(declared)}"
                    " (robot.joints maps one to the other)"
                )
            joint, reach = declared[of_settings], None
            if self.calibration:
                row = self.calibration.get(f"arm_{name}")
                if row is None or row.id != joint.servo:
                    says = "has no such joint" if row is None else f"says servo {row.id}"
                    raise ValueError(
                        f"arm_{name} is servo {joint.servo} by failstop's settings; {self.calibration_fpath} {says}"
                    )
                reach = Reach(row.range_min, row.range_max, bool(row.drive_mode))
            whole = Unit.DEGREES if self.config.use_degrees else Unit.SHARE
            found[name] = Scale(name, joint, reach, Unit.GRIP if name == "gripper" else whole)
        return found

    def _read_arm(self, service: Service) -> None:
        """Let the service read the arm, if a joint was not read yet or may have been moved by hand because its torque
        is off. Raises DeviceNotConnectedError if the service refuses and a joint was not read yet."""
        arm = service.state.arm
        joints = list(arm.joints.values()) if arm else []
        unread = arm is None or any(joint.at_rad is None for joint in joints)
        # While another program moves the arm, a request to read it would be a second program at the arm.
        limp = arm is not None and not arm.by and not all(joint.torque for joint in joints)
        if self._scales and (unread or limp):
            try:
                service.arm.read()
            except Refused as error:
                if not unread:
                    return
                raise DeviceNotConnectedError(
                    f"{self}: where the arm is was not read yet, and can't be now: {error}; connect again with motion"
                    f" disabled and no stop latched ({self._command('why')})"
                ) from error

    def _command(self, verb: str) -> str:
        """Return the failstop command for this robot's service, in backquotes."""
        name = self.config.service
        return f"`failstop {verb}`" if name == DEFAULT_SERVICE else f"`failstop {verb} --name {name}`"

    def _connected(self) -> Service:
        if self._service is None:
            raise DeviceNotConnectedError(f"{self} is not connected: call connect() first")
        return self._service

    def get_observation(self) -> dict[str, Any]:
        """Return each joint's position, the velocity that the service commands, and an image from each camera. Raises
        DeviceNotConnectedError if the service has ended, or if a joint was not read yet."""
        service = self._connected()
        try:
            state = service.state
        except FailstopError as error:
            raise DeviceNotConnectedError(f"{self}: {error}") from error
        found: dict[str, Any] = {f"arm_{name}.pos": scale.number(angle) for name, scale, angle in self._joints(state)}
        found |= base_numbers(*state.body_vel)
        for name, camera in self.cameras.items():
            found[name] = camera.read_latest()
        if state.arm and self._scales:
            self._tell("arm", state.arm.refused)
        return found

    def _joints(self, state: State) -> list[tuple[str, Scale, float]]:
        """Return (name, scale, angle in rad) of each joint. The angle is the last reading if that is fresh, otherwise
        the commanded angle. Raises DeviceNotConnectedError if a joint was not read yet."""
        found = []
        for name, scale in self._scales.items():
            joint = state.arm.joints.get(self.config.joints[name]) if state.arm else None
            fresh = joint is not None and joint.age_s is not None and joint.age_s <= FRESH_S
            angle = None if joint is None else joint.angle_rad if fresh else joint.at_rad
            if angle is None:
                raise DeviceNotConnectedError(
                    f"{self}: where arm_{name} is was not read yet; {self._command('arm')} reads it"
                )
            found.append((name, scale, angle))
        return found

    def send_action(self, action: dict[str, Any]) -> dict[str, float]:
        """Send an action to the service. Returns the action as it was sent, with joints limited to the settings' range.
        If an action has only some of the velocities, the others are zero.

        Raises RobotStopped if a stop is latched and `after_stop` is `raise`. Raises ValueError for a number that is not
        finite, or for a name that LeKiwi does not have. Raises DeviceNotConnectedError if the service has ended.
        """
        service = self._connected()
        if unknown := sorted(set(action) - set(self.action_features)):
            raise ValueError(f"no action {unknown[0]!r}: there are {', '.join(self.action_features)}")
        angles = {
            name: scale.angle_rad(float(action[key]))
            for name, scale in self._scales.items()
            if (key := f"arm_{name}.pos") in action
        }
        given = {name: float(action.get(name, 0.0)) for name in VELOCITIES}
        velocity = base_velocity(*given.values())  # this may raise, so it comes before anything moves
        sent = {f"arm_{name}.pos": self._scales[name].number(angle) for name, angle in angles.items()}
        try:
            if angles:
                service.arm.follow({self.config.joints[name]: angle for name, angle in angles.items()})
            if not set(VELOCITIES) & set(action):
                self._look(service, service.state.cause is not None)
                return sent
            answer = service.drive(*velocity, manual=self.config.manual, source=self.config.source, wait_s=0.0)
            self._look(service, isinstance(answer, Blocked) and answer.block is Block.LATCHED)
            self._tell("wheels", _why_not(answer) if any(given.values()) else "")
        except FailstopError as error:
            raise DeviceNotConnectedError(f"{self}: {error}") from error
        return {**sent, **given}

    def _look(self, service: Service, latched: bool) -> None:
        if latched and self.config.after_stop == "raise":
            raise RobotStopped(str(service.why()))

    def _tell(self, part: str, why: str) -> None:
        """Log why the wheels or the arm don't move, if the reason has changed."""
        if why != self._told[part]:
            self._told[part] = why
            if why:
                ending = "" if part == "wheels" else "s"
                logger.warning("the %s stand%s still: %s (%s)", part, ending, why, self._command("why"))

    def stop_base(self) -> None:
        """Stop the wheels, as LeKiwi's host does when it receives nothing."""
        self._connected().drive(0.0, 0.0, 0.0, manual=self.config.manual, source=self.config.source, wait_s=0.0)

    def park(self) -> None:
        """Move the arm to its tuck pose, then switch its torque off. Raises Refused, and then the torque stays on."""
        arm = self._connected().arm
        arm.pose("tuck")
        arm.release()

    def release(self) -> None:
        """Switch the arm's torque off where the arm is, so that it falls. Raises Refused while a stop is latched, and
        on some boards while motion is enabled."""
        self._connected().arm.release()

    def disconnect(self) -> None:
        """Disconnect from the service. The wheels stop, and motion is disabled if this robot enabled it. The option
        `at_end` says whether the arm is held, parked or released. While an exception is handled, which is so in a
        `finally` that it passes through, the program counts as crashed: motion is disabled if it has driven, and the
        arm is held. KeyboardInterrupt and SystemExit are clean ends."""
        self._connected()
        self._leave(sys.exc_info()[1])

    def __del__(self) -> None:
        """Leave as a program that has crashed. LeRobot's own `__del__` calls disconnect(), which would be a clean
        end."""
        with contextlib.suppress(Exception):
            if self.is_connected:
                self._leave(RuntimeError("freed without disconnect()"))

    def _leave(self, error: BaseException | None) -> None:
        """Disconnect from the service. `error`: why the program ends. If it is an Exception, the program has
        crashed."""
        service = self._connected()
        ends: dict[str, Callable[[], None]] = {"park": self.park, "release": self.release}
        try:
            if self._scales and not isinstance(error, Exception) and (end := ends.get(self.config.at_end)):
                self._end(service, end)
        finally:
            self._service = None
            with contextlib.ExitStack() as rest:
                for camera in self.cameras.values():
                    rest.callback(camera.disconnect)
                # Added last, so it runs first: the wheels must not wait for a camera that blocks.
                rest.callback(service.__exit__, type(error), error, None)

    def _end(self, service: Service, end: Callable[[], None]) -> None:
        try:
            if self.config.enable:
                service.disable()
            end()
        except Refused as error:
            logger.warning("the arm is held and not let go: %s", error)

    def _from_keyboard_to_base_action(self, pressed_keys: Collection[str]) -> dict[str, float]:
        """The velocity for these keys. LeRobot's scripts for LeKiwi call it by this name."""
        self._level = keys.level_after(self._level, pressed_keys, self.config.teleop_keys)
        return keys.velocity(self._level, pressed_keys, self.config.teleop_keys)
