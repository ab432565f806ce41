"""The check of the stop path: a burst by each way there is, and the board's answer to a ping behind it.

Without a service the port is opened here, as supervisor, stopper and stop tool each do it. With one, nobody else may
write: a stop request goes the service's own way, latches, and is reset. What only a death brings about is the matter
of `failstop prove`.
"""

from __future__ import annotations

import os
import select
import time
from collections.abc import Callable

from failstop import stopping
from failstop.api.errors import FailstopError
from failstop.api.robot import Robot
from failstop.board.decoder import Decoder
from failstop.board.interface import BOARD
from failstop.board.port import PortError, release_exclusive
from failstop.board.stop_port import StopPort
from failstop.doctor.look import FAIL, Finding, Look, fail, ok, skip, warn
from failstop.doctor.port import BOARD_USB
from failstop.supervisor.port import OwnPort

ANSWER_S = 0.5
SERVICE_ANSWER_S = 2.0
REASON = "doctor: stop test"
POLL_S = 0.002
SLOW_ANSWER_MS = 100.0
"""The burst takes 4 ms on the wire, ping and answer 0.2; a service leaves 50 ms between two pings."""
CHUNK = 4096
OPENING = "supervisor's opening"
REQUEST = "port owner, by a stop request"


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
    if look.stops is not None:
        return look.stops
    if obstacle := _of_service(look) if look.service else _of_port(look):
        why, fix = obstacle
        return (warn if look.stop_wanted else skip)(f"not tested: {why}", fix, "" if fix else "see to that first")
    if not look.service:
        return by_hand(look.device[0], look.again())
    try:
        return by_service(look.name, look.again())
    except FailstopError as error:
        return _broken(REQUEST, error, look.again())


def _of_port(look: Look) -> tuple[str, str] | None:
    """Why nothing is written to the port, and the command that changes it."""
    node, (holders, _) = look.node, look.holders
    if node is None:
        return "there is no port", ""
    if not node.accessible:
        return "this user may not open the port", ""
    if holders:
        return f"{holders[0]} has the port open", ""
    if not (look.device_path or node.pseudo or node.usb_id == BOARD_USB):
        return f"{node.path} may not be the board, and it is not written to", f"failstop doctor --device {node.path}"
    return None


def _of_service(look: Look) -> tuple[str, str] | None:
    """Why the running service is not told to stop, and the command that changes it."""
    test = f"failstop doctor --stop-test --name {look.name}"
    if not (state := look.state):
        return "the running service can't be asked", ""
    if state.enabled:
        return "motion is enabled", f"failstop disable --name {look.name}"
    if state.cause:
        return f"a stop is latched already ({state.cause})", f"failstop reset --name {look.name}"
    if not look.stop_wanted:
        return "the service runs, and would be stopped once and reset", test
    try:
        # It takes the right to clear the latch that the test leaves. Motion is disabled already: this changes nothing.
        with Robot(look.name, client="doctor") as robot:
            robot.disable()
    except FailstopError as error:
        return str(error), f"sudo {test}"
    return None


def _broken(writer: str, problem: object, again: str) -> list[Finding]:
    return fail(f"{writer}: {problem}", again, "once that is seen to; wheels that turn: the POWER SWITCH")


def judged(writer: str, written: bool, answered_ms: float | None, again: str) -> list[Finding]:
    """One writer's burst. `answered_ms`: from before the burst to the board's answer to a ping behind it; None: there
    was none. `again`: the command that tests once more."""
    if not written:
        return fail(f"{writer}: the burst could not be written", "", "unplug the board and plug it in again")
    if answered_ms is None:
        text = f"{writer}: the burst was written, and the board did not answer the ping behind it"
        return fail(text, again, "is it the board? if so, cut its power and try again")
    text = f"{writer}: acknowledged by the board after {answered_ms:.1f} ms"
    if answered_ms > SLOW_ANSWER_MS:
        return warn(f"{text}, which is late", again, "once more on a quiet machine")
    return ok(text)


def by_hand(path: str, again: str) -> list[Finding]:
    """Every writer's way, ended by the first that is not answered. Nobody else may have the port open."""
    begun_ns = time.monotonic_ns()
    try:
        own = OwnPort.open_and_stop(path)
    except PortError as error:
        return _broken(OPENING, error, again)
    tap = Tap(own.fd)
    ways: dict[str, Callable[[], bool]] = {
        OPENING: lambda: True,
        "stopper's duplicate": lambda: on_duplicate(own),
        "stop tool": lambda: _with_tool(own, path),
    }
    found: list[Finding] = []
    try:
        for writer, write in ways.items():
            written = write()
            answer_ns = tap.answer_ns(tap.ping()[0], ANSWER_S)
            found += judged(writer, written, None if answer_ns is None else (answer_ns - begun_ns) / 1e6, again)
            if found[-1].level == FAIL:
                break
            begun_ns = time.monotonic_ns()
    except (OSError, PortError) as error:
        found += _broken(writer, error, again)
    finally:
        own.close()
    return found


def on_duplicate(own: OwnPort) -> bool:
    """The burst as the stopper writes it; False: it could not be written."""
    duplicate = StopPort(os.dup(own.fd))
    try:
        return duplicate.burst()
    finally:
        duplicate.close()


def _with_tool(own: OwnPort, path: str) -> bool:
    # It opens the port as ExecStopPost does, when the service has let it go.
    release_exclusive(own.fd)
    stopping.stop(path, lambda _: 0.0, lambda _: None)
    return True


def by_service(name: str, again: str) -> list[Finding]:
    """A stop request to the running service, its acknowledgement, and the reset. Raises FailstopError; the caller has
    seen to it that motion is disabled, nothing latched, and the reset allowed."""
    with Robot(name, client="doctor") as robot:
        robot.estop(REASON)
        until_s = time.monotonic() + SERVICE_ANSWER_S
        written = False
        answered_ms = None
        while answered_ms is None and time.monotonic() < until_s:
            time.sleep(POLL_S)
            stop = robot.state.last_stop
            if stop and stop.cause.named().get("words") == REASON:
                written = stop.written_s is not None
                answered_ms = None if stop.acknowledged_s is None else stop.acknowledged_s * 1e3
        try:
            robot.reset()
        except FailstopError as error:
            return _broken(REQUEST, f"the stop of the test stays latched ({error}): failstop reset", again)
    return judged(REQUEST, written, answered_ms, again)
