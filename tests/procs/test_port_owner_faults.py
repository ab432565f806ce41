"""The port owner, turn by turn: deaths, hangs, a port that does not drain, a device that goes and comes back."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.board.burst import BURST
from failstop.procs.loop import READ
from failstop.procs.port_owner import main
from failstop.shm import layout, records
from tests.support.port_scene import MOTION, TICK, Kernel, Scene
from tests.support.ptys import open_fds
from tests.support.stage import MS, Dummy
from tests.support.waiting import until

POWER_SWITCH = "port does not drain: use the POWER SWITCH"


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Scene]:
    made = Scene(tmp_path, monkeypatch)
    yield made
    made.close()


@pytest.fixture
def kernel(monkeypatch: pytest.MonkeyPatch) -> Kernel:
    return Kernel(monkeypatch)


# Deaths and hangs.


def ready_after(scene: Scene, dummy: Dummy) -> None:
    dummy.kill()
    until(lambda: scene.owner.loop.wait(0), "the news of the death")


def test_the_gate_s_death_is_a_stop(scene: Scene) -> None:
    scene.drive()
    ready_after(scene, scene.gate)
    scene.put()
    assert scene.turn() == BURST
    assert scene.reasons() == ["gate died"]
    scene.raise_epoch(2)
    scene.put(epoch=2)
    scene.turn()
    scene.put(epoch=2)
    assert scene.turn() == b"", "no frame counts while no gate is watched"
    scene.start(layout.GATE)
    scene.turn()
    scene.put(epoch=2)
    assert scene.turn() == MOTION


def test_a_gate_that_died_before_it_was_watched_is_a_stop(scene: Scene) -> None:
    scene.drive()
    scene.start(layout.GATE).kill()
    scene.turn()
    assert scene.turn() == BURST
    assert scene.reasons() == ["gate died"]


@pytest.mark.parametrize("process", [layout.TELEMETRY, layout.STOPPER])
def test_so_is_any_other_s_and_motion_goes_on_after_an_enable(scene: Scene, process: str) -> None:
    other = scene.start(process)
    scene.drive()
    ready_after(scene, other)
    scene.put()
    assert scene.turn() == BURST
    assert scene.reasons() == [f"{process} died"]
    scene.put()
    assert scene.turn() == b""
    scene.raise_epoch(2)
    scene.put(epoch=2)
    assert scene.turn() == MOTION, "the epoch was raised for what it had stopped for, and motion needs the gate alone"


@pytest.mark.parametrize("process", [layout.GATE, layout.TELEMETRY, layout.STOPPER])
def test_a_death_that_is_known_by_the_successor_alone_is_a_stop(scene: Scene, process: str) -> None:
    scene.drive()
    before = scene.gate if process == layout.GATE else scene.start(process)
    scene.turn()
    before.kill()
    scene.start(process)
    assert scene.owner.turn({}), "its news has not come yet"
    assert scene.pty.read() == BURST
    assert scene.reasons() == [f"{process} died"]


def test_before_the_first_gate_is_named_there_is_nobody_to_watch(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene = Scene(tmp_path, monkeypatch, named=False)
    scene.turn()
    scene.put()
    assert scene.turn() == b""
    scene.start(layout.GATE)
    scene.turn()
    scene.put()
    assert scene.turn() == MOTION
    scene.close()


def test_the_supervisor_s_death_is_a_stop_and_then_the_end(scene: Scene) -> None:
    scene.drive()
    ready_after(scene, scene.supervisor)
    scene.put()
    assert scene.turn() == BURST
    assert scene.reasons() == ["supervisor died"]
    written = []
    for _ in range(150):
        assert scene.stays
        scene.put()
        if wrote := scene.turn(MS):
            written.append(wrote)
    assert not scene.stays
    assert written == [BURST, BURST], "the two repeats, and no motion"


def test_its_early_news_is_answered_once(scene: Scene) -> None:
    """The mark stays, where a descriptor is no longer watched."""
    scene.drive()
    scene.owner._parent.life.marked = True
    assert scene.turn() == BURST
    assert scene.reasons() == ["supervisor died"]
    assert scene.turn() == b""
    assert scene.reasons() == []


@pytest.mark.parametrize("process", [layout.GATE, layout.TELEMETRY])
def test_the_supervisor_s_comes_before_that_of_who_dies_with_it_whoever_s_news_is_first(
    scene: Scene, process: str
) -> None:
    other = scene.gate if process == layout.GATE else scene.start(process)
    scene.drive()
    scene.supervisor.kill()
    other.kill()
    life = next(peer.life for peer in scene.owner._peers if peer.life and peer.life.pid == other.pid)
    assert scene.owner.turn({life.fd: READ})
    assert scene.pty.read() == BURST
    assert scene.reasons() == ["supervisor died", f"{process} died"]
    scene.turn()
    assert scene.reasons() == [], "each is answered once"


@pytest.mark.parametrize(("gate_ms", "supervisor_ms"), [(60, 0), (0, 60), (60, 60), (10_000, 0)])
def test_a_lease_that_runs_out_while_moving_is_a_stop(scene: Scene, gate_ms: int, supervisor_ms: int) -> None:
    scene.drive()
    scene.clock.now_ns += 10_000 * MS
    scene.beat(layout.GATE, age_ns=gate_ms * MS)
    scene.beat(layout.SUPERVISOR, age_ns=supervisor_ms * MS)
    assert scene.turn(alive=False) == BURST
    name, silent_ms = ("gate", gate_ms) if gate_ms else ("supervisor", supervisor_ms)
    assert scene.reasons() == [f"{name} hangs: {silent_ms} ms silent"]


def test_a_lease_is_good_until_the_last_nanosecond(scene: Scene) -> None:
    scene.drive()
    assert scene.turn(50 * MS, alive=False) == b""
    assert scene.next_ns() == scene.clock() + 10 * MS, "it wakes just then"
    assert scene.turn(10 * MS - 1, alive=False) == b""
    assert scene.turn(1, alive=False) == BURST


def test_motion_does_not_begin_on_a_lease_that_has_run_out(scene: Scene) -> None:
    scene.turn()
    scene.clock.now_ns += 1_000 * MS
    scene.turn(alive=False)
    scene.put()
    assert MOTION not in scene.turn(alive=False)
    assert scene.reasons() == ["gate hangs: 1000 ms silent"]


def test_silence_without_motion_is_nothing(scene: Scene) -> None:
    scene.turn()
    for _ in range(50):
        scene.turn(TICK, alive=False)
    assert scene.reasons() == []


# A port that does not drain.


def test_a_port_that_does_not_drain_is_a_stop_once(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    scene.drive()
    held = [100]
    scene.world.play("unsent_bytes", lambda fd: held[0])
    for _ in range(30):
        scene.turn(TICK)
    assert scene.reasons() == [POWER_SWITCH]
    held[0] = 0
    scene.turn(TICK)
    held[0] = 100
    for _ in range(6):
        scene.turn(TICK)
    assert scene.reasons() == [POWER_SWITCH]


def test_a_port_that_does_not_drain_while_nothing_moves_is_one_too(
    scene: Scene, monkeypatch: pytest.MonkeyPatch
) -> None:
    scene.turn()
    scene.world.play("unsent_bytes", lambda fd: 100)
    for _ in range(6):
        scene.turn(TICK)
    assert scene.reasons() == [POWER_SWITCH]


def test_bytes_just_written_are_no_sign_of_a_port_that_does_not_drain(
    scene: Scene, monkeypatch: pytest.MonkeyPatch, kernel: Kernel
) -> None:
    """A frame at every turn, drained before the next: at each turn's end the kernel holds something."""
    scene.drive()
    held = [0]
    kernel.taken = held
    scene.world.play("unsent_bytes", lambda fd: held[0])
    for _ in range(30):
        held[0] = 0
        scene.put()
        assert scene.turn(TICK) == MOTION
        assert held[0] > 0
    assert scene.reasons() == []


