"""The port owner, turn by turn: what it writes for every cause, and what it refuses to write."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.board import codec, port
from failstop.board.burst import BURST
from failstop.procs.port_owner import admission, main
from failstop.procs.port_owner import wire as wire_module
from failstop.procs.port_owner.main import PortOwner
from failstop.shm import layout, records

from .parts import until
from .stage import MS, Dummy, Stage

MAX_RPS = 2.0
MOTION = codec.motor_speeds((0.8, 0.8, -0.8, -0.8), MAX_RPS)
SLOWER = codec.motor_speeds((0.4, 0.4, -0.4, -0.4), MAX_RPS)
TOO_FAST = codec.motor_speeds((50.0, 0.0, 0.0, 0.0), 60.0)
TICK = 20 * MS
POWER_SWITCH = "port does not drain: use the POWER SWITCH"


class Scene(Stage):
    """A port owner at work on its stage."""

    def __init__(self, directory: Path, monkeypatch: pytest.MonkeyPatch, *, open_port: bool = True) -> None:
        super().__init__(layout.PORT_OWNER, directory, open_port=open_port)
        monkeypatch.setattr(main, "monotonic_ns", self.clock)
        self.gate = self.start(layout.GATE)
        self.news = self.segment(layout.PORT_OWNER).ring_reader("stops")
        self.port_record = self.segment(layout.PORT_OWNER).latest_reader("port")
        self.stays = True
        self.owner = PortOwner(self)  # type: ignore[arg-type]

    def turn(self, elapsed_ns: int = 0, *, alive: bool = True) -> bytes:
        """Time passes, the others beat, the port owner wakes up; returns what it wrote."""
        self.clock.now_ns += elapsed_ns
        if alive:
            self.beat(layout.SUPERVISOR, layout.GATE)
        self.stays = self.owner.turn(self.owner.loop.wait(0))
        return self.pty.read() if self.pty.master >= 0 else b""

    def put(self, frame: bytes = MOTION, *, epoch: int = 1, age_ns: int = 0, kind: int = records.MOTION) -> None:
        self.frames.put(records.pack_frame(epoch, kind, frame), self.clock() - age_ns)

    def drive(self) -> None:
        """Get it to where a motion frame has just been written."""
        self.turn()
        self.put()
        assert self.turn() == MOTION
        assert self.owner.admission.moving

    def causes(self) -> list[tuple[int, int, str]]:
        """Stops that it has published since the last call: (epoch, when written, reason)."""
        found = []
        while entry := self.news.next():
            epoch, _, written_ns, _, reason = records.unpack_stop(entry[2])
            found.append((epoch, written_ns, reason))
        return found

    def reasons(self) -> list[str]:
        return [reason for _, _, reason in self.causes()]

    def word(self, name: str) -> int:
        return self.segment(layout.PORT_OWNER).word(name).get()

    def port_state(self) -> int:
        entry = self.port_record.read()
        assert entry is not None
        return records.unpack_port(entry[2])[2]

    def close(self) -> None:
        self.owner.wire.close()
        self.owner._control.close()
        super().close()


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Scene]:
    made = Scene(tmp_path, monkeypatch)
    yield made
    made.close()


class Kernel:
    """Takes at most `room` more bytes for the port, then EAGAIN; None takes everything."""

    def __init__(self, monkeypatch: pytest.MonkeyPatch) -> None:
        self.room: int | None = None
        self.taken = [0]

        class Os:
            write = staticmethod(self.write)
            read = staticmethod(os.read)
            close = staticmethod(os.close)

        monkeypatch.setattr(wire_module, "os", Os)

    def write(self, fd: int, data: bytes) -> int:
        if self.room is None:
            self.taken[0] = os.write(fd, data)
            return self.taken[0]
        part = data[: self.room]
        if not part:
            raise BlockingIOError
        self.room -= len(part)
        return os.write(fd, part)


@pytest.fixture
def kernel(monkeypatch: pytest.MonkeyPatch) -> Kernel:
    return Kernel(monkeypatch)


# Start.


def test_the_first_bytes_are_a_burst_for_the_epoch_it_finds(scene: Scene) -> None:
    assert scene.pty.read() == BURST
    assert scene.word("stopped_epoch") == 1
    assert scene.word("written_ns") == scene.clock()
    assert scene.port_state() == records.PORT_OPEN


def test_a_start_without_a_port_opens_it_and_stops(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(tmp_path, monkeypatch, open_port=False)
    assert scene.port_state() == records.PORT_LOST
    assert scene.turn() == BURST
    assert scene.port_state() == records.PORT_OPEN
    passed_on = scene.control.receive()
    assert os.ttyname(passed_on) == scene.pty.link
    os.close(passed_on)
    scene.close()


def test_a_start_on_a_port_that_has_just_gone_is_a_device_lost(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(main, "Wire", unplugged_first)
    scene = Scene(tmp_path, monkeypatch)
    scene.turn()
    assert scene.reasons() == ["device lost"]
    assert scene.port_state() == records.PORT_LOST
    scene.close()


def unplugged_first(fd: int) -> wire_module.Wire:
    made = wire_module.Wire(fd)
    made.lost = True
    return made


# Motion.


def test_a_good_frame_is_written(scene: Scene) -> None:
    scene.drive()
    scene.put(SLOWER)
    assert scene.turn(TICK) == SLOWER


def test_of_several_the_newest_is_written(scene: Scene) -> None:
    scene.turn()
    scene.put(MOTION)
    scene.put(SLOWER)
    assert scene.turn() == SLOWER


def test_a_stop_ends_the_motion_queued_before_it_and_not_what_comes_after(scene: Scene) -> None:
    scene.drive()
    scene.put(MOTION)
    scene.put(b"disabled", kind=records.STOP)
    assert scene.turn() == BURST
    assert not scene.owner.admission.moving
    scene.put(b"disabled", kind=records.STOP)
    scene.put(SLOWER)
    assert scene.turn() == BURST + SLOWER
    assert scene.reasons() == []


@pytest.mark.parametrize("age_ms", [60, 61, 5_000])
def test_a_late_frame_is_dropped(scene: Scene, age_ms: int) -> None:
    scene.turn()
    scene.put(age_ns=age_ms * MS)
    assert scene.turn() == b""
    assert scene.reasons() == []


@pytest.mark.parametrize("epoch", [0, 2, 2**64 - 1])
def test_a_frame_of_another_epoch_is_dropped(scene: Scene, epoch: int) -> None:
    scene.turn()
    scene.put(epoch=epoch)
    assert scene.turn() == b""
    assert scene.reasons() == []


@pytest.mark.parametrize(
    ("frame", "reason"),
    [
        (TOO_FAST, "wheel 0 at 50.00 rps"),
        (codec.PING, "not a motor frame"),
        (MOTION[:-1] + bytes((MOTION[-1] ^ 1,)), "bad crc"),
    ],
)
def test_content_that_may_not_be_is_a_stop(scene: Scene, frame: bytes, reason: str) -> None:
    scene.drive()
    scene.put(frame)
    assert scene.turn() == BURST
    assert scene.reasons()[0].startswith(reason)


def test_a_motor_frame_in_another_s_clothes_never_passes(scene: Scene) -> None:
    scene.turn()
    scene.put(MOTION, kind=records.OTHER)
    scene.put(codec.motor_stop_mask(15), kind=records.OTHER)
    scene.put(codec.buzzer(1400, 100, 100, 1), kind=records.OTHER)
    assert scene.turn() == codec.buzzer(1400, 100, 100, 1)


def test_a_zero_frame_that_finds_the_port_busy_becomes_a_burst(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    """Else the wheels would turn on until the gate's next refresh, 0.2 s later."""
    scene.drive()
    monkeypatch.setattr(port, "unsent_bytes", lambda fd: 27)
    scene.put(SLOWER)
    assert scene.turn() == b""
    scene.put(codec.STOP)
    assert scene.turn() == BURST


