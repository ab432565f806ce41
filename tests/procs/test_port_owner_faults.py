"""The port owner, turn by turn: deaths, hangs, a port that does not drain, a device that goes and comes back."""

from __future__ import annotations

import pytest

from failstop.board.rrc.board import BOARD
from failstop.board.rrc.burst import BURST
from failstop.messages import layout, records
from failstop.policy.processes import HANG_NS
from failstop.procs.loop import GONE, READ
from failstop.procs.peer import LATEST_NS, LEAVE_AFTER_NS
from failstop.shm import heartbeat
from tests.support.port_scene import MOTION, TICK, Scene
from tests.support.stage import MS

POWER_SWITCH = "port does not drain"


def test_the_gate_s_death_is_a_stop_and_without_a_gate_no_frame_counts() -> None:
    scene = Scene(named=False)
    scene.turn()
    assert scene.forward() == b"", "before the first is named there is nobody to watch"
    gate = scene.start(layout.GATE)
    scene.turn()
    assert scene.forward() == MOTION
    gate.kill()
    scene.put()
    assert scene.answer() == (BURST, ["gate died"])
    scene.raise_epoch(2)
    scene.put(epoch=2)
    scene.turn()
    assert scene.forward(epoch=2) == b""
    scene.start(layout.GATE)
    scene.turn()
    assert scene.forward(epoch=2) == MOTION
    scene.start(layout.GATE).kill()
    scene.turn()
    assert scene.answer() == (BURST, ["gate died"]), "before it was watched"


@pytest.mark.parametrize("process", [layout.TELEMETRY, layout.STOPPER])
def test_any_other_s_death_is_a_stop_and_motion_goes_on_after_an_enable(scene: Scene, process: str) -> None:
    """The epoch was raised for what it had stopped for, and motion needs the gate alone."""
    other = scene.start(process)
    scene.drive()
    other.kill()
    scene.put()
    assert scene.answer() == (BURST, [f"{process} died"])
    assert scene.forward() == b""
    scene.raise_epoch(2)
    assert scene.forward(epoch=2) == MOTION


@pytest.mark.parametrize("process", [layout.GATE, layout.TELEMETRY])
def test_a_death_that_is_known_by_the_successor_alone_is_a_stop(scene: Scene, process: str) -> None:
    scene.drive()
    before = scene.gate if process == layout.GATE else scene.start(process)
    scene.turn()
    before.kill()
    scene.start(process)
    assert scene.owner.turn({}), "its news has not come yet"
    assert scene.wire.read() == BURST
    assert scene.reasons() == [f"{process} died"]


def test_the_supervisor_s_death_is_a_stop_and_then_the_end(scene: Scene) -> None:
    scene.drive()
    scene.supervisor.kill()
    scene.put()
    assert scene.answer() == (BURST, ["supervisor died"])
    written = []
    for _ in range(150):
        assert scene.stays
        scene.put()
        if wrote := scene.turn(MS):
            written.append(wrote)
    assert not scene.stays
    assert written == [BURST, BURST], "the two repeats, and no motion"


def test_the_early_news_of_the_supervisor_s_death_is_answered_once(scene: Scene) -> None:
    """The mark stays, where a descriptor is no longer watched."""
    scene.drive()
    scene.early.tell(scene.supervisor.pid)
    assert scene.answer() == (BOARD.first_stop + BURST, ["supervisor died"])
    assert scene.answer() == (b"", [])


@pytest.mark.parametrize("process", [layout.GATE, layout.TELEMETRY])
def test_the_supervisor_s_death_is_told_before_that_of_who_dies_with_it(scene: Scene, process: str) -> None:
    other = scene.gate if process == layout.GATE else scene.start(process)
    scene.drive()
    scene.supervisor.kill()
    other.kill()
    assert scene.owner.turn(scene.news_of(other))
    assert scene.wire.read() == BURST
    assert scene.reasons() == ["supervisor died", f"{process} died"]
    scene.turn()
    assert scene.reasons() == [], "each is answered once"


def orphan(scene: Scene) -> int:
    """The supervisor has died, and the port owner has answered it; when that was."""
    scene.drive()
    scene.supervisor.kill()
    assert scene.answer() == (BURST, ["supervisor died"])
    return scene.clock()


@pytest.mark.parametrize("by", ["the kernel", "the port owner"])
def test_an_orphan_stays_until_the_port_has_passed_on_the_stop(scene: Scene, by: str) -> None:
    """The kernel drops what it holds at the last close, and what it has not taken ends with the process."""
    begun_ns = orphan(scene)
    if by == "the kernel":
        scene.wire.port.under_way = 1
    else:
        scene.wire.port.takes(0)
    for _ in range(17):
        scene.turn(10 * MS)
        assert scene.stays
    scene.turn(3 * MS)
    scene.wire.port.under_way = 0
    scene.wire.port.takes()
    left_ns = begun_ns + 175 * MS
    assert scene.next_ns() == left_ns, "it looks again each 5 ms"
    scene.turn(left_ns - scene.clock() - 1)
    assert scene.stays
    scene.turn(1)
    assert not scene.stays


