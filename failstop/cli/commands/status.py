"""`failstop status` shows the state once, and `failstop status -w` shows it live. `failstop why` says in a few lines
why the wheels are stopped."""

from __future__ import annotations

import dataclasses
from argparse import ArgumentParser, Namespace
from collections import deque
from collections.abc import Iterable, Sequence
from math import hypot

from failstop.api import dates, host, verdict, words
from failstop.api.errors import NoService
from failstop.api.events import Event, EventLog
from failstop.api.follow import Follower, Vibration
from failstop.api.state import State, StateReader
from failstop.api.why import explain
from failstop.cli import style
from failstop.cli.commands import add_name
from failstop.cli.screen import summary
from failstop.cli.style import DIM, FAIL, OK, PLAIN, STRONG, WARN, Line
from failstop.incidents.left import left, refusal
from failstop.policy.settings import BY_KEY

EXAMPLES = {
    "status": """\
failstop status                        # print the state once
failstop status -w                     # show it live
ssh -t robot failstop status -w        # from another computer
failstop status --json | jq .blocked   # for programs
""",
    "why": """\
failstop why                         # why the wheels are stopped
failstop why --json | jq -r '.do[]'  # only the steps to take
""",
}

MOST_COLUMNS = 100
"""The width of the longest line that `failstop why` prints, in columns. Longer lines are hard to read."""
LABEL = 7
PERIOD_S = 0.1
REMEMBERED = 400
"""The largest number of values that a sparkline shows. On a wider terminal, the left part of the sparkline's row stays
empty."""
SLOW_S = 0.5
"""The time between two redraws of the ages and the process table, in seconds. Digits that change faster can't be
read."""
STILL_RADPS = float(BY_KEY["still.std_radps"].default)
TOP_MPS = float(BY_KEY["limits.vx_mps"].default)
TOP_RADPS = float(BY_KEY["limits.wz_radps"].default)
NAMES = 32
"""The width of the text to the left of a sparkline, in columns."""
BARS = "▁▂▃▄▅▆▇█"


def add_arguments(parser: ArgumentParser) -> None:
    """Define the options of `failstop status` or `failstop why`. The parser's name says which of the two it is."""
    how = parser.add_mutually_exclusive_group()
    if parser.prog.endswith("status"):
        live = "show the state live, with velocity and vibration; q or Ctrl-C ends it"
        how.add_argument("-w", "--watch", action="store_true", help=live)
    how.add_argument("--json", action="store_true", help="print JSON instead of text")
    add_name(parser)


def main(arguments: Namespace) -> int:
    """Run the command. Raises NoService if no service is running. But if the service has died, `failstop why` prints
    the reason and returns an error code."""
    if arguments.command == "why":
        return _why(arguments.name, as_json=arguments.json)
    return _watch(arguments.name) if arguments.watch else _status(arguments.name, as_json=arguments.json)


def _status(name: str, *, as_json: bool) -> int:
    try:
        state = StateReader(name).read()
    except NoService as error:
        raise refusal(name, error) from None
    if as_json:
        style.show(style.record(state.as_dict()))
    else:
        at = dates.now()
        state, events = dates.dated(state, EventLog(name).read(), at)
        style.show(summary.lines(state, at.unix_s, style.width(), events))
    return 0


def _why(name: str, *, as_json: bool) -> int:
    code = 0
    try:
        at = dates.now()
        found = explain(*dates.dated(StateReader(name).read(), EventLog(name).read(), at), at.unix_s)
    except NoService as error:
        if not (dead := left(name)):
            raise refusal(name, error) from None
        found, code = dead[0], error.exit_code
    rows = [[(f"{label:<{LABEL}}", style.DIM), *summary.commands(text)] for label, text in found.rows()]
    lines = summary.wrapped(rows, min(style.width(), MOST_COLUMNS), LABEL)
    style.show(style.record(dataclasses.asdict(found)) if as_json else lines)
    return code


def _watch(name: str) -> int:
    """Show the state live until the user types q or a signal arrives. Returns 0 after q, and 128 plus the signal's
    number after a signal."""
    from failstop.cli.screen.terminal import Terminal

    follower, live = Follower(name), Live(name)
    with Terminal() as terminal:
        for typed, now_s in terminal.turns(PERIOD_S):
            if b"q" in typed.lower():
                return 0
            if now_s is not None:
                state, at = follower.read(now_s), dates.now()
                if state is None:
                    terminal.draw(live.gone(follower.note, terminal.columns, absent=follower.absent))
                else:
                    state, events = dates.dated(state, follower.events, at)
                    size = terminal.columns, terminal.rows
                    terminal.draw(live.lines(state, now_s, at.unix_s, *size, events))
    return 128 + terminal.ended


