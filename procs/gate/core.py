"""The gate's decisions about the wheels. Pure: takes the time and all events as arguments, and returns wheel speeds,
causes of stops, and replies.

While the wheels are blocked, the reason is the first of these that applies:

    estop: REASON     a stop is latched; only a reset ends it
    disabled          motion is disabled until somebody enables it
    let go first      no source drives, and one has commanded a velocity since before motion was enabled
    cmd timeout       no source drives, because none has a command that is younger than its timeout
    no scan           the source that drives is not manual, and the obstacle sensor is silent

While the wheels are blocked, the velocity is set to zero at once, without a ramp. Otherwise the velocity moves toward
the command, which is clamped to the limits. Each step changes the velocity by at most the acceleration times the time
since the last step. If this time is longer than two periods, it counts as two periods.
"""

from __future__ import annotations

from math import isfinite

from failstop.messages.box import DISABLED, HELD, LATCHED, NO_COMMAND, NO_SCAN
from failstop.messages.packing import Note
from failstop.messages.records import FOR_AN_INTERLOCK, REFUSED
from failstop.policy import causes
from failstop.policy.causes import Cause, Reply, refused
from failstop.policy.kinematics import Chassis, Velocity, WheelSpeeds
from failstop.policy.settings import ANSWERS_TO_SILENCE, DEATHS, PAD_SOURCE, Settings
from failstop.procs.gate.conditions import Attendance, Interlocks, ScanGate
from failstop.procs.gate.remarks import DriverLosses, disabled_by_death, disabled_by_silence
from failstop.procs.gate.sources import PAD_SESSION, Command, Sources

REST = (0.0, 0.0, 0.0)
IS_LATCHED = "a stop is latched"
WHEELS_ENABLED = "wheels enabled"
MAY_MOVE = "motion enabled"
LEAST_LIMIT = 5
"""The lowest speed limit that is allowed, percent. With a lower limit the robot would hardly move, and nobody would
know why."""
_DISABLE, _LATCH, _STAY = DEATHS
_WAIT, *_ = ANSWERS_TO_SILENCE
MOST_IGNORED = 64
"""One gate process logs ignored commands of at most this many pairs of a session and a source."""


