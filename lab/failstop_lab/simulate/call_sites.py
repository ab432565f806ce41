"""Call sites: the system calls of a run without faults, by the lines of code that make them.

A call of the port owner in a turn that keeps the wheels turning counts as another site than the same call in another
turn, because the stop protocol is about the time before such a frame.
"""

from __future__ import annotations

from typing import Any

from failstop_lab.machine.port import Port
from failstop_lab.machine.process import Thread
from failstop_lab.simulate.faults import line_of
from failstop_lab.simulate.stage import Stage

Sites = dict[str, list[int]]
"""The call sites, each with the numbers of its calls."""
BEFORE = " before a frame"


class CallSites:
    """Records the call sites while a stage runs."""

    def __init__(self, stage: Stage) -> None:
        self._stage = stage
        self._count = 0
        self._lines: list[tuple[int, str]] = []
        self._turns: dict[int, list[int]] = {}
        """For each thread of the port owner: the numbers of its calls since it last waited."""
        self.before: set[int] = set()
        """The numbers of calls in turns that write a frame, up to that frame."""
        stage.machine.at_seam = self._at

    def _at(self, thread: Thread, call: str, about: tuple[Any, ...]) -> None:
        self._count += 1
        self._lines.append((self._count, f"{thread.process.name} {call} {line_of(call, about)}"))
        if thread.process.name != "port_owner":
            return
        turn = self._turns.setdefault(thread.number, [])
        if call == "epoll_wait":
            turn.clear()
        turn.append(self._count)
        if call == "write" and isinstance(thread.process.files[about[0]].node, Port) and self._keeps_turning(about[1]):
            self.before.update(turn)

    def _keeps_turning(self, data: bytes) -> bool:
        """Whether wheels turn, and this is a frame that turns them."""
        board = self._stage.robot.board
        return any(board.model.wheels) and any(board.traits.language.speeds(data) or ())

    def sites(self) -> Sites:
        """All call sites."""
        found: Sites = {}
        for number, line in self._lines:
            found.setdefault(line + BEFORE * (number in self.before), []).append(number)
        return found
