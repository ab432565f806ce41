"""The port owner, turn by turn: what it writes, what it refuses to write, and stops that somebody asks for."""

from __future__ import annotations

import pytest

from failstop.board.rrc import codec
from failstop.board.rrc.board import BOARD
from failstop.board.rrc.burst import BURST
from failstop.messages import box, layout, records
from failstop.policy import causes, kinematics
from failstop.policy.processes import PROCESS_BY_NAME
from failstop.procs.port_owner import main
from tests.support import frames
from tests.support.port_scene import MOTION, SLOWER, TICK, Scene
from tests.support.stage import MS


def test_the_first_bytes_are_a_burst_for_the_epoch_it_finds(scene: Scene) -> None:
    assert scene.wire.read() == BURST
    assert (scene.word("stopped_epoch"), scene.word("written_ns")) == (1, scene.clock())
    assert scene.port_state() == records.PORT_OPEN


def test_from_its_first_byte_on_the_wheels_are_told_to_stand_whatever_the_process_before_it_told_them() -> None:
    told: list[int] = []

    def before(scene: Scene) -> None:
        scene.own.word("told_ns").set(5)
        scene.wire.on_bytes = lambda data: told.append(scene.word("told_ns"))

    assert Scene(before=before).word("told_ns") == 0
    assert set(told) == {0}


@pytest.mark.parametrize("gone", [False, True])
def test_a_start_without_a_port_takes_the_one_that_it_is_sent_and_stops(gone: bool) -> None:
    scene = Scene(before=lambda scene: scene.wire.unplug()) if gone else Scene(open_port=False)
    assert scene.turn(MS) == b"", "it opens none itself"
    assert scene.port_state() == records.PORT_LOST
    assert scene.reasons() == ["device lost"] * gone
    if gone:
        scene.replug(2)
    else:
        scene.send_port(scene.wire, 2)
    assert scene.answer() == (BURST, [])
    assert (scene.port_state(), scene.port()) == (records.PORT_OPEN, (2, scene.wire.link))


def test_it_waits_for_both_deaths_at_its_own_futexes(scene: Scene) -> None:
    """Its first stop does not wait for the kernel to take the dying gate down: on one core it would, in a thread that
    does not run above it."""
    scene.turn()
    assert scene.early.watched == [(scene.supervisor.pid, layout.SUPERVISOR_BLOCK, 0), (scene.gate.pid, 3, 1)]
    assert scene.early.dying[scene.gate.pid] == PROCESS_BY_NAME[layout.GATE].priority


def test_a_key_that_rings_before_the_bell_is_cleared_is_heard_in_the_same_turn(scene: Scene) -> None:
    """Its bell is not taken for one of before."""
    scene.turn()

    def press() -> None:
        scene.views[layout.TELEMETRY].ring_writer("causes").put(causes.KEY(1).pack())
        scene.bell("bell").ring()

    scene.bell("bell").ring()
    scene.at_next("read", press)
    assert scene.answer() == (BURST, ["key1"])


def test_a_bell_that_was_rung_wakes_it_once(scene: Scene) -> None:
    scene.turn()
    for rung in (scene.bell("bell"), scene.early.bell):
        rung.ring()
        assert rung.fd in scene.owner.loop.wait(0)
        assert scene.owner.loop.wait(0) == {}


def test_at_the_early_news_the_first_stop_goes_out_before_the_loop_has_woken(scene: Scene) -> None:
    for pid in (scene.gate.pid, scene.supervisor.pid):
        scene.turn()
        scene.wire.read()
        scene.early.tell(pid)
        assert scene.wire.read() == BOARD.first_stop
        assert scene.turn() == BURST


def test_no_motion_follows_an_early_stop_that_comes_in_mid_turn(scene: Scene) -> None:
    """Deaths have been looked at in this turn, and the frame is good."""
    scene.drive()
    scene.put(SLOWER)
    scene.at_next("ioctl", lambda: scene.early.tell(scene.gate.pid))
    assert scene.turn() == BOARD.first_stop
    scene.put(SLOWER)
    assert scene.answer() == (BURST, ["gate died"])


