"""Deadlines of the witness: how long the wheels may still turn after a reason to stop, phase by phase."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any, cast

from failstop_lab.boards.line import ADAPTER_BAR_NS
from failstop_lab.machine.robot import MS
from failstop_lab.simulate.witness import REPEAT_NS, ZEROS_NS, Deadline, Phase, Witness

BAR_NS, OWN_NS = 8 * MS, 12 * MS


class Scene:
    """A witness and a machine in which a test sets what the deadline looks at."""

    def __init__(self, own_ns: int = 0) -> None:
        self.port = SimpleNamespace(drained_ns=0, took_again_ns=-REPEAT_NS)
        self.board = SimpleNamespace(port=self.port, model=SimpleNamespace(driven=[1.0]), catch_up=lambda: None)
        self.machine = SimpleNamespace(now_ns=0, at=self._at)
        self.asked_for_motion = self.wire_ns = self.paused_ns = 0
        self.late_ns = -ADAPTER_BAR_NS
        self.reaches = True
        self.verdicts: list[int] = []
        self._own_ns = own_ns
        self._due: tuple[int, Callable[[], None]] | None = None
        Deadline(cast(Witness, self), "a reason", BAR_NS, "", lambda: False).begin(Phase.BAR)

    def own_ns(self) -> int:
        return self._own_ns

    def all_paused_ns(self, _by: str) -> int:
        return self.paused_ns

    def late_until_ns(self, _by: str = "") -> int:
        return self.late_ns

    def reached(self) -> bool:
        return self.reaches

    def must_be_still(self, _why: str, within_ns: int, *, forbids: bool) -> None:
        assert forbids
        self.verdicts.append(within_ns)

    def _at(self, t_ns: int, what: Callable[[], None]) -> None:
        assert self._due is None, "two timers for one deadline"
        self._due = t_ns, what

    def step(self) -> int:
        """Let the next timer come; returns its time."""
        assert self._due
        (self.machine.now_ns, what), self._due = self._due, None
        what()
        return int(self.machine.now_ns)

    def all_steps(self) -> list[int]:
        """The times of all timers up to the verdict."""
        times: list[int] = []
        while self._due:
            times.append(self.step())
            assert len(times) < 10
        return times


def test_a_verdict_comes_at_the_end_of_the_bar() -> None:
    scene = Scene()
    assert scene.all_steps() == [BAR_NS]
    assert scene.verdicts == [BAR_NS]


def test_no_verdict_once_a_program_has_asked_for_motion() -> None:
    scene = Scene()
    scene.asked_for_motion = 1
    assert scene.all_steps() == [BAR_NS]
    assert scene.verdicts == []


def test_the_bar_begins_again_until_a_process_reaches_the_wheels() -> None:
    scene = Scene()
    scene.reaches = False
    assert [scene.step(), scene.step()] == [BAR_NS, 2 * BAR_NS]
    scene.reaches = True
    assert scene.all_steps() == [3 * BAR_NS, 4 * BAR_NS]
    assert scene.verdicts == [BAR_NS]


def test_a_pause_makes_the_phase_longer() -> None:
    scene = Scene()
    scene.paused_ns = MS
    assert scene.all_steps() == [BAR_NS, BAR_NS + MS]
    assert scene.verdicts == [BAR_NS]


def test_the_bar_begins_again_when_the_port_has_passed_on_what_it_kept() -> None:
    scene = Scene()
    scene.port.drained_ns, scene.wire_ns = 3 * MS, 10 * MS
    assert scene.all_steps() == [BAR_NS, 10 * MS + BAR_NS]
    assert scene.verdicts == [BAR_NS]


def test_a_refused_stop_is_waited_for_until_its_first_repeat() -> None:
    scene = Scene()
    scene.port.took_again_ns = 3 * MS
    assert scene.step() == BAR_NS
    assert scene.step() == 3 * MS + REPEAT_NS + BAR_NS
    assert scene.verdicts == []
    scene.all_steps()
    assert scene.verdicts == [BAR_NS]


def test_wheels_of_another_board_that_still_turn_get_its_own_time() -> None:
    scene = Scene(OWN_NS)
    assert scene.all_steps() == [BAR_NS, BAR_NS + OWN_NS]
    assert scene.verdicts == [BAR_NS + OWN_NS]


def test_wheels_of_another_board_that_are_still_get_a_verdict_at_once() -> None:
    scene = Scene(OWN_NS)
    cast(Any, scene.board.model).driven = [0.0]
    assert scene.all_steps() == [BAR_NS]


def test_after_moved_repeats_the_zeros_count_once() -> None:
    scene = Scene(OWN_NS)
    scene.late_ns = BAR_NS + OWN_NS
    assert scene.all_steps() == [BAR_NS, BAR_NS + OWN_NS, BAR_NS + OWN_NS + ZEROS_NS]
    assert scene.verdicts == [BAR_NS + OWN_NS]
