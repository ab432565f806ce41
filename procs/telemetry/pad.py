"""The gamepad, and the buzzer's sounds. Pure.

Every button except MODE stops the robot. In the mode `drive`, the sticks drive the robot. A press of MODE changes the
mode, and a long press requests a reset.

locked --MODE--> drive --MODE--> locked ...                           for a robot without an arm
locked --MODE--> drive --MODE--> joint --MODE--> locked ...           for a robot with an arm
any mode --a latched stop, or a button that is not MODE--> locked     the mode stays locked while the stop is latched
any mode --a pushed stick in frames that never change--> locked       a receiver may repeat the last frame of a lost pad

Two changes by MODE are at least the lockout time (pad.mode_lockout_s) apart.
"""

from __future__ import annotations

from failstop.data import Data
from failstop.policy import causes
from failstop.policy.causes import Cause
from failstop.policy.kinematics import Velocity
from failstop.policy.settings import Settings

LOCKED, DRIVING, JOINT = range(3)
"""The modes, as indices of records.PAD_MODES. JOINT needs an arm: the left stick chooses a joint, the right one turns
it."""
CHOOSES = 0.7
"""How far the left stick must be pushed to choose the next joint; 1 is all the way. Before it can choose again, it must
come back to less than half of this."""

FULL_AXIS = 127
SILENCE_NS = 500_000_000
"""If no frame has come for longer than this, in ns, no button counts as held any more. Normally about 20 frames come
per second."""
HOLD_ENDS = 3
"""A hold of MODE ends when this many frames in a row show that MODE is not pressed. Fewer such frames may just be
transmission errors."""
RAW_FRAMES = 6
"""How many raw frames are kept for the log. They show what the gamepad sent just before a stop."""
STANDSTILL = (0.0, 0.0, 0.0)

PRESSES = frozenset((0x01, 0x02, 0x04, 0x20, 0x40, 0x80))
"""The events of the board's keys which mean that a finger is or was on a key. Releases (0x08, 0x10) don't count."""

Sound = tuple[int, int, int, int]
"""A sound: the frequency in Hz, the length of each beep in ms, the pause after it in ms, and the number of beeps."""
OFF_MS = 100
"""The pause after each beep, ms. With a pause of 0 a buzzer sounded forever."""
LATCH_SOUND: Sound = (1000, 400, OFF_MS, 2)
"""Two long low beeps: a stop was latched."""
MODE_SOUNDS = ((1500, 100, OFF_MS, 1), (2500, 100, OFF_MS, 2), (2500, 100, OFF_MS, 3))
"""The sound for each mode of the gamepad. One short beep means locked, two short high beeps mean drive, and three mean
joint."""
TUCK_SOUND = (2000, 50, OFF_MS, 4)
"""Four short beeps: the arm is about to move by itself."""


class PadNews(Data):
    """What telemetry must do because of one frame of the gamepad."""

    cause: Cause | None
    command: Velocity | None
    """The velocity to command (m/s, m/s, rad/s), or None."""
    reset: bool
    arm: tuple[int, float] | None
    """The chosen joint, and its speed as a share of the full speed, from -1 to 1. None if no joint is commanded."""
    frozen: bool
    """True if this frame has locked the gamepad, because a stick is pushed and all frames of the last pad.frozen_s have
    been the same."""