def test_a_stop_ends_the_motion_queued_before_it_and_not_what_comes_after(scene: Scene) -> None:
    def disable(elapsed_ns: int = 0) -> bytes:
        return scene.forward(b"disabled", kind=records.WRITE_BURST, elapsed_ns=elapsed_ns)

    scene.drive()
    scene.put(MOTION)
    assert scene.forward(SLOWER, elapsed_ns=TICK) == SLOWER, "of several good frames the newest"
    scene.put(MOTION)
    assert disable() == BURST
    assert not scene.owner.admission.wheels_move
    for _ in range(50):
        scene.put(b"disabled", kind=records.WRITE_BURST)
    assert disable(TICK - MS) == b"", "a flood of them is none on the wire"
    scene.put(b"disabled", kind=records.WRITE_BURST)
    assert scene.forward(SLOWER, elapsed_ns=TICK).endswith(BURST + SLOWER)
    assert disable() == BURST, "at once when something moves"
    assert scene.reasons() == []


def test_a_stop_of_the_gate_s_is_written_from_20_ms_after_the_last_on(scene: Scene) -> None:
    last_ns = scene.word("written_ns")
    for after_ns, written_ns in ((TICK - 1, last_ns), (1, last_ns + TICK)):
        scene.forward(b"disabled", kind=records.WRITE_BURST, elapsed_ns=after_ns)
        assert scene.word("written_ns") == written_ns


def test_motion_that_the_gate_sends_while_a_stop_is_latched_is_a_stop(scene: Scene) -> None:
    scene.turn()
    latch = records.LATCH.pack(1, scene.clock(), scene.clock(), causes.KEY(1).pack())
    scene.views[layout.SUPERVISOR].latest_writer("latch").write(latch)
    scene.put()
    assert scene.answer() == (BURST, ["internal error: gate: motion while a stop is latched"])


def test_a_zero_frame_is_never_too_late(scene: Scene) -> None:
    scene.drive()
    assert scene.forward(BOARD.stop, age_ns=75 * MS) == BURST
    assert not scene.owner.admission.wheels_move
    assert scene.reasons() == []
    assert scene.forward(SLOWER) == SLOWER, "and nothing is latched by it"


def test_the_fastest_wheel_that_the_settings_allow_passes_and_a_faster_one_does_not(scene: Scene) -> None:
    scene.turn()
    rps = kinematics.max_wheel_rps(scene.settings)
    fastest, faster = (codec.motor_speeds((factor * rps, 0.0, 0.0, -rps), 60.0) for factor in (1.0, 1.01))
    assert scene.forward(fastest) == fastest
    assert scene.forward(faster) == BURST
    assert scene.reasons()[0].startswith("the gate's frame was refused: wheel 0 at ")


def test_a_frame_that_finds_the_port_busy_goes_out_or_becomes_a_burst(scene: Scene) -> None:
    """Else the wheels would turn on until the gate's next refresh, 0.2 s later. Motion alone is dropped."""
    scene.drive()
    for disguised in (MOTION, frames.motor_stop_mask(15)):
        assert scene.forward(disguised, kind=records.OTHER) == b"", "a motor frame in another's clothes"
    scene.wire.port.under_way = 27
    beep = codec.buzzer(1400, 100, 100, 1)
    assert scene.forward(beep, kind=records.OTHER) == beep
    assert scene.forward(SLOWER) == b""
    assert scene.forward(codec.STOP) == BURST
    scene.wire.port.under_way = 0
    assert scene.turn(20 * MS) == BURST, "and again, like any stop"


def test_its_own_stop_refuses_motion_until_a_newer_epoch(scene: Scene) -> None:
    scene.drive()
    scene.ask_to_stop(b"red button\n")
    scene.put()
    asked_ns = scene.clock()
    assert scene.turn() == BURST
    assert scene.causes() == [(1, asked_ns, "stop request: red button")], "written before it gave way"
    assert scene.forward() == b""
    scene.raise_epoch(2)
    scene.put(epoch=1)
    assert scene.forward(epoch=2) == MOTION, "no second burst: the epoch was raised for the stop it had made"
    assert scene.word("stopped_epoch") == 2