def spark(values: Iterable[float | None], top: float, columns: int) -> str:
    """Draw the last `columns` values as bars, the newest at the right. A value of `top` or more is a full bar. None is
    a gap."""
    bars = (" " if value is None else BARS[round(min(1.0, value / top) * (len(BARS) - 1))] for value in values)
    return "".join(bars)[-columns:].rjust(columns)


class Live:
    """Draws the live screen of `failstop status -w`. It remembers earlier values for the sparklines."""

    def __init__(self, name: str) -> None:
        self._name = name
        self._history: dict[str, deque[float | None]] = {}
        self._vibration = Vibration()
        self._slow: list[Line] = []
        self._key: object = None

    def lines(
        self, state: State, mono_s: float, unix_s: float, columns: int, rows: int, events: Sequence[Event] = ()
    ) -> list[Line]:
        """Return the lines of the screen for a state. Call this at a steady rate, because each call adds one step to
        the sparklines. `mono_s`: time.monotonic(). `unix_s`: the Unix time. `rows`: the height of the terminal; the
        last events fill the rows that are left. `events`: the events of this run, the oldest first."""
        wheels = summary.wrapped([summary.headline(state)], columns)
        fact = state.turning.does, state.turning.unexpected
        said = (state.blocked, state.epoch, state.waiting_for, state.device, state.moving, fact)
        if (key := (int(mono_s / SLOW_S), columns, said)) != self._key:
            self._key = key
            self._slow = summary.lines(state, unix_s, columns, events)[len(wheels) :]
        title = self._title(words.clock(unix_s, unix_s), columns)
        body = [title, *wheels, [], *self._bars(state, mono_s, columns), [], *self._slow]
        return [*body, *_news(events, unix_s, rows - len(body))]

    def _title(self, clock: str, columns: int) -> Line:
        left, right = f"failstop status{words.of(self._name)}", f"{clock}   q quits"
        return [(left, STRONG), (" " * max(1, columns - len(left) - len(right)), PLAIN), (right, DIM)]

    def _bars(self, state: State, mono_s: float, columns: int) -> list[Line]:
        vx, vy, wz = state.body_vel
        speed, turn, shake = hypot(vx, vy), abs(wz), self._vibration.update(state.imu, mono_s)
        shakes = shake is not None and shake > STILL_RADPS
        unknown = "not known" if state.device.imu else "no IMU"
        text = unknown if shake is None else f"{shake:.4f} rad/s"
        moves, shaken = OK if state.moving else PLAIN, WARN if shakes and not state.moving else PLAIN
        return [
            self._bar("speed", speed, f"{speed:.2f} m/s", TOP_MPS, moves, columns),
            self._bar("turn", turn, f"{turn:.2f} rad/s", TOP_RADPS, moves, columns),
            self._bar("vibration", shake, text, 3 * STILL_RADPS, shaken, columns),
        ]

    def _bar(self, name: str, value: float | None, text: str, top: float, role: str, columns: int) -> Line:
        values = self._history.setdefault(name, deque(maxlen=REMEMBERED))
        values.append(value)
        top = max(top, *(known or 0.0 for known in values))
        return [*summary.row(name, f"{text:<{NAMES - summary.LABEL}}"), (spark(values, top, columns - NAMES), role)]

    def gone(self, note: str, columns: int, *, absent: bool = True) -> list[Line]:
        """Return the lines of the screen while the state can't be read. `note`: the reason. `absent`: True if no
        service is running."""
        told = host.journal(self._name) or words.named("`failstop why`", self._name)
        rows: list[Line] = [
            self._title("", columns),
            [],
            [(f"{verdict.NO_SERVICE if absent else verdict.UNREADABLE}  ", FAIL), (note, STRONG)],
            [("waiting for it to come back" if absent else "the service may be running; trying again", PLAIN)],
            [],
            [("if the wheels turn:  ", PLAIN), (host.stop(self._name), STRONG), (", or the POWER SWITCH", PLAIN)],
        ]
        if absent:
            rows.append([("what happened:       ", PLAIN), (told, STRONG)])
            rows.append([("to start it:         ", PLAIN), (host.start(self._name), STRONG)])
        return summary.wrapped(rows, columns, 0)


def _news(events: Sequence[Event], unix_s: float, room: int) -> list[Line]:
    """Return the last events, one in each row, as many as fit into `room` rows. The advice at the end of an event's
    text is left out, because the screen shows it higher up."""
    count = max(0, min(room - 2, len(events)))
    shown = [dataclasses.replace(it, text=it.what) for it in events[len(events) - count :]]
    return [[], [("last events", DIM)], *(summary.event(it, unix_s) for it in shown)] if shown else []