def test_an_orphan_does_not_wait_forever_for_a_port_that_never_drains(scene: Scene) -> None:
    begun_ns = orphan(scene)
    scene.wire.port.under_way = 1
    while scene.stays:
        scene.turn(MS)
    assert scene.clock() - begun_ns == LATEST_NS


def test_an_orphan_waits_for_no_port_that_has_gone(scene: Scene) -> None:
    begun_ns = orphan(scene)
    scene.wire.port.takes(50)
    scene.ask_to_stop(b"x")
    scene.turn()
    scene.wire.unplug()
    scene.turn()
    scene.turn(begun_ns + LEAVE_AFTER_NS - 1 - scene.clock())
    assert scene.stays
    scene.turn(1)
    assert not scene.stays


@pytest.mark.parametrize(("gate_ms", "supervisor_ms"), [(0, 60), (60, 60)])
def test_a_lease_that_runs_out_while_moving_is_a_stop(scene: Scene, gate_ms: int, supervisor_ms: int) -> None:
    scene.drive()
    scene.clock.now_ns += 10_000 * MS
    scene.beat(layout.GATE, age_ns=gate_ms * MS)
    scene.beat(layout.SUPERVISOR, age_ns=supervisor_ms * MS)
    assert scene.turn(alive=False) == BURST
    name, silent_ms = ("gate", gate_ms) if gate_ms else ("supervisor", supervisor_ms)
    assert scene.reasons() == [f"{name} hangs: {silent_ms} ms silent"]


def test_a_lease_is_good_to_its_last_nanosecond_and_needed_for_motion_alone(scene: Scene) -> None:
    scene.turn()
    for _ in range(50):
        scene.turn(TICK, alive=False)
    assert scene.reasons() == []
    scene.put()
    assert MOTION not in scene.turn(alive=False)
    assert scene.reasons() == ["gate hangs: 1000 ms silent"], "motion does not begin on it"
    scene.raise_epoch(2)
    scene.turn()
    assert scene.forward(epoch=2).endswith(MOTION)
    assert scene.turn(50 * MS, alive=False) == b""
    assert scene.next_ns() == scene.clock() + 10 * MS, "it wakes just then"
    assert scene.turn(10 * MS - 1, alive=False) == b""
    assert scene.turn(1, alive=False) == BURST


def test_a_silence_of_its_own_while_moving_is_a_stop_though_nobody_else_noticed(scene: Scene) -> None:
    scene.drive()
    assert scene.turn(HANG_NS - 1) == b""
    assert scene.answer(HANG_NS) == (BURST, ["port_owner hangs: 250 ms silent"])
    scene.turn(HANG_NS)
    assert scene.reasons() == []


@pytest.mark.parametrize("moves", [True, False])
def test_a_port_that_does_not_drain_is_a_stop_once(scene: Scene, moves: bool) -> None:
    if moves:
        scene.drive()
        for _ in range(30):  # a frame at every turn, drained before the next: at each turn's end something is held
            scene.wire.port.drains = False
            scene.put()
            assert scene.answer(TICK) == (MOTION, [])
        scene.wire.port.drains = True
    scene.turn()
    for held, turns in ((100, 30), (0, 1), (100, 6)):
        scene.wire.port.under_way = held
        for _ in range(turns):
            scene.turn(TICK)
        assert scene.reasons() == ([POWER_SWITCH] if held else [])


def test_a_stop_that_the_kernel_does_not_take_is_not_said_to_be_written(scene: Scene) -> None:
    scene.drive()
    before_ns = scene.word("written_ns")
    scene.turn(5 * MS)
    scene.wire.port.takes(50)
    scene.ask_to_stop(b"x")
    assert scene.turn() == BURST[:50]
    assert scene.causes() == [(1, 0, "stop request: x")]
    assert scene.word("written_ns") == before_ns
    scene.wire.port.takes()
    assert scene.turn() == BURST[50:], "the rest follows as soon as there is room"


def test_the_rest_of_the_first_burst_and_of_a_frame_follows_as_soon_as_there_is_room() -> None:
    scene = Scene(before=lambda scene: scene.wire.port.takes(100))
    assert scene.turn() == BURST[:100]
    assert scene.word("written_ns") == 0
    scene.wire.port.takes()
    assert scene.turn() == BURST[100:]
    scene.wire.port.takes(10)
    assert scene.forward() == MOTION[:10]
    scene.wire.port.takes()
    assert scene.turn() == MOTION[10:]
    assert scene.owner.loop.wait(0) == {}, "it no longer waits for room"


