"""The port owner and an arm's frames: what goes to the servos, what never does, and what every stop has behind it."""

from __future__ import annotations

from typing import Any

import pytest

from failstop.board import servos
from failstop.board.rrc.arm import RrcArm
from failstop.board.rrc.burst import BURST
from failstop.board.rrc.servos import bus_servo_move, bus_servo_read, bus_servo_stop, bus_servo_torque
from failstop.messages import records
from failstop.procs.port_owner.admission import MOST_WAITING
from tests.support.port_scene import MOTION, Scene
from tests.support.stage import MS

IDS = (1, 2, 3, 4, 5, 10)
WITH_SERVOS = BURST + RrcArm().stops(IDS)
MOVE = bus_servo_move([(1, 500)], 40)
TWO = bus_servo_move([(1, 500), (2, 600)], 40)
READ = bus_servo_read(1, servos.POSITION)


ARM: dict[str, Any] = {f"joints.j{servo}.servo": servo for servo in IDS}


@pytest.fixture
def scene() -> Scene:
    """The port owner of a robot with an arm."""
    return Scene(**ARM)


def arm(scene: Scene, frame: bytes = MOVE, *, epoch: int = 1, age_ns: int = 0) -> bytes:
    return scene.forward(frame, epoch=epoch, age_ns=age_ns, kind=records.ARM)


def settle(scene: Scene) -> None:
    for ms in (0, 25, 100, 100):
        scene.turn(ms * MS)


def test_a_move_goes_out_and_no_stop_behind_it_is_put_off(scene: Scene) -> None:
    assert scene.turn() == WITH_SERVOS, "the first bytes stop the arm too"
    settle(scene)
    for _ in range(2):
        assert arm(scene) == MOVE
        assert scene.word("moving") == 0
        assert scene.forward(b"held", kind=records.WRITE_BURST, elapsed_ns=5 * MS) == WITH_SERVOS
    settle(scene)
    scene.put(MOVE, kind=records.ARM)
    assert scene.forward(b"held", kind=records.WRITE_BURST) == WITH_SERVOS, "within one turn it takes its place"
    scene.turn(5 * MS)
    for _ in range(40):
        scene.put(TWO, kind=records.ARM)
    assert scene.turn() == TWO
    assert len(scene.owner.bus.waiting) <= MOST_WAITING, "a gate that floods is not remembered for ever"


def test_a_move_goes_out_behind_what_is_still_under_way_and_its_joints_do_not_stand(scene: Scene) -> None:
    settle(scene)
    scene.wire.port.under_way = 1
    assert arm(scene) == MOVE


@pytest.mark.claim("ARM-1")
@pytest.mark.parametrize("cause", ["pipe", "epoch", "gate", "supervisor"])
def test_every_stop_has_the_arm_s_behind_it(scene: Scene, cause: str) -> None:
    settle(scene)
    assert arm(scene) == MOVE
    if cause == "pipe":
        scene.ask_to_stop(b"now\n")
    elif cause == "epoch":
        scene.raise_epoch(2)
    elif cause == "gate":
        scene.gate.kill()
    else:
        scene.supervisor.kill()
    assert scene.turn(1 * MS) == WITH_SERVOS


def test_a_frame_that_is_too_old_of_a_dead_epoch_or_a_stopped_one_is_dropped(scene: Scene) -> None:
    settle(scene)
    assert [arm(scene, epoch=0), arm(scene, age_ns=61 * MS)] == [b"", b""]
    scene.raise_epoch(2)
    assert scene.turn() == WITH_SERVOS
    assert [arm(scene, epoch=1), arm(scene, epoch=2)] == [b"", MOVE]
    scene.ask_to_stop(b"now\n")
    scene.turn()
    assert arm(scene, epoch=2) == b""
    scene.raise_epoch(3)
    scene.turn(5 * MS)
    scene.at_next("ioctl", lambda: scene.raise_epoch(4))
    assert arm(scene, epoch=3) == WITH_SERVOS, "one raised just before the write wins"


def test_while_the_wheels_may_turn_nothing_goes_to_the_servos(scene: Scene) -> None:
    """A frame that has waited since before does not either."""
    settle(scene)
    scene.put(TWO, kind=records.ARM)
    scene.put(TWO, kind=records.ARM)
    assert scene.forward() == TWO + MOTION
    assert scene.turn(5 * MS) == b""
    for frame in (MOVE, READ, bus_servo_torque(1, on=False)):
        assert arm(scene, frame) == b""
    assert scene.forward(b"disabled", kind=records.WRITE_BURST) == WITH_SERVOS
    assert arm(scene) == MOVE


def test_the_wait_of_a_stop_is_bounded_over_frames_and_no_move_is_lost(scene: Scene) -> None:
    settle(scene)
    other = bus_servo_move([(3, 500)], 40)
    scene.put(TWO, kind=records.ARM)
    scene.put(MOVE, kind=records.ARM)
    scene.put(other, kind=records.ARM)
    begun_ns = scene.clock()
    assert scene.turn() == TWO
    # 2 x 0.87 ms are before the second, which adds as much: 0.61 ms until both are 2 ms.
    due_ns = min(begun_ns + 20 * MS, scene.owner.loop.due_ns())
    assert due_ns - begun_ns == 610_000
    assert scene.turn(due_ns - begun_ns - 1) == b""
    assert scene.turn(1) == MOVE
    assert scene.turn(868_000) == b""
    assert scene.turn(2_000) == other