def test_a_stop_that_the_kernel_does_not_take_is_not_said_to_be_written(scene: Scene, kernel: Kernel) -> None:
    scene.drive()
    before_ns = scene.word("written_ns")
    scene.turn(5 * MS)
    kernel.room = 50
    scene.ask_to_stop(b"x")
    assert scene.turn() == BURST[:50]
    assert scene.causes() == [(1, 0, "stop request: x")]
    assert scene.word("written_ns") == before_ns
    kernel.room = None
    assert scene.turn() == BURST[50:], "the rest follows as soon as there is room"


def test_what_is_left_of_a_frame_follows_as_soon_as_there_is_room(scene: Scene, kernel: Kernel) -> None:
    scene.turn()
    kernel.room = 10
    scene.put()
    assert scene.turn() == MOTION[:10]
    kernel.room = None
    assert scene.turn() == MOTION[10:]
    assert scene.owner.wire.unsent == b""
    assert scene.owner.loop.wait(0) == {}, "and it no longer waits for room"


def test_what_is_left_of_the_first_burst_follows_too(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    kernel = Kernel(monkeypatch)
    kernel.room = 100
    scene = Scene(tmp_path, monkeypatch)
    assert scene.turn() == BURST[:100]
    assert scene.word("written_ns") == 0
    kernel.room = None
    assert scene.turn() == BURST[100:]
    assert scene.owner.wire.unsent == b""
    scene.close()


# A device that goes and comes back.


def test_a_device_lost_is_told_and_a_burst_waits_for_its_return(scene: Scene) -> None:
    scene.drive()
    scene.causes()
    scene.pty.unplug()
    until(lambda: scene.owner.loop.wait(0), "the hang-up")
    scene.turn()
    assert scene.causes() == [(1, 0, "device lost")]
    assert scene.port_state() == records.PORT_LOST
    assert scene.owner.wire.fd == -1, "let go at once, or the device comes back under another name"
    assert scene.owner.loop.wait(0) == {}, "though others still hold it"
    assert scene.port()[0] == 1
    for _ in range(3):
        scene.turn(5 * MS)
    scene.replug(2)
    assert scene.turn(5 * MS) == BURST
    assert scene.port_state() == records.PORT_OPEN
    assert scene.port() == (2, scene.pty.link)
    scene.put()
    assert scene.turn() == b"", "its epoch is over"
    scene.raise_epoch(2)
    scene.put(epoch=2)
    assert MOTION in scene.turn()


def test_a_frame_for_a_device_that_has_just_gone_is_a_device_lost(scene: Scene) -> None:
    """The frame is at hand when the hang-up is, and is written first."""
    scene.drive()
    scene.pty.unplug()
    scene.put()
    scene.stays = scene.owner.turn({})
    assert scene.reasons() == ["device lost"]
    assert not scene.owner.admission.wheels_move


def test_a_pulled_plug_is_told_at_the_wake_up_that_it_makes_and_not_a_tick_later(scene: Scene) -> None:
    scene.drive()
    scene.pty.unplug()
    news: dict[int, int] = {}

    def hung_up() -> bool:
        news.update(scene.owner.loop.wait(0))
        return bool(news)

    until(hung_up, "the hang-up")
    assert scene.owner.turn(news)
    assert scene.reasons() == ["device lost"]
    assert scene.port_state() == records.PORT_LOST


def test_a_plug_pulled_under_a_stop_that_is_half_written_does_not_keep_it_awake_for_ever(
    scene: Scene, kernel: Kernel
) -> None:
    """Others hold the device still, as the supervisor does: the kernel would tell of the hang-up at every wait."""
    scene.drive()
    kernel.room = 50
    scene.ask_to_stop(b"x")
    scene.turn()
    scene.pty.unplug()
    until(lambda: scene.owner.loop.wait(0), "the hang-up")
    scene.turn()
    assert scene.port_state() == records.PORT_LOST
    assert scene.owner.loop.wait(0) == {}


@pytest.mark.parametrize("frame", [True, False])
def test_a_new_port_that_comes_before_the_loss_of_the_old_is_seen_is_a_device_lost_too(
    scene: Scene, frame: bool
) -> None:
    """Else what was let pass for the old one would go to the new one, behind the stop."""
    scene.drive()
    scene.replug(2)
    if frame:
        scene.put()
    scene.stays = scene.owner.turn({scene.owner._parent.control.fd: 1})
    assert MOTION not in scene.pty.read()
    assert scene.reasons() == ["device lost"]
    assert not scene.owner.admission.wheels_move
    assert (scene.port_state(), scene.port()[0]) == (records.PORT_OPEN, 2)
    os.write(scene.pty.master, b"x")
    until(lambda: scene.owner.wire.fd in scene.owner.loop.wait(0), "what the board sends")
    scene.put()
    assert scene.turn() == b"", "its epoch is over"


def held_open(path: str) -> int:
    """How many descriptors of this process are of that device."""
    return sum(os.path.realpath(f"/proc/self/fd/{fd}") == path for fd in os.listdir("/proc/self/fd"))


@pytest.mark.parametrize("number", [0, 1])
def test_a_port_that_is_known_already_changes_nothing_and_is_not_kept_open(scene: Scene, number: int) -> None:
    """Sent twice, or to the one before this process."""
    scene.drive()
    before = held_open(scene.pty.link)
    scene.control.send(scene.pty.slave, number, "/dev/other")
    assert scene.turn() == b""
    assert held_open(scene.pty.link) == before
    assert scene.reasons() == []
    assert scene.owner.admission.wheels_move


def test_of_several_that_wait_the_newest_counts(scene: Scene) -> None:
    scene.turn()
    before = open_fds()
    for number in (2, 3):
        scene.control.send(scene.pty.slave, number, "/dev/board")
    scene.turn()
    assert (scene.port_state(), scene.port()[0]) == (records.PORT_OPEN, 3)
    assert open_fds() == before


def test_without_a_port_it_turns_at_its_tick(scene: Scene) -> None:
    scene.turn()
    scene.pty.unplug()
    until(lambda: scene.owner.loop.wait(0), "the hang-up")
    scene.turn()
    assert scene.next_ns() == scene.clock() + TICK


def test_bytes_from_the_board_go_into_the_ring_in_order(scene: Scene) -> None:
    scene.turn()
    received = scene.segment(layout.PORT_OWNER).ring_reader("received", from_oldest=True)
    sent = bytes(range(256)) * 5
    os.write(scene.pty.master, sent)
    found = b""

    def arrived() -> bool:
        nonlocal found
        scene.turn()
        while entry := received.next():
            assert len(entry[2]) <= main.RECEIVED_CHUNK
            found += entry[2]
        return len(found) >= len(sent)

    until(arrived, "all of the bytes")
    assert found == sent


def board_sends(scene: Scene) -> None:
    os.write(scene.pty.master, b"imu")
    until(lambda: scene.owner.loop.readable(scene.owner.wire.fd), "the bytes")


def test_bytes_alone_are_passed_on_and_the_rest_is_looked_at_at_the_tick(scene: Scene) -> None:
    scene.turn()
    received = scene.segment(layout.PORT_OWNER).ring_reader("received")
    beat = scene.segment(layout.PORT_OWNER).word("beat_ns")
    before_ns, tick_ns = beat.get(), scene.next_ns()
    scene.raise_epoch(2)  # its bell is lost
    for _ in range(3):
        board_sends(scene)
        assert scene.turn(MS) == b""
        assert received.next()
        assert beat.get() == before_ns, "not a whole turn"
        assert scene.next_ns() == tick_ns, "and none that puts the next one off"
    board_sends(scene)
    scene.clock.now_ns = tick_ns
    assert scene.turn() == BURST
    assert beat.get() == tick_ns


@pytest.mark.parametrize(("early_ns", "whole"), [(main.EARLY_NS + 1, False), (main.EARLY_NS, True)])
def test_a_tick_that_is_due_soon_is_taken_with_the_board_s_bytes_and_saves_a_wake_up(
    scene: Scene, early_ns: int, whole: bool
) -> None:
    scene.turn()
    board_sends(scene)
    scene.clock.now_ns = scene.next_ns() - early_ns
    scene.turn()
    assert (scene.word("beat_ns") == scene.clock()) is whole


def test_bytes_of_the_board_do_not_end_the_port_owner(scene: Scene) -> None:
    scene.turn()
    board_sends(scene)
    scene.turn(MS)
    assert scene.stays


def test_bytes_of_the_board_hold_up_no_stop(scene: Scene) -> None:
    scene.turn()
    board_sends(scene)
    scene.ask_to_stop(b"hand near wheel")
    assert scene.turn().startswith(BURST)


def test_bytes_alone_are_no_news_of_a_descriptor_that_has_the_number_of_a_lost_port(scene: Scene) -> None:
    scene.turn()
    number = scene.owner.wire.fd
    scene.pty.close()
    until(lambda: scene.turn() == b"" and scene.owner.wire.lost, "the loss")
    scene.causes()
    scene.raise_epoch(2)
    scene.owner.turn({number: READ})
    assert scene.word("stopped_epoch") == 2, "a whole turn"
