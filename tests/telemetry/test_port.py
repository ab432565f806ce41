"""The port as telemetry has it: what comes, and when it counts as come; its loss, and the next one."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from failstop.board import framing
from failstop.lab.sim import upward
from failstop.messages import layout, records
from failstop.procs.telemetry import port
from tests.support.stage import MS
from tests.support.telemetry_scene import S, Scene

PONG = upward.pwm_servo_position(2, 1500)


@pytest.fixture
def scene() -> Iterator[Scene]:
    made = Scene()
    yield made
    assert made.wire.read() == b"", "it never writes"


def heard(scene: Scene) -> list[tuple[int, bytes]]:
    """The whole ring of bytes: when they came, and what."""
    ring = scene.own.ring_reader("received", from_oldest=True)
    return [entry[1:] for entry in iter(ring.next, None)]


def answered_ns(scene: Scene) -> int:
    return records.unpack_pong(scene.own.word("pong").get())[0]


def test_bytes_go_into_the_ring_in_order(scene: Scene) -> None:
    sent = bytes(range(256)) * 16
    scene.wake(sent)
    found = [data for _, data in heard(scene)]
    assert b"".join(found) == sent
    assert max(map(len, found)) == 512


@pytest.mark.parametrize("late", [False, True])
def test_bytes_that_may_have_waited_for_long_are_as_old_as_they_can_be(scene: Scene, late: bool) -> None:
    """An answer that telemetry, held up, has read late is none to a ping that was written meanwhile."""
    scene.wake()
    empty_ns = scene.clock()
    scene.wake(PONG, elapsed_ns=port.LATE_NS - (not late))
    assert answered_ns(scene) == (empty_ns if late else scene.clock())
    scene.wake(PONG, elapsed_ns=MS)
    assert answered_ns(scene) == scene.clock()


def test_what_waits_at_the_start_is_dropped(scene: Scene) -> None:
    scene.wire.port.send(PONG)
    scene.start_telemetry()
    scene.wake()
    assert heard(scene) == []
    assert answered_ns(scene) == 0


@pytest.mark.parametrize("sign", ["hang-up", "record"])
def test_a_port_that_has_gone_is_let_go_and_the_next_one_heard(scene: Scene, sign: str) -> None:
    """The port owner, which does not read, is told of a hang-up; of the loss that it has found itself it tells."""
    number = scene.own.word("port_number")
    before = scene.open_fds()
    assert number.get() == 1
    if sign == "hang-up":
        scene.wire.unplug()
    else:
        lost = records.PORT.pack(1, scene.clock(), records.PORT_LOST, scene.wire.link)
        scene.views[layout.PORT_OWNER].latest_writer("port").write(lost)
    scene.wake()
    assert scene.rung("port_owner_bell") is (sign == "hang-up")
    assert number.get() == 0
    assert scene.open_fds() == before - 1
    scene.wake(elapsed_ns=S)
    scene.replug(2)
    scene.wake()
    assert number.get() == 2
    scene.wake(PONG)
    assert answered_ns(scene) == scene.clock()


def test_samples_alone_are_published_at_once_and_acted_on_with_the_odometry(scene: Scene) -> None:
    """Every other report of the board is acted on at once, and they before it."""
    published, kept, beat = scene.own.latest_reader("imu"), scene.own.ring_reader("box"), scene.own.word("beat_ns")
    came_ns, beats = [], set()
    for _ in range(220):
        scene.imu(0.0, 0.0, 1.0, 0.0, 0.0, 0.0, elapsed_ns=2 * S // 220)
        came_ns.append(scene.clock())
        beats.add(beat.get())
        assert published.read()[1] == scene.clock()
    assert abs(len(beats) - 100) <= 1
    scene.wake(PONG, elapsed_ns=MS)
    assert answered_ns(scene) == beat.get() == scene.clock()
    assert [entry[1] for entry in iter(kept.next, None)] == came_ns


def test_at_rest_the_board_wakes_nobody_and_its_samples_are_told_apart(scene: Scene) -> None:
    """Once a stop is long proved and nobody is there for whom anything could move."""
    busy = scene.views[layout.GATE].word("busy")
    sample, kept = framing.frame(framing.IMU_FUNC, bytes(24)), scene.own.ring_reader("box")

    def wakes() -> bool:
        scene.wake()
        scene.wire.port.send(PONG)
        woken = bool(scene.telemetry.loop.wait(0))
        scene.wake(elapsed_ns=MS)
        assert answered_ns(scene) == scene.clock()
        return woken

    assert wakes()
    scene.turn(elapsed_ns=port.PROVED_NS)
    assert wakes()
    busy.set(0)
    assert not wakes()
    scene.raise_epoch(2)
    assert wakes(), "the answer to a stop is waited for"
    scene.clock.now_ns += port.PROVED_NS
    assert not wakes()
    list(iter(kept.next, None))
    scene.wake(4 * sample, elapsed_ns=40 * MS)
    assert [(scene.clock() - entry[1]) // MS for entry in iter(kept.next, None)] == [30, 20, 10, 0]
    scene.wire.unplug()
    assert scene.telemetry.loop.wait(0), "its end does"
