"""The port owner on boards that need silence on the line, that are deaf when they were opened, or that lose two stops
which touch."""

from __future__ import annotations

from itertools import pairwise
from typing import Any

import pytest

from failstop.board.interface import PORT_OWNER_ROW
from failstop.board.kinds import is_described
from failstop.messages import layout, records
from failstop.policy.layouts import BOARDS
from failstop.procs.loop import NEVER
from failstop.procs.peer import AFTER_LAST_NS, LEAVE_AFTER_NS
from failstop.procs.schedule import PING_GAP_NS, QUICK, ZERO_EVERY_NS
from tests.support.port_scene import TICK, Scene
from tests.support.stage import MS

MAX_RPS = 2.0
REFRESH_NS = 183 * MS
"""Of the gate, here, so that it falls on no repeat. It ends the repeats."""


def made(kind: str, **given: Any) -> Scene:
    changed: dict[str, Any] = {"board.kind": kind, **given}
    return Scene(**changed)


def motion(scene: Scene) -> bytes:
    return bytes(scene.board.motor_speeds((0.5,) * scene.board.wheels, MAX_RPS))


def hoverboard() -> Scene:
    """A board that needs silence on the line, with a silent line."""
    scene = made("hoverboard")
    writes(scene, 190 * MS)
    return scene


def waiting() -> Scene:
    """A stop is on the line, and motion waits behind it."""
    scene = hoverboard()
    scene.raise_epoch(2)
    assert scene.turn() == scene.board.burst
    scene.put(motion(scene), epoch=2)
    assert scene.turn() == b""
    return scene


def at_rest_after_motion(kind: str) -> tuple[Scene, tuple[int, ...]]:
    """A board that was told to turn its wheels and then a zero; and when a stop is written again. Nothing is asked
    meanwhile."""
    scene = made(kind)
    scene.turn()
    writes(scene, 6050 * MS)
    scene.owner.port.pings.wait(scene.clock() + 6000 * MS)
    first_motion(scene)
    writes(scene, 100 * MS)
    assert scene.forward(scene.board.stop) == scene.board.stop
    return scene, scene.board.repeats_ns[PORT_OWNER_ROW]


def first_motion(scene: Scene) -> None:
    """The first motion after a stop, which waits until the line has sent what sets the watchdog."""
    wrote = scene.forward(motion(scene))
    if scene.board.arming:
        assert wrote.endswith(scene.board.arming)
        wrote = scene.turn(len(scene.board.arming) * scene.board.port.byte_ns + scene.board.idle_ns)
    assert wrote.endswith(motion(scene))


def writes(scene: Scene, for_ns: int) -> list[tuple[int, bytes]]:
    """When it writes what, from now on."""
    begun_ns, found = scene.clock(), []
    while (left_ns := begun_ns + for_ns - scene.clock()) > 0:
        if data := scene.turn(min(left_ns, max(0, scene.next_ns() - scene.clock()))):
            found.append((scene.clock() - begun_ns, data))
    return found