def test_a_raised_epoch_is_one_stop_before_anything_of_the_new_one_moves(scene: Scene) -> None:
    scene.drive()
    scene.raise_epoch(2)
    scene.raise_epoch(5)
    assert scene.forward(epoch=1) == BURST
    assert scene.word("stopped_epoch") == 5
    scene.raise_epoch(6)
    assert scene.forward(epoch=6) == BURST + MOTION
    assert scene.word("stopped_epoch") == 6


def test_a_stop_in_an_epoch_not_seen_yet_refuses_it_and_the_next_is_answered(scene: Scene) -> None:
    scene.drive()
    scene.raise_epoch(2)
    scene.ask_to_stop(b"x")
    assert scene.forward(epoch=2) == BURST
    assert scene.causes()[0][0] == 2
    scene.raise_epoch(3)
    assert scene.forward(epoch=3) == MOTION
    scene.at_next("ioctl", lambda: scene.raise_epoch(4))
    assert scene.forward(epoch=3) == BURST, "it is looked at again just before the write"


def test_it_says_that_it_moves_from_before_the_write_until_it_has_stopped(scene: Scene) -> None:
    """That the epoch is looked at in between is in test_pairs.py."""
    scene.turn()
    assert scene.word("moving") == 0, "the first burst has been written"
    moving = []
    scene.wire.on_bytes = lambda data: moving.append(scene.word("moving"))
    assert scene.forward() == MOTION
    assert (moving[0], scene.word("moving")) == (1, 1)
    for epoch, room, moves in ((2, 100, 1), (3, None, 0)):
        scene.wire.port.takes(room)
        scene.raise_epoch(epoch)
        scene.turn()
        assert scene.word("moving") == moves, "until a burst was taken whole"


@pytest.mark.parametrize(("call", "held_ms", "wrote"), [("select", 60, BURST), ("ioctl", 100, b"")])
def test_held_up_behind_its_look_it_writes_nothing_old(scene: Scene, call: str, held_ms: int, wrote: bytes) -> None:
    """The machine may starve it for seconds there, and nobody kills it for that. While the pipe rests it looks into it
    before each frame; else it is held up between waking and writing."""

    def pass_time() -> None:
        scene.clock.now_ns += held_ms * MS

    if call == "select":
        scene.ask_to_stop(b"x")
        scene.turn()
        scene.raise_epoch(2)
        scene.turn()
        scene.put(epoch=2)
    else:
        scene.drive()
        scene.put()
    scene.at_next(call, pass_time)
    assert scene.turn() == wrote
    if call == "ioctl":
        assert scene.answer(alive=False) == (BURST, ["gate hangs: 100 ms silent"])
    assert not scene.owner.admission.wheels_move


def test_nothing_cuts_into_motion_but_that_the_gate_beats_and_sends_nothing(scene: Scene) -> None:
    """After two refresh periods it is a stop: the board would keep the last frame for ever."""
    for _ in range(60):  # the quick pings of the start are over then
        scene.turn(10 * MS)
    scene.drive()
    for _ in range(39):
        assert scene.answer(10 * MS) == (b"", [])
    assert scene.next_ns() == scene.clock() + 10 * MS + 1, "it wakes just then"
    assert scene.turn(10 * MS) == b""
    assert scene.answer(1) == (BURST, ["gate runs but has sent nothing for 400 ms"])


def test_it_wakes_for_its_repeats_and_does_not_spin(scene: Scene) -> None:
    scene.drive()
    for _ in range(10):
        scene.turn(30 * MS)
    now_ns = scene.clock()
    assert scene.next_ns() == now_ns + main.TICK_NS
    scene.ask_to_stop(b"x")
    assert scene.turn() == BURST
    scene.turn(15 * MS)
    assert scene.next_ns() == now_ns + 20 * MS
    written = [(15 + ms, wrote) for ms in range(1, 600) if (wrote := scene.turn(MS))]
    assert written == [(20, BURST), (100, BURST), *((ms, codec.STOP) for ms in (200, 400, 600))]


