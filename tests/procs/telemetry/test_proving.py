"""Proving: since when a board obeys zero although it is told to move."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

from tests.support.telemetry_scene import Scene

MS = 1_000_000
FORWARD, ZERO = (28.0, 28.0), (0.0, 0.0)


def faded(*, told_ms: int) -> Any:
    """A hoverboard whose own watchdog has acted on the motion of 1,000 ms; its wheels are told to turn since then."""
    scene = Scene(**{"board.kind": "hoverboard", "wheels.layout": "differential"})
    proving = scene.telemetry._proving
    proving._handled = SimpleNamespace(faded_ns=1_000 * MS, asked_ns=0, heard=lambda *_: 0, wrote=lambda *_: None)
    proving._told_word = SimpleNamespace(get=lambda: told_ms * MS)
    proving._stopped = [SimpleNamespace(get=lambda: 0)]
    for came_ms in (2_000, 2_010):
        proving.obeyed(ZERO, came_ms * MS, moves=True)
    return scene.own.word("unheeded_ns").get()


def test_zeros_of_its_own_watchdog_count_from_the_motion_that_it_heard_last() -> None:
    assert faded(told_ms=900) == 1_000 * MS


def test_what_it_heard_before_this_motion_says_nothing_of_this_one() -> None:
    """Else a board that lost one frame long ago would be called deaf as soon as it is told to move again."""
    assert faded(told_ms=1_990) == 2_000 * MS