# Its own stops, and the epoch.


def test_its_own_stop_refuses_motion_until_a_newer_epoch(scene: Scene) -> None:
    scene.drive()
    scene.ask_to_stop(b"red button\n")
    scene.put()
    assert scene.turn() == BURST
    assert scene.causes() == [(1, scene.clock(), "red button")]
    scene.put()
    assert scene.turn() == b""
    scene.raise_epoch(2)
    scene.put(epoch=1)
    scene.put(epoch=2)
    assert scene.turn() == MOTION, "no second burst: the epoch was raised for the stop it had made"
    assert scene.word("stopped_epoch") == 2


def test_a_raised_epoch_is_a_stop_before_anything_of_the_new_one_moves(scene: Scene) -> None:
    scene.drive()
    scene.raise_epoch(2)
    scene.put(epoch=2)
    assert scene.turn() == BURST + MOTION
    assert scene.word("stopped_epoch") == 2


def test_an_epoch_raised_twice_at_once_is_one_stop(scene: Scene) -> None:
    scene.drive()
    scene.raise_epoch(5)
    scene.put(epoch=1)
    assert scene.turn() == BURST
    assert scene.word("stopped_epoch") == 5


def test_a_stop_in_an_epoch_not_seen_yet_refuses_that_one_too(scene: Scene) -> None:
    scene.drive()
    scene.raise_epoch(2)
    scene.ask_to_stop(b"x")
    scene.put(epoch=2)
    assert scene.turn() == BURST
    assert scene.causes()[0][0] == 2
    scene.raise_epoch(3)
    scene.put(epoch=3)
    assert scene.turn() == MOTION