def test_the_black_box_has_all_that_was_written_and_what_the_port_did_not_take() -> None:
    whole, part = len(BURST), len(MOTION)
    scene = Scene(before=lambda scene: scene.wire.port.takes(100))
    assert scene.kept() == [(box.WIRE_BURST, whole, 100)], "the first burst, which was written before"
    scene.turn()
    scene.wire.port.takes()
    scene.turn()
    assert scene.kept() == [(box.WIRE_REST, whole - 100, whole - 100)]
    for frame, taken in ((MOTION, part), (SLOWER, 0)):
        scene.wire.port.under_way = part - taken
        scene.forward(frame)
        assert scene.kept() == [(box.WIRE_FRAME, part, taken)]
    scene.wire.port.takes(50)
    scene.ask_to_stop(b"x")
    scene.turn()
    assert scene.kept() == [(box.WIRE_BURST, whole, 50)], "a stop is told from the rest of one"


@pytest.mark.parametrize(
    ("line", "reason"),
    [
        *(
            (b"obstacle", ": obstacle"),
            (b"", ""),
            (b"\tnav\t3", " (says it is nav, pid 3)"),
            (b"obstacle\tnav\tx", ": obstacle?nav?x"),
        ),
        *((b"gate died", ": gate died"), (b"gamepad button 0x0100", ": gamepad button 0x0100")),
        *((b"\0", ": ?"), (b"\xff\xfe\x1b[31m", ": \ufffd\ufffd?[31m")),
    ],
)
def test_a_line_of_the_pipe_is_somebody_s_words_whatever_it_says(line: bytes, reason: str) -> None:
    assert str(causes.requested(line)) == f"stop request{reason}"


@pytest.mark.parametrize(
    ("message", "said"),
    [
        (b"obstacle\tnav\t3\n", "stop request: obstacle (says it is nav, pid 3)"),
        (b"first\nsecond\n", "stop request: first"),
        (b"no end of line", "stop request: no end of line"),
        (b"\xfe" * 16 * 4096, ""),
    ],
    ids=["", "two lines", "no line", "a full pipe of garbage"],
)
def test_any_bytes_are_a_stop(scene: Scene, message: bytes, said: str) -> None:
    scene.drive()
    scene.ask_to_stop(message)
    assert scene.turn() == BURST
    (reason,) = scene.reasons()
    assert not said or reason == said
    assert len(reason.removeprefix("stop request: ").encode()) <= causes.ARGUMENTS_BYTES
    assert scene.turn() == b"", "the pipe is empty again"


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


def test_the_next_request_is_looked_at_when_the_pipe_s_rest_is_over(scene: Scene) -> None:
    scene.wire.read()
    scene.ask_to_stop(b"first\n")  # it waits at the start
    asked_ns = scene.clock()
    assert scene.turn() == BURST
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
        assert scene.forward(epoch=2, elapsed_ns=MS) == MOTION
        scene.ask_to_stop(b"second\n")
    else:
        scene.ask_to_stop(b"second\n")
        scene.put(epoch=2)
    assert scene.answer(MS) == (BURST, ["stop request: first", "stop request: second"])


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


def test_the_stop_is_written_again_without_a_cause(scene: Scene) -> None:
    scene.turn()
    epoch = scene.word("stopped_epoch")
    scene.views[layout.TELEMETRY].ring_writer("causes").put(b"")
    assert scene.answer() == (BURST, [])
    assert scene.word("stopped_epoch") == epoch
    assert scene.forward() == MOTION, "nothing has to be enabled again"


def test_a_key_that_follows_such_a_request_is_heard_in_the_same_turn(scene: Scene) -> None:
    scene.turn()
    telemetry = scene.views[layout.TELEMETRY].ring_writer("causes")
    telemetry.put(b"")
    telemetry.put(causes.KEY(1).pack())
    assert scene.answer() == (BURST + BURST, ["key1"])


@pytest.mark.parametrize(("handed", "written"), [(128, BURST), (129, b"")])
def test_the_stop_is_written_again_behind_a_little_under_way_and_behind_no_more(
    scene: Scene, handed: int, written: bytes
) -> None:
    for _ in range(60):  # the quick pings of the start are over then
        scene.turn(TICK)
    assert scene.owner.wire.frame(bytes(handed))
    scene.wire.read()
    scene.wire.port.under_way = 1
    scene.views[layout.TELEMETRY].ring_writer("causes").put(b"")
    assert scene.turn() == written
