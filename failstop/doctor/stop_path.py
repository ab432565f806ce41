"""The checks of the board and the stop path: which board is connected to the port, and whether a stop reaches it.

Without a running service, these checks open the port only once, because opening resets some boards. The first bytes are
a stop, written as the supervisor does. Then the board is asked questions that move nothing. Unless the answers show
that the board is missing, two more stops are written as the stopper and the stop tool do. The stop tool opens the port
itself, while the checks still have the port open.

With a running service, nobody else may write to the port, so the checks show what the service knows. `failstop prove`
tests what happens when a process dies.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Callable, Mapping

from failstop import stop_tool
from failstop.api import verdict, words
from failstop.api.snapshot import State
from failstop.board import asking
from failstop.board.interface import BY_ECHO, Board
from failstop.board.kinds import board_of, is_own
from failstop.board.port import PortError, release_exclusive, set_speed
from failstop.board.stop_port import StopPort
from failstop.board.tap import Tap
from failstop.doctor.look import OK, Finding, Look, fail, ok, skip, warn
from failstop.files.instance import option
from failstop.instances import unit_of
from failstop.messages import layout
from failstop.policy.layouts import BOARDS
from failstop.policy.proofs import LINK_ALIVE, LINK_DEAF, LINK_SILENT, LINK_UNASKED, UNMOVED, unmoved
from failstop.supervisor.port_handover import OwnPort

ANSWER_S = 0.5
ASKING = (layout.SUPERVISOR, layout.PORT_OWNER, layout.TELEMETRY)
"""The processes that together ask the board and judge its answers."""
UNANSWERED = "written; this board never acknowledges a stop"


def board(look: Look) -> list[Finding]:
    """Check whether the board at the port is of the kind that the settings name."""
    if isinstance(look.board, asking.Unknown):
        path = look.settings[0]
        fix, advice = (f"failstop config --check {path}", "") if path else ("", "fix it before the next start")
        return (warn if look.state else fail)(look.board.why, fix, advice)
    if look.state:
        return _known_by_the_service(look, look.state)
    return _left_alone(look) or _tried(look)[0]


def stop_path(look: Look) -> list[Finding]:
    """Test whether a stop reaches the board, or say why this was not tested. With a running service, report its last
    stop instead."""
    if look.state:
        return of_service(look.name, look.state)
    return _left_alone(look) or _tried(look)[1]


def _left_alone(look: Look) -> list[Finding]:
    """Why the port must not be opened for a test. Empty if it may be opened."""
    node, (holders, _) = look.node, look.holders
    if look.service[-1]:
        why = "the running service can't be asked"
    elif look.settings[-1] or isinstance(look.board, asking.Unknown):
        why = "the settings that name the board can't be used"
    elif node is None:
        why = "there is no port"
    elif not node.accessible:
        why = "this user may not open the port"
    elif holders:
        why = f"{holders[0]} has the port open"
    elif not (look.device_path or node.pseudo or look.usb_id in look.board.usb):
        text = f"not tested: {node.path} may not be the board, so nothing is written to it"
        resets = (
            f"opening the port may reset the board, which then hears nothing for {ns / 1e9:g} s"
            if (ns := look.board.port.deaf_ns)
            else ""
        )
        return skip(text, f"failstop doctor --device {node.path}", resets)
    else:
        return []
    return skip(f"not tested: {why}", "", "fix that first")


def _known_by_the_service(look: Look, state: State) -> list[Finding]:
    """What the running service knows about the board."""
    age_s, now = state.ages.board_s, state.is_current(state.ages.battery_s)
    battery = f", and reports a battery of {state.battery_v:.1f} V" if state.battery_v and now else ""
    if state.device.state != "open" or state.device.link in (LINK_DEAF, LINK_SILENT):
        return fail(verdict.unreached(state), f"failstop why{option(look.name)}", asking.WIRES)
    if absent := [name for name in ASKING if state.processes[name].state != "running"]:
        text = f"not known: {absent[0]} is {state.processes[absent[0]].state}, so nobody watches the board's answers"
        return skip(text, "", "fix that first (see service)")
    if state.device.link == LINK_ALIVE:
        return ok(f"it answers the service's questions as {look.kind} does{battery}")
    if state.device.link == LINK_UNASKED:
        text = f"the service reads it as {look.kind}, which answers no questions{battery}"
        if age_s is None:
            reports = look.board.echo_ns or look.board.reports.every_ns
            return warn(f"{text}; it has reported nothing so far", "", asking.WIRES) if reports else ok(text)
        return ok(f"{text}; its last report was {words.span(age_s)} ago")
    text = f"it may not be {look.kind}, because it answers none of the service's questions{battery}"
    stop = f"sudo systemctl stop {unit_of(look.name)} && " if look.unit else ""
    advice = "when no service is running, doctor also asks for the other kinds of boards"
    return warn(text, f"{stop}failstop doctor{option(look.name)} --device {state.device.path}", advice)


def of_service(name: str, state: State) -> list[Finding]:
    """The outcome of the running service's last stop."""
    stop = state.last_stop
    if unreached := verdict.unreached(state):
        return fail(f"{unreached}, whatever its last stop proved", f"failstop why{option(name)}")
    if stop and stop.acknowledged_s is not None:
        return ok(f"the service's last stop: acknowledged by the board after {stop.acknowledged_s * 1e3:.1f} ms")
    if stop and stop.written_s is not None and state.device.link == LINK_UNASKED:
        if stop.acknowledged_by != BY_ECHO:
            return ok(f"the service's last stop: {UNANSWERED}")
        if unmoved(stop.observed_s, stop.observed_by):
            return ok(f"the service's last stop: written, {UNMOVED}")
    text = (
        "the board has not acknowledged the service's last stop"
        if stop
        else "this run of the service has had no stop yet"
    )
    advice = f"this latches a stop; then run doctor again, and `failstop reset{option(name)}`"
    return (warn if stop else skip)(text, f"failstop stop{option(name)}", advice)


