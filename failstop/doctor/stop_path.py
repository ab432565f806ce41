"""The check of the stop path: a burst by each way there is, and the board's answer to a ping behind it.

Without a service the port is opened here, as supervisor, stopper and stop tool each do it. With one, nobody else may
write, and its own last stop says whether the board has answered. What only a death brings about is the matter of
`failstop prove`.
"""

from __future__ import annotations

import contextlib
import os
import select
import time
from collections.abc import Callable

from failstop import stopping
from failstop.api.snapshot import State
from failstop.board.decoder import Decoder
from failstop.board.interface import BOARD
from failstop.board.port import PortError, release_exclusive
from failstop.board.stop_port import StopPort
from failstop.discovery import BOARD_USB
from failstop.doctor.look import FAIL, Finding, Look, fail, ok, skip, warn
from failstop.shm.instance import option
from failstop.supervisor.port import OwnPort

ANSWER_S = 0.5
CHUNK = 4096


class Tap:
    """A tap on an open port: what the board sends, decoded, with the time of its reading; and pings. It reads a
    descriptor that is not blocking, which stays the caller's."""

    def __init__(self, fd: int) -> None:
        self.fd = fd
        self._decoder = Decoder()
        self._pings = 0

    def read(self) -> list[tuple[int, int, bytes]]:
        """(time of reading, function, data) of the frames that have come. Raises OSError when the device has gone."""
        found: list[tuple[int, int, bytes]] = []
        while True:
            try:
                data = os.read(self.fd, CHUNK)
            except BlockingIOError:
                return found
            if not data:
                raise OSError("the device has gone")
            now_ns = time.monotonic_ns()
            found += [(now_ns, func, body) for func, body in self._decoder.feed(data)]

    def ping(self) -> tuple[int, int]:
        """Ask the board; returns (index of the ping, when it was written). Raises OSError."""
        index = self._pings % len(BOARD.pings)
        self._pings += 1
        now_ns = time.monotonic_ns()
        os.write(self.fd, BOARD.pings[index])
        return index, now_ns

    def answer_ns(self, index: int, timeout_s: float) -> int | None:
        """When the answer to that ping came; None: it did not. Raises OSError."""
        until_s = time.monotonic() + timeout_s
        while (left_s := until_s - time.monotonic()) > 0:
            select.select((self.fd,), (), (), left_s)
            for now_ns, func, data in self.read():
                if BOARD.pong(func, data) == index:
                    return now_ns
        return None


def stop_path(look: Look) -> list[Finding]:
    """The self-test where it is safe, else why it was left out."""
    if look.state:
        return of_service(look.name, look.state)
    node, (holders, _) = look.node, look.holders
    if look.problem:
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
        return by_hand(look.device[0], f"failstop {look.again()}")
    return skip(f"not tested: {why}", "", "see to that first")


def of_service(name: str, state: State) -> list[Finding]:
    """What became of the running service's last stop."""
    stop = state.last_stop
    if stop and stop.acknowledged_s is not None:
        return ok(f"the service's last stop: acknowledged by the board after {stop.acknowledged_s * 1e3:.1f} ms")
    advice = f"it latches a stop; then doctor once more, and `failstop reset{option(name)}`"
    if stop:
        return warn("the service's last stop: not acknowledged by the board", f"failstop stop{option(name)}", advice)
    return skip("the service has stopped nothing yet", f"failstop stop{option(name)}", advice)


def judged(writer: str, written: bool, answered_ms: float | None, again: str) -> list[Finding]:
    """One writer's burst. `answered_ms`: until the board's answer to a ping behind it; None: there was none. `again`:
    the command that tests once more."""
    if not written:
        return fail(f"{writer}: the burst could not be written", "", "unplug the board and plug it in again")
    if answered_ms is None:
        text = f"{writer}: the burst was written, and the board did not answer the ping behind it"
        return fail(text, again, "is it the board? if so, cut its power and try again")
    return ok(f"{writer}: acknowledged by the board after {answered_ms:.1f} ms")


def by_hand(path: str, again: str) -> list[Finding]:
    """Every writer's way, ended by the first that is not answered. Nobody else may have the port open."""
    found: list[Finding] = []
    writer = "supervisor's opening"
    try:
        with contextlib.closing(OwnPort.open_and_stop(path)) as own:
            tap = Tap(own.fd)
            ways: dict[str, Callable[[], bool]] = {
                writer: lambda: own.stopped,
                "stopper's duplicate": lambda: on_duplicate(own),
                "stop tool": lambda: _with_tool(own, path),
            }
            for writer, write in ways.items():
                begun_ns = time.monotonic_ns()
                written = write()
                answer_ns = tap.answer_ns(tap.ping()[0], ANSWER_S)
                found += judged(writer, written, None if answer_ns is None else (answer_ns - begun_ns) / 1e6, again)
                if found[-1].level == FAIL:
                    break
    except (OSError, PortError) as error:
        found += fail(f"{writer}: {error}", again, "once that is seen to; wheels that turn: the POWER SWITCH")
    return found


def on_duplicate(own: OwnPort) -> bool:
    """The burst as the stopper writes it; False: it could not be written."""
    with contextlib.closing(StopPort(os.dup(own.fd))) as duplicate:
        return duplicate.burst()


def _with_tool(own: OwnPort, path: str) -> bool:
    # It opens the port as ExecStopPost does, when the service has let it go.
    release_exclusive(own.fd)
    stopping.write(path)
    return True
