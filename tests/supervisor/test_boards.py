"""The supervisor on boards that lose two stops which touch, and that report the command that they obey."""

from __future__ import annotations

import pytest

from failstop.board.interface import SUPERVISOR_ROW
from failstop.messages import layout
from tests.support.stage import MS
from tests.support.supervisor_scene import Scene


def made(kind: str) -> Scene:
    return Scene(layout.PORT_OWNER, settings={"board.kind": kind})


def stops(scene: Scene, for_ns: int) -> list[int]:
    """When it writes a stop, from now on."""
    begun_ns, found = scene.now_ns, []
    while (left_ns := begun_ns + for_ns - scene.now_ns) > 0:
        if scene.port.board.burst in scene.pass_time(min(left_ns, max(0, scene.next_ns() - scene.now_ns))):
            found.append(scene.now_ns - begun_ns)
    return found


@pytest.mark.parametrize("kind", ["rrc", "hoverboard", "arduino", "ugv"])
def test_the_stop_for_the_port_owner_is_written_at_once_and_again_at_its_own_times(kind: str) -> None:
    scene = made(kind)
    scene.turn()
    scene.dies(layout.PORT_OWNER)
    assert scene.port.board.burst in scene.pass_time()
    assert stops(scene, 150 * MS) == list(scene.port.board.repeats_ns[SUPERVISOR_ROW])


def test_a_port_owner_that_serves_repeats_its_own_stop() -> None:
    """A repeat of an old stop must not cut into the motion that comes after it."""
    scene = made("hoverboard")
    scene.turn()
    scene.dies(layout.PORT_OWNER)
    scene.pass_time()
    scene.pass_time(150 * MS)
    scene.wire.read()
    scene.dies(layout.PORT_OWNER)
    scene.pass_time()
    scene.supervisor.processes.restart_due(scene.now_ns + 10_000 * MS)
    scene.employ(layout.PORT_OWNER)
    assert stops(scene, 60 * MS) == []


def test_a_report_of_zeros_acknowledges_what_was_written_long_enough_before() -> None:
    scene = made("hoverboard")
    scene.stops("the first")
    written_ns = scene.port_owner.word("written_ns").get()
    obeyed, echo_ns = scene.telemetry.word("obeyed_ns"), scene.port.board.echo_ns
    scene.turn(echo_ns)
    obeyed.set(written_ns + echo_ns - 1)
    scene.turn(MS)
    assert scene.table("stop")["acknowledged_us"] is None, "it may be of before"
    obeyed.set(written_ns + echo_ns)
    scene.turn(MS)
    assert scene.table("stop")["acknowledged_us"] > 0
    assert scene.read("link") == b"unasked"
