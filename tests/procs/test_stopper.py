"""The stopper, turn by turn: what makes it write, and when it leaves."""

from __future__ import annotations

import pytest

from failstop.board.rrc.board import BOARD
from failstop.board.rrc.burst import BURST
from failstop.messages import layout, records
from failstop.policy.processes import HANG_NS, PROCESS_BY_NAME
from failstop.procs import starved
from failstop.procs.stopper.main import STALLED_NS
from failstop.shm import heartbeat
from failstop_lab.machine.files import Null, Open
from tests.support.arm_settings import ARM, SERVOS
from tests.support.stage import MS, Wire
from tests.support.stopper_scene import Scene


@pytest.fixture
def other(scene: Scene) -> Wire:
    """The port of a board that comes after the first."""
    return Wire(scene.machine, 1)


def test_it_waits_for_both_deaths_at_its_own_futexes(scene: Scene) -> None:
    """Its first stop does not wait until the dying port owner is taken down: on one core it would, in a thread that
    does not run above it."""
    assert scene.early.watched == [(scene.supervisor.pid, layout.SUPERVISOR_BLOCK, 1), (scene.port_owner.pid, 3, 1)]
    assert scene.early.dying[scene.port_owner.pid] == PROCESS_BY_NAME[layout.PORT_OWNER].priority


def test_it_is_silent_while_all_is_well_and_sleeps_though_a_bell_was_rung(scene: Scene) -> None:
    assert scene.written(300) == []
    scene.raise_epoch(2)
    assert scene.turn() == b""
    for rung in (scene.bell("bell"), scene.early.bell):
        rung.ring()
        assert rung.fd in scene.stopper.loop.wait(0), "it wakes up"
        assert scene.stopper.loop.wait(0) == {}
        assert scene.turn() == b""
    scene.views[layout.PORT_OWNER].word("beat_state").set(heartbeat.BEAT_STARTING)
    assert scene.written(600, alive=False) == [], "a port owner that is only starting does not hang"
    assert scene.stays


def test_the_port_owner_s_death_is_answered_until_the_next_has_stopped_itself(scene: Scene) -> None:
    scene.port_owner.kill()
    assert scene.turn() == BURST
    assert scene.own.word("written_ns").get() == scene.clock()
    assert scene.written(500) == [(ms, BURST) for ms in (20, 100, 300, 500)], "zeros between the supervisor's"
    assert scene.stays
    following = scene.start(layout.PORT_OWNER)
    scene.turn()
    following.kill()
    assert scene.turn() == BURST
    scene.start(layout.PORT_OWNER, heartbeat.BEAT_STARTING)
    assert scene.written(50) == [(20, BURST)], "it is named, and still starting"
    scene.runs(layout.PORT_OWNER)
    assert scene.written(500) == []


def test_the_burst_stops_an_arm_too() -> None:
    scene = Scene(changed=ARM)
    scene.port_owner.kill()
    assert scene.turn() == BOARD.burst + BOARD.arm.stops(SERVOS)


def test_at_the_early_news_the_first_stop_goes_out_before_the_loop_has_woken(scene: Scene) -> None:
    scene.early.tell(scene.port_owner.pid)
    assert scene.wire.read() == BOARD.first_stop
    assert scene.turn() == BURST
    scene.early.tell(scene.supervisor.pid)
    assert scene.wire.read() == b"", "it is the port owner's to answer first"


@pytest.mark.parametrize("before", [True, False])
def test_a_stopper_that_was_held_up_does_not_cut_into_the_motion_of_the_next(scene: Scene, before: bool) -> None:
    """It was held up before its first burst, or before the repeats."""
    scene.port_owner.kill()
    if not before:
        assert scene.turn() == BURST
    scene.start(layout.PORT_OWNER)
    if before:
        scene.early.tell(scene.port_owner.pid)
    assert scene.turn(100 * MS) == b""
    assert scene.written(500) == []


def test_a_port_owner_that_died_before_the_news_came_is_answered(scene: Scene) -> None:
    scene.port_owner.kill()
    scene.start(layout.PORT_OWNER, heartbeat.BEAT_STARTING)
    scene.stopper.turn({})
    assert scene.wire.read() == BURST


def test_the_first_port_owner_that_is_named_and_the_next_are_watched() -> None:
    scene = Scene(named=False)
    assert scene.written(300, alive=False) == []
    for _ in range(2):
        named = scene.start(layout.PORT_OWNER)
        scene.written(200)
        named.kill()
        assert scene.turn() == BURST


