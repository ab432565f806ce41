"""The port owner, turn by turn: stops that somebody asks for by the pipe, a button or a key."""

from __future__ import annotations

import pytest

from failstop.board.burst import BURST
from failstop.messages import layout
from failstop.policy import causes
from tests.support.port_scene import MOTION, Scene
from tests.support.stage import MS


@pytest.fixture
def scene() -> Scene:
    return Scene()


# Stop requests.


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (b"obstacle\n", "stop request: obstacle"),
        (b"first\nsecond\n", "stop request: first"),
        (b"\n", "stop request"),
        (b"\tnav\t3\n", "stop request (nav, pid 3)"),
        (b"obstacle\tnav\t3\n", "stop request: obstacle (nav, pid 3)"),
        (b"obstacle\tnav\tx\n", "stop request: obstacle?nav?x"),
        (b"gate died\n", "stop request: gate died"),
        (b"\0", "stop request: ?"),
        (b"\xff\xfe\x1b[31m", "stop request: \ufffd\ufffd?[31m"),
        (b"no end of line", "stop request: no end of line"),
    ],
)
def test_any_bytes_are_a_stop(scene: Scene, message: bytes, reason: str) -> None:
    scene.drive()
    scene.ask_to_stop(message)
    assert scene.answer() == (BURST, [reason])
    assert scene.turn() == b"", "the pipe is empty again"


def test_a_full_pipe_of_garbage_is_a_stop(scene: Scene) -> None:
    scene.drive()
    for _ in range(16):
        scene.ask_to_stop(b"\xfe" * 4096)
    assert scene.turn() == BURST
    reasons = scene.reasons()
    assert len(reasons) == 1
    assert len(reasons[0].removeprefix("stop request: ").encode()) <= causes.ARGUMENTS_BYTES


def test_a_flood_of_requests_is_no_flood_of_bursts(scene: Scene) -> None:
    scene.drive()
    scene.ask_to_stop(b"first\n")
    assert scene.turn() == BURST
    bursts = 0
    for _ in range(100):
        scene.ask_to_stop(b"again\n")
        bursts += scene.turn(MS).count(BURST)
    assert 5 <= bursts <= 12
    assert set(scene.reasons()) == {"stop request: first", "stop request: again"}
    assert scene.next_ns() > scene.clock()


def test_a_request_that_waits_at_the_start_is_a_stop_and_then_the_pipe_rests(scene: Scene) -> None:
    scene.wire.read()
    scene.ask_to_stop(b"first\n")
    assert scene.turn() == BURST
    scene.ask_to_stop(b"second\n")
    assert scene.answer(MS) == (b"", ["stop request: first"])


def test_the_next_request_is_looked_at_when_the_pipe_s_rest_is_over(scene: Scene) -> None:
    scene.drive()
    scene.ask_to_stop(b"first\n")
    asked_ns = scene.clock()
    scene.turn()
    scene.views[layout.TELEMETRY].ring_writer("causes").put(causes.KEY(1).pack())
    scene.ask_to_stop(b"second\n")
    scene.turn(10 * MS)
    assert scene.next_ns() == asked_ns + 20 * MS
    scene.turn(10 * MS)
    scene.turn()
    assert scene.reasons() == ["stop request: first", "key1", "stop request: second"]


def test_a_request_within_a_flood_stops_before_any_motion(scene: Scene) -> None:
    scene.drive()
    scene.ask_to_stop(b"first\n")
    scene.turn()
    scene.raise_epoch(2)
    scene.ask_to_stop(b"second\n")
    scene.put(epoch=2)
    assert scene.answer(MS) == (BURST, ["stop request: first", "stop request: second"])


def test_a_request_soon_after_motion_began_anew_is_not_put_off(scene: Scene) -> None:
    scene.drive()
    scene.ask_to_stop(b"first\n")
    scene.turn()
    scene.raise_epoch(2)
    assert scene.forward(epoch=2, elapsed_ns=MS) == MOTION
    scene.ask_to_stop(b"second\n")
    assert scene.answer(MS) == (BURST, ["stop request: first", "stop request: second"])


# Buttons and keys, which telemetry has seen.


def test_what_telemetry_has_seen_stops_before_any_motion_under_its_own_name(scene: Scene) -> None:
    scene.drive()
    buttons = scene.views[layout.TELEMETRY].ring_writer("causes")
    buttons.put(causes.BUTTON(0x0100).pack())
    scene.put()
    assert scene.answer() == (BURST, ["gamepad button 0x0100"])
    assert scene.forward() == b"", "until the supervisor has raised the epoch"
    buttons.put(b"\xff\xff")
    assert scene.turn() == BURST
    assert scene.reasons() == ["stopped by the supervisor"], "whatever it is"


def test_nobody_else_can_press_a_button(scene: Scene) -> None:
    scene.drive()
    scene.ask_to_stop(b"gamepad button 0x0100\n")
    assert scene.answer() == (BURST, ["stop request: gamepad button 0x0100"])
