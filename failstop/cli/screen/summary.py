"""Summary: makes the lines of `failstop status`, and the line that shows an event."""

from __future__ import annotations

import re
from collections.abc import Sequence

from failstop.api import steps, verdict, words
from failstop.api import wheels as seen
from failstop.api.events import Event
from failstop.api.snapshot import ArmState, Block, State
from failstop.api.why import FORGOTTEN, UNTIMED, WAITS, explain, proofs
from failstop.cli import style
from failstop.cli.style import DIM, FAIL, OK, PLAIN, STRONG, WARN, Line
from failstop.policy import servos
from failstop.policy.proofs import WATCHDOGS
from failstop.supervisor.kinds import EVENT_KINDS
from failstop.supervisor.status import cost

LABEL = 10
"""The width of the names at the left, in columns."""
LINKS = {"alive": OK, "unproven": WARN, "deaf": FAIL, "silent": FAIL, "unheard": FAIL}
WORDS = {
    **dict.fromkeys((verdict.MAY_TURN, verdict.TURNING, verdict.MOVED), FAIL),
    **dict.fromkeys((verdict.STOPPING, verdict.TOLD_TO_STOP), WARN),
    verdict.DRIVING: OK,
    verdict.STANDING: OK,
}
PORTS = {"open": PLAIN, "closed": WARN, "lost": FAIL}
PROOFS = {True: OK, None: PLAIN, False: WARN}
STATE_STYLES = {"running": PLAIN, "starting": WARN, "waiting": WARN}
LEVEL_STYLES = {"critical": FAIL, "error": FAIL, "warning": WARN, "notice": PLAIN, "info": DIM}
KIND_COLUMNS = max(len(kind.name) for kind in EVENT_KINDS)


def lines(state: State, now_s: float, columns: int, events: Sequence[Event] = ()) -> list[Line]:
    """Return the lines of the screen. `now_s`: the Unix time, from which ages are computed. `columns`: the width of the
    terminal. `events`: the events of this run, the oldest first."""
    also = explain(state, events, now_s).also
    rows = wheels(state)
    rows += _drivers(state)
    if state.steering_rad is not None:
        rows.append(row("steering", words.steering(state.steering_rad)))
    rows += last_stop(state, now_s, verdict.unlatched(state, events), known=verdict.remembered(state, events))
    if state.speed_limit < 1:
        rows.append(row("limit", f"speed limited to {100 * state.speed_limit:.0f} % of the settings'", WARN))
    if state.arm:
        rows.append(row("arm", arm_headline(state.arm)))
    rows += [device(state), battery(state), _sensors(state)]
    if state.servos:
        age = words.aged(state.ages.servos_s, current=state.is_current(0.0))
        rows.append([*row("servos", servos.summary(state.servos)), (age, WARN)])
    if state.clients:
        rows.append(row("clients", ", ".join(f"{client.name} (pid {client.pid})" for client in state.clients)))
    rows += [
        row("says", f"{who}: {sees}") for who, sees, wrong in words.said(state) if wrong or state.block not in WAITS
    ]
    below = wrapped([*([(text, WARN)] for text in also), *_remarks(state, events)], columns, 0)
    return [*wrapped(rows, columns), [], *processes(state), *([[], *below] if below else [])]


def row(label: str, text: str, role: str = PLAIN) -> Line:
    """Return a row of the screen: the name at the left, and the text."""
    return [(f"{label:<{LABEL}}", DIM), (text, role)]


def wrapped(rows: list[Line], columns: int, label: int = LABEL) -> list[Line]:
    """Wrap rows to the width of the terminal. The names are in the first `label` columns."""
    return [part for row in rows for part in style.wrap(row, columns, label)]


def headline(state: State) -> Line:
    """Return one line about what the wheels do, and why."""
    word = verdict.word(state)
    role = FAIL if state.cause else WORDS.get(word, WARN)
    if verdict.unproven(state) and role == OK:
        role = WARN
    return [*row("wheels", verdict.proven_word(state), role), ("  ", PLAIN), (verdict.headline(state), STRONG)]


def wheels(state: State) -> list[Line]:
    """Return the lines about the wheels: the headline, the last observation of the wheels, and the next command to
    type."""
    rows = [headline(state), observed(state)]
    if step := steps.line(state):
        rows.append(row("next", "") + commands(step))
    return rows


def observed(state: State) -> Line:
    """Return the row with the last observation of the wheels, and its age."""
    role = FAIL if verdict.doubt(state) else WARN if verdict.unseen(state) else PLAIN
    text = "; ".join(filter(None, (seen.now(state), verdict.unreached(state))))
    return row("seen", text, role)


def commands(text: str) -> Line:
    """Convert a text to a line in which the commands in backquotes are highlighted."""
    return [(part, STRONG if number % 2 else PLAIN) for number, part in enumerate(re.split("(`[^`]*`)", text))]


def _drivers(state: State) -> list[Line]:
    rows = []
    for source in state.sources:
        drives = source.state == "drives"
        text = f"{source}, priority {source.priority}" if source.priority or len(state.sources) > 1 else f"{source}"
        rows.append(row("driver" if drives else source.state, text, OK if drives and state.moving else PLAIN))
    if not rows:
        rows.append(row("driver", "nobody commands"))
    return rows