@pytest.mark.parametrize("end", ["stop", "pipe", "epoch", "age"])
def test_a_move_that_waits_is_ended_by_a_stop_and_by_its_age(scene: Scene, end: str) -> None:
    settle(scene)
    scene.put(TWO, kind=records.ARM)
    assert scene.forward(TWO, kind=records.ARM, age_ns=59 * MS if end == "age" else 0) == TWO
    if end == "stop":
        scene.put(b"held", kind=records.WRITE_BURST)
    elif end == "pipe":
        scene.ask_to_stop(b"now\n")
    elif end == "epoch":
        scene.raise_epoch(2)
    assert scene.turn(1_000) == (b"" if end == "age" else WITH_SERVOS)
    assert scene.turn(5 * MS) == b""


def test_the_gate_can_drop_the_frames_that_wait_without_a_stop(scene: Scene) -> None:
    settle(scene)
    scene.put(TWO, kind=records.ARM)
    assert scene.forward(TWO, kind=records.ARM) == TWO
    scene.put(b"", kind=records.DROP_ARM)
    assert scene.forward(MOVE, kind=records.ARM, elapsed_ns=5 * MS) == MOVE, "those after it are written"
    assert scene.turn(5 * MS) == b""


@pytest.mark.claim("BOARD-1")
def test_the_wheels_zero_is_repeated_while_an_arm_on_their_bus_moves_and_afterwards() -> None:
    """Neither the zero nor the burst of that bus touches the arm's servos, and the end of its movement writes none."""
    changed: dict[str, Any] = {"board.kind": "feetech", "joints.pan.servo": 4, "joints.pan.zero": 2048}
    scene = Scene(**changed)
    bus = scene.owner.board.arm
    assert bus
    zero, move = scene.owner.board.refresh, bus.move([(4, 2000)], 40)
    settle(scene)
    wrote = scene.forward(move, kind=records.ARM) + b"".join(scene.turn(5 * MS) for _ in range(200))
    assert move in wrote
    assert wrote.count(zero) >= 4
    scene.put(b"", kind=records.DROP_ARM)
    assert b"".join(scene.turn(5 * MS) for _ in range(200)).count(zero) >= 4


def test_a_question_waits_until_no_servo_moves_and_a_move_behind_it_waits(scene: Scene) -> None:
    settle(scene)
    assert arm(scene) == MOVE
    assert arm(scene, READ) == b""
    scene.turn(40 * MS)
    assert arm(scene, READ) == b""
    scene.turn(21 * MS)
    assert arm(scene, READ) == READ
    assert arm(scene, READ) == b""
    scene.turn(5 * MS)
    assert arm(scene, READ) == READ
    assert arm(scene) == b""
    assert scene.turn(5 * MS) == MOVE


BAD = [
    *(bus_servo_move([(6, 500)], 40), bus_servo_stop([6]), bus_servo_move([(1, 500)], 1000, 1000)),
    *(bytes.fromhex("AA550508030601020304050AE8"), MOTION, b"", MOVE + MOVE),
]


@pytest.mark.parametrize("frame", BAD, ids=bytes.hex)
def test_a_frame_that_is_none_for_this_arm_stops(scene: Scene, frame: bytes) -> None:
    settle(scene)
    assert arm(scene, frame) == WITH_SERVOS
    assert [reason.partition(":")[0] for reason in scene.reasons()] == ["the gate's frame was refused"]


def test_without_an_arm_no_such_frame_goes_out_and_stops_are_as_they_were() -> None:
    armless = Scene()
    assert armless.turn() == BURST
    settle(armless)
    assert arm(armless) == BURST
    assert armless.reasons() == ["the gate's frame was refused: for the arm, this robot has no arm"]
    for frame in (MOVE, READ, bus_servo_stop([1])):
        assert armless.forward(frame, epoch=1, kind=records.OTHER) == b""


def test_the_word_moving_is_up_while_an_arm_s_frame_is_written_or_half_written(scene: Scene) -> None:
    settle(scene)
    seen: list[int] = []
    scene.wire.on_bytes = lambda data: seen.append(scene.word("moving"))
    assert arm(scene) == MOVE
    assert seen == [1]
    assert scene.word("moving") == 0
    scene.turn(5 * MS)
    scene.wire.port.takes(5)
    assert arm(scene) == MOVE[:5]
    assert scene.word("moving") == 1


def test_the_word_moving_stays_up_when_the_plug_is_pulled_under_a_move(scene: Scene) -> None:
    settle(scene)
    scene.wire.unplug()
    scene.put(MOVE, kind=records.ARM)
    scene.owner.turn({})
    assert scene.reasons() == ["device lost"]
    assert scene.word("moving") == 1


def test_a_move_does_not_take_back_that_the_wheels_may_turn(scene: Scene) -> None:
    scene.drive()
    scene.wire.port.takes(100)
    scene.raise_epoch(2)
    scene.turn()
    scene.wire.port.takes()
    scene.turn()
    assert arm(scene, epoch=2) == MOVE
    assert scene.word("moving") == 1
    scene.raise_epoch(3)
    assert scene.turn() == WITH_SERVOS
    assert scene.word("moving") == 0
