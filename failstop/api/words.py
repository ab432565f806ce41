"""Words: puts times, ages, velocities and other programs' texts into a form for people."""

from __future__ import annotations

import time
from math import degrees, isfinite

from failstop.files.instance import DEFAULT_NAME, option

TYPE_CHECKING = False
if TYPE_CHECKING:  # the incident saver, which starts just after a stop, imports this module too
    from failstop.api.snapshot import State

DAY_S = 86400.0
OLD_WORDS_S = 5.0
JUMP_S = 5.0
DRIFT = 1e-3
"""Two clocks of one machine drift apart by at most this share of the time, as long as nobody sets one of them."""
GUARDED = "uses the guard port "
"""How the guard's report about a driver begins; the path of the port follows."""
NOWHERE_MPS = 0.0005
"""A speed below this is shown as standing, because it would be rounded to 0."""


def span(seconds: float) -> str:
    """A length of time as a text: 0.4 s, 12 s, 3 min, 2 h 5 min, 3 days."""
    if not isfinite(seconds):
        return f"{seconds:g} s"
    if seconds < 9.95:
        return f"{max(0.0, seconds):.1f} s"
    if seconds < 120:
        return f"{seconds:.0f} s"
    minutes = int(seconds // 60)
    if minutes < 60:
        return f"{minutes} min"
    if seconds < 2 * DAY_S:
        return f"{minutes // 60} h {minutes % 60} min"
    return f"{seconds / DAY_S:.0f} days"


def printable(text: str) -> str:
    """Somebody else's text on one line of a terminal: characters that control a terminal or change the direction of
    writing are shown as codes, such as `\x1b` or `\u202e`."""
    shown = (c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    return text if text.isprintable() else "".join(shown)


def clock_jump(wall_s: float, monotonic_s: float) -> float:
    """How far the wall clock jumped while these times passed on it and on the monotonic clock, s; negative: backward;
    0: not more than the clocks drift apart."""
    jumped_s = wall_s - monotonic_s
    return jumped_s if abs(jumped_s) > max(JUMP_S, DRIFT * monotonic_s) else 0.0


def jumped(seconds: float) -> str:
    """A jump of the wall clock in words. A jump forward may mean that the machine slept, because the monotonic clock
    does not count that."""
    if seconds < 0:
        return f"the clock was set back by {span(-seconds)}"
    return f"the clock went forward by {span(seconds)} (it was set, or the machine slept)"


def clock(unix_s: float, now_s: float = 0.0) -> str:
    """Local time of day, with the date if it is more than half a day from now or no `now_s` is given."""
    form = "%H:%M:%S" if abs(now_s - unix_s) < DAY_S / 2 else "%Y-%m-%d %H:%M:%S"
    return time.strftime(form, time.localtime(unix_s))


def ago(unix_s: float, now_s: float) -> str:
    """A time as text, for example `14:03:22, 12 s ago`. A stamp from the future, from a clock that was set back, is
    shown as just a time."""
    seconds = now_s - unix_s
    return f"{clock(unix_s, now_s)}, {span(seconds)} ago" if seconds >= 0 else clock(unix_s, now_s)


AGED_S = 3.0
"""A reading of this age, s, or more is shown with its age, because some boards report their battery only once per
second."""


def aged(age_s: float | None, *, current: bool = True) -> str:
    """The age of a reading as text to put after it, for example `, 12 s ago`; empty if the reading is fresh. `current`:
    the board still sends reports."""
    return "" if age_s is None or (age_s < AGED_S and current) else f", {span(age_s)} ago"


def velocity(vx_mps: float, vy_mps: float, wz_radps: float) -> str:
    """A velocity of the robot as a text, without the axes that are zero."""
    axes = (
        (vx_mps, "m/s", "forward", "backward"),
        (vy_mps, "m/s", "left", "right"),
        (wz_radps, "rad/s", "turning left", "turning right"),
    )
    return ", ".join(
        f"{abs(value):.2f} {unit} {other if value < 0 else one}"
        for value, unit, one, other in axes
        if not abs(value) < NOWHERE_MPS  # a value that is not a number is shown too
    )


def steering(rad: float) -> str:
    """The commanded angle of the steered wheels, in words."""
    angle = round(degrees(rad))
    return f"{abs(angle)} degrees to the {'left' if angle > 0 else 'right'}" if angle else "straight ahead"


def took(seconds: float) -> str:
    """A short time as a text, with the digits that matter."""
    if seconds < 1e-4:
        return f"{seconds * 1e6:.0f} us"
    if seconds >= 1:
        return f"{seconds:.1f} s"
    milliseconds = seconds * 1e3
    return f"{milliseconds:.2f} ms" if milliseconds < 10 else f"{milliseconds:.0f} ms"


def named(text: str, name: str) -> str:
    """The text with the service's name added to failstop commands in backquotes, which is needed if several services
    exist."""
    import re  # the saver does not need it

    return re.sub(r"(?<=`)failstop (?![^`]* --name )[^`]*(?=`)", lambda found: found[0] + option(name), text)


def plain(text: str) -> str:
    """The text without the backquotes of its commands."""
    return text.replace("`", "")


def sentence(text: str) -> str:
    """A text for the page: without backquotes, with a capital letter at its beginning and a full stop at its end."""
    text = plain(text).strip()
    return f"{text[:1].upper()}{text[1:]}{'' if text.endswith(('.', '!', '?')) else '.'}"


def of(name: str) -> str:
    """The service's name for the title of a screen; empty for the default name."""
    return "" if name == DEFAULT_NAME else f" of {name!r}"


def said(state: State) -> list[tuple[str, str, str]]:
    """(client, what it sees, what it reports as wrong) for each client that reports something. Old reports come with
    their age."""
    found = []
    for client in state.clients:
        if client.said_s is not None:
            age = f" ({span(client.said_s)} ago)" if client.said_s > OLD_WORDS_S else ""
            found.append((f"{client.name}{age}", client.sees, client.wrong))
    return found
