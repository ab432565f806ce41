"""Diagnostics: turns the state into diagnostic_msgs/DiagnosticStatus messages, as plain dictionaries. Pure."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from typing import Any

from failstop.api import steps, verdict
from failstop.api import wheels as seen
from failstop.api import words as api_words
from failstop.api.state import Process, State
from failstop.ros2 import report, words

OK = 0
WARN = 1
ERROR = 2
STALE = 3

StatusMessage = dict[str, Any]
LINKS = {
    "unproven": (WARN, f"unproven: {verdict.NEVER_ANSWERED}, so nobody knows whether it hears"),
    "deaf": (ERROR, "deaf: the board does not hear, so a stop may not reach the wheels: use the POWER SWITCH"),
    "silent": (
        ERROR,
        "silent: the board says nothing any more, so nobody knows whether it hears: use the POWER SWITCH",
    ),
    "unheard": (
        ERROR,
        "unheard: nothing answers since the port came back, so it may not be the board: use the POWER SWITCH",
    ),
}


def statuses(
    node: str, state: State | None, problem: str, sees: Sequence[str], wrong: Sequence[str], lacks: Sequence[str] = ()
) -> list[StatusMessage]:
    """All statuses. `problem`: why there is no state. `sees`, `wrong` and `lacks`: what the bridge itself reports."""
    if state is None:
        rows = [_status("stop layer", ERROR, problem)]
    else:
        rows = [_stop_layer(state), _wheels(state), *_processes(state), _port(state), _link(state), _battery(state)]
        rows += [*_servos(state), *_arm(state), _speeds(state), _rights(state)]
    rows.append(_status("ROS", WARN if wrong else OK, "; ".join(wrong or sees)))
    rows += [_status("not offered", OK, line) for line in lacks]
    return [{**row, "name": f"{node}: {row['name']}", "hardware_id": state.name if state else ""} for row in rows]


def _status(name: str, level: int, message: str, **values: object) -> StatusMessage:
    pairs = [{"key": key, "value": str(value)} for key, value in values.items()]
    return {"name": name, "level": level, "message": message, "values": pairs}


def _stop_layer(state: State) -> StatusMessage:
    """Why the wheels may not turn, and the next command to type."""
    level = ERROR if state.estop or verdict.doubt(state) or verdict.down(state) else OK
    if level == OK and verdict.unproven(state):
        level = WARN
    if state.age_s > verdict.STALE_S:
        level = STALE
    step = steps.line(state)
    blocked = report.blocked(state)
    what = verdict.doubt(state) or (f"blocked: {blocked}" if blocked else verdict.headline(state))
    message = f"{verdict.proven_word(state)}: {what}" + (f"; next: {step}" if step else "")
    return _status(
        "stop layer",
        level,
        message,
        enabled=state.enabled,
        estop=words.plain(state.cause),
        blocked=report.blocked(state) or "",
        waiting_for=state.waiting_for or "",
    )


def _wheels(state: State) -> StatusMessage:
    """What is observed of the wheels. Measured numbers are only in the values, because each change of the message
    counts as news."""
    doubt, unseen, known = verdict.doubt(state), verdict.unseen(state), state.turning
    level = ERROR if doubt else WARN if unseen and verdict.word(state) != verdict.TOLD_TO_STOP else OK
    message = f"{verdict.word(state)}: {doubt or unseen or seen.SEEN[seen.seen(state)]}"
    values = {"does": known.does, "by": known.by, "unexpected": known.unexpected, "speeds": seen.speeds(state)}
    age_ms = "" if known.age_s is None else round(known.age_s * 1e3, 1)
    return _status("wheels", level, message, **values, age_ms=age_ms)


def _processes(state: State) -> Iterator[StatusMessage]:
    for name, process in state.processes.items():
        yield _status(
            f"process {name}",
            _level(process),
            process.state,
            pid=process.pid,
            age_ms=round(process.age_s * 1e3, 1),
            worst_ms=round(process.worst_s * 1e3, 1),
            restarts=process.restarts,
            last_exit=process.last_exit or "",
        )


def _level(process: Process) -> int:
    if process.state == "running":
        return WARN if process.age_s > verdict.LATE_BEAT_S else OK
    return WARN if process.state in ("starting", "waiting") else ERROR


def _port(state: State) -> StatusMessage:
    found = state.device.state
    return _status("port", OK if found == "open" else ERROR, found, path=state.device.path)


def _link(state: State) -> StatusMessage:
    link = state.device.link
    if state.device.state != "open":
        return _status("link", ERROR, f"{verdict.unreached(state)}: use the POWER SWITCH if the wheels turn")
    return _status("link", *LINKS.get(link, (OK, f"{link}: {verdict.LINKS[link]}")))


def _battery(state: State) -> StatusMessage:
    if not state.battery_v:
        return _status("battery", OK, "not reported by the board")
    age_s = state.ages.battery_s
    if not state.is_current(age_s):
        age = api_words.aged(age_s, current=False)
        return _status("battery", STALE, f"{state.battery_v:.2f} V{age}", charger=state.plugged)
    level = WARN if state.battery_v < verdict.BATTERY_LOW_V else OK
    return _status("battery", level, f"{state.battery_v:.2f} V", charger=state.plugged)


def _servos(state: State) -> Iterator[StatusMessage]:
    level = OK if state.is_current(state.ages.servos_s) else STALE
    for name, (load, temperature_c) in state.servos.items():
        wrong = state.servos_wrong.get(name, "")
        text = f"{temperature_c} degrees C{f': {wrong}' if wrong else ''}"
        yield _status(name, max(level, WARN if wrong else OK), text, temperature_c=temperature_c, load=load)
    for name in state.servos_wrong.keys() - state.servos.keys():
        yield _status(name, ERROR, state.servos_wrong[name])


def _arm(state: State) -> Iterator[StatusMessage]:
    """The arm, if there is one: joints whose servo is silent, hot, or about to let go."""
    if state.arm:
        yield _status("arm", WARN if state.arm.wrong else OK, "; ".join(state.arm.wrong) or "no fault is known")


def _speeds(state: State) -> StatusMessage:
    """Whether the wheels turn much faster or slower than they are commanded to. The row is always there, because tools
    keep the last level of a row that disappears."""
    wrong = state.scale.wrong
    return _status("speeds", WARN if wrong else OK, "; ".join(wrong) or "no difference is known")


def _rights(state: State) -> StatusMessage:
    without = [name for name, process in state.processes.items() if process.pid and not process.realtime]
    if without:
        return _status("real-time rights", WARN, f"missing for {', '.join(without)}, so stops come later under load")
    return _status("real-time rights", OK, "granted")


def changed(before: Sequence[StatusMessage], now: Sequence[StatusMessage]) -> bool:
    """True if a name, level or message has changed. Values don't count."""
    return [(row["name"], row["level"], row["message"]) for row in before] != [
        (row["name"], row["level"], row["message"]) for row in now
    ]