def test_the_supervisor_s_death_lets_the_port_owner_go_first(scene: Scene) -> None:
    scene.supervisor.kill()
    assert scene.turn() == b""
    assert 0 < scene.next_ns() - scene.clock() < MS, "it looks again soon"
    scene.port_owner_writes()
    assert scene.turn() == BURST
    assert scene.written(149) == [(20, BURST), (100, BURST)]
    assert scene.port_owner.lives(), "it has answered"
    assert scene.stays
    scene.turn(MS)
    assert not scene.stays


def test_an_orphan_stays_until_the_port_has_passed_on_the_stop(scene: Scene) -> None:
    """The kernel drops what it holds at the last close, and the stopper may be the last that has the port open."""
    scene.port_owner.kill()
    scene.supervisor.kill()
    scene.turn()
    scene.wire.port.under_way = 1
    scene.written(170)
    assert scene.stays
    scene.wire.port.under_way = 0
    assert scene.next_ns() - scene.clock() <= 5 * MS
    scene.turn(5 * MS)
    assert not scene.stays


def test_the_stopper_does_not_wait_long_for_the_port_owner(scene: Scene) -> None:
    scene.supervisor.kill()
    assert scene.turn() == b""
    assert scene.written(22, alive=False) == [(3, BURST)]
    assert scene.turn(MS, alive=False) == BURST, "again after 20 ms, and now it is fenced"
    assert scene.turn(MS, alive=False) == BURST, "again, now that nothing of it can follow"
    assert scene.written(150, alive=False) == [(20, BURST), (100, BURST)]
    assert not scene.stays


@pytest.mark.parametrize("dies", ["long before", "at once", "meanwhile"])
def test_when_the_port_owner_dies_too_it_does_not_wait_for_it(scene: Scene, dies: str) -> None:
    if dies != "meanwhile":
        scene.port_owner.kill()
    if dies == "long before":
        scene.turn()
    scene.supervisor.kill()
    if dies == "meanwhile":
        assert scene.turn() == b""
        scene.port_owner.kill()
    assert scene.turn().startswith(BURST)


@pytest.mark.parametrize("holds_the_port", [True, False])
def test_a_port_owner_that_hangs_is_fenced_before_the_burst(scene: Scene, holds_the_port: bool) -> None:
    """One that wakes up between the two could write a frame after the burst. Nobody but the supervisor opens a port:
    what is silent hangs, also without one."""
    lived: list[bool] = []
    scene.wire.on_bytes = lambda data: lived.append(scene.port_owner.lives())
    if not holds_the_port:
        scene.stopper.held.let_go()
    assert scene.written(249, alive=False) == []
    assert scene.port_owner.lives()
    assert scene.next_ns() == scene.clock() + MS, "it looks again just when it is time"
    assert scene.turn(MS, alive=False) == BURST * holds_the_port
    assert not scene.port_owner.lives()
    if holds_the_port:
        assert scene.next_ns() == scene.clock() + 20 * MS, "for the repeat, and not to look for a hang"
        assert scene.turn(MS, alive=False) == BURST, "again, now that nothing of it can follow"
        assert scene.written(500, alive=False) == [(ms, BURST) for ms in (20, 100, 300, 500)]
        assert not any(lived)


@pytest.mark.parametrize(("late_ns", "fences_ms"), [(5_000 * MS, 250), (STALLED_NS, 50)], ids=["frozen", "late itself"])
def test_a_stopper_that_was_frozen_with_the_rest_waits_anew(scene: Scene, late_ns: int, fences_ms: int) -> None:
    assert scene.turn(late_ns, alive=False) == b""
    assert scene.written(fences_ms, alive=False) == [(fences_ms, BURST)]


def test_a_stopper_that_is_started_anew_counts_a_silence_from_before_it(scene: Scene) -> None:
    """The one before has died meanwhile, and the supervisor may be silent too: nobody else would end it."""
    scene.clock.now_ns += HANG_NS - MS
    scene.stopper = scene.load("failstop.procs.stopper.main").Stopper(scene)
    assert scene.turn(alive=False) == b""
    assert scene.turn(MS, alive=False) == BURST


