"""The port owner, turn by turn: what it writes, and what it refuses to write."""

from __future__ import annotations

import pytest

from failstop.board import codec
from failstop.board.burst import BURST
from failstop.board.rrc.board import BOARD
from failstop.lab import encoders
from failstop.messages import box, layout, records
from failstop.policy import causes, kinematics
from failstop.policy.processes import PROCESS_BY_NAME
from failstop.procs.port_owner import main
from tests.support.port_scene import MOTION, SLOWER, TICK, Scene
from tests.support.stage import MS


@pytest.fixture
def scene() -> Scene:
    return Scene()


# Start.


def test_the_first_bytes_are_a_burst_for_the_epoch_it_finds(scene: Scene) -> None:
    assert scene.wire.read() == BURST
    assert scene.word("stopped_epoch") == 1
    assert scene.word("written_ns") == scene.clock()
    assert scene.port_state() == records.PORT_OPEN


def test_a_start_without_a_port_takes_the_one_that_it_is_sent_and_stops() -> None:
    scene = Scene(open_port=False)
    assert scene.port_state() == records.PORT_LOST
    assert scene.turn(MS) == b"", "it opens none itself"
    scene.send_port(scene.wire, 2)
    assert scene.turn() == BURST
    assert scene.port_state() == records.PORT_OPEN
    assert scene.port() == (2, scene.wire.link)
    assert scene.reasons() == []


def test_a_start_on_a_port_that_has_just_gone_is_a_device_lost() -> None:
    scene = Scene(before=lambda scene: scene.wire.unplug())
    scene.turn()
    assert scene.reasons() == ["device lost"]
    assert scene.port_state() == records.PORT_LOST


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


def test_a_bell_that_was_rung_does_not_keep_it_awake(scene: Scene) -> None:
    scene.turn()
    for rung in (scene.bell("bell"), scene.early.bell):
        rung.ring()
        scene.turn()
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


# Motion.


def test_of_several_good_frames_the_newest_is_written(scene: Scene) -> None:
    scene.drive()
    scene.put(MOTION)
    assert scene.forward(SLOWER, elapsed_ns=TICK) == SLOWER


def test_a_stop_ends_the_motion_queued_before_it_and_not_what_comes_after(scene: Scene) -> None:
    scene.drive()
    scene.put(MOTION)
    assert scene.forward(b"disabled", kind=records.WRITE_BURST) == BURST
    assert not scene.owner.admission.wheels_move
    scene.put(b"disabled", kind=records.WRITE_BURST)
    scene.put(SLOWER)
    assert scene.turn(TICK).endswith(BURST + SLOWER)
    assert scene.reasons() == []


def test_stops_of_the_gate_do_not_flood_the_wire(scene: Scene) -> None:
    scene.drive()
    for _ in range(50):
        scene.put(b"disabled", kind=records.WRITE_BURST)
    assert scene.turn() == BURST
    assert scene.forward(b"disabled", kind=records.WRITE_BURST, elapsed_ns=TICK - MS) == b""
    assert scene.forward(SLOWER) == SLOWER
    assert scene.forward(b"disabled", kind=records.WRITE_BURST) == BURST, "at once when something moves"


@pytest.mark.parametrize("frame", [{"age_ns": 60 * MS}, {"epoch": 2}], ids=str)
def test_a_late_frame_and_one_of_another_epoch_is_dropped(scene: Scene, frame: dict[str, int]) -> None:
    scene.turn()
    scene.put(**frame)  # type: ignore[arg-type]
    assert scene.answer() == (b"", [])


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


def test_a_motor_frame_in_another_s_clothes_never_passes(scene: Scene) -> None:
    scene.turn()
    scene.put(MOTION, kind=records.OTHER)
    scene.put(encoders.motor_stop_mask(15), kind=records.OTHER)
    assert scene.forward(codec.buzzer(1400, 100, 100, 1), kind=records.OTHER) == codec.buzzer(1400, 100, 100, 1)


def test_a_frame_that_finds_the_port_busy_goes_out_or_becomes_a_burst(scene: Scene) -> None:
    """Else the wheels would turn on until the gate's next refresh, 0.2 s later. Motion alone is dropped."""
    scene.drive()
    scene.wire.port.under_way = 27
    beep = codec.buzzer(1400, 100, 100, 1)
    assert scene.forward(beep, kind=records.OTHER) == beep
    assert scene.forward(SLOWER) == b""
    assert scene.forward(codec.STOP) == BURST


# Its own stops, and the epoch.


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
    """A cause after motion in the new epoch is answered anew."""
    scene.drive()
    scene.raise_epoch(2)
    scene.ask_to_stop(b"x")
    assert scene.forward(epoch=2) == BURST
    assert scene.causes()[0][0] == 2
    scene.raise_epoch(3)
    assert scene.forward(epoch=3) == MOTION
    scene.raise_epoch(4)
    assert scene.turn() == BURST


