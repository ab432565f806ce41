"""The self-test of the stop path: a burst by each way there is, and the board's answer to a ping behind it.

Without a service the port is opened here, as supervisor, stopper and stop tool each do it. With one, nobody else may
write: a stop request goes the service's own way, latches, and is reset. What only a death brings about is the matter
of `failstop prove`.
"""

from __future__ import annotations

import functools
import os
import time
from collections.abc import Callable
from typing import NamedTuple

from failstop.api.errors import FailstopError
from failstop.api.robot import Robot
from failstop.board.port import PortError, release_exclusive
from failstop.board.stop_port import StopPort
from failstop.doctor.finding import Finding, fail, ok, skip, warn
from failstop.doctor.port import BOARD_USB
from failstop.doctor.tap import Tap
from failstop.stopping import tool
from failstop.supervisor.port import OwnPort

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.doctor.look import Look

ANSWER_S = 0.5
SERVICE_ANSWER_S = 2.0
REASON = "doctor: stop test"
POLL_S = 0.002
SLOW_ANSWER_MS = 100.0
"""The burst takes 4 ms on the wire, ping and answer 0.2; a service leaves 50 ms between two pings."""


class StopTest(NamedTuple):
    """One writer's burst, and the board's answer to a ping behind it."""

    writer: str
    written: bool
    answered_ms: float | None
    """From before the burst to the answer; None: there was none."""
    problem: str = ""


class StopPath(NamedTuple):
    """What was tested."""

    stops: tuple[StopTest, ...] = ()
    skipped: str = ""
    """Why the stop path was not tested."""
    fix: str = ""
    """The command by which it would be."""


def stop_path(look: Look) -> list[Finding]:
    """Each writer's burst, and the board's answer behind it."""
    found = []
    for writer, written, answered_ms, problem in look.stops.stops:
        if problem:
            advice = "once that is seen to; wheels that turn: the POWER SWITCH"
            found += fail(f"{writer}: {problem}", look.again(), advice)
        elif not written:
            found += fail(f"{writer}: the burst could not be written", "", "unplug the board and plug it in again")
        elif answered_ms is None:
            text = f"{writer}: the burst was written, and the board did not answer the ping behind it"
            found += fail(text, look.again(), "is it the board? if so, cut its power and try again")
        elif answered_ms > SLOW_ANSWER_MS:
            text = f"{writer}: acknowledged by the board after {answered_ms:.1f} ms, which is late"
            found += warn(text, look.again(), "once more on a quiet machine")
        else:
            found += ok(f"{writer}: acknowledged by the board after {answered_ms:.1f} ms")
    if look.stops.skipped:
        told = warn if look.stop_wanted else skip
        fix = look.stops.fix
        found += told(f"not tested: {look.stops.skipped}", fix, "" if fix else "see to that first")
    return found


def tried(look: Look) -> StopPath:
    """The self-test where it is safe, else why it was left out."""
    node, (holders, _) = look.node, look.holders
    if look.service:
        return _of_service(look)
    if node is None or not node.character:
        return StopPath(skipped="there is no port")
    if not node.accessible:
        return StopPath(skipped="this user may not open the port")
    if holders:
        return StopPath(skipped=f"{holders[0].name} (pid {holders[0].pid}) has the port open")
    if not (look.named or node.pseudo or node.usb_id == BOARD_USB):
        unsure = f"{node.path} may not be the board, and it is not written to"
        return StopPath(skipped=unsure, fix=f"failstop doctor --device {node.path}")
    return StopPath(by_hand(node.path))


def _of_service(look: Look) -> StopPath:
    test = f"failstop doctor --stop-test --name {look.name}"
    if not (state := look.state):
        return StopPath(skipped="the running service can't be asked")
    if state.enabled:
        return StopPath(skipped="motion is enabled", fix=f"failstop disable --name {look.name}")
    if state.cause:
        return StopPath(skipped=f"a stop is latched already ({state.cause})", fix=f"failstop reset --name {look.name}")
    if not look.stop_wanted:
        return StopPath(skipped="the service runs, and would be stopped once and reset", fix=test)
    if problem := no_right(look.name):
        return StopPath(skipped=problem, fix=f"sudo {test}")
    try:
        return StopPath(by_service(look.name))
    except FailstopError as error:
        return StopPath((StopTest("port owner, by a stop request", False, None, str(error)),))


def by_hand(path: str) -> tuple[StopTest, ...]:
    """Every writer's way, ended by the first that is not answered. Nobody else may have the port open."""
    try:
        begun_ns = time.monotonic_ns()
        own = OwnPort.open_and_stop(path)
    except PortError as error:
        return (StopTest("supervisor's opening", False, None, str(error)),)
    try:
        tap = Tap(own.fd)
        found = [_asked("supervisor's opening", begun_ns, True, tap)]
        for writer, write in (("stopper's duplicate", _on_duplicate), ("stop tool", _with_tool)):
            if found[-1].answered_ms is not None:
                found.append(_written(writer, functools.partial(write, own, path), tap))
        return tuple(found)
    finally:
        own.close()


def _written(writer: str, write: Callable[[], bool], tap: Tap) -> StopTest:
    begun_ns = time.monotonic_ns()
    try:
        return _asked(writer, begun_ns, write(), tap)
    except (OSError, PortError) as error:
        return StopTest(writer, False, None, str(error))


def _on_duplicate(own: OwnPort, _path: str) -> bool:
    duplicate = StopPort(os.dup(own.fd))
    try:
        return duplicate.burst()
    finally:
        duplicate.close()


def _with_tool(own: OwnPort, path: str) -> bool:
    # It opens the port as ExecStopPost does, when the service has let it go.
    release_exclusive(own.fd)
    tool.stop(path, lambda _: 0.0, lambda _: None)
    return True


def _asked(writer: str, begun_ns: int, written: bool, tap: Tap) -> StopTest:
    try:
        index, _ = tap.ping()
        answer_ns = tap.answer_ns(index, ANSWER_S)
    except OSError as error:
        return StopTest(writer, written, None, f"the port failed ({error})")
    return StopTest(writer, written, None if answer_ns is None else (answer_ns - begun_ns) / 1e6)


def no_right(name: str) -> str:
    """Why this user could not clear the latch that the test leaves; empty when it could. Motion is disabled already:
    disabling it once more changes nothing, and takes the same right."""
    try:
        with Robot(name, client="doctor") as robot:
            robot.disable()
    except FailstopError as error:
        return str(error)
    return ""


def by_service(name: str) -> tuple[StopTest, ...]:
    """A stop request to the running service, its acknowledgement, and the reset. Raises FailstopError; the caller has
    seen to it that motion is disabled, nothing latched, and the reset allowed."""
    writer = "port owner, by a stop request"
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
        problem = ""
        try:
            robot.reset()
        except FailstopError as error:
            problem = f"the stop of the test stays latched ({error}): failstop reset"
    return (StopTest(writer, written, answered_ms, problem),)