class Pad:
    """Follows the gamepad from frame to frame. If the gamepad falls silent while it drives, this class does nothing.
    The gate stops the wheels when the gamepad's last command times out."""

    def __init__(self, settings: Settings) -> None:
        self._mode_button = int(settings["pad.mode_button"])
        self._dead_zone = settings["pad.dead_zone"]
        self._lockout_ns = settings.ns("pad.mode_lockout_s")
        self._reset_hold_ns = settings.ns("pad.reset_hold_s")
        self._frozen_ns = settings.ns("pad.frozen_s")
        self.frozen = f"no byte has changed for {settings['pad.frozen_s']:g} s"
        """The text that explains why a frozen gamepad was locked."""
        self._sample: tuple[int, ...] = ()
        self._sample_ns = 0
        """`_sample`: the newest frame that differs from the one before it. `_sample_ns`: when that frame came."""
        self._limits = (settings["limits.vx_mps"], settings["limits.vy_mps"], settings["limits.wz_radps"])
        """The velocity (m/s, m/s, rad/s) that the sticks command when they are pushed all the way."""
        self._joints = len(settings.servos())
        self._raw: list[tuple[int, bytes]] = []
        self._buttons = 0
        """The buttons of the last frame. They are kept so that a button which is held causes only one stop."""
        self._last_ns: int | None = None
        self._changed_ns: int | None = None
        self._latched_ns: int | None = None
        self._hold_ns: int | None = None
        self._hold_frames_missing = 0
        self._hold_spent = False
        self._chose = False
        self.joint = 0
        """The chosen joint, by its place in the settings."""
        self.mode = LOCKED

    def follow(self, latched: bool, now_ns: int) -> None:
        """Record whether a stop is latched, for any cause. A latched stop switches the gamepad to locked."""
        if not latched:
            self._latched_ns = None
        elif self._latched_ns is None:
            self.stopped(now_ns)

    def stopped(self, now_ns: int) -> None:
        """Record a stop. Call this even if the stop was reset before follow() saw it. Only a hold of MODE after
        `now_ns` counts towards a reset."""
        self.mode = LOCKED
        self._latched_ns = now_ns

    def add(self, sample: tuple[int, int, int, int, int, int], raw: bytes, t_ns: int) -> PadNews:
        """Add one frame. `sample`: (buttons, hat, lx, ly, rx, ry). `raw`: its raw bytes."""
        self._notice_silence(t_ns)
        self._raw = [*self._raw[1 - RAW_FRAMES :], (t_ns, raw)]
        buttons, _, lx, ly, rx, _ = sample
        cause = self._stops(buttons)
        was = self.mode
        if cause:
            self.mode = LOCKED
        self._update_hold(buttons, t_ns)
        same_ns = self._same_ns(sample, t_ns)
        # Nobody means a hold as a reset if all frames have been the same for longer than this.
        self._hold_spent |= same_ns >= self._frozen_ns + self._reset_hold_ns
        locks = same_ns >= self._frozen_ns and self.mode != LOCKED and any(map(self._axis, (lx, ly, rx)))
        if locks:
            self.mode = LOCKED
        if self.mode == DRIVING:
            command: Velocity | None = self._sticks(lx, ly, rx)
        else:
            # If MODE has just locked the gamepad, stop now and not when the command times out. A cause stops anyway.
            command = STANDSTILL if was == DRIVING and not cause else None
        arm = self._turns_joint(lx, rx) if self.mode == JOINT else (self.joint, 0.0) if was == JOINT else None
        return PadNews(cause, command, self._reset_is_due(buttons, t_ns), arm, locks)

    def _same_ns(self, sample: tuple[int, ...], t_ns: int) -> int:
        """Return how long the gamepad has sent the same frame, ns."""
        if sample != self._sample:
            self._sample, self._sample_ns = sample, t_ns
        return t_ns - self._sample_ns

    def _stops(self, buttons: int) -> Cause | None:
        """Return the cause of a stop if a button other than MODE was just pressed, otherwise None. One frame is enough,
        because a short tap may last only one frame."""
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
        """Return the last raw frames in hex, oldest first. Each has its age in ms, counted back from the newest one."""
        newest_ns = self._raw[-1][0] if self._raw else 0
        return ", ".join(f"{raw.hex()} (-{(newest_ns - t_ns) // 1_000_000} ms)" for t_ns, raw in self._raw)

    def _notice_silence(self, t_ns: int) -> None:
        if self._last_ns is not None and t_ns - self._last_ns > SILENCE_NS:
            self._buttons = 0  # a button that was held before the silence must not hide the next tap
            self._hold_ns = None
        self._last_ns = t_ns

    def _update_hold(self, buttons: int, t_ns: int) -> None:
        """Follow whether MODE is held. When a hold of MODE alone begins, change the mode if that is allowed."""
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
        """Return True, once per hold, if MODE alone was held for long enough while a stop was latched. The time before
        the stop does not count."""
        if buttons != self._mode_button or self._hold_ns is None or self._latched_ns is None or self._hold_spent:
            return False
        self._hold_spent = t_ns - max(self._hold_ns, self._latched_ns) >= self._reset_hold_ns
        return self._hold_spent

    def _sticks(self, lx: int, ly: int, rx: int) -> Velocity:
        forward, left, turn = self._limits
        return self._axis(ly) * forward, self._axis(-lx) * left, self._axis(-rx) * turn

    def _axis(self, raw: int) -> float:
        """Return the position of an axis, from -1 to 1, or 0 within the dead zone. The raw value -128 counts as -1,
        like -127."""
        value = max(-1.0, min(1.0, raw / FULL_AXIS))
        return value if abs(value) >= self._dead_zone else 0.0


class Tones:
    """Chooses the buzzer's sounds. Only a change makes a sound, and none does if buzzer.tones is off."""

    def __init__(self, *, on: bool) -> None:
        self._on = on
        self._seen = (True, LOCKED, False)
        """The arguments of the last sound_for(). At the start, a stop counts as latched. So a stop that was latched
        before telemetry started makes no second sound."""

    def sound_for(self, latched: bool, mode: int, *, tucks: bool = False) -> Sound | None:
        """Return the sound to make now, or None. While a stop is latched, a change of the mode makes no sound."""
        (was_latched, was_mode, tucked), self._seen = self._seen, (latched, mode, tucks)
        if not self._on:
            return None
        if latched and not was_latched:
            return LATCH_SOUND
        if tucks and not tucked:
            return TUCK_SOUND
        return MODE_SOUNDS[mode] if mode != was_mode and not latched else None
