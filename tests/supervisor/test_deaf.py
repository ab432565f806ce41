"""A board that hears nothing any more, and a service that did not listen."""

from __future__ import annotations

import pytest

from failstop.messages import layout
from failstop.policy.processes import PROCESS_BY_NAME
from failstop.supervisor.main import CLIENT_SILENT_NS, EXCUSE_NS
from tests.support.stage import MS
from tests.support.supervisor_scene import Scene, others

HEARS = (layout.PORT_OWNER, layout.TELEMETRY)


def nearly_deaf(left_ns: int) -> Scene:
    """A board that has answered, and will be deaf in a while to those who hear it."""
    scene = Scene(*HEARS)
    deaf_ns = scene.now_ns + scene.settings.ns("link.deaf_s")
    scene.pings()
    scene.tick(400 * MS, beating=HEARS)
    scene.pings(answered=False)
    scene.tick(deaf_ns - left_ns - scene.now_ns, beating=HEARS)
    assert scene.read("link") == b"alive"
    return scene


def test_a_board_is_not_deaf_while_telemetry_is_down() -> None:
    scene = nearly_deaf(20 * MS)
    scene.dies(layout.TELEMETRY)
    scene.tick(20 * MS, beating=HEARS)
    assert scene.read("link") == b"alive"


def test_a_board_is_not_deaf_while_the_port_owner_is_starved() -> None:
    deadline_ns = PROCESS_BY_NAME[layout.PORT_OWNER].deadline_ns
    scene = nearly_deaf(deadline_ns + 20 * MS)
    scene.starve(layout.PORT_OWNER)
    scene.tick(deadline_ns, beating=(layout.TELEMETRY,))
    assert scene.state(layout.PORT_OWNER) == "hanging"
    scene.pass_time(20 * MS)
    assert scene.read("link") == b"alive"


@pytest.mark.parametrize(
    ("silent_ns", "motion", "deaf"),
    [(CLIENT_SILENT_NS, 0, 0), (CLIENT_SILENT_NS - 1, 0, 1), (CLIENT_SILENT_NS, 1, 0), (CLIENT_SILENT_NS - 1, 1, 1)],
)
@pytest.mark.parametrize("held_up", [*HEARS, layout.SUPERVISOR])
def test_a_process_that_was_held_up_did_not_listen_and_the_robot_is_stopped_all_the_same(
    held_up: str, silent_ns: int, motion: int, deaf: int
) -> None:
    scene = nearly_deaf(silent_ns)
    if motion:
        scene.enabled()
    if held_up == layout.SUPERVISOR:
        scene.now_ns += silent_ns
        scene.beat(*HEARS)
        scene.pass_time()
    else:
        scene.pass_time(EXCUSE_NS)  # all were, and one of them goes on
        scene.tick(silent_ns - EXCUSE_NS, beating=others(held_up))
    assert (scene.read("link") == b"deaf") is bool(deaf)
    if motion:
        assert scene.cause()[0] > 0
