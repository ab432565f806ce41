"""Cockpit: the screen of `failstop teleop`. Pure."""

from __future__ import annotations

from failstop.api import verdict, words
from failstop.cli import style
from failstop.cli.screen import summary
from failstop.cli.style import DIM, FAIL, OK, PLAIN, STRONG, WARN

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.api.state import State
    from failstop.cli.screen.hold import Velocity
    from failstop.cli.style import Line

KEYS = (
    ("w s", "\u2191 \u2193", "forward, backward", "space", "STOP, latched"),
    ("a d", "\u2190 \u2192", "turn left, right", "e", "enable motion"),
    ("j l", "", "slide left, right", "r", "reset a latched stop"),
    ("+ -", "", "faster, slower", "q", "stop, disable, leave"),
)
"""Two columns of keys: letters, arrows, what they do; another key, what it does."""
REPEATS = "hold a key to drive: a tap drives 0.3 s, going on when the terminal repeats it"
RELEASES = "hold a key to drive: it ends with the key's release"


def lines(
    state: State,
    *,
    held: bool,
    releases: bool,
    command: Velocity | None,
    percent: int,
    speeds: tuple[float, float],
    note: tuple[str, str],
    source: str,
    fancy: bool,
    columns: int,
) -> list[Line]:
    """The screen. `command`: the last one while it counts; `speeds`: m/s and rad/s that a key commands."""
    word, role = verdict.word(state), summary.role_of(state)
    rows: list[Line] = [
        [("failstop teleop", STRONG), (f"  {state.name}, as {source}", DIM)],
        [],
        *_keys(fancy),
        [],
        _row("keys", ("held" if held else "none held"), OK if held else PLAIN),
        _row("speed", f"{percent} %: {speeds[0]:.2f} m/s, {speeds[1]:.2f} rad/s"),
        _row("command", "none" if command is None else words.velocity(*command) or "zero"),
        [*_row("wheels", word, role), ("  ", PLAIN), (verdict.headline(state), STRONG)],
        _row("battery", *_battery(state)),
        summary.device(state),
        [],
        [(note[0], note[1])],
        [(RELEASES if releases else REPEATS, DIM)],
    ]
    return [part for row in rows for part in (style.wrap(row, columns, summary.LABEL if _labelled(row) else 0))]


def _labelled(row: Line) -> bool:
    return bool(row) and row[0][1] == DIM and len(row[0][0]) == summary.LABEL


def _keys(fancy: bool) -> list[Line]:
    rows: list[Line] = []
    for letters, arrows, moves, other, does in KEYS:
        row: Line = [(f"{letters}  ", STRONG), (f"{arrows if fancy else '':<5}", STRONG), (f"{moves:<22}", PLAIN)]
        rows.append([*row, (f"{other:<7}", STRONG), (does, FAIL if other == "space" else PLAIN)])
    return rows


def _row(label: str, text: str, role: str = PLAIN) -> Line:
    return [(f"{label:<{summary.LABEL}}", DIM), (text, role)]


def _battery(state: State) -> tuple[str, str]:
    if not state.battery_v:
        return "not known yet", PLAIN
    return f"{state.battery_v:.2f} V", WARN if state.battery_v < summary.BATTERY_LOW_V else PLAIN
