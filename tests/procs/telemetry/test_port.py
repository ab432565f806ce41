"""The port as telemetry has it: what comes, and when it counts as come; answers to pings; its loss, and the
next one."""

from __future__ import annotations

from collections.abc import Iterator

import pytest

from failstop.board.interface import HEARD_PONG
from failstop.board.rrc import framing
from failstop.board.rrc.board import BOARD
from failstop.messages import layout, records
from failstop.procs.telemetry import port
from failstop_lab.sim import upward
from failstop_lab.sim.model import BoardModel
from failstop_lab.sim.receiver import Receiver
from tests.support.stage import MS, Wire
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


def told(scene: Scene) -> tuple[int, int]:
    """The published (when it was asked, when the answer came); zeros before the first."""
    entry = scene.own.latest_reader("answered").read()
    return records.PROVED.unpack(entry[2]) if entry else (0, 0)


def answered_ns(scene: Scene) -> int:
    return told(scene)[1]


def ask(scene: Scene, index: int = 1) -> int:
    """The port owner asks now; returns when. No two questions have one time."""
    scene.clock.now_ns += 1
    scene.views[layout.PORT_OWNER].ring_writer("wrote").put(records.WROTE.pack(index, ()), scene.clock())
    return scene.clock()


def test_bytes_go_into_the_ring_in_order(scene: Scene) -> None:
    sent = bytes(range(256)) * 16
    scene.wake(sent)
    found = [data for _, data in heard(scene)]
    assert b"".join(found) == sent
    assert max(map(len, found)) == 512


@pytest.mark.parametrize("late", [False, True])
def test_bytes_that_may_have_waited_for_long_are_as_old_as_they_can_be(scene: Scene, late: bool) -> None:
    """An answer that telemetry, held up, has read late is none to a ping that was written meanwhile."""
    ask(scene)
    scene.wake()
    empty_ns = scene.clock()
    scene.wake(PONG, elapsed_ns=port.LATE_NS - (not late))
    assert answered_ns(scene) == (empty_ns if late else scene.clock())
    ask(scene)
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
    ask(scene)
    scene.wake(PONG)
    assert answered_ns(scene) == scene.clock()


