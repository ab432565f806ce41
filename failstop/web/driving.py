"""Driving: the thumb stick of a paired device whose operator attends. A command comes together with the answer to a
nonce, and counts from the time at which the robot made that nonce. The gate lets it count for the source's timeout, 0.3
s, and applies the limits."""

from __future__ import annotations

import contextlib
import time
from math import isfinite

from failstop.api.errors import FailstopError
from failstop.api.robot import Robot
from failstop.policy.settings import FIRST_SOURCE, UNATTENDED_DRIVE

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.api.state import State
    from failstop.policy.settings import Settings
    from failstop.web.devices import Device
    from failstop.web.viewer import Viewer

SOURCE = "page"
"""Commands are given as this source if the settings declare it, else as cmd_vel."""
OTHER_S = 0.5
"""The pause between driving by one person with the stick and driving by another, s."""
OFF = "driving from the page is switched off (settings web.drive and attend.required)"
LIMIT_FIRST = "choose the speed limit first"
DISABLED = "motion is disabled: enable it, then hold the stick again"


def share(said: str) -> tuple[float, float] | None:
    """Forward and to the left, each from -1 to 1, from a command's text; None if it is not one."""
    try:
        forward, turn = (float(word) for word in said.split())
    except ValueError:
        return None
    return (forward, turn) if isfinite(forward + turn) and max(abs(forward), abs(turn)) <= 1.0 else None


class Driving:
    """The stick of one viewer at a time."""

    def __init__(self, name: str, settings: Settings) -> None:
        wanted, attended = settings.on("web.drive"), settings.on("attend.required")
        self.on = wanted and attended
        self.lacks = UNATTENDED_DRIVE if wanted and not attended else ""
        """Why nobody can drive from the page although web.drive is on; empty if people can, or if it is off."""
        self._name = name
        self._full = settings["limits.vx_mps"], settings["limits.wz_radps"]
        self._source = SOURCE if SOURCE in settings.sources() else FIRST_SOURCE
        self._robot: Robot | None = None
        self._driver: tuple[Viewer, str] | None = None
        self._last_s = 0.0
        self._chosen: set[str] = set()
        """Devices whose operators have chosen a speed limit since they began to attend."""
        self._spent: set[Viewer] = set()
        """Viewers whose stick counts only after it was let go, because motion was disabled while they held it. This
        stays so even if motion is enabled again."""
        self._taken: dict[Viewer, tuple[int, int]] = {}
        """For each stick that is held: (the epoch when it was pushed, when motion had been enabled then, ns)."""

    def has_chosen(self, device: Device | None) -> bool:
        """True if the operator of this device has chosen a speed limit."""
        return not self.on or device is None or device.id in self._chosen

    def chose(self, device: str) -> None:
        """The operator of a device has chosen a speed limit."""
        self._chosen.add(device)

    def command(self, viewer: Viewer, said: str, proven_ns: int, state: State | None) -> str:
        """Handle a proven command of a viewer that attends. Returns what keeps it from driving, or ""."""
        device, wanted = viewer.device(), share(said)
        if not self.on or device is None or wanted is None or state is None:
            return OFF
        if device.id not in self._chosen:
            return LIMIT_FIRST
        if self._driver and self._driver[0] is not viewer and time.monotonic() - self._last_s < OTHER_S:
            return f"{self._driver[1]} drives"
        state = self._newest(state)
        motion = state.epoch, state.enabled_ns
        if not state.enabled or self._taken.setdefault(viewer, motion) != motion:
            self._spent.add(viewer)
        if viewer in self._spent:
            return DISABLED
        if self._driver is None or self._driver[0] is not viewer:
            self._close()
            self._driver = viewer, device.name
        self._last_s = time.monotonic()
        vx_mps, wz_radps = (part * full * state.speed_limit for part, full in zip(wanted, self._full, strict=True))
        return self._drive(viewer.who(), vx_mps, wz_radps, proven_ns)

    def _newest(self, state: State) -> State:
        """The state now, if somebody drives; otherwise the given state, which may be 0.1 s old."""
        with contextlib.suppress(FailstopError):
            return self._robot.state if self._robot else state
        return state

    def _drive(self, who: str, vx_mps: float, wz_radps: float, proven_ns: int | None) -> str:
        try:
            if self._robot is None:
                self._robot = Robot(self._name, client=who, disable_on_exit=False)
            self._robot.drive(vx_mps, 0.0, wz_radps, manual=True, source=self._source, wait_s=0, proven_ns=proven_ns)
        except (FailstopError, ValueError) as error:
            self._close()
            return str(error)
        return ""

    def release(self, viewer: Viewer) -> None:
        """The stick was let go, so the velocity goes to zero along the ramp. No proof is needed, because this moves
        nothing."""
        self._spent.discard(viewer)
        self._taken.pop(viewer, None)
        if self._driver and self._driver[0] is viewer:
            self._driver = None
            self._drive(viewer.who(), 0.0, 0.0, None)

    def end(self, viewer: Viewer) -> None:
        """A viewer no longer attends: command zero at once. When it comes back, it must choose the limit again."""
        if device := viewer.device():
            self._chosen.discard(device.id)
        self._spent.discard(viewer)
        self._taken.pop(viewer, None)
        if self._driver and self._driver[0] is viewer:
            self._close()

    def _close(self) -> None:
        robot, self._robot, self._driver = self._robot, None, None
        if robot:
            with contextlib.suppress(FailstopError):
                robot.close()

    def close(self) -> None:
        """The page ends."""
        self._close()