def last_stop(state: State, now_s: float, unlatched: Event | None = None, *, known: bool = True) -> list[Line]:
    """Return the rows about the last stop. A latched stop is shown with its three proofs. `unlatched` is the event of a
    later stop that was not latched (verdict.unlatched). The latched stop is then shown only as an earlier stop, without
    its proofs. `known`: False if there may have been such a stop that is not remembered (verdict.remembered)."""
    stop = state.last_stop
    if unlatched:
        told = [*row("last stop", unlatched.what, WARN), (f" ({words.ago(unlatched.t, now_s)})", DIM)]
        rows = [told, row("", UNTIMED)]
        if stop:
            rows.append([*row("earlier", f"a latched stop: {stop.reason}"), (f" ({words.ago(stop.t, now_s)})", DIM)])
        return rows
    if stop is None:
        return [row("last stop", "none since the service was started")]
    if not known:
        return [
            [*row("last stop", f"latched: {stop.reason}"), (f" ({words.ago(stop.t, now_s)})", DIM)],
            row("", FORGOTTEN),
        ]
    what = "the one that is latched" if stop.cause == state.cause else stop.reason
    line = row("", "")
    for number, (text, proven) in enumerate(proofs(stop, now_s, state.device.link)):
        unwritten = number == 0 and not proven
        line += [(", " if number else "", PLAIN), (text, FAIL if unwritten else PROOFS[proven])]
    return [[*row("last stop", what), (f" ({words.ago(stop.t, now_s)})", DIM)], line]


def device(state: State) -> Line:
    """Return the row about the port. It also says whether the board is known to receive commands."""
    port, link = state.device.state, state.device.link
    found = [*row("device", state.device.path), (f" {port}", PORTS.get(port, WARN))]
    told = link if link == "alive" else f"{link}: {verdict.LINKS[link]}"
    does, after_s = WATCHDOGS.get(state.device.watchdog_does), state.device.watchdog_s
    own = f"; without a host {does} after {after_s:.1f} s" if does else ""
    return [*found, (", link ", PLAIN), (told, LINKS.get(link, PLAIN)), (own, PLAIN)] if port == "open" else found


def battery(state: State) -> Line:
    """Return the row about the battery: its voltage, and whether a charger is plugged in."""
    if not state.battery_v:
        return row("battery", "not reported by the board")
    found = row("battery", f"{state.battery_v:.2f} V", WARN if state.battery_v < verdict.BATTERY_LOW_V else PLAIN)
    charger = f", charger {state.plugged}" if state.plugged != "unknown" else ""
    return [*found, (charger, PLAIN), (words.aged(state.ages.battery_s, current=state.is_current(0.0)), WARN)]


def _sensors(state: State) -> Line:
    age_s = state.scan_age_s
    scan = "obstacle sensor " + ("never heard" if age_s is None else f"heard {words.span(age_s)} ago")
    pad = f", gamepad {state.pad_mode}" if state.pad_mode else ""
    imu = "" if state.device.imu else ", no IMU"
    return row("sensor", scan + pad + imu, WARN if state.block is Block.NO_SCAN else PLAIN)


def processes(state: State) -> list[Line]:
    """Return the rows of the process table."""
    heads = ("process", " pid", "state", " beat", " worst", " restarts", "rights")
    rows: list[Line] = [[(head, DIM) for head in heads]]
    for name, process in state.processes.items():
        beat = f" {process.age_s * 1e3:.0f} ms" if process.pid and process.age_s < 10 else " -"
        late = process.state == "running" and process.age_s > verdict.LATE_BEAT_S
        row: Line = [(name, PLAIN), (f" {process.pid or '-'}", PLAIN)]
        row += [(process.state, STATE_STYLES.get(process.state, FAIL)), (beat, WARN if late else PLAIN)]
        row.append((f" {process.worst_s * 1e3:.0f} ms" if process.pid else " -", PLAIN))
        granted = ["realtime"] * process.realtime + ["locked"] * process.memory_locked
        rights = " ".join(granted) or "none" if process.pid else "-"
        row.append((f" {process.restarts}", WARN if process.restarts else PLAIN))
        row.append((rights, PLAIN if len(granted) == 2 or not process.pid else WARN))
        rows.append(row)
    return style.table(rows)


def _remarks(state: State, events: Sequence[Event]) -> list[Line]:
    """Return rows with remarks about the processes, in words."""
    found: list[Line] = []
    ends = verdict.ends(state, events)
    for name, process in state.processes.items():
        if process.state == "running" and process.last_exit:
            times = "once" if process.restarts == 1 else f"{process.restarts} times"
            found.append([(f"{name} was restarted {times}; it {ends[name]}", WARN)])
    running = [process for process in state.processes.values() if process.pid]
    if not state.starved and not all(process.realtime for process in running):
        text = f"without real-time rights stops come later on a busy machine, and {cost(state.lease_s)}"
        found.append([(f"{text}; `failstop doctor` says more", DIM)])
    return found


def event(told: Event, now_s: float) -> Line:
    """Return an event as one line for people, with its time, kind and text."""
    role = LEVEL_STYLES.get(told.level, PLAIN)
    when = f"{words.clock(told.t, now_s)}.{int(told.t % 1 * 1000):03d}  "
    return [(when, DIM), (f"{told.kind:<{KIND_COLUMNS}}  ", role), (told.text, role)]


def arm_headline(arm: ArmState) -> str:
    """Describe what the arm does."""
    if arm.mode:
        return f"{arm.mode} for {arm.by}{f', {arm.phase}' if arm.phase else ''}"
    if arm.released:
        return "released: its torque is off"
    pose = f", in the {arm.pose} pose" if arm.pose else ""
    tucks = f", tucks itself in {arm.auto_tuck_s} s" if arm.auto_tuck_s is not None else ""
    return f"{_holding(arm)}{pose}{tucks}"


def _holding(arm: ArmState) -> str:
    """Describe whether the arm's torque is on, according to its joints' reports."""
    torques = {joint.torque for joint in arm.joints.values()}
    loose = [name for name, joint in arm.joints.items() if joint.torque is False]
    if True in torques:
        return f"holding, except for {', '.join(loose)}" if loose else "holding"
    return "its torque is off" if loose else "not moving; its torque has not been read yet"