def test_a_cause_after_motion_in_the_new_epoch_is_answered_anew(scene: Scene) -> None:
    scene.drive()
    scene.ask_to_stop(b"x")
    scene.turn()
    scene.raise_epoch(2)
    scene.put(epoch=2)
    assert scene.turn() == MOTION
    scene.raise_epoch(3)
    assert scene.turn() == BURST


def test_the_epoch_is_looked_at_again_just_before_the_write(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    scene.drive()

    def raised_meanwhile(frame: bytes, max_rps: float) -> str:
        scene.raise_epoch(2)
        return ""

    monkeypatch.setattr(admission, "check_motion", raised_meanwhile)
    scene.put()
    assert scene.turn() == BURST


class Slow:
    """A ring whose reader is held up, as by SIGSTOP, after it has read an entry."""

    def __init__(self, scene: Scene, held_up_ns: int) -> None:
        self._next = scene.owner._frames.next
        self._scene = scene
        self._held_up_ns = held_up_ns

    def next(self) -> tuple[int, int, bytes] | None:
        entry = self._next()
        if entry:
            self._scene.clock.now_ns += self._held_up_ns
        return entry


def test_held_up_between_waking_and_writing_it_writes_nothing_old(scene: Scene) -> None:
    scene.drive()
    scene.put()
    scene.owner._frames = Slow(scene, 100 * MS)  # type: ignore[assignment]
    assert scene.turn() == b""
    assert scene.turn(alive=False) == BURST
    assert scene.reasons() == ["gate hangs: silent for 100 ms"]


# Stop requests.


@pytest.mark.parametrize(
    ("message", "reason"),
    [
        (b"obstacle\n", "obstacle"),
        (b"first\nsecond\n", "first"),
        (b"\n", "stop request"),
        (b"\0", "?"),
        (b"\xff\xfe\x1b[31m", "\ufffd\ufffd?[31m"),
        (b"no end of line", "no end of line"),
    ],
)
def test_any_bytes_are_a_stop(scene: Scene, message: bytes, reason: str) -> None:
    scene.drive()
    scene.ask_to_stop(message)
    assert scene.turn() == BURST
    assert scene.reasons() == [reason]
    assert scene.turn() == b"", "the pipe is empty again"


def test_a_full_pipe_of_garbage_is_a_stop(scene: Scene) -> None:
    scene.drive()
    for _ in range(16):
        scene.ask_to_stop(b"\xfe" * 4096)
    assert scene.turn() == BURST
    reasons = scene.reasons()
    assert len(reasons) == 1
    assert len(reasons[0].encode()) <= 280


def test_a_flood_of_requests_is_no_flood_of_bursts(scene: Scene) -> None:
    scene.drive()
    scene.ask_to_stop(b"first\n")
    assert scene.turn() == BURST
    bursts = 0
    for _ in range(100):
        scene.ask_to_stop(b"again\n")
        bursts += scene.turn(MS).count(BURST)
    assert 5 <= bursts <= 12
    assert set(scene.reasons()) == {"first", "again"}
    assert scene.owner.next_ns(scene.clock()) > scene.clock()


def test_a_request_within_a_flood_stops_before_any_motion(scene: Scene) -> None:
    scene.drive()
    scene.ask_to_stop(b"first\n")
    scene.turn()
    scene.raise_epoch(2)
    scene.ask_to_stop(b"second\n")
    scene.put(epoch=2)
    assert scene.turn(MS) == BURST
    assert scene.reasons() == ["first", "second"]


def test_a_request_soon_after_motion_began_anew_is_not_put_off(scene: Scene) -> None:
    scene.drive()
    scene.ask_to_stop(b"first\n")
    scene.turn()
    scene.raise_epoch(2)
    scene.put(epoch=2)
    assert scene.turn(MS) == MOTION
    scene.ask_to_stop(b"second\n")
    assert scene.turn(MS) == BURST
    assert scene.reasons() == ["first", "second"]


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


@pytest.mark.parametrize(("gate_ms", "supervisor_ms"), [(60, 0), (0, 60), (60, 60), (10_000, 0)])
def test_a_lease_that_runs_out_while_moving_is_a_stop(scene: Scene, gate_ms: int, supervisor_ms: int) -> None:
    scene.drive()
    scene.clock.now_ns += 10_000 * MS
    scene.beat(layout.GATE, age_ns=gate_ms * MS)
    scene.beat(layout.SUPERVISOR, age_ns=supervisor_ms * MS)
    assert scene.turn(alive=False) == BURST
    name, silent_ms = ("gate", gate_ms) if gate_ms else ("supervisor", supervisor_ms)
    assert scene.reasons() == [f"{name} hangs: silent for {silent_ms} ms"]


def test_a_lease_is_good_until_the_last_nanosecond(scene: Scene) -> None:
    scene.drive()
    assert scene.turn(60 * MS - 1, alive=False) == b""
    assert scene.turn(1, alive=False) == BURST


def test_motion_does_not_begin_on_a_lease_that_has_run_out(scene: Scene) -> None:
    scene.turn()
    scene.clock.now_ns += 1_000 * MS
    scene.turn(alive=False)
    scene.put()
    assert MOTION not in scene.turn(alive=False)
    assert scene.reasons() == ["gate hangs: silent for 1000 ms"]


def test_silence_without_motion_is_nothing(scene: Scene) -> None:
    scene.turn()
    for _ in range(50):
        scene.turn(TICK, alive=False)
    assert scene.reasons() == []


# While stopped.


def test_bursts_again_and_zero_frames_while_stopped(scene: Scene) -> None:
    scene.drive()
    scene.ask_to_stop(b"x")
    assert scene.turn() == BURST
    written = [(ms, wrote) for ms in range(1, 700) if (wrote := scene.turn(MS))]
    zeros = [(ms, codec.STOP) for ms in (200, 400, 600)]
    assert written == [(20, BURST), (100, BURST), *zeros]


def test_nothing_cuts_into_motion(scene: Scene) -> None:
    scene.drive()
    assert [wrote for _ in range(500) if (wrote := scene.turn(MS))] == []


def test_it_wakes_for_its_repeats_and_does_not_spin(scene: Scene) -> None:
    scene.drive()
    scene.turn(1_000 * MS)
    now_ns = scene.clock()
    assert scene.owner.next_ns(now_ns) == now_ns + TICK
    scene.ask_to_stop(b"x")
    scene.turn()
    scene.turn(15 * MS)
    assert scene.owner.next_ns(scene.clock()) == now_ns + 20 * MS


# A port that does not drain.


def test_a_port_that_does_not_drain_is_a_stop_once(scene: Scene, monkeypatch: pytest.MonkeyPatch) -> None:
    scene.drive()
    held = [100]
    monkeypatch.setattr(port, "unsent_bytes", lambda fd: held[0])
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
    monkeypatch.setattr(port, "unsent_bytes", lambda fd: 100)
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
    monkeypatch.setattr(port, "unsent_bytes", lambda fd: held[0])
    for _ in range(30):
        held[0] = 0
        scene.put()
        assert scene.turn(TICK) == MOTION
        assert held[0] == len(MOTION)
    assert scene.reasons() == []


def test_a_stop_that_the_kernel_does_not_take_is_not_said_to_be_written(scene: Scene, kernel: Kernel) -> None:
    scene.drive()
    before_ns = scene.word("written_ns")
    scene.turn(5 * MS)
    kernel.room = 50
    scene.ask_to_stop(b"x")
    assert scene.turn() == BURST[:50]
    assert scene.causes() == [(1, 0, "x")]
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
    for _ in range(3):
        scene.turn(5 * MS)
    scene.replug()
    assert scene.turn(5 * MS) == BURST
    assert scene.port_state() == records.PORT_OPEN
    passed_on = scene.control.receive()
    assert os.ttyname(passed_on) == scene.pty.link
    os.close(passed_on)
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
    assert not scene.owner.admission.moving


def test_a_device_is_looked_for_often(scene: Scene) -> None:
    scene.turn()
    scene.pty.unplug()
    until(lambda: scene.owner.loop.wait(0), "the hang-up")
    scene.turn()
    assert scene.owner.next_ns(scene.clock()) - scene.clock() <= 5 * MS


def test_bytes_from_the_board_go_into_the_ring_in_order(scene: Scene) -> None:
    scene.turn()
    received = scene.segment(layout.PORT_OWNER).ring_reader("received", from_oldest=True)
    sent = bytes(range(256)) * 5
    os.write(scene.pty.master, sent)
    until(lambda: scene.owner.loop.wait(0), "the bytes")
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
