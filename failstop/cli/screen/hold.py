"""Hold: hold-to-run, from key events to velocity commands. Pure: the time is an argument.

A command goes out with a key's event and counts for the service's command timeout (0.3 s); nothing else keeps the
wheels turning. So whatever ends the events - the key's release, a dead connection, a stopped program - ends the
driving.

What the terminal tells decides what a press is worth:
    it only repeats      a press drives for one command timeout, then the wheels stand until the terminal's repeats
                         begin (after 250 to 660 ms): a tap is a nudge, and a release counts from the last repeat on
    it tells releases    a press drives until the release, or until repeats should have begun: a press whose release
                         got lost on the way ends then
"""

from __future__ import annotations

from failstop.cli.screen.keys import FOCUS_OUT, PRESS, RELEASE, REPEAT

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.cli.screen.keys import Key

    Velocity = tuple[float, float, float]

AXES = {
    "w": (1.0, 0.0, 0.0),
    "up": (1.0, 0.0, 0.0),
    "s": (-1.0, 0.0, 0.0),
    "down": (-1.0, 0.0, 0.0),
    "a": (0.0, 0.0, 1.0),
    "left": (0.0, 0.0, 1.0),
    "d": (0.0, 0.0, -1.0),
    "right": (0.0, 0.0, -1.0),
    "j": (0.0, 1.0, 0.0),
    "l": (0.0, -1.0, 0.0),
}
"""Keys that move: forward, to the left, counter-clockwise."""
COMMAND_S = 0.3
"""What one command is worth by default (gate.command_timeout_s)."""
ENDS_S = 0.35
"""After the last event: by then the service's own timeout has stopped the wheels; for a source with a longer one, a
zero is sent."""
FIRST_REPEAT_S = 0.7
"""A terminal that repeats keys has begun to by then."""
RESEND_S = 0.05
STILL = (0.0, 0.0, 0.0)
MOST_AT_ONCE = 5
"""More motion keys in one read than a terminal sends between two looks: they were held up on the way, and are old."""


class Hold:
    """Which keys are held, as far as the terminal tells, and what is to be sent for them."""

    __slots__ = ("_first_until_s", "_held", "_sent_s", "_until_s", "releases")

    def __init__(self) -> None:
        self.releases = False
        """The terminal tells releases."""
        self._held: list[str] = []
        self._until_s = 0.0
        """When what is held ends unless another event comes."""
        self._first_until_s = 0.0
        """Until then commands are repeated without an event."""
        self._sent_s = 0.0

    @property
    def active(self) -> bool:
        """True while keys are held."""
        return bool(self._held)

    def wanted(self) -> Velocity:
        """The velocity that the held keys ask for, each axis within -1 to 1."""
        x, y, turn = (
            max(-1.0, min(1.0, sum(axes))) for axes in zip(STILL, *(AXES[key] for key in self._held), strict=True)
        )
        return x, y, turn

    def events(self, keys: list[Key], now_s: float) -> Velocity | None:
        """What to send for these events, the newest state of the keys; None: nothing."""
        before = self.active
        moved = False
        if sum(name in AXES and kind != RELEASE for name, kind in keys) > MOST_AT_ONCE:
            return self.let_go()
        for name, kind in keys:
            if name == FOCUS_OUT:
                self._held.clear()
            elif name in AXES:
                moved = self._event(name, kind, now_s) or moved
        if before and not self.active:
            return STILL
        if not moved:
            return None
        self._sent_s = now_s
        return self.wanted()

    def _event(self, name: str, kind: int, now_s: float) -> bool:
        """True when it asks for motion."""
        if kind == RELEASE:
            if name in self._held:
                self._held.remove(name)
            return self.active
        if not self.releases:
            self._held.clear()  # of several keys such a terminal repeats the last one alone
        if name not in self._held:
            if kind == REPEAT:
                return False  # let go by something else: it counts again when it is pressed again
            self._held.append(name)
        self._first_until_s = now_s + FIRST_REPEAT_S if kind == PRESS and self.releases else 0.0
        self._until_s = max(self._first_until_s, now_s) + ENDS_S
        return True

    def due(self, now_s: float) -> Velocity | None:
        """What to send without any event; None: nothing."""
        if not self._held:
            return None
        if now_s >= self._until_s:
            return self.let_go()
        if now_s < self._first_until_s and now_s - self._sent_s >= RESEND_S:
            self._sent_s = now_s
            return self.wanted()
        return None

    def let_go(self) -> Velocity | None:
        """Forget the held keys; what to send for it."""
        was_active, self._held = self.active, []
        self._first_until_s = 0.0
        return STILL if was_active else None
