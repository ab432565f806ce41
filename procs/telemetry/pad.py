"""The gamepad: its buttons stop the robot, its sticks drive in the drive mode, and MODE changes the mode and, held for
long, requests a reset. Also the buzzer's sounds. Pure.

locked --MODE--> drive --MODE--> locked ...     with a lockout between two changes
any --any latch, any other button--> locked     and locked it stays while latched
any --a pushed stick, frames all the same--> locked     a receiver may repeat the last frame of a pad that is away
"""

from __future__ import annotations

from failstop.data import Data
from failstop.policy import causes
from failstop.policy.causes import Cause
from failstop.policy.kinematics import Velocity
from failstop.policy.settings import Settings

LOCKED, DRIVING, JOINT = range(3)
"""Indices of records.PAD_MODES. JOINT needs an arm: the left stick chooses a joint, the right stick turns it."""
CHOOSES = 0.7
"""How far the stick must be pushed to choose a joint, from 0 to 1. It may choose again once it is back within half of
that."""

FULL_AXIS = 127
SILENCE_NS = 500_000_000
"""About 20 frames come per second. If none has come for this long, no button counts as held."""
HOLD_ENDS = 3
"""After this many frames without MODE a hold has ended. Fewer may be missed frames."""
RAW_FRAMES = 6
"""How many raw frames are kept for the log, to show what the pad sent just before a stop."""
STANDSTILL = (0.0, 0.0, 0.0)

PRESSES = frozenset((0x01, 0x02, 0x04, 0x20, 0x40, 0x80))
"""Events of the board's keys that mean that a finger is or was on the key. Releases (0x08, 0x10) don't count."""

Sound = tuple[int, int, int, int]
"""A sound: frequency in Hz, length of a beep in ms, pause in ms, number of beeps."""
OFF_MS = 100
"""The pause between two beeps, and after the last, ms. With a pause of 0 a buzzer sounded forever."""
LATCH_SOUND: Sound = (1000, 400, OFF_MS, 2)
"""Two long low beeps."""
MODE_SOUNDS = ((1500, 100, OFF_MS, 1), (2500, 100, OFF_MS, 2), (2500, 100, OFF_MS, 3))
"""The sound of each pad mode. One short beep: locked; two short high ones: drive; three: joint."""
TUCK_SOUND = (2000, 50, OFF_MS, 4)
"""Four short beeps: the arm is about to move by itself."""


class PadNews(Data):
    """What follows from one frame of the gamepad."""

    cause: Cause | None
    command: Velocity | None
    """The velocity to command (m/s, m/s, rad/s), or None."""
    reset: bool
    arm: tuple[int, float] | None
    """The joint to turn, and at what share of its speed, or None."""
    frozen: bool
    """True if this frame has locked the gamepad, because a stick is pushed and all frames of the last pad.frozen_s were
    the same."""


