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

from failstop import stopping
from failstop.api.errors import FailstopError
from failstop.api.robot import Robot
from failstop.board.port import PortError, release_exclusive
from failstop.board.stop_port import StopPort
from failstop.doctor.tap import Tap
from failstop.supervisor.port import OwnPort

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
    stopping.stop(path, lambda _: 0.0, lambda _: None)
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
