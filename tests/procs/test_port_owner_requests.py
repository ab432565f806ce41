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
        (b"obstacle\tnav\t3\n", "stop request: obstacle (nav, pid 3)"),
        (b"first\nsecond\n", "stop request: first"),
        (b"no end of line", "stop request: no end of line"),
    ],
)
def test_any_bytes_are_a_stop(scene: Scene, message: bytes, reason: str) -> None:
    scene.drive()
    scene.ask_to_stop(message)
    assert scene.answer() == (BURST, [reason])
    assert scene.turn() == b"", "the pipe is empty again"


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        (b"obstacle", "stop request: obstacle"),
        (b"", "stop request"),
        (b"\tnav\t3", "stop request (nav, pid 3)"),
        (b"obstacle\tnav\tx", "stop request: obstacle?nav?x"),
        (b"gate died", "stop request: gate died"),
        (b"gamepad button 0x0100", "stop request: gamepad button 0x0100"),
        (b"\0", "stop request: ?"),
        (b"\xff\xfe\x1b[31m", "stop request: \ufffd\ufffd?[31m"),
    ],
)
def test_a_line_of_the_pipe_is_somebody_s_words_whatever_it_says(line: bytes, reason: str) -> None:
    assert str(causes.requested(line)) == reason


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


@pytest.mark.parametrize("anew", [False, True])
def test_a_request_within_a_flood_stops_before_any_motion_and_once_it_began_anew(scene: Scene, anew: bool) -> None:
    scene.drive()
    scene.ask_to_stop(b"first\n")
    scene.turn()
    scene.raise_epoch(2)
    if anew:
        scene.turn(MS)
        assert scene.forward(epoch=2) == MOTION
        scene.ask_to_stop(b"second\n")
    else:
        scene.ask_to_stop(b"second\n")
        scene.put(epoch=2)
    assert scene.answer(MS) == (BURST, ["stop request: first", "stop request: second"])


# Buttons and keys, which telemetry has seen.


def test_a_button_that_telemetry_has_seen_stops_before_any_motion_under_its_own_name(scene: Scene) -> None:
    scene.drive()
    buttons = scene.views[layout.TELEMETRY].ring_writer("causes")
    buttons.put(causes.BUTTON(0x0100).pack())
    scene.put()
    assert scene.answer() == (BURST, ["gamepad button 0x0100"])
    assert scene.forward() == b"", "until the supervisor has raised the epoch"
    buttons.put(b"\xff\xff")
    assert scene.turn() == BURST
    assert scene.reasons() == ["stopped by the supervisor"], "whatever it is"
