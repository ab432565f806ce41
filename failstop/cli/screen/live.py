"""Live: the screen of `failstop watch`, made of states as they come; the times are arguments. Pure."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from math import hypot, sqrt

from failstop.api import host, words
from failstop.cli import style
from failstop.cli.screen import summary, told
from failstop.cli.screen.sparkline import spark
from failstop.cli.style import DIM, FAIL, OK, PLAIN, STRONG, WARN
from failstop.policy.settings import BY_KEY

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence

    from failstop.api.events import Event
    from failstop.api.state import State
    from failstop.cli.style import Line

REMEMBERED = 400
"""Values a sparkline can show; a wider terminal leaves a gap."""
WINDOW = 10
"""Samples, a second of them, that a vibration is taken from."""
MOST_EVENTS = 12
SLOW_S = 0.5
"""Ages and the process table are drawn again this often: digits that change faster can't be read."""
STILL_RADPS = float(BY_KEY["still.std_radps"].default)
TOP_RADPS = 3 * STILL_RADPS
TOP_MPS = float(BY_KEY["limits.vx_mps"].default)
TOP_TURN_RADPS = float(BY_KEY["limits.wz_radps"].default)
NAMES = 32
"""Columns before a sparkline."""


class Vibration:
    """How much the gyro's x and y vary: wheels that turn shake it."""

    __slots__ = ("_last", "_samples")

    def __init__(self) -> None:
        self._samples: deque[tuple[float, float]] = deque(maxlen=WINDOW)
        self._last: Sequence[float] | None = None

    def add(self, rate_radps: Sequence[float] | None) -> float | None:
        """A new reading; returns the standard deviation in rad/s, None while too little is known."""
        if rate_radps is None or rate_radps == self._last:
            self._samples.clear()  # a sensor that repeats itself is silent
            return None
        self._last = rate_radps
        self._samples.append((rate_radps[0], rate_radps[1]))
        if len(self._samples) < WINDOW:
            return None
        return sqrt(sum(_variance([sample[axis] for sample in self._samples]) for axis in (0, 1)) / 2)


def _variance(values: list[float]) -> float:
    mean = sum(values) / len(values)
    return sum((value - mean) ** 2 for value in values) / (len(values) - 1)


class Live:
    """What the screen remembers from one state to the next."""

    def __init__(self, name: str, *, fancy: bool) -> None:
        self._name = name
        self._fancy = fancy
        self._speed: deque[float | None] = deque(maxlen=REMEMBERED)
        self._turn: deque[float | None] = deque(maxlen=REMEMBERED)
        self._shake: deque[float | None] = deque(maxlen=REMEMBERED)
        self._vibration = Vibration()
        self._slow: list[Line] = []
        self._drawn_s = -SLOW_S
        self._key: object = None
        self._gone_s = 0.0
        self._device: str | None = None

    def lines(
        self, state: State, mono_s: float, unix_s: float, columns: int, rows: int, events: Sequence[Event] = ()
    ) -> list[Line]:
        """The screen for a state. `mono_s`: a monotonic clock; call it at a steady rate, as a sparkline's step is one
        call. `events`: of this run, oldest first."""
        self._gone_s = 0.0
        self._device = state.device.path
        vx, vy, wz = state.body_vel
        self._speed.append(hypot(vx, vy))
        self._turn.append(abs(wz))
        self._shake.append(self._vibration.add(state.imu.rate_radps if state.imu else None))
        key = (columns, state.blocked, state.epoch, state.waiting_for, state.device, state.moving)
        if key != self._key or mono_s - self._drawn_s >= SLOW_S:
            self._key, self._drawn_s = key, mono_s
            self._slow = summary.lines(state, unix_s, columns, events)[len(self._wheels(state, columns)) :]
        head = [self._title(unix_s, columns), *self._wheels(state, columns), []]
        body = [*head, *self._bars(state, columns), [], *self._slow]
        return fit([*body, *_news(events, unix_s, rows - len(body))], rows)

    def _wheels(self, state: State, columns: int) -> list[Line]:
        return style.wrap(summary.wheels(state)[0], columns, summary.LABEL)

    def _title(self, unix_s: float, columns: int) -> Line:
        left, right = f"failstop {self._name}", f"{words.clock(unix_s, unix_s)}   q quits"
        return [(left, STRONG), (" " * max(1, columns - len(left) - len(right)), PLAIN), (right, DIM)]

    def _bars(self, state: State, columns: int) -> list[Line]:
        vx, vy, wz = state.body_vel
        role = OK if state.moving else PLAIN
        return [
            self._bar("speed", f"{hypot(vx, vy):.2f} m/s", self._speed, TOP_MPS, role, columns),
            self._bar("turn", f"{abs(wz):.2f} rad/s", self._turn, TOP_TURN_RADPS, role, columns),
            self._shaking(state, columns),
        ]

    def _shaking(self, state: State, columns: int) -> Line:
        now = self._shake[-1]
        if now is None:
            text, role = "IMU silent" if state.imu is None or len(self._shake) > WINDOW else "measuring", DIM
        else:
            text = f"{now:.4f} rad/s {'shakes' if now > STILL_RADPS else 'still'}"
            role = WARN if now > STILL_RADPS and not state.moving else PLAIN
        return self._bar("vibration", text, self._shake, TOP_RADPS, role, columns)

    def _bar(self, name: str, text: str, values: deque[float | None], top: float, role: str, columns: int) -> Line:
        top = max([top, *(value for value in values if value is not None)])
        head = f"{text:<{NAMES - summary.LABEL}}"
        bars = spark(list(values), top, columns - NAMES, fancy=self._fancy)
        return [(f"{name:<{summary.LABEL}}", DIM), (head, PLAIN), (bars, role)]

    def gone(self, note: str, unix_s: float, columns: int) -> list[Line]:
        """The screen while there is no service; the history shows the gap."""
        if not self._gone_s:
            self._gone_s = unix_s
            for values in (self._speed, self._turn, self._shake):
                values.append(None)
        told = host.journal(self._name) or words.named("`failstop why`", self._name)
        rows: list[Line] = [
            self._title(unix_s, columns),
            [],
            [("NO SERVICE  ", FAIL), (note, STRONG)],
            [(f"since {words.ago(self._gone_s, unix_s)}; waiting for it to come back", PLAIN)],
            [],
            [("if the wheels turn:  ", PLAIN), (host.stop(self._device), STRONG), (", or the POWER SWITCH", PLAIN)],
            [("what happened:       ", PLAIN), (told, STRONG)],
            [("to start it:         ", PLAIN), (host.start(self._name, self._device), STRONG)],
        ]
        return [part for row in rows for part in (style.wrap(row, columns, 0) if row else [row])]


def _news(events: Sequence[Event], unix_s: float, room: int) -> list[Line]:
    """The last events, as many as there are rows for them, each in one: without what to do next, which is above."""
    count = min(room - 2, len(events), MOST_EVENTS)
    shown = [replace(event, text=event.text.partition("; next: ")[0]) for event in events[-count:]] if count > 0 else []
    return [[], [("last events", DIM)], *(told.line(event, unix_s) for event in shown)] if shown else []


def fit(lines: list[Line], rows: int) -> list[Line]:
    """As many lines as the screen has: empty ones go first, then the last ones, and that is said."""
    spare = len(lines) - rows
    kept = []
    for line in lines:
        if spare > 0 and not line:
            spare -= 1
        else:
            kept.append(line)
    if len(kept) > rows:
        hidden = len(kept) - rows + 1
        kept = [*kept[: rows - 1], [(f"({hidden} more lines: the window is too small)", DIM)]]
    return kept