def test_samples_alone_are_published_at_once_and_acted_on_with_the_odometry(scene: Scene) -> None:
    published, kept, beat = scene.own.latest_reader("imu"), scene.own.ring_reader("box"), scene.own.word("beat_ns")
    came_ns, beats = [], set()
    for _ in range(220):
        scene.imu(0.0, 0.0, 1.0, 0.0, 0.0, 0.0, elapsed_ns=2 * S // 220)
        came_ns.append(scene.clock())
        beats.add(beat.get())
        assert published.read()[1] == scene.clock()
    assert abs(len(beats) - 100) <= 1
    ask(scene)
    scene.wake(PONG, elapsed_ns=MS)
    assert answered_ns(scene) == beat.get() == scene.clock()
    assert [entry[1] for entry in iter(kept.next, None)] == came_ns


def test_at_rest_the_board_wakes_nobody_and_its_samples_are_told_apart(scene: Scene) -> None:
    busy = scene.views[layout.GATE].word("busy")
    sample, kept = framing.frame(framing.IMU_FUNC, bytes(24)), scene.own.ring_reader("box")

    def wakes() -> bool:
        scene.wake()
        ask(scene)
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


STOP_DATA = BOARD.stop[4:-1]
DRIVE = BOARD.motor_speeds((0.796, 0.796, -0.796, -0.796), 2.0)
ALL = range(layout.PINGS)


def answer(index: int) -> tuple[int, bytes]:
    """The frame that answers a ping."""
    frame = upward.pwm_servo_position(index + 1, 1500)
    return frame[2], frame[4:-1]


def test_the_pings_differ_fill_the_layout_s_words_and_ask_for_servos_that_there_are() -> None:
    assert len(BOARD.pings) == len(set(BOARD.pings)) == layout.PINGS
    assert BOARD.pings[0] == bytes.fromhex("AA5504020501E0")
    for ping in BOARD.pings:
        assert BOARD.check_motion(ping, 1000.0) != ""
        assert framing.MOTOR_HEAD not in ping
        assert [found[1:] for found in Receiver().feed(ping)] == [(framing.PWM_SERVO, bytes((5, ping[5])))]
        assert ping[5] in (1, 2, 3, 4)


@pytest.mark.parametrize("behind", [BOARD.burst, BOARD.stop * 20, DRIVE * 20])
@pytest.mark.parametrize("ping", BOARD.pings)
def test_no_cut_of_a_ping_is_completed_to_anything(ping: bytes, behind: bytes) -> None:
    """Executed are frames that were written whole, and empty SYS frames of the burst's
    zeros, which do nothing. Nothing reads servo 0, which is outside the firmware's table."""
    whole = {(framing.SYS, b""), (framing.MOTOR, STOP_DATA), (framing.MOTOR, DRIVE[4:-1])}
    for cut in range(len(ping)):
        for version in (10, 11, 12):
            receiver = Receiver(version)
            receiver.feed(ping[:cut])
            executed = {(func, data) for _, func, data in receiver.feed(behind)}
            assert executed <= whole
            assert executed - {(framing.SYS, b"")}, "nothing came through"


def test_the_board_answers_every_ping_in_order_with_no_servo_connected() -> None:
    board = BoardModel(0, imu_hz=0)
    board.receive(b"".join(BOARD.pings), 0)
    answers = BOARD.hearing().feed(b"".join(board.advance(S)))
    assert answers == [(HEARD_PONG, (index,)) for index in ALL]
    assert board.wheels == (0.0, 0.0, 0.0, 0.0)


def test_an_answer_is_published_with_the_time_of_its_question_and_rings_the_supervisor(scene: Scene) -> None:
    assert told(scene) == (0, 0)
    for index in (0, 1, 2, 3, 0):
        scene.rung("supervisor_bell")
        asked_ns = ask(scene, index)
        scene.turn(answer(index), elapsed_ns=500 * MS)
        assert told(scene) == (asked_ns, scene.clock())
        assert scene.rung("supervisor_bell")
    before = told(scene)
    ask(scene)
    scene.turn((framing.PWM_SERVO, b"\x01\x09\x05"), (framing.PWM_SERVO, b"\x05\x05\xdc\x05"), elapsed_ns=MS)
    scene.turn((framing.BUS_SERVO, b"\x01\x05\x00\xdc\x05"), (framing.IMU_FUNC, bytes(24)))
    assert told(scene) == before, "nothing else counts as an answer"
    assert not scene.rung("supervisor_bell")
    frame = upward.pwm_servo_position(2, 1500)
    for piece in (frame[:5], frame[5:]):
        scene.wake(piece, elapsed_ns=10 * MS)
    assert answered_ns(scene) == scene.clock(), "an answer in pieces has the time of its last"


def test_a_successor_counts_on_from_what_was_answered(scene: Scene) -> None:
    """It has not seen the answers before it: one that it can not place would prove the oldest question alone."""
    for _ in range(3):
        asked_ns = ask(scene)
        scene.wake(PONG, elapsed_ns=10 * MS)
    scene.start_telemetry()
    late_ns = ask(scene)
    scene.wake(PONG, elapsed_ns=10 * MS)
    assert told(scene)[0] == late_ns > asked_ns


@pytest.mark.parametrize("reopened", [True, False])
def test_half_a_frame_from_before_a_reopening_does_not_join_what_comes_after(scene: Scene, reopened: bool) -> None:
    frame = upward.pwm_servo_position(2, 1500)
    ask(scene)
    scene.wake(frame[:5])
    if reopened:
        scene.replug(2)
        scene.turn(elapsed_ns=3 * S)
    scene.wake(frame[5:])
    assert answered_ns(scene) == (0 if reopened else scene.clock())


def test_bytes_of_the_lost_port_still_belong_together(scene: Scene) -> None:
    whole, torn = upward.pwm_servo_position(2, 1500), upward.pwm_servo_position(3, 1500)
    for index in (1, 3):
        ask(scene, index)
    scene.wake(whole[:5])
    following = Wire(scene.machine, 1)
    scene.send_port(following, 2)
    scene.wake(whole[5:] + torn[:5])
    assert answered_ns(scene) == scene.clock()
    scene.wire = following
    scene.wake(torn[5:], elapsed_ns=MS)
    assert answered_ns(scene) == scene.clock() - MS
    ask(scene, 3)
    scene.turn(answer(3))
    assert answered_ns(scene) == scene.clock()
