"""Words: turns times, ages, velocities and texts of other programs into texts for people."""

from __future__ import annotations

import time
from math import degrees, isfinite

from failstop.files.instance import DEFAULT_NAME, option

TYPE_CHECKING = False
if TYPE_CHECKING:  # the incident saver imports this module too, and must start fast
    from failstop.api.snapshot import State

DAY_S = 86400.0
OLD_WORDS_S = 5.0
JUMP_S = 5.0
DRIFT = 1e-3
"""How far two clocks of one computer drift apart at most, as a share of the elapsed time. If they differ by more, a
clock was set."""
GUARDED = "uses the guard port "
"""How the guard's report about a driver begins; the path of the port follows."""
ON_PAGE = "(page)"
"""The end of the name that the operator's page uses for a paired device. The pid follows it."""
NOWHERE_MPS = 0.0005
"""A speed below this, in m/s or rad/s, is left out. With two decimals it would be shown as 0.00."""


def span(seconds: float) -> str:
    """A length of time as a text, for example 0.4 s, 12 s, 3 min, 2 h 5 min, 3 days."""
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
    r"""Another program's text, made safe to show on one line of a terminal. Characters that control a terminal or
    change the direction of writing are shown as codes, such as `\x1b` or `\u202e`."""
    shown = (c if c.isprintable() else c.encode("unicode_escape").decode() for c in text)
    return text if text.isprintable() else "".join(shown)


def clock_jump(wall_s: float, monotonic_s: float) -> float:
    """How far the wall clock has jumped, in s; negative if it jumped backward. Pass the length of one interval by each
    clock. Returns 0 for a difference of up to JUMP_S, and for one that drift can explain."""
    jumped_s = wall_s - monotonic_s
    return jumped_s if abs(jumped_s) > max(JUMP_S, DRIFT * monotonic_s) else 0.0


def jumped(seconds: float) -> str:
    """A text about a jump of the wall clock. After a jump forward it also mentions sleep, because the monotonic clock
    does not count while the computer sleeps."""
    if seconds < 0:
        return f"the clock was set back by {span(-seconds)}"
    return f"the clock went forward by {span(seconds)} (it was set, or the machine slept)"


def clock(unix_s: float, now_s: float = 0.0) -> str:
    """The local time of day, with the date if `now_s` is more than half a day away or not given."""
    form = "%H:%M:%S" if abs(now_s - unix_s) < DAY_S / 2 else "%Y-%m-%d %H:%M:%S"
    return time.strftime(form, time.localtime(unix_s))


def ago(unix_s: float, now_s: float) -> str:
    """A time as text, for example `14:03:22, 12 s ago`. If the clock was set back and the time is in the future, only
    the time of day is shown."""
    seconds = now_s - unix_s
    return f"{clock(unix_s, now_s)}, {span(seconds)} ago" if seconds >= 0 else clock(unix_s, now_s)


AGED_S = 3.0
"""The age from which a reading is shown with its age, in s. A younger reading is normal, because some boards report
their battery only once per second."""


def aged(age_s: float | None, *, current: bool = True) -> str:
    """The age of a reading, as text to put after the reading, for example `, 12 s ago`. Empty if the age is not known.
    Also empty if it is below AGED_S and the board still sends reports (`current`)."""
    return "" if age_s is None or (age_s < AGED_S and current) else f", {span(age_s)} ago"


def velocity(vx_mps: float, vy_mps: float, wz_radps: float) -> str:
    """A velocity of the robot as text. Directions with zero speed are left out."""
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
    """The commanded angle of the steered wheels, as text."""
    angle = round(degrees(rad))
    return f"{abs(angle)} degrees to the {'left' if angle > 0 else 'right'}" if angle else "straight ahead"


def took(seconds: float) -> str:
    """A short time as text, with only as many digits as matter."""
    if seconds < 1e-4:
        return f"{seconds * 1e6:.0f} us"
    if seconds >= 1:
        return f"{seconds:.1f} s"
    milliseconds = seconds * 1e3
    return f"{milliseconds:.2f} ms" if milliseconds < 10 else f"{milliseconds:.0f} ms"


def named(text: str, name: str) -> str:
    """Add `--name` with the service's name to each failstop command in backquotes, because a computer may have several
    services. For the default service, nothing is added."""
    import re  # imported only here, because the incident saver does not need it

    return re.sub(r"(?<=`)failstop (?![^`]* --name )[^`]*(?=`)", lambda found: found[0] + option(name), text)


def plain(text: str) -> str:
    """The text without the backquotes around its commands."""
    return text.replace("`", "")


def sentence(text: str) -> str:
    """The text as a sentence for the web page: no backquotes, a capital letter first, and a full stop unless it ends
    with ! or ?."""
    text = plain(text).strip()
    return f"{text[:1].upper()}{text[1:]}{'' if text.endswith(('.', '!', '?')) else '.'}"


def of(name: str) -> str:
    """The service's name for the title of a screen. Empty for the default service."""
    return "" if name == DEFAULT_NAME else f" of {name!r}"


def said(state: State) -> list[tuple[str, str, str]]:
    """For each client that reports something: its name, what it sees, and what it reports as wrong. The name of an old
    report is followed by the report's age."""
    found = []
    for client in state.clients:
        if client.said_s is not None:
            age = f" ({span(client.said_s)} ago)" if client.said_s > OLD_WORDS_S else ""
            found.append((f"{client.name}{age}", client.sees, client.wrong))
    return found