def test_the_epoch_is_looked_at_again_just_before_the_write(scene: Scene) -> None:
    scene.drive()
    scene.at_next("ioctl", lambda: scene.raise_epoch(2))
    assert scene.forward() == BURST


def test_it_says_that_it_moves_from_before_the_write_until_it_has_stopped(scene: Scene) -> None:
    """That the epoch is looked at in between is in test_pairs.py."""
    scene.turn()
    assert scene.word("moving") == 0, "the first burst has been written"
    moving = []
    scene.wire.on_bytes = lambda data: moving.append(scene.word("moving"))
    assert scene.forward() == MOTION
    assert moving[0] == 1
    assert scene.word("moving") == 1
    scene.raise_epoch(2)
    assert scene.turn() == BURST
    assert scene.word("moving") == 0


def pass_time(scene: Scene, ns: int) -> None:
    scene.clock.now_ns += ns


def test_held_up_behind_its_look_at_the_time_it_writes_nothing_old(scene: Scene) -> None:
    """The machine may starve it for seconds there, and nobody kills it for that. While the pipe rests it looks into it
    before each frame."""
    scene.ask_to_stop(b"x")
    scene.turn()
    scene.raise_epoch(2)
    scene.turn()
    scene.put(epoch=2)
    scene.at_next("select", lambda: pass_time(scene, 60 * MS))
    assert scene.turn() == BURST
    assert not scene.owner.admission.wheels_move


def test_a_burst_that_was_not_taken_whole_leaves_it_moving(scene: Scene) -> None:
    scene.drive()
    scene.wire.port.takes(100)
    scene.raise_epoch(2)
    scene.turn()
    assert scene.word("moving") == 1
    scene.wire.port.takes()
    scene.raise_epoch(3)
    scene.turn()
    assert scene.word("moving") == 0


def test_held_up_between_waking_and_writing_it_writes_nothing_old(scene: Scene) -> None:
    scene.drive()
    scene.put()
    scene.at_next("ioctl", lambda: pass_time(scene, 100 * MS))
    assert scene.turn() == b""
    assert scene.answer(alive=False) == (BURST, ["gate hangs: 100 ms silent"])


# While stopped.


def test_bursts_and_zero_frames_go_out_while_it_is_stopped(scene: Scene) -> None:
    scene.drive()
    scene.ask_to_stop(b"x")
    assert scene.turn() == BURST
    written = [(ms, wrote) for ms in range(1, 700) if (wrote := scene.turn(MS))]
    zeros = [(ms, codec.STOP) for ms in (200, 400, 600)]
    assert written == [(20, BURST), (100, BURST), *zeros]


def test_nothing_cuts_into_motion_but_that_the_gate_beats_and_sends_nothing(scene: Scene) -> None:
    """After two refresh periods it is a stop: the board would keep the last frame for ever."""
    scene.drive()
    assert [wrote for _ in range(400) if (wrote := scene.turn(MS))] == []
    assert scene.reasons() == []
    assert scene.answer(MS) == (BURST, ["gate beats but sends nothing: 401 ms"])
    assert scene.turn(MS) == b""


def test_it_wakes_just_when_the_gate_has_sent_nothing_for_too_long(scene: Scene) -> None:
    for _ in range(60):  # the quick pings of the start are over then
        scene.turn(10 * MS)
    scene.drive()
    for _ in range(39):
        scene.turn(10 * MS)
    assert scene.next_ns() == scene.clock() + 10 * MS + 1
    assert scene.turn(10 * MS) == b""
    assert scene.answer(1) == (BURST, ["gate beats but sends nothing: 400 ms"])


def test_it_wakes_for_its_repeats_and_does_not_spin(scene: Scene) -> None:
    scene.drive()
    for _ in range(10):
        scene.turn(30 * MS)
    now_ns = scene.clock()
    assert scene.next_ns() == now_ns + main.TICK_NS
    scene.ask_to_stop(b"x")
    scene.turn()
    scene.turn(15 * MS)
    assert scene.next_ns() == now_ns + 20 * MS


# The black box.


def test_the_black_box_has_all_that_was_written_and_what_the_port_did_not_take() -> None:
    scene = Scene(before=lambda scene: scene.wire.port.takes(100))
    assert scene.kept() == [(box.WIRE_BURST, len(BURST), 100)], "the first burst, which was written before"
    scene.turn()
    scene.wire.port.takes()
    scene.turn()
    assert scene.kept() == [(box.WIRE_REST, len(BURST) - 100, len(BURST) - 100)]
    scene.put()
    scene.turn()
    assert scene.kept() == [(box.WIRE_FRAME, len(MOTION), len(MOTION))]
    scene.wire.port.under_way = len(MOTION)
    scene.put(SLOWER)
    scene.turn()
    assert scene.kept() == [(box.WIRE_FRAME, len(SLOWER), 0)]
    scene.wire.port.takes(50)
    scene.ask_to_stop(b"x")
    scene.turn()
    assert scene.kept() == [(box.WIRE_BURST, len(BURST), 50)], "a stop is told from the rest of one"
