"""Summary: the whole state in one screen, for `failstop status` and as the body of `failstop watch`. Pure."""

from __future__ import annotations

from failstop.api import verdict, words
from failstop.cli import style
from failstop.cli.screen import arm
from failstop.cli.style import DIM, FAIL, OK, PLAIN, STRONG, WARN
from failstop.shm import blocks
from failstop.supervisor.stops import NOT_SENT

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Sequence

    from failstop.api.events import Event
    from failstop.api.state import Process, State, Stop
    from failstop.api.verdict import Earlier
    from failstop.cli.style import Line

LABEL = 10
"""Columns of the names on the left."""
BATTERY_LOW_V = 10.5
"""Three lithium cells at 3.5 V: little is left."""
LATE_BEAT_S = 0.3
"""A beat older than this is worth a look; the slowest process beats every 100 ms."""
LINKS = {
    "alive": ("alive: the board answers", OK),
    "unproven": ("unproven: the board has not answered a ping yet, so nobody knows that it hears", WARN),
    "deaf": ("deaf: the board has stopped answering, so it may not hear a stop: use the POWER SWITCH", FAIL),
}
PORTS = {"open": PLAIN, "closed": WARN, "lost": FAIL}


def lines(state: State, now_s: float, columns: int, events: Sequence[Event] = ()) -> list[Line]:
    """The screen. `now_s`: Unix time, for ages; `columns`: the width to wrap at; `events`: of this run,
    oldest first."""
    rows = wheels(state)
    rows += _drivers(state, verdict.left_off(events), now_s)
    rows += last_stop(state, now_s, verdict.earlier(events))
    rows += [*_limit(state), *_arm(state), device(state), battery(state), *_sensors(state), *_clients(state)]
    wrapped = [part for row in rows for part in style.wrap(row, columns, LABEL)]
    return [*wrapped, [], *processes(state), *_remarks(state, columns, verdict.exits(events))]


def row(label: str, text: str, role: str = PLAIN) -> Line:
    """A name on the left and what it says."""
    return [(f"{label:<{LABEL}}", DIM), (text, role)]


def role_of(state: State) -> str:
    """The role of the verdict's word."""
    roles = {verdict.MAY_TURN: FAIL, verdict.DRIVING: OK, verdict.STANDING: OK}
    return roles.get(verdict.word(state)) or (FAIL if state.cause else WARN)


def wheels(state: State) -> list[Line]:
    """What the wheels do, why, and the next command."""
    word, role = verdict.word(state), role_of(state)
    rows: list[Line] = [[(f"{'wheels':<{LABEL}}", DIM), (word, role), ("  ", PLAIN), (verdict.headline(state), STRONG)]]
    if step := verdict.next_step(state):
        rows.append([(f"{'next':<{LABEL}}", DIM), *commands(step)])
    if state.waiting_for and not state.blocked:
        rows.append(row("waits for", state.waiting_for, WARN))
    return rows


def commands(text: str) -> Line:
    """A text whose commands in backquotes stand out."""
    found: Line = []
    parts = text.split("`")
    for number, part in enumerate(parts):
        if number % 2 and number == len(parts) - 1:
            found.append((f"`{part}", PLAIN))  # one alone, of a reason that somebody gave
        elif part:
            found.append((f"`{part}`", STRONG) if number % 2 else (part, PLAIN))
    return found


def _drivers(state: State, left_off: Event | None, now_s: float) -> list[Line]:
    if not state.sources:
        found = row("driver", "nobody commands")
        if left_off and state.blocked == blocks.NO_COMMAND:
            when = f" ({words.ago(left_off.t, now_s)})"
            found += [("; ", PLAIN), (verdict.leaving(left_off), WARN), (when, DIM)]
        return [found]
    rows = []
    for source in state.sources:
        drives = source.state == "drives"
        text = f"{source.who} as {source.source}, priority {source.priority}"
        rows.append(row("driver" if drives else "waits", text, OK if drives and state.moving else PLAIN))
    return rows


def last_stop(state: State, now_s: float, earlier: Earlier | None = None) -> list[Line]:
    """The last stop and its three proofs. `earlier`: the run before this one, if it was not ended in order."""
    stop = state.last_stop
    if stop is None:
        rows = [row("last stop", "none since the service was started")]
        if earlier:
            rows.append([*row("before it", earlier.how, WARN), (f" ({words.ago(earlier.t, now_s)})", DIM)])
            rows.append(row("", "") + commands(earlier.show(state.name)))
        return rows
    what = "the one that is latched" if stop.cause == state.cause else stop.reason
    head: Line = [(f"{'last stop':<{LABEL}}", DIM), (what, PLAIN), (f" ({words.ago(stop.t, now_s)})", DIM)]
    return [head, [(f"{'':<{LABEL}}", PLAIN), *proofs(stop)]]


