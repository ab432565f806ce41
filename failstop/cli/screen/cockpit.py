"""Cockpit: the screen of `failstop teleop`. Pure."""

from __future__ import annotations

from failstop.api import verdict, words
from failstop.cli import style
from failstop.cli.screen import arm, summary
from failstop.cli.screen.summary import row
from failstop.cli.style import DIM, FAIL, OK, PLAIN, STRONG

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
ARM_KEYS = "[ ]"
"""What turns the arm's joint that a digit has chosen."""
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
    joint: int = 0,
) -> list[Line]:
    """The screen. `command`: the last one while it counts; `speeds`: m/s and rad/s that a key commands; `joint`: the
    arm's that is chosen, by its place."""
    word, role = verdict.word(state), summary.role_of(state)
    rows: list[Line] = [
        [("failstop teleop", STRONG), (f"  {state.name}, as {source}", DIM)],
        [],
        *_keys(fancy),
        *_arm_keys(state),
        [],
        row("keys", ("held" if held else "none held"), OK if held else PLAIN),
        row("speed", f"{percent} %: {speeds[0]:.2f} m/s, {speeds[1]:.2f} rad/s"),
        row("command", "none" if command is None else words.velocity(*command) or "zero"),
        [*row("wheels", word, role), ("  ", PLAIN), (verdict.headline(state), STRONG)],
        *_arm(state, joint),
        summary.battery(state),
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


def _arm_keys(state: State) -> list[Line]:
    """On a robot with an arm."""
    if not state.arm:
        return []
    digits = f"1 - {len(state.arm.joints)}"
    row: Line = [(f"{ARM_KEYS:<10}", STRONG), (f"{'turn the chosen joint':<22}", PLAIN)]
    return [[*row, (f"{digits:<7}", STRONG), ("choose a joint of the arm", PLAIN)]]


def _arm(state: State, chosen: int) -> list[Line]:
    """What it does, and the chosen joint: where it is, or was sent."""
    if not state.arm:
        return []
    joints = list(state.arm.joints.items())
    name, joint = joints[min(chosen, len(joints) - 1)]
    where = "not read yet" if joint.at_rad is None else f"{joint.at_rad:+.2f} rad, {joint.at_by}"
    closed = f"; {state.arm.closed}" if state.arm.closed else ""
    return [row("arm", f"{arm.headline(state.arm)}{closed}"), row("joint", f"{chosen + 1} {name}: {where}")]