def test_a_port_that_the_port_owner_has_given_up_is_let_go(scene: Scene) -> None:
    for number, let_go in ((0, False), (2, False), (1, True)):
        lost = records.PORT.pack(number, scene.clock() + 1, records.PORT_LOST, "/dev/board")
        scene.views[layout.PORT_OWNER].latest_writer("port").write(lost)
        scene.turn(MS)
        assert (scene.fd("port") not in scene.me.files) is let_go


@pytest.mark.parametrize("number", [1, 2])
def test_a_port_that_it_has_let_go_alone_is_taken_when_it_is_sent_again(scene: Scene, other: Wire, number: int) -> None:
    """A write of its own failed, and the others have kept it; or it had no descriptor free for the second: the message
    arrives without it."""
    scene.stopper.held.let_go()
    if number == 2:
        scene.os.write(scene.control.fd, bytes(8))
    scene.turn()
    assert scene.own.word("port_number").get() == 0
    scene.send_port(other, number)
    scene.turn()
    assert scene.own.word("port_number").get() == number
    scene.port_owner.kill()
    scene.turn()
    assert other.read() == BURST


@pytest.mark.parametrize("number", [0, 1])
def test_a_port_that_it_has_already_is_not_taken_again(scene: Scene, other: Wire, number: int) -> None:
    before = scene.open_fds()
    scene.send_port(other, number)
    scene.turn()
    assert scene.open_fds() == before
    assert scene.fd("port") in scene.me.files


@pytest.mark.parametrize("noticed_by", ["its hang-up", "a write", "none"])
def test_a_port_that_has_gone_is_let_go_and_said_not_to_be_held(scene: Scene, other: Wire, noticed_by: str) -> None:
    fd, number, stdout = scene.fd("port"), scene.own.word("port_number"), Null()
    scene.me.files[1] = Open(stdout)
    assert number.get() == 1
    if noticed_by == "none":  # the service has none
        scene.stopper.held.let_go()
    else:
        scene.wire.unplug()
    if noticed_by == "a write":
        scene.port_owner.kill()
        scene.stopper.turn(scene.news_of(scene.port_owner))
    else:
        scene.turn()
        scene.port_owner.kill()
        assert scene.turn() == b""
    with pytest.raises(OSError, match="Bad file descriptor"):
        scene.os.fstat(fd)
    assert (number.get(), scene.own.word("written_ns").get()) == (0, 0)
    assert stdout.heard == []
    scene.send_port(other, 2)
    scene.turn(MS)
    assert number.get() == 2


@pytest.mark.parametrize("hung_up", [False, True])
def test_a_port_that_was_opened_anew_is_adopted(scene: Scene, other: Wire, hung_up: bool) -> None:
    old = scene.fd("port")
    if hung_up:
        scene.wire.unplug()
    scene.send_port(other, 2)
    scene.turn()
    assert hung_up or old not in scene.me.files
    scene.port_owner.kill()
    assert scene.turn() == b""
    assert other.read() == BURST


def test_a_full_port_and_a_supervisor_s_closed_socket_hold_nothing_up(scene: Scene) -> None:
    scene.wire.fill()
    scene.port_owner.kill()
    scene.stopper.turn(scene.stopper.loop.wait(0))
    assert scene.own.word("written_ns").get() == 0
    scene.wire.read()
    assert BURST in b"".join(wrote for _, wrote in scene.written(100))
    scene.supervisor.kill()
    scene.control.close()
    scene.turn()
    scene.turn()
    assert scene.fd("control") not in scene.stopper.loop.wait(0)


def test_a_starved_port_owner_that_moves_nothing_is_left_alone_but_not_for_ever(scene: Scene) -> None:
    scene.port_owner.starve()
    assert scene.written(600, alive=False) == []
    scene.turn()
    assert scene.written(249, alive=False) == []
    assert scene.port_owner.lives()
    last_ms = (HANG_NS + starved.LONGEST_NS) // MS
    wrote = scene.written(last_ms + HANG_NS // MS, alive=False)
    assert wrote[0] == (last_ms - 249, BURST)


def test_a_starved_port_owner_that_moves_the_wheels_is_fenced(scene: Scene) -> None:
    """It may have been about to say so when it was looked at: the word is read after that."""

    def moves(thread: object, call: str, about: object) -> None:
        if call == "stat":
            scene.views[layout.PORT_OWNER].word("moving").set(1)

    scene.port_owner.starve()
    scene.machine.at_seam = moves
    assert scene.written(249, alive=False) == []
    assert scene.turn(MS, alive=False) == BURST