def proofs(stop: Stop) -> Line:
    """The three levels of a stop, each with its time or that it is not known."""
    if stop.written_s is None:
        return [("NOT written: the board did not get it", FAIL)]
    found: Line = [(f"written after {words.took(stop.written_s)}", OK), (", ", PLAIN)]
    if not stop.sent:
        found = [(NOT_SENT, FAIL), (", ", PLAIN)]
    if stop.acknowledged_s is None:
        found.append(("not acknowledged", WARN))
    else:
        found.append((f"acknowledged after {words.took(stop.acknowledged_s)}", OK))
    found.append((", ", PLAIN))
    if stop.observed_s is None:
        found.append(("not seen still", WARN))
    else:
        # No shaking before the stop either: that the wheels rest now proves nothing of it.
        seen = words.wheels_seen(stop).replace("wheels still", "still").replace("less than", "<")
        found.append((seen, OK if stop.observed_s else PLAIN))
    return found


def device(state: State) -> Line:
    """The port, and what proves that the board hears."""
    port = state.device.state
    found = row("device", state.device.path or "no port")
    found.append((f" {port}", PORTS.get(port, WARN)))
    if port == "open":
        text, role = LINKS.get(state.device.link, (state.device.link, WARN))
        found += [(", link ", PLAIN), (text, role)]
    return found


def battery(state: State) -> Line:
    """Its voltage, and whether it is charged."""
    if not state.battery_v:
        return row("battery", "not known yet")
    found = row("battery", f"{state.battery_v:.2f} V", WARN if state.battery_v < BATTERY_LOW_V else PLAIN)
    return [*found, (f", charger {state.plugged}" if state.plugged != "unknown" else "", PLAIN)]


def _sensors(state: State) -> list[Line]:
    age_s = state.scan_age_s
    scan = "obstacle sensor " + ("never delivered" if age_s is None else f"delivered {words.span(age_s)} ago")
    pad = f", gamepad {state.pad_mode}" if state.pad_mode else ""
    return [row("sensor", scan + pad, WARN if state.blocked == blocks.NO_SCAN else PLAIN)]


def _limit(state: State) -> list[Line]:
    """The speed limit, where somebody has set one."""
    return [row("limit", words.limited(state.speed_limit), WARN)] if state.speed_limit < 1 else []


def _arm(state: State) -> list[Line]:
    """The arm, where there is one."""
    if state.arm is None:
        return []
    return [row("arm", arm.headline(state.arm)), *(row("", text, WARN) for text in arm.wrong(state.arm))]


def _clients(state: State) -> list[Line]:
    names = [f"{client.name} (pid {client.pid})" for client in state.clients]
    return [row("clients", ", ".join(names)), *_said(state)] if names else []


def _said(state: State) -> list[Line]:
    """What clients say of themselves, a row each."""
    rows = []
    for who, sees, wrong in words.said(state):
        rows.append(row("says", f"{who}: {sees}"))
        if wrong:
            rows.append(row("wrong", f"{who}: {wrong}", WARN))
    return rows


def processes(state: State) -> list[Line]:
    """The process table."""
    rows: list[Line] = [
        [(head, DIM) for head in ("process", " pid", "state", " beat", " worst", " restarts", "rights")]
    ]
    for name, process in state.processes.items():
        running = process.state == "running"
        late = running and process.age_s > LATE_BEAT_S
        rows.append(
            [
                (name, PLAIN),
                (f" {process.pid or '-'}", PLAIN),
                (process.state, PLAIN if running else WARN if process.state in ("starting", "waiting") else FAIL),
                (
                    f" {process.age_s * 1e3:.0f} ms" if process.pid and process.age_s < 10 else " -",
                    WARN if late else PLAIN,
                ),
                (f" {process.worst_s * 1e3:.0f} ms" if process.pid else " -", PLAIN),
                (f" {process.restarts}", WARN if process.restarts else PLAIN),
                (_rights(process), PLAIN if _well(process) else WARN),
            ]
        )
    return style.table(rows)


def _well(process: Process) -> bool:
    """Nothing to say of its rights."""
    return not process.pid or (process.realtime and process.memory_locked)


def _rights(process: Process) -> str:
    if not process.pid:
        return "-"
    granted = [word for word, has in (("realtime", process.realtime), ("locked", process.memory_locked)) if has]
    return " ".join(granted) or "none"


def _remarks(state: State, columns: int, hung: dict[str, str]) -> list[Line]:
    """What is wrong beside the wheels, a line each."""
    found: list[Line] = []
    for name, process in state.processes.items():
        if process.state == "down":
            how = verdict.last_exit(state, name, hung)
            found.append([(f"{name} died too often and is {verdict.until(name)}; it {how}", FAIL)])
        elif process.last_exit:
            how = verdict.last_exit(state, name, hung)
            found.append([(f"{name} was restarted {_times(process.restarts)}; it {how}", WARN)])
    if state.age_s > verdict.STALE_S:
        found.append([(f"the gate has said nothing for {words.span(state.age_s)}: what is above may be old", FAIL)])
    if starved := words.starved(state.starved):
        found.append([(f"{starved}; `failstop doctor` has the command that gives it real-time rights", WARN)])
    elif not all(process.realtime or not process.pid for process in state.processes.values()):
        found.append(
            [("without real-time rights stops come later on a busy machine; `failstop doctor` says more", DIM)]
        )
    if not all(process.early_news or not process.pid for process in state.processes.values()):
        found.append(
            [("this kernel tells of deaths late, and stops after one come later; `failstop doctor` says more", WARN)]
        )
    return [[], *(part for row in found for part in style.wrap(row, columns, 0))] if found else []


def _times(count: int) -> str:
    return "once" if count == 1 else f"{count} times"
