"""The check of the stop path: a burst, and the board's answer to a ping behind it.

Without a service the port is opened here, and written to as supervisor, stopper and stop tool each do it. With one,
nobody else may write, and its own last stop says whether the board has answered. What only a death brings about is the
matter of `failstop prove`.
"""

from __future__ import annotations

import contextlib
import os
from collections.abc import Callable

from failstop import stopping
from failstop.api.snapshot import State
from failstop.board.interface import Board
from failstop.board.kinds import board_of
from failstop.board.port import PortError, release_exclusive
from failstop.board.stop_port import StopPort
from failstop.board.tap import Tap
from failstop.discovery import BOARD_USB
from failstop.doctor.look import OK, Finding, Look, fail, ok, skip, warn
from failstop.files.instance import option
from failstop.policy.proofs import LINK_UNASKED
from failstop.supervisor.port_handover import OwnPort

ANSWER_S = 0.5
UNANSWERED = "written; this board acknowledges nothing"


def stop_path(look: Look) -> list[Finding]:
    """The self-test where it is safe, else why it was left out."""
    if look.state:
        return of_service(look.name, look.state)
    node, (holders, _) = look.node, look.holders
    if look.service[-1]:
        why = "the running service can't be asked"
    elif node is None:
        why = "there is no port"
    elif not node.accessible:
        why = "this user may not open the port"
    elif holders:
        why = f"{holders[0]} has the port open"
    elif not (look.device_path or node.pseudo or look.usb_id == BOARD_USB):
        text = f"not tested: {node.path} may not be the board, and it is not written to"
        return skip(text, f"failstop doctor --device {node.path}")
    else:
        return by_hand(look.device[0], board_of(*look.settings[1].board()), f"failstop {look.again()}")
    return skip(f"not tested: {why}", "", "see to that first")


def of_service(name: str, state: State) -> list[Finding]:
    """The outcome of the running service's last stop."""
    stop = state.last_stop
    if stop and stop.acknowledged_s is not None:
        return ok(f"the service's last stop: acknowledged by the board after {stop.acknowledged_s * 1e3:.1f} ms")
    if stop and stop.written_s is not None and state.device.link == LINK_UNASKED:
        return ok(f"the service's last stop: {UNANSWERED}")
    text = "the service's last stop: not acknowledged by the board" if stop else "the service has stopped nothing yet"
    advice = f"it latches a stop; then doctor once more, and `failstop reset{option(name)}`"
    return (warn if stop else skip)(text, f"failstop stop{option(name)}", advice)


def by_hand(path: str, board: Board, again: str) -> list[Finding]:
    """Each writer's way to the board, ended by one that is not answered. Nobody else may have the port open. `again`:
    the command that tests once more."""
    found: list[Finding] = []
    try:
        with contextlib.closing(OwnPort.open_and_stop(path, board)) as own:
            if not own.stopped:
                raise PortError("io", f"{path} takes no bytes")
            tap = Tap(own.fd, board)
            for writer, write in WRITERS.items():
                write(own, path)
                found += judged(writer, board, tap.answered_ms(ANSWER_S), again)
                if found[-1].level != OK:
                    break
            return found
    except (OSError, PortError) as error:
        advice = "once that is seen to; wheels that turn: the POWER SWITCH"
        return [*found, *fail(f"no stop was written: {error}", again, advice)]


def _on_duplicate(own: OwnPort, _: str) -> None:
    with contextlib.closing(StopPort(os.dup(own.fd), own.board)) as duplicate:
        duplicate.burst()


def _with_tool(own: OwnPort, path: str) -> None:
    # It opens the port as ExecStopPost does, when the service has let it go.
    release_exclusive(own.fd)
    stopping.write(path, own.board)


WRITERS: dict[str, Callable[[OwnPort, str], None]] = {
    "supervisor's opening": lambda own, path: None,
    "stopper's duplicate": _on_duplicate,
    "stop tool": _with_tool,
}
"""The writers of a stop, and how; by the time of the first it is written."""


def judged(writer: str, board: Board, answered_ms: float | None, again: str) -> list[Finding]:
    """One writer's burst, by the board's answer to a ping behind it."""
    if not board.pings:
        return ok(f"{writer}: {UNANSWERED}")
    if answered_ms is None:
        text = f"{writer}: the burst was written, and the board did not answer the ping behind it"
        return fail(text, again, "is it the board? if so, cut its power and try again")
    return ok(f"{writer}: acknowledged by the board after {answered_ms:.1f} ms")
