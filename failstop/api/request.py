"""Request: one request to the gate on its way, from its slot in the queue of this program's to its answer."""

from __future__ import annotations

import threading
import time

from failstop.api.client import gone
from failstop.api.errors import NoAnswer, Refused
from failstop.shm import records

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable

    from failstop.api.client import Client
    from failstop.api.robot import Robot
    from failstop.api.run import Run


class Request:
    """Look until it is answered, then leave. The gate keeps one request of a client, and its answer, so those of
    several threads go one after the other; one that is under way, such as an arm's move, lets others pass, which is
    how it is given up."""

    def __init__(
        self,
        robot: Robot,
        verb: int,
        answer_s: float,
        told: Callable[[str], None] | None = None,
        prepare: Callable[[Client], None] | None = None,
    ) -> None:
        """`told`: is called with each word of how far it is, where that takes time; `prepare`: what the gate finds with
        the request."""
        self.thread = threading.get_ident()
        self._robot = robot
        self._verb = verb
        self._answer_s = answer_s
        self._told = told
        self._prepare = prepare
        self._client: Client | None = None
        self._run: Run | None = None
        self._number = 0
        self._until_s = 0.0
        self._said = ""

    def look(self) -> str | None:
        """The answer; None while there is none. Raises Refused, NoAnswer, NoService, FailstopError."""
        if self._client is None and not self._send():
            return None
        client, run = self._client, self._run
        assert client
        assert run
        answer = client.answer(self._number)
        if answer and answer.done != records.UNDER_WAY:
            if not answer.done:
                raise Refused(answer.text, answer.cause)
            return str(answer)
        if answer and answer.text != self._said:
            self._said, self._until_s = answer.text, time.monotonic() + self._answer_s
            self.leave()
            if self._told:
                self._told(self._said)
        robot = self._robot
        with robot._lock:
            robot._check_open(closing=self._robot._closing)
            if run.over():
                raise gone(robot.name)
        if time.monotonic() > self._until_s:
            text = f"the gate of {robot.name!r} did not answer within {self._answer_s:g} s: see `failstop status`"
            raise NoAnswer(text)
        return None

    def _send(self) -> bool:
        """False while another thread's is on its way. A signal's handler goes before what it has interrupted."""
        robot = self._robot
        with robot._lock:
            before = robot._pending
            if before and before is not self and before.thread != self.thread:
                robot._check_open(closing=robot._closing)
                return False
            self._run = robot._current()
            self._client = robot._slot(self._run)
            robot._pending = self
            if self._prepare:
                self._prepare(self._client)
            self._number = self._client.ask(self._verb)
            self._until_s = time.monotonic() + self._answer_s
        return True

    def leave(self) -> None:
        """Let the next one pass."""
        with self._robot._lock:
            if self._robot._pending is self:
                self._robot._pending = None