class GateCore:
    """Decides how the wheels may turn, from the latch, the sources' commands, the velocity and whether motion is
    enabled."""

    def __init__(
        self, settings: Settings, kinematics: Chassis, now_ns: int, *, arm_beside_wheels: bool = False
    ) -> None:
        self.arm_waits = not arm_beside_wheels
        """True if the arm may move only while motion is disabled, because the board can't move arm and wheels
        together."""
        acceleration = settings["limits.acceleration_mps2"]
        limits = (settings["limits.vx_mps"], settings["limits.vy_mps"], settings["limits.wz_radps"])
        self._most = tuple(limit * axis for limit, axis in zip(limits, kinematics.axes, strict=True))
        self.limit_to(100)
        self._ramps = (acceleration, acceleration, settings["limits.acceleration_radps2"])
        self._refresh_ns = settings.ns("gate.refresh_s")
        self._longest_step_ns = 2 * settings.ns("gate.period_s")
        self._kinematics = kinematics
        self.sources = Sources(
            settings.sources(), settings.ns("gate.command_timeout_s"), settings.ns("guard.timeout_s")
        )
        self.scan = ScanGate(settings.ns("scan.timeout_s"), on=settings.text("scan.gate") == "on")
        self.interlocks = Interlocks(settings.interlocks())
        self.attendance = Attendance(settings.ns("attend.lease_s"), on=settings.on("attend.required"))
        self.enabled = False
        self.enabled_ns = 0
        """The time when motion was enabled, or 0 while it is disabled."""
        self.latch: Cause | None = None
        """The latched cause, or None. Normally this is the cause that the supervisor has published. After a stop by the
        gate itself, it is the gate's cause until the supervisor has answered."""
        self._stopped_in = 0
        """The epoch in which the gate last stopped by itself. The supervisor answers such a stop with a newer epoch."""
        self.epoch = 0
        """The epoch in which motion was enabled. Every motion frame carries this number."""
        self.velocity = REST
        self.speeds = kinematics.rest
        self.capped = ""
        """If nobody has confirmed the scale of the board's speeds, a text that says how the speed is limited until
        somebody does. Otherwise empty."""
        self.notes: list[Note] = []
        """Notes for people, oldest first. The gate's loop passes them on to the supervisor and empties this list."""
        self._losses = DriverLosses(now_ns)
        self._ignored: set[tuple[int, str]] = set()
        self._driver_death = settings.text("gate.driver_death")
        self._driver_silence = settings.text("gate.driver_silence")
        self._drivers: dict[int, Command] = {}
        """The last command of each session that has sent one. If such a session dies, a driver has died, because its
        program would drive again after a restart. This is so even if the session was not driving when it died."""
        self._movers: set[int] = set()
        """The sessions whose commands have turned the wheels."""
        self._wants_motion = False
        """True if the program whose command drove last wanted to move. The velocity doesn't show this: without scans it
        is zero too, but the driver drives on with the next scan."""
        self._stepped_ns = now_ns
        self._sent_ns = 0
        self._ramps_on = False

    def rests(self, until_ns: int) -> bool:
        """Return True if the velocity stays as it is, and no frame must be sent before `until_ns`."""
        return not self.enabled or not (self._ramps_on or until_ns > self._sent_ns + self._refresh_ns)

    def blocked(self, now_ns: int) -> str:
        """Return why the wheels may not turn, as one of the reasons at the top of this file, or an empty text if they
        may turn."""
        if self.latch is not None:
            return f"{LATCHED}{self.latch}"
        if not self.enabled:
            return DISABLED
        driving = self.sources.driving(now_ns)
        if driving is None:
            return HELD if self.sources.holds(now_ns) else NO_COMMAND
        if not driving.manual and self.scan.silent(now_ns):
            return NO_SCAN
        return ""

    def arm_closed(self) -> str:
        """Return why the arm accepts no goal at the moment, or an empty text if it accepts one."""
        return IS_LATCHED if self.latch is not None else WHEELS_ENABLED if self.enabled and self.arm_waits else ""

    def due_ns(self, now_ns: int) -> int | None:
        """Return when the driver's command, the operators' presence or the last scan becomes too old. The wheels must
        stop at that moment, not at a later tick. None if nothing moves the wheels."""
        driving = self.sources.driving(now_ns)
        if driving is None or self.blocked(now_ns):
            return None
        ends_ns = [self.sources.stale_ns(driving)]
        if self.attendance.on:
            ends_ns.append(self.attendance.due_ns())
        if self.scan.on and not driving.manual:
            ends_ns.append(self.scan.silent_ns())
        return min(ends_ns)

    def accept(self, command: Command, now_ns: int) -> Cause | None:
        """Accept a new command. Returns the cause of a stop if a value is not finite, or if another program publishes
        for the same source. Otherwise returns None. A command for a source that its sender may not use is ignored, with
        a note. A time stamp from the future counts as now."""
        if not all(map(isfinite, command.velocity)):
            return causes.NOT_FINITE(command.who)
        if not self.sources.allows(command):
            self._note_ignored(command)
            return None
        rival = self.sources.rival(command, now_ns)
        if rival is not None:
            return causes.TWO_PUBLISHERS(command.source, rival.who, causes.rival_of(rival.who, command.who))
        self.sources.put(command, now_ns)
        if command.session != PAD_SESSION:
            self._drivers[command.session] = command
        return None

    def rename(self, session: int, who: str) -> None:
        """Show another name for a client. Its last command gets the name too, so the client also ends under it."""
        if driver := self._drivers.get(session):
            driver.who = who

    def _note_ignored(self, command: Command) -> None:
        """Note that a command was ignored, once per session and source. At most MOST_IGNORED are noted, because a
        session could invent new sources forever."""
        ignored = (command.session, command.source)
        if ignored not in self._ignored and len(self._ignored) < MOST_IGNORED:
            self._ignored.add(ignored)
            reserved = f"the source {PAD_SOURCE!r} is the board's gamepad alone"
            why = reserved if command.source == PAD_SOURCE else f"no source {command.source!r} in the settings"
            text = f"command from {command.who} ignored: {why}"
            self.notes.append(Note("ignored", text, {"who": command.who, "source": command.source}))

    def client_gone(self, session: int, now_ns: int, *, parted: bool) -> Cause | None:
        """Drop the commands of a client that has gone. `parted`: True if it said goodbye. If a driver has died while
        motion is enabled, the setting gate.driver_death chooses one of three answers: leave motion enabled, disable it
        and add a note, or return the cause of a stop. If motion stays enabled, a note is added only if the client's
        command was turning the wheels."""
        driving, driver = self.sources.driving(now_ns), self._drivers.pop(session, None)
        moved = session in self._movers
        self._movers.discard(session)
        self.sources.drop(session)
        if driver is None:
            return None
        if parted or not self.enabled or self._driver_death == _STAY:
            if driving and driving.session == session and any(self.velocity):
                self.notes += self._losses.gone(driver, now_ns, parted=parted)
            return None
        if self._driver_death == _LATCH:
            return causes.DRIVER_DIED(driver.who)
        self.stand_still()
        self.notes.append(disabled_by_death(driver, moved=moved))
        return None

    def driver_silence(self, now_ns: int) -> Cause | None:
        """Check whether the driver has just fallen silent although its last command was not zero. Call it once per
        step. The setting gate.driver_silence chooses one of three answers: only add a note if the wheels turned,
        disable motion and add a note, or return the cause of a stop. A person who has let go of a key gets the first
        answer."""
        if not self._wants_motion or self.sources.driving(now_ns):
            return None
        self._wants_motion = False
        driver = self.sources.last_driver()
        if driver is None:
            return None
        silent_ns = self.sources.silent_ns(driver, now_ns)
        if driver.by_hand or self._driver_silence == _WAIT:
            if any(self.velocity):
                self.notes += self._losses.silent(driver, silent_ns, now_ns)
            return None
        if self._driver_silence == _LATCH:
            return causes.DRIVER_SILENT(driver.who, silent_ns // 1_000_000)
        self.stand_still()
        self.notes.append(disabled_by_silence(driver, silent_ns))
        return None

    def stop(self, cause: Cause, epoch: int) -> bool:
        """Stop at once, and forbid motion until the supervisor has latched the stop. Returns True if nothing was
        latched before, so the cause must be reported to the supervisor."""
        self.stand_still()
        if self.latch is not None:
            return False
        self.latch = cause
        self._stopped_in = epoch
        return True

    def follow(self, latched: Cause | None, epoch: int) -> None:
        """Take over the latch that the supervisor has published in this epoch. A stop by the gate itself stays latched
        until a newer epoch."""
        if latched:
            self.stand_still()
        if latched or epoch > self._stopped_in:
            self.latch = latched

    def stand_still(self) -> None:
        """Disable motion, and set the velocity to zero at once."""
        self.enabled = False
        self.enabled_ns = 0
        self.sources.clear()
        self.scan.stand_still()
        self.velocity = REST
        self.speeds = self._kinematics.rest

    def refusal(self, missing: str, now_ns: int) -> Reply | None:
        """Return why motion can't be enabled now, or None if it can. `missing`: what the service waits for, or an empty
        text."""
        if self.latch is not None:
            return refused(IS_LATCHED, self.latch)
        if missing:
            return refused(f"not ready: {missing}")
        if unmet := self.interlocks.unmet(now_ns):
            return Reply(REFUSED, unmet, refused_for=FOR_AN_INTERLOCK)
        alone = self.attendance.unmet(now_ns)
        return refused(alone) if alone else None

    def enable(self, epoch: int, missing: str, now_ns: int) -> Reply:
        """Enable motion in this epoch, if nothing forbids it. `missing`: what the service still waits for, or empty."""
        if refusal := self.refusal(missing, now_ns):
            return refusal
        if self.enabled:
            return self._may_move(self.sources.held(now_ns), now_ns)
        self.stand_still()
        self.enabled = True
        self.enabled_ns = now_ns
        self.epoch = epoch
        return self._may_move(self.sources.hold(now_ns), now_ns)

    def _may_move(self, held: list[str], now_ns: int) -> Reply:
        """Return the reply to the client that has enabled motion. It names the programs that may move the robot next:
        the held programs (`held`, see Sources.hold), and those that commanded motion a moment ago."""
        waits = f"{' and '.join(held)} must send zero or pause before it can drive{_or_end(held)}" if held else ""
        paused = [
            f"{who} commanded motion {ago_ns / 1e9:.1f} s ago, so the robot moves when it commands again"
            for who, ago_ns in self.sources.paused(now_ns)
        ]
        return Reply(True, "; ".join(filter(None, (MAY_MOVE, waits, *paused, self.capped))))

    def disable(self) -> Reply:
        self.stand_still()
        return Reply(True, "motion disabled")

    def limit_to(self, percent: int) -> Reply:
        """Limit all speeds to this percentage of the settings' speeds, from LEAST_LIMIT to 100. The velocity ramps to
        the new limit."""
        if not LEAST_LIMIT <= percent <= 100:
            return refused(f"a speed limit of {percent} %: must be {LEAST_LIMIT} to 100")
        self.limit = percent
        """The speed limit, percent of the speeds in the settings."""
        self._limits = tuple(most * percent / 100 for most in self._most)
        return Reply(True, f"speed limited to {percent} % of the settings'" if percent < 100 else "speed limit lifted")

    def check_interlocks(self, now_ns: int) -> str:
        """Disable motion if an interlock is lost. Call it once per tick. Returns the text of the lost interlock, or an
        empty text."""
        unmet = self.interlocks.unmet(now_ns) if self.enabled else ""
        if unmet:
            self.stand_still()
            self.notes.append(Note("disabled", f"motion disabled: {unmet}", {"reason": unmet}))
        return unmet

    def step(self, now_ns: int) -> WheelSpeeds | None:
        """Advance the velocity to the time `now_ns`. Returns the wheel speeds (turns per second) if they must be sent
        now, or None."""
        elapsed_s = min(now_ns - self._stepped_ns, self._longest_step_ns) * 1e-9
        self._stepped_ns = now_ns
        if not self.enabled:
            return None
        reason = self.blocked(now_ns)
        if note := self.scan.note(now_ns, blocks=reason == NO_SCAN):
            self.notes.append(note)
        driving, fell_back = self.sources.choose_driver(now_ns)
        if driving:
            self._wants_motion = not driving.lets_go
        before = self.velocity
        if reason or driving is None:
            self.velocity = REST
        else:
            self.velocity = self._ramped(driving.velocity, elapsed_s, REST if fell_back else self.velocity)
            if self._kinematics.steers:
                self.velocity = self._kinematics.reach(self.velocity)
        self._ramps_on = self.velocity != before
        if driving and driving.moves and any(self.velocity):
            self._movers.add(driving.session)
        speeds = self._kinematics.wheels_rps(*self.velocity)
        if speeds == self.speeds and now_ns - self._sent_ns < self._refresh_ns:
            return None
        self.speeds = speeds
        self._sent_ns = now_ns
        return speeds

    def _ramped(self, wanted: Velocity, elapsed_s: float, start: Velocity) -> Velocity:
        vx, vy, wz = (
            _toward(now, max(-limit, min(limit, want)), ramp * elapsed_s)
            for now, want, limit, ramp in zip(start, wanted, self._limits, self._ramps, strict=True)
        )
        return vx, vy, wz


def _toward(now: float, want: float, most: float) -> float:
    return max(now - most, min(now + most, want))


def _or_end(held: list[str]) -> str:
    """Return the advice to end the held programs and start them again, because some programs never send zero. Empty if
    one of them is the gamepad, because a person can let go of its stick."""
    if PAD_SOURCE in held:
        return ""
    it = "it" if len(held) == 1 else "them"
    return f" (or end {it}, enable motion, and start {it} again)"