def _tried(look: Look) -> tuple[list[Finding], list[Finding]]:
    """(findings about the board, findings about the stop path). Only the first call opens the port."""
    if look.tried is None:
        others = {kind: board_of(kind, 1.0, 0.0) for kind in BOARDS if kind != look.kind}
        look.tried = by_hand(look.device[0], {look.kind: look.board} | others, f"failstop {look.again()}")
    return look.tried


def by_hand(path: str, boards: Mapping[str, Board], again: str) -> tuple[list[Finding], list[Finding]]:
    """Test the board at this port without a service. No other process may have the port open.

    Returns (findings about the board, one finding for each way to write a stop). The second list ends with the first
    failure. The first of `boards` is the board that the settings name. `again`: the command that repeats the test.
    """
    kind, board = next(iter(boards.items()))
    told: list[Finding] = []
    found: list[Finding] = []
    try:
        with contextlib.closing(OwnPort.open_and_stop(path, board)) as own:
            opened_ns = time.monotonic_ns()
            if not own.stopped:
                raise PortError("io", f"{path} takes no bytes")
            heard = asking.seek(own.fd, boards, opened_ns, strangers=is_own(kind))
            known, text, remedy = asking.told_of(heard, kind, board)
            told = fail(text, again, remedy) if known is False else (ok if known else skip)(text, "", remedy)
            if known is False:
                return told, skip("not tested, because it may not be the board", "", "fix that first")
            set_speed(own.fd, board.port)
            tap = Tap(own.fd, board)
            for writer, write in WRITERS.items():
                write(own, path)
                found += judged(writer, board, asking.heard_ms(tap, board), again)
                if found[-1].level != OK:
                    break
            return told, found
    except (OSError, PortError) as error:
        advice = "try again once that is fixed; if a wheel turns, use the POWER SWITCH"
        return told, [*found, *fail(f"no stop was written: {error}", again, advice)]


def _on_duplicate(own: OwnPort, _: str) -> None:
    with contextlib.closing(StopPort(os.dup(own.fd), own.board)) as duplicate:
        duplicate.burst()


def _with_tool(own: OwnPort, path: str) -> None:
    # The tool opens the port itself, as in ExecStopPost after the service has closed it.
    release_exclusive(own.fd)
    stop_tool.write(path, own.board)


WRITERS: dict[str, Callable[[OwnPort, str], None]] = {
    "supervisor's opening": lambda own, path: None,
    "stopper's duplicate": _on_duplicate,
    "stop tool": _with_tool,
}
"""The ways to write a stop, each with its function. The first has no function of its own, because opening the port has
already written that stop."""


def judged(writer: str, board: Board, answered_ms: float | None, again: str) -> list[Finding]:
    """The finding about one way to write a stop. `answered_ms`: how long the board took to answer a ping after the
    stop, or to report that it obeys. None if it did neither."""
    if not (board.pings or board.echo_ns):
        return ok(f"{writer}: {UNANSWERED}")
    if answered_ms is None:
        proof = "answer the ping after it" if board.pings else "report that it obeys"
        text = f"{writer}: the stop was written, but the board did not {proof}"
        return fail(text, again, "is this the board? If so, turn its power off and on, and try again")
    if not board.pings:
        return ok(f"{writer}: written; the board reports zero speed, but it would also do that if it heard nothing")
    return ok(f"{writer}: acknowledged by the board after {answered_ms:.1f} ms")
