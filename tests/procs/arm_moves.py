"""Moves of the arm, as a test asks for them and sees them."""

from __future__ import annotations

from struct import unpack_from

from failstop.messages import records
from tests.support.gate_scene import Scene

FOLLOW, JOG = records.ARM_FOLLOW, records.ARM_JOG


def follow(scene: Scene, seconds: float, rate: float, servo: int = 1) -> None:
    begun_ns = scene.clock()
    while (t_s := (scene.clock() - begun_ns) * 1e-9) < seconds:
        scene.goal(FOLLOW, {servo: rate * t_s})
        scene.run(0.02)


def renew(scene: Scene, times: int, mode: int, values: dict[int, float]) -> None:
    """One goal again and again."""
    for _ in range(times):
        scene.goal(mode, values)
        scene.run(0.02)


def moves_in(scene: Scene, seconds: float) -> int:
    """How many moves are sent in that time."""
    before = len(scene.moves)
    scene.run(seconds)
    return len(scene.moves) - before


def sent(scene: Scene, servo: int) -> list[tuple[int, int]]:
    """(when, where to) of each move of a servo."""
    found = []
    for t_ns, data in scene.moves:
        for index in range(data[3]):
            to, position = unpack_from("<BH", data, 4 + 3 * index)
            found += [(t_ns, position)] if to == servo else []
    return found