def test_a_device_lost_is_told_and_a_burst_waits_for_its_return(scene: Scene) -> None:
    """Others hold the device still, as the supervisor does: the kernel would tell of the hang-up at every wait."""
    scene.os.dup(scene.fd("port"))
    scene.drive()
    scene.wire.unplug()
    scene.turn()
    assert scene.causes() == [(1, 0, "device lost")]
    assert (scene.port_state(), scene.port()[0]) == (records.PORT_LOST, 1)
    assert scene.next_ns() == scene.clock() + TICK, "its first repeat"
    assert scene.owner.wire.fd == -1, "let go at once, or the device comes back under another name"
    assert scene.owner.loop.wait(0) == {}
    for _ in range(3):
        scene.turn(5 * MS)
    scene.replug(2)
    assert scene.turn(5 * MS) == BURST
    assert (scene.port_state(), scene.port()) == (records.PORT_OPEN, (2, scene.wire.link))
    assert scene.forward() == b"", "its epoch is over"
    scene.raise_epoch(2)
    scene.put(epoch=2)
    assert MOTION in scene.turn()
    scene.os.dup(scene.owner.wire.fd)
    scene.wire.port.takes(50)
    scene.ask_to_stop(b"x")
    scene.turn()
    scene.wire.unplug()
    scene.turn()
    assert scene.port_state() == records.PORT_LOST
    assert scene.owner.loop.wait(0) == {}, "the plug was pulled under half a stop"


@pytest.mark.parametrize("told", [GONE, READ, GONE | READ])
def test_a_hang_up_is_a_loss_whether_it_is_told_or_read(scene: Scene, told: int) -> None:
    scene.wire.unplug()
    scene.owner.port.serve({scene.owner.wire.fd: told})
    assert scene.owner.wire.lost


@pytest.mark.parametrize(("frame", "new"), [(True, True), (False, True), (True, False)])
def test_a_device_that_has_just_gone_or_has_a_successor_is_lost_first(scene: Scene, frame: bool, new: bool) -> None:
    """Else what was let pass for the old port would go to the new one, behind the stop."""
    scene.drive()
    if new:
        scene.replug(2)
    else:
        scene.wire.unplug()
    if frame:
        scene.put()
    scene.stays = scene.owner.turn({scene.fd("control"): READ} if new else {})
    assert MOTION not in scene.wire.read()
    assert scene.reasons() == ["device lost"]
    assert not scene.owner.admission.wheels_move
    if new:
        assert (scene.port_state(), scene.port()[0]) == (records.PORT_OPEN, 2)
        scene.wire.port.send(b"x")
        assert scene.owner.wire.fd in scene.owner.loop.wait(0), "what the board sends"
        assert scene.forward() == b"", "its epoch is over"


def test_a_known_port_is_not_kept_open_and_of_several_the_newest_counts(scene: Scene) -> None:
    scene.drive()
    before = scene.open_fds()
    for number in (0, 1):  # sent to the one before this process, or twice
        scene.send_port(scene.wire, number)
        assert scene.answer() == (b"", [])
        assert scene.open_fds() == before
        assert scene.owner.admission.wheels_move
    for number in (2, 3):
        scene.send_port(scene.wire, number)
    scene.turn()
    assert (scene.port_state(), scene.port()[0], scene.open_fds()) == (records.PORT_OPEN, 3, before)


def test_bytes_from_the_board_go_into_the_ring_in_order_while_no_telemetry_runs(scene: Scene) -> None:
    """It reads them else, and wakes nobody."""
    received = scene.segment(layout.PORT_OWNER).ring_reader("received", from_oldest=True)

    def kept(sent: bytes) -> bytes:
        scene.wire.port.send(sent)
        scene.turn()
        return b"".join(entry[2] for entry in iter(received.next, None))

    scene.turn()
    sent = bytes(range(256)) * 5
    assert kept(sent) == sent
    telemetry = scene.start(layout.TELEMETRY, heartbeat.BEAT_STARTING)
    assert kept(b"it starts") == b"it starts"
    scene.runs(layout.TELEMETRY)
    assert kept(b"") == b""
    scene.wire.port.send(b"it reads")
    assert scene.owner.loop.wait(0) == {}
    assert kept(b"") == b""
    telemetry.kill()
    scene.turn()
    assert kept(b", or not") == b"it reads, or not"
    scene.wire.port.send(b"imu")
    scene.ask_to_stop(b"hand near wheel")
    assert scene.turn().startswith(BURST), "they hold up no stop"


@pytest.mark.parametrize("heard", [False, True])
def test_half_a_stop_keeps_nobody_from_reading_what_the_board_sends(heard: bool) -> None:
    """Telemetry reads it where it runs, and the port owner does not."""
    scene = Scene()
    received = scene.segment(layout.PORT_OWNER).ring_reader("received", from_oldest=True)
    if heard:
        scene.start(layout.TELEMETRY)
    scene.turn()
    scene.wire.port.takes(50)
    scene.ask_to_stop(b"hand near wheel")
    assert scene.turn() == BURST[:50]
    scene.wire.port.takes(0)
    scene.wire.port.send(b"imu")
    scene.turn()
    assert b"".join(entry[2] for entry in iter(received.next, None)) == (b"" if heard else b"imu")
