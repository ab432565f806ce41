"""Driving: lets an operator drive with the page's thumb stick. The operator's device must be paired, and must prove
that the operator is present.

A driving command arrives with the device's answer to a nonce (lease.py). The command counts as given when the nonce was
made, so a command that the network has delayed does not look fresh. The gate obeys the command for the timeout of the
command's source (by default 0.3 s), and applies the speed limits.
"""

from __future__ import annotations

import contextlib
import time
from math import isfinite

from failstop.api import client
from failstop.api.errors import FailstopError
from failstop.api.robot import Robot
from failstop.policy.settings import FIRST_SOURCE, UNATTENDED_DRIVE

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Collection

    from failstop.api.state import State
    from failstop.policy.settings import Settings
    from failstop.web.devices import Device
    from failstop.web.viewer import Viewer

SOURCE = "page"
"""The source of the page's commands, if the settings declare this source. If they don't, the page's commands have the
source cmd_vel."""
OTHER_S = 0.5
"""How long after the driver's last command, or after the driver has let go of the stick, another person must wait
before driving, s."""
OFF = "driving from the page is switched off (settings web.drive and attend.required)"
LIMIT_FIRST = "choose the speed limit first"
DISABLED = "motion is disabled: enable it, then hold the stick again"


def share(said: str) -> tuple[float, float] | None:
    """Parse a command of the stick. Returns (forward, turn), each from -1 to 1, or None if the text is not a command. A
    positive turn is to the left."""
    try:
        forward, turn = (float(word) for word in said.split())
    except ValueError:
        return None
    return (forward, turn) if isfinite(forward + turn) and max(abs(forward), abs(turn)) <= 1.0 else None


class Driving:
    """Drives the robot for one viewer at a time."""

    def __init__(self, name: str, settings: Settings) -> None:
        wanted, attended = settings.on("web.drive"), settings.on("attend.required")
        self.on = wanted and attended
        self.lacks = UNATTENDED_DRIVE if wanted and not attended else ""
        """Why nobody can drive from the page although web.drive is on. Empty if the page can drive, or if web.drive is
        off."""
        self._name = name
        self._full = settings["limits.vx_mps"], settings["limits.wz_radps"]
        self._source = SOURCE if SOURCE in settings.sources() else FIRST_SOURCE
        self._robot: Robot | None = None
        self._driver: tuple[Viewer, str] | None = None
        """The viewer who drives or has driven last, and the name of the device. The connection to the service is that
        of this viewer."""
        self._released = False
        """True if the driver has let go of the stick."""
        self._last_s = 0.0
        """When the driver has sent the last command or has let go of the stick (time.monotonic())."""
        self._chosen: dict[str, str] = {}
        """The ids of devices whose operators have chosen a speed limit since they began to attend. Each has the run of
        the service in which it was chosen (see run()), because the next run begins without a limit."""
        self._spent: set[Viewer] = set()
        """Viewers whose stick moves nothing until they let go of it. While such a viewer held the stick, motion was
        disabled or enabled, or the robot was stopped (see `_taken`). Even if motion is enabled now, the viewer must
        first let go of the stick."""
        self._taken: dict[Viewer, tuple[int, int]] = {}
        """For each viewer who holds the stick: the robot's epoch, and the time at which motion was last enabled (ns).
        Both were read when the viewer took hold of the stick. If either changes, the viewer must let go of the stick
        before driving again."""

    def has_chosen(self, device: Device | None) -> bool:
        """Return False if the operator of this device must choose a speed limit before driving. True if one was chosen,
        or if this device can't drive: driving is off, or the device is not paired."""
        return not self.on or device is None or self._knows(device.id)

    def run(self) -> str:
        """Return a name of the service's present run. Empty if no service is running."""
        with contextlib.suppress(FailstopError):
            return client.run(self._name)[0]
        return ""

    def _knows(self, device: str) -> bool:
        found = self._chosen.get(device)
        return bool(found) and found == self.run()

    def chose(self, device: str, run: str) -> None:
        """Note that the operator of this device has chosen a speed limit. `run`: the run of the service in which the
        limit was requested, as run() returns it."""
        self._chosen[device] = run

    def command(self, viewer: Viewer, said: str, proven_ns: int, state: State | None) -> str:
        """Carry out a driving command of a viewer that attends. Returns why the robot does not obey, or "". `said`: the
        command's text, which the viewer's answer has proved. `proven_ns`: when the device was certainly present
        (CLOCK_MONOTONIC, ns)."""
        device, wanted = viewer.device(), share(said)
        if not self.on or device is None or wanted is None or state is None:
            return OFF
        if not self._knows(device.id):
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
        self._last_s, self._released = time.monotonic(), False
        vx_mps, wz_radps = (part * full * state.speed_limit for part, full in zip(wanted, self._full, strict=True))
        return self._drive(viewer.who(), vx_mps, wz_radps, proven_ns)

    def _newest(self, state: State) -> State:
        """Return the robot's present state if somebody is driving, else `state`, which may be 0.1 s old."""
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
        """Note that the viewer has let go of the stick. If this viewer drives the robot, slow the robot down to zero
        along its ramp. Slowing down needs no proof that the operator is present."""
        self._spent.discard(viewer)
        self._taken.pop(viewer, None)
        if self._driver and self._driver[0] is viewer and not self._released:
            self._last_s, self._released = time.monotonic(), True
            self._drive(viewer.who(), 0.0, 0.0, None)

    def end(self, viewer: Viewer, attending: Collection[Viewer]) -> None:
        """Note that the viewer no longer attends. If this viewer drives the robot or has driven it last, stop the robot
        at once. The operator must choose a speed limit before driving again, unless the device still attends through
        another viewer, such as another tab. `attending`: the viewers that still attend."""
        if (device := viewer.device()) and device.id not in {
            found.id for each in attending if (found := each.device())
        }:
            self._chosen.pop(device.id, None)
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
        """Stop driving, because the page closes."""
        self._close()