@pytest.mark.parametrize("kind", ["hoverboard", "arduino", "damiao", "feetech", "ugv", "vesc"])
def test_a_stop_goes_out_at_once_and_again_at_the_port_owner_s_own_times(kind: str) -> None:
    scene = made(kind)
    scene.turn()
    scene.turn(6000 * MS)
    scene.turn()
    scene.raise_epoch(2)
    assert scene.turn(TICK // 2).startswith(scene.board.burst)
    row = scene.board.repeats_ns[PORT_OWNER_ROW]
    again = [at_ns for at_ns, data in writes(scene, row[-1] + 2 * ZERO_EVERY_NS) if scene.board.burst in data]
    first_zero_ns = max(ZERO_EVERY_NS, row[-1] + ZERO_EVERY_NS if row[-1] > ZERO_EVERY_NS else 0)
    assert again[: len(row) + 1] == [*row, first_zero_ns]


@pytest.mark.parametrize("kind", BOARDS)
def test_a_zero_of_the_gate_s_is_written_again_like_a_stop_because_it_may_be_lost(kind: str) -> None:
    """A hoverboard loses one frame in sixteen, and the gate's next one comes 0.2 s later."""
    scene, row = at_rest_after_motion(kind)
    begun_ns, found = scene.clock(), []
    for number in range(1, 6):
        after_ns = scene.clock() - begun_ns
        found += [(after_ns + at_ns, data) for at_ns, data in writes(scene, REFRESH_NS)]
        assert scene.forward(scene.board.stop) == scene.board.stop, f"refresh {number} of the gate's"
    assert found == [(at_ns, scene.board.burst) for at_ns in row if at_ns < REFRESH_NS]


@pytest.mark.parametrize("kind", BOARDS)
def test_motion_ends_the_repeats_of_a_zero(kind: str) -> None:
    scene, row = at_rest_after_motion(kind)
    scene.turn(row[0])
    scene.turn(MS)
    scene.put(motion(scene))
    assert [data for _, data in writes(scene, row[-1])] == [motion(scene)]


@pytest.mark.parametrize("kind", ["hoverboard", "arduino", "damiao", "ugv", "vesc"])
def test_it_says_that_it_moves_until_its_stop_can_not_be_lost(kind: str) -> None:
    """A hoverboard may lose one stop: behind motion its repeat tells that nothing moves, at a start its first one."""
    scene = made(kind, before=lambda scene: scene.own.word("moving").set(1))
    assert scene.word("moving") == 0
    scene.turn()
    scene.turn(6000 * MS)
    writes(scene, 150 * MS)
    first_motion(scene)
    assert scene.word("moving") == 1
    scene.raise_epoch(2)
    assert scene.turn(TICK // 2).startswith(scene.board.burst)
    assert scene.word("moving") == (kind == "hoverboard")
    scene.wire.port.takes(1)
    scene.turn(scene.board.repeats_ns[PORT_OWNER_ROW][0])
    assert scene.word("moving") == (kind == "hoverboard"), "until a burst was taken whole"
    scene.wire.port.takes()
    writes(scene, 120 * MS)
    assert scene.word("moving") == 0


@pytest.mark.parametrize("kind", BOARDS)
def test_an_orphan_stays_until_its_board_has_had_the_last_repeat_of_any_writer(kind: str) -> None:
    scene = made(kind)
    writes(scene, 190 * MS)
    scene.supervisor.kill()
    scene.turn()
    begun_ns = scene.clock()
    while scene.stays:
        scene.turn(MS)
    last_ns = max(at_ns for row in scene.board.repeats_ns for at_ns in row)
    assert scene.clock() - begun_ns == max(LEAVE_AFTER_NS, last_ns + AFTER_LAST_NS)


@pytest.mark.parametrize(("early_ns", "again"), [(1, False), (0, True)])
def test_a_stop_that_is_asked_for_again_goes_out_only_on_a_silent_line(early_ns: int, again: bool) -> None:
    """Else it would garble what is on the line, and itself. The next zero does it then."""
    scene = hoverboard()
    wire = scene.owner.wire
    assert wire.frame(scene.board.stop)
    scene.wire.read()
    scene.clock.now_ns = wire.free_ns - early_ns
    scene.views[layout.TELEMETRY].ring_writer("causes").put(b"")
    assert scene.turn() == (scene.board.burst if again else b"")


def test_what_a_board_echoes_is_kept_with_the_time_before_its_write() -> None:
    scene = hoverboard()
    scene.machine.look_ns = 1000
    assert scene.forward(motion(scene)) == motion(scene)
    *_, (_, kept_ns, _) = scene.kept_writes()
    assert kept_ns == scene.word("told_ns")


def test_motion_waits_until_the_line_has_been_silent_for_long_enough() -> None:
    scene = waiting()
    silent_ns = len(scene.board.burst) * scene.board.port.byte_ns + scene.board.idle_ns
    assert writes(scene, 2 * MS) == [(silent_ns, motion(scene))]


@pytest.mark.parametrize("kind", [kind for kind in BOARDS if is_described(kind)])
def test_the_first_motion_is_not_written_while_the_stop_before_it_is_on_the_line(kind: str) -> None:
    """A stop that is asked for at that moment would have to wait for both."""
    scene = made(kind)
    scene.turn()
    writes(scene, 6000 * MS)
    scene.raise_epoch(2)
    assert scene.board.burst in scene.turn()
    begun_ns = scene.clock()
    scene.put(motion(scene), epoch=2)
    first, *_ = (
        at_ns
        for at_ns, data in [(scene.clock() - begun_ns, scene.turn()), *writes(scene, 50 * MS)]
        if motion(scene) in data
    )
    assert first >= len(scene.board.burst) * scene.board.port.byte_ns


@pytest.mark.parametrize("by", ["a stop", "the gate"])
def test_motion_that_waits_is_ended_by_a_stop_or_the_gate_and_leaves_no_timer_behind(by: str) -> None:
    """A loop that waited for it still would never sleep again."""
    scene = waiting()
    if by == "a stop":
        scene.ask_to_stop(b"\n")
    else:
        scene.put(b"", kind=records.WRITE_BURST)
    assert scene.turn() == b"", "the stop on the line is this one's too"
    assert not any(motion(scene) in data for _, data in writes(scene, 200 * MS))


def test_a_stop_that_a_thread_has_written_is_not_written_again_at_once() -> None:
    """Without a gap between them both would be lost."""
    scene = hoverboard()
    scene.gate.kill()
    scene.early.tell(scene.gate.pid)
    assert scene.turn() == scene.board.burst


def test_the_port_counts_as_open_when_the_board_hears_and_has_been_told() -> None:
    scene = made("ugv")
    scene.turn()
    assert scene.port_record.read() is None
    assert not scene.asked, "nobody would answer"
    deaf_ns = scene.board.port.deaf_ns
    found = writes(scene, deaf_ns + TICK)
    assert scene.port_state() == records.PORT_OPEN
    when = [at_ns for at_ns, data in found if scene.board.port.opening[1] in data]
    assert len(when) == 1
    assert deaf_ns - TICK <= when[0] <= deaf_ns
    scene.turn(TICK)
    assert scene.asked


@pytest.mark.parametrize("kind", ["arduino", "ugv"])
def test_a_port_that_comes_back_counts_as_open_when_its_board_hears_again(kind: str) -> None:
    scene = made(kind, open_port=False)
    scene.turn()
    assert scene.port_state() == records.PORT_LOST, "that there is none is told at once"
    scene.replug(2)
    assert scene.turn().startswith(scene.board.burst)
    writes(scene, scene.board.port.deaf_ns - 1)
    assert (scene.port_state(), scene.asked) == (records.PORT_LOST, [])
    scene.turn(1)
    assert scene.port_state() == records.PORT_OPEN
    writes(scene, TICK)
    assert scene.asked == [0]
    writes(scene, QUICK * PING_GAP_NS)
    assert len(scene.asked) == 1 + QUICK, "answers to it may count for questions that were lost with the port before"


def test_a_board_is_told_all_at_once_though_its_port_holds_the_first_of_it() -> None:
    scene = made("ugv")
    scene.turn()
    writes(scene, scene.board.port.deaf_ns - 1)
    scene.wire.port.drains = False
    assert b"".join(scene.board.port.opening) in scene.turn(1)
    assert scene.port_state() == records.PORT_OPEN


def test_motion_to_a_board_without_pings_goes_behind_nothing_under_way() -> None:
    scene = hoverboard()
    scene.wire.port.under_way = 1
    assert scene.forward(motion(scene)) == b""
    scene.wire.port.under_way = 0
    assert scene.forward(motion(scene)) == motion(scene)


def test_a_successor_does_not_tell_it_again() -> None:
    """It asks at once: the board was not opened again."""

    def was_open(scene: Scene) -> None:
        record = scene.views[layout.PORT_OWNER].latest_writer("port")
        record.write(records.PORT.pack(1, scene.clock(), records.PORT_OPEN, scene.wire.link))

    scene = made("ugv", before=was_open)
    wrote = scene.turn() + b"".join(data for _, data in writes(scene, TICK))
    assert scene.asked
    wrote += b"".join(data for _, data in writes(scene, 6000 * MS))
    assert scene.board.port.opening[1] not in wrote


def test_stops_for_two_deaths_at_once_do_not_touch() -> None:
    """As when gate and telemetry end with the supervisor: a second stop behind the first would garble both."""
    scene = hoverboard()
    wire, stop = scene.owner.wire, scene.board.burst
    wire.early_stop()
    scene.clock.now_ns += MS // 2
    wire.early_stop()
    assert scene.wire.read() == stop
    assert wire.burst()
    assert scene.wire.read() == b""
    assert not wire.frame(motion(scene)), "the loop has not looked who has died"
    wire.heed()
    scene.clock.now_ns += MS
    wire.early_stop()
    assert scene.wire.read() == b"", "nothing but that stop was written since"
    scene.clock.now_ns += MS
    wire.early_stop()
    assert scene.wire.read() == stop
    wire.heed()
    scene.clock.now_ns += MS
    assert wire.frame(motion(scene))
    wire.early_stop()
    assert scene.wire.read() == motion(scene) + stop, "motion is no stop"


def test_repeats_that_are_late_do_not_touch() -> None:
    scene = hoverboard()
    scene.raise_epoch(2)
    scene.turn()
    late = [scene.turn(50 * MS), *(data for _, data in writes(scene, 10 * MS))]
    assert [data for data in late if data] == [scene.board.burst] * 3
    scene.raise_epoch(3)
    begun_ns = scene.clock()
    scene.turn()
    scene.clock.now_ns += 50 * MS
    times = [begun_ns + 50 * MS + at_ns for at_ns, _ in writes(scene, 10 * MS)]
    apart_ns = len(scene.board.burst) * scene.board.port.byte_ns + scene.board.idle_ns
    assert len(times) == 3
    assert all(after - before >= apart_ns for before, after in pairwise(times))


@pytest.mark.parametrize("room", [0, 30])
def test_what_the_port_does_not_take_whole_is_told_again_before_it_counts_as_open(room: int) -> None:
    scene = made("ugv")
    scene.turn()
    writes(scene, scene.board.port.deaf_ns - TICK)
    scene.wire.port.takes(room)
    arms = scene.board.port.opening[1]
    wrote = b"".join(data for _, data in writes(scene, 3 * TICK))
    assert arms not in wrote
    assert scene.port_record.read() is None
    scene.raise_epoch(2)
    scene.wire.port.takes()
    assert arms in b"".join(data for _, data in writes(scene, 3 * TICK))
    assert scene.port_state() == records.PORT_OPEN


def test_the_board_s_own_watchdog_is_set_before_the_first_motion_of_each_enable() -> None:
    """The board may have restarted since its port was opened, and has its own time again then."""
    scene = made("ugv")
    scene.turn()
    scene.turn(6000 * MS)
    for epoch in (2, 3):
        scene.raise_epoch(epoch)
        scene.turn()
        writes(scene, 10 * MS)
        assert scene.forward(motion(scene), epoch=epoch) == scene.board.arming
        sent_ns = len(scene.board.arming) * scene.board.port.byte_ns + scene.board.idle_ns
        assert writes(scene, 10 * MS) == [(sent_ns, motion(scene))], "a stop would wait for both"
        assert scene.forward(motion(scene), epoch=epoch) == motion(scene), "once is enough"


@pytest.mark.parametrize("kind", ["damiao", "ugv"])
@pytest.mark.parametrize("by", ["a repeat", "telemetry"])
def test_what_set_the_watchdog_before_a_stop_is_written_again_after_it(kind: str, by: str) -> None:
    """Such a stop switches a Damiao motor off."""
    scene = made(kind)
    scene.turn()
    writes(scene, 6000 * MS)
    scene.owner.port.pings.wait(scene.clock() + 6000 * MS)
    scene.raise_epoch(2)
    scene.turn()
    writes(scene, 10 * MS)
    assert scene.forward(motion(scene), epoch=2) == scene.board.arming
    if by == "a repeat":
        scene.put(b"", kind=records.WRITE_BURST, epoch=2)  # the gate does not want it any more
        assert scene.turn() == b""
        assert writes(scene, scene.board.repeats_ns[PORT_OWNER_ROW][0])[-1][1] == scene.board.burst
    else:
        scene.clock.now_ns += len(scene.board.arming) * scene.board.port.byte_ns + scene.board.idle_ns
        scene.views[layout.TELEMETRY].ring_writer("causes").put(b"")
        assert scene.turn() == scene.board.burst
    wrote = scene.forward(motion(scene), epoch=2) + b"".join(data for _, data in writes(scene, 20 * MS))
    assert wrote == scene.board.arming + motion(scene)


def test_the_first_motion_goes_behind_the_setting_of_the_watchdog_and_the_next_behind_a_ping_alone() -> None:
    """On a port that is still passing on what it was just given."""
    scene = made("ugv")
    scene.turn()
    scene.turn(6000 * MS)
    scene.owner.port.pings.wait(NEVER)
    scene.raise_epoch(2)
    writes(scene, 100 * MS)
    ping = len(scene.board.pings[0])
    scene.wire.port.drains = False
    assert scene.forward(motion(scene), epoch=2) == scene.board.arming
    assert [data for _, data in writes(scene, 10 * MS)] == [motion(scene)]
    scene.wire.port.drains = True
    for more, written in ((0, motion(scene)), (1, b"")):
        scene.wire.port.under_way = 0
        assert scene.owner.wire.frame(bytes(ping + more))
        scene.wire.read()
        scene.clock.now_ns += 10 * MS  # as far as can be reckoned, the line has sent it
        scene.wire.port.under_way = 1
        assert scene.forward(motion(scene), epoch=2) == written


def test_a_board_that_restarts_while_it_is_deaf_is_told_once_it_hears_and_not_before() -> None:
    """Telemetry sees the restart that opening the port has caused."""
    scene = made("ugv", open_port=False)
    scene.turn()
    scene.replug(2)
    scene.turn()
    writes(scene, 100 * MS)
    scene.views[layout.TELEMETRY].word("restarts").set(1)
    arms = scene.board.port.opening[1]
    assert arms not in b"".join(data for _, data in writes(scene, scene.board.port.deaf_ns - 100 * MS - 1))
    assert scene.port_state() == records.PORT_LOST
    assert arms in scene.turn(1)
    assert scene.port_state() == records.PORT_OPEN


def test_a_board_that_was_seen_to_restart_is_told_what_it_is_told_at_its_opening() -> None:
    scene = made("ugv")
    scene.turn()
    scene.turn(6000 * MS)
    writes(scene, 10 * MS)
    scene.views[layout.TELEMETRY].word("restarts").set(1)
    found = b"".join(data for _, data in writes(scene, 50 * MS))
    assert b"".join(scene.board.port.opening) in found
    assert scene.port_state() == records.PORT_OPEN


def asked(scene: Scene) -> list[tuple[int, bytes]]:
    """When it asked for the board's counts, from the record of its questions."""
    return [(t_ns, payload) for _, t_ns, payload in scene.kept_writes()]


def test_a_client_s_question_waits_for_a_silent_line_and_does_not_make_a_board_look_as_if_it_heard() -> None:
    scene = made("arduino")
    scene.turn()
    scene.turn(6000 * MS)
    writes(scene, 500 * MS)
    before, asked_ns = len(asked(scene)), scene.word("asked_ns")
    assert motion(scene) in scene.forward(motion(scene))
    scene.put(scene.board.pings[1], kind=records.OTHER)
    begun_ns, silent_ns = scene.clock(), scene.owner.wire.free_ns
    assert scene.turn() == b""
    scene.turn(scene.next_ns() - scene.clock())
    new = asked(scene)[before:]
    assert new[0][0] - begun_ns >= scene.board.idle_ns
    assert new[0][0] == silent_ns, "it wakes just then"
    assert new[0] == (new[0][0], records.WROTE.pack(1, ()))
    assert scene.word("asked_ns") == asked_ns


@pytest.mark.parametrize(("later_ns", "written"), [(0, False), (1, True)])
def test_a_client_s_question_to_a_board_that_is_still_deaf_is_dropped(later_ns: int, written: bool) -> None:
    scene = made("arduino", open_port=False)
    scene.turn()
    scene.replug(2)
    scene.turn()
    writes(scene, scene.owner.port.hears_ns - 1 - scene.clock())
    scene.put(scene.board.pings[1], kind=records.OTHER)
    scene.turn(later_ns)
    assert (records.WROTE.pack(1, ()) in [payload for _, payload in asked(scene)]) is written


@pytest.mark.parametrize(
    ("frame", "written"), [(b"w 11 1\r", True), (b"w 13 1\r", False), (b"m +9, +9\r", False), (b"", False)]
)
def test_a_client_s_frame_is_written_once_the_board_admits_it(frame: bytes, written: bool) -> None:
    scene = made("arduino")
    scene.turn()
    scene.turn(6000 * MS)
    writes(scene, 500 * MS)
    scene.put(frame, kind=records.OTHER)
    assert (frame in [data for _, data in writes(scene, 20 * MS)]) == written


def test_of_a_flood_of_clients_frames_the_newest_wait_for_the_line() -> None:
    scene = made("arduino")
    scene.turn()
    scene.turn(6000 * MS)
    writes(scene, 500 * MS)
    for number in range(60):
        scene.put(b"x 11 %d\r" % number, kind=records.OTHER)
    found = [data for _, data in writes(scene, 200 * MS) if data.startswith(b"x 11")]
    assert found == [b"x 11 0\r", *(b"x 11 %d\r" % number for number in range(52, 60))]
