"""The gate's decisions. Pure: the time and the news are arguments, frames and texts are results.

Block reasons, the first that holds:
    estop: REASON     latched; ends only by reset
    disabled          until an explicit enable
    cmd timeout       no command yet, or the last is older than the command timeout
While blocked the velocity is zero at once, without a ramp. Otherwise it moves toward the clamped command by at most
acceleration x elapsed time, and the elapsed time that counts is bounded, so that a late tick makes no jump.
"""

from __future__ import annotations

from math import isfinite

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.procs.gate.kinematics import Mecanum
    from failstop.supervisor.settings import Settings

    Speeds = tuple[float, float, float, float]

STILL = (0.0, 0.0, 0.0, 0.0)
REST = (0.0, 0.0, 0.0)


class Command:
    """A velocity command: who gave it, when (CLOCK_MONOTONIC ns), and what."""

    __slots__ = ("manual", "session", "t_ns", "velocity", "who")

    def __init__(
        self, session: int, who: str, t_ns: int, velocity: tuple[float, float, float], *, manual: bool = False
    ) -> None:
        self.session = session
        self.who = who
        self.t_ns = t_ns
        self.velocity = velocity
        self.manual = manual


class GateCore:
    """What the gate knows: enabled, the latch, the command, the velocity now."""

    def __init__(self, settings: Settings, kinematics: Mecanum, now_ns: int) -> None:
        acceleration = settings["limits.acceleration_mps2"]
        self._limits = (settings["limits.vx_mps"], settings["limits.vy_mps"], settings["limits.wz_radps"])
        self._ramps = (acceleration, acceleration, settings["limits.acceleration_radps2"])
        self._timeout_ns = settings.ns("gate.command_timeout_s")
        self._refresh_ns = settings.ns("gate.refresh_s")
        self._longest_step_ns = 2 * settings.ns("gate.period_s")
        self._kinematics = kinematics
        self.enabled = False
        self.latch: str | None = None
        self.latched_in = 0
        """The epoch in which the latch was made; its stop is carried out once the epoch is newer."""
        self.epoch = 0
        """The epoch that motion was enabled in; every frame carries it."""
        self.command: Command | None = None
        self.velocity = REST
        self.speeds = STILL
        self._stepped_ns = now_ns
        self._sent_ns = 0

    def blocked(self, now_ns: int) -> str:
        """Why the wheels may not turn; an empty text when they may."""
        if self.latch is not None:
            return f"estop: {self.latch}"
        if not self.enabled:
            return "disabled"
        if self.command is None or now_ns - self.command.t_ns > self._timeout_ns:
            return "cmd timeout"
        return ""

    def take(self, command: Command, now_ns: int) -> str:
        """A new command. Returns the reason to trip for, empty when it is a good one: non-finite values, a second
        publisher beside one whose command still counts. A stamp from the future counts as now."""
        if not all(map(isfinite, command.velocity)):
            return f"command from {command.who} is not finite"
        last = self.command
        if last and last.session != command.session and now_ns - last.t_ns <= self._timeout_ns:
            return f"multiple cmd_vel publishers: {last.who}, {command.who}"
        command.t_ns = min(command.t_ns, now_ns)
        self.command = command
        return ""

    def driver_gone(self, session: int) -> bool:
        """A client has gone; True when it was the one that drives: its command is dropped."""
        if self.command is None or self.command.session != session:
            return False
        self.command = None
        return True

    def trip(self, reason: str, epoch: int) -> bool:
        """Latch (the first reason stays), disable, stand still. True when the latch is new."""
        self.stand_still()
        if self.latch is not None:
            return False
        self.latch = reason
        self.latched_in = epoch
        return True

    def stand_still(self) -> None:
        """Disable and set the velocity to zero at once."""
        self.enabled = False
        self.command = None
        self.velocity = REST
        self.speeds = STILL

    def enable(self, epoch: int, missing: str) -> tuple[bool, str]:
        """Allow motion in this epoch; `missing` names what is not ready. Returns (done, text)."""
        if self.latch is not None:
            return False, f"e-stop latched ({self.latch})"
        if missing:
            return False, f"not ready: {missing}"
        if not self.enabled:
            self.stand_still()
            self.enabled = True
            self.epoch = epoch
        return True, "motion enabled"

    def disable(self) -> tuple[bool, str]:
        """Forbid motion. Returns (done, text)."""
        self.stand_still()
        return True, "motion disabled"

    def reset(self, epoch: int) -> tuple[bool, str]:
        """Clear the latch and nothing else. Returns (done, text)."""
        if self.latch is None:
            return True, "no e-stop is latched"
        if epoch <= self.latched_in:
            return False, f"the stop is still being carried out ({self.latch})"
        text = f"e-stop cleared (was: {self.latch}); motion still disabled"
        self.latch = None
        return True, text

    def step(self, now_ns: int) -> Speeds | None:
        """Move the velocity on; returns the wheel speeds (rps) to send now, or None when nothing is to be sent."""
        elapsed_s = min(now_ns - self._stepped_ns, self._longest_step_ns) * 1e-9
        self._stepped_ns = now_ns
        if not self.enabled:
            return None
        if self.command is None or self.blocked(now_ns):
            self.velocity = REST
        else:
            self.velocity = self._ramped(self.command.velocity, elapsed_s)
        speeds = self._kinematics.wheels_rps(*self.velocity)
        if speeds == self.speeds and now_ns - self._sent_ns < self._refresh_ns:
            return None
        self.speeds = speeds
        self._sent_ns = now_ns
        return speeds

    def _ramped(self, wanted: tuple[float, float, float], elapsed_s: float) -> tuple[float, float, float]:
        vx, vy, wz = (
            _toward(now, max(-limit, min(limit, want)), ramp * elapsed_s)
            for now, want, limit, ramp in zip(self.velocity, wanted, self._limits, self._ramps, strict=True)
        )
        return vx, vy, wz


def _toward(now: float, want: float, most: float) -> float:
    """Move from `now` to `want` by at most `most`."""
    if want > now:
        return min(want, now + most)
    return max(want, now - most)