class Pad:
    """The gamepad's state from frame to frame. If it falls silent in drive mode, the command's timeout stops the
    wheels."""

    def __init__(self, settings: Settings) -> None:
        self._mode_button = int(settings["pad.mode_button"])
        self._dead_zone = settings["pad.dead_zone"]
        self._lockout_ns = settings.ns("pad.mode_lockout_s")
        self._reset_hold_ns = settings.ns("pad.reset_hold_s")
        self._frozen_ns = settings.ns("pad.frozen_s")
        self.frozen = f"no byte has changed for {settings['pad.frozen_s']:g} s"
        """The text that says why a frozen gamepad is locked."""
        self._sample: tuple[int, ...] = ()
        self._sample_ns = 0
        """The newest frame that differs from the one before it, and when it came."""
        self._limits = (settings["limits.vx_mps"], settings["limits.vy_mps"], settings["limits.wz_radps"])
        """The velocity that each stick commands when it is pushed all the way."""
        self._joints = len(settings.servos())
        self._raw: list[tuple[int, bytes]] = []
        self._buttons = 0
        """The buttons of the last frame, so that a button that is held causes only one request."""
        self._last_ns: int | None = None
        self._changed_ns: int | None = None
        self._latched_ns: int | None = None
        self._hold_ns: int | None = None
        self._hold_frames_missing = 0
        self._hold_spent = False
        self._chose = False
        self.joint = 0
        """The joint that is chosen, by its place in the settings."""
        self.mode = LOCKED

    def follow(self, latched: bool, now_ns: int) -> None:
        """Follow whether a stop is latched, whatever its cause. A latch switches the pad to locked."""
        if not latched:
            self._latched_ns = None
        elif self._latched_ns is None:
            self.stopped(now_ns)

    def stopped(self, now_ns: int) -> None:
        """There was a stop, perhaps one that was latched and reset between two looks. Whatever is held now is from
        before it, so it does not count."""
        self.mode = LOCKED
        self._latched_ns = now_ns

    def add(self, sample: tuple[int, int, int, int, int, int], raw: bytes, t_ns: int) -> PadNews:
        """Add one frame: (buttons, hat, lx, ly, rx, ry), and its raw bytes."""
        self._notice_silence(t_ns)
        self._raw = [*self._raw[1 - RAW_FRAMES :], (t_ns, raw)]
        buttons, _, lx, ly, rx, _ = sample
        cause = self._stops(buttons)
        was = self.mode
        if cause:
            self.mode = LOCKED
        self._update_hold(buttons, t_ns)
        same_ns = self._same_ns(sample, t_ns)
        # Longer than any hold that somebody means as a reset.
        self._hold_spent |= same_ns >= self._frozen_ns + self._reset_hold_ns
        locks = same_ns >= self._frozen_ns and self.mode != LOCKED and any(map(self._axis, (lx, ly, rx)))
        if locks:
            self.mode = LOCKED
        if self.mode == DRIVING:
            command: Velocity | None = self._sticks(lx, ly, rx)
        else:
            # Locked by MODE: stop now, not when the command times out. A cause stops by itself.
            command = STANDSTILL if was == DRIVING and not cause else None
        arm = self._turns_joint(lx, rx) if self.mode == JOINT else (self.joint, 0.0) if was == JOINT else None
        return PadNews(cause, command, self._reset_is_due(buttons, t_ns), arm, locks)

    def _same_ns(self, sample: tuple[int, ...], t_ns: int) -> int:
        """For how long all frames have been the same, ns."""
        if sample != self._sample:
            self._sample, self._sample_ns = sample, t_ns
        return t_ns - self._sample_ns

    def _stops(self, buttons: int) -> Cause | None:
        """The cause if a button stops the robot. One frame is enough, because a short tap lasts only one."""
        pressed = buttons & ~self._buttons & ~self._mode_button
        self._buttons = buttons
        return causes.BUTTON(pressed) if pressed else None

    def _turns_joint(self, lx: int, rx: int) -> tuple[int, float]:
        side = self._axis(lx)
        if abs(side) >= CHOOSES and not self._chose:
            self.joint = (self.joint + (1 if side > 0 else -1)) % self._joints
        self._chose = abs(side) >= (CHOOSES / 2 if self._chose else CHOOSES)
        return self.joint, self._axis(-rx)

    def recent(self) -> str:
        """The last raw frames in hex, the oldest first, each with its age in ms."""
        newest_ns = self._raw[-1][0] if self._raw else 0
        return ", ".join(f"{raw.hex()} (-{(newest_ns - t_ns) // 1_000_000} ms)" for t_ns, raw in self._raw)

    def _notice_silence(self, t_ns: int) -> None:
        if self._last_ns is not None and t_ns - self._last_ns > SILENCE_NS:
            self._buttons = 0  # a button that was held then must not hide the next tap
            self._hold_ns = None
        self._last_ns = t_ns

    def _update_hold(self, buttons: int, t_ns: int) -> None:
        """Follow MODE: a hold begins, goes on or ends. The mode changes when a hold begins."""
        if buttons & self._mode_button:
            self._hold_frames_missing = 0
            if self._hold_ns is None:
                self._hold_ns = t_ns
                self._hold_spent = False
                if buttons == self._mode_button:
                    self._change_mode(t_ns)
        elif self._hold_ns is not None:
            self._hold_frames_missing += 1
            if self._hold_frames_missing >= HOLD_ENDS:
                self._hold_ns = None

    def _change_mode(self, t_ns: int) -> None:
        if self._latched_ns is not None:
            return
        if self._changed_ns is None or t_ns - self._changed_ns >= self._lockout_ns:
            self._changed_ns = t_ns
            self.mode = (self.mode + 1) % (JOINT + 1 if self._joints else JOINT)

    def _reset_is_due(self, buttons: int, t_ns: int) -> bool:
        """True if MODE was held long enough, and a stop was latched during all that time: a hold that began before the
        latch resets nothing, because the person could not know about the stop. It is true once per hold, and only if no
        other button is pressed."""
        if buttons != self._mode_button or self._hold_ns is None or self._latched_ns is None or self._hold_spent:
            return False
        self._hold_spent = t_ns - max(self._hold_ns, self._latched_ns) >= self._reset_hold_ns
        return self._hold_spent

    def _sticks(self, lx: int, ly: int, rx: int) -> Velocity:
        forward, left, turn = self._limits
        return self._axis(ly) * forward, self._axis(-lx) * left, self._axis(-rx) * turn

    def _axis(self, raw: int) -> float:
        """The position of an axis from -1 to 1 (raw values go down to -128); 0 within the dead zone."""
        value = max(-1.0, min(1.0, raw / FULL_AXIS))
        return value if abs(value) >= self._dead_zone else 0.0


class Tones:
    """The buzzer's tones. It remembers what it last saw, so that a tone sounds only on a change. If the setting is off,
    none sounds."""

    def __init__(self, *, on: bool) -> None:
        self._on = on
        self._seen = (True, LOCKED, False)
        """The arguments of the last call. A stop that is already latched at the start makes no sound, because it was
        announced when it happened."""

    def sound_for(self, latched: bool, mode: int, *, tucks: bool = False) -> Sound | None:
        """The sound to make now, or None. A latch also locks the gamepad, but then only the latch's tone sounds."""
        (was_latched, was_mode, tucked), self._seen = self._seen, (latched, mode, tucks)
        if not self._on:
            return None
        if latched and not was_latched:
            return LATCH_SOUND
        if tucks and not tucked:
            return TUCK_SOUND
        return MODE_SOUNDS[mode] if mode != was_mode and not latched else None
