"""Between two looks at everything the supervisor only shows that it lives."""

from __future__ import annotations

import pytest

from failstop.board.interface import SUPERVISOR_ROW
from failstop.messages import layout, records
from failstop.procs.loop import READ
from failstop.supervisor.main import AT_REST_NS, BEATS_ALONE, EXCUSE_NS, TICK_NS
from tests.support.stage import MS
from tests.support.supervisor_scene import Scene


@pytest.fixture
def scene() -> Scene:
    made = Scene(layout.PORT_OWNER)
    made.turn()
    made.answers()
    made.turn(MS)
    return made


def rest(scene: Scene) -> tuple[int, dict[int, int]]:
    """How long after the begin of its rest it has beaten last (ns; 0: it has not), and what was ready then."""
    beat, begun_ns = scene.word("beat_ns"), scene.now_ns
    before_ns = beat.get()
    ready = scene.supervisor.rest()
    return beat.get() - begun_ns if beat.get() > before_ns else 0, ready


def test_the_supervisor_rests_while_nothing_has_happened(scene: Scene) -> None:
    begun_ns = scene.now_ns
    assert rest(scene) == (BEATS_ALONE * AT_REST_NS, {})
    assert scene.now_ns - begun_ns > BEATS_ALONE * AT_REST_NS


@pytest.mark.parametrize(("who", "word"), [("gate", ""), ("gate", "busy"), ("port_owner", "moving")])
def test_its_ticks_are_twice_as_long_while_nobody_could_move_anything(scene: Scene, who: str, word: str) -> None:
    scene.keep_beating()
    if word:
        scene.own[who].word(word).set(1)
    begun_ns = scene.now_ns
    rest(scene)
    rested_ns = scene.now_ns - begun_ns
    assert rested_ns == (BEATS_ALONE + 1) * TICK_NS if word else rested_ns > BEATS_ALONE * AT_REST_NS


def test_a_bell_ends_the_rest_at_once(scene: Scene) -> None:
    bell = scene.run.bells[layout.SUPERVISOR]
    bell.ring()
    assert rest(scene) == (0, {bell.fd: READ})


def test_a_stop_that_is_not_answered_ends_the_rest_at_every_tick(scene: Scene) -> None:
    scene.notice()
    scene.turn(MS)
    assert rest(scene) == (0, {})


def test_a_supervisor_that_was_held_up_looks_at_everything(scene: Scene) -> None:
    scene.own[layout.GATE].word("busy").set(1)
    scene.now_ns += EXCUSE_NS - TICK_NS
    assert rest(scene) == (0, {})


def test_a_time_that_has_come_ends_the_rest(scene: Scene) -> None:
    timer = scene.supervisor.loop.timer()
    timer.set(scene.now_ns + MS)
    assert rest(scene) == (0, {})


# On boards that lose two stops which touch, and that report the command that they obey.


def made(kind: str) -> Scene:
    return Scene(layout.PORT_OWNER, settings={"board.kind": kind})


def stops(scene: Scene, for_ns: int) -> list[int]:
    """When it writes a stop, from now on."""
    begun_ns, found = scene.now_ns, []
    while (left_ns := begun_ns + for_ns - scene.now_ns) > 0:
        if scene.port.board.burst in scene.pass_time(min(left_ns, max(0, scene.next_ns() - scene.now_ns))):
            found.append(scene.now_ns - begun_ns)
    return found


@pytest.mark.parametrize("kind", ["rrc", "hoverboard", "arduino", "damiao", "feetech", "ugv", "vesc"])
def test_the_stop_for_the_port_owner_is_written_at_once_and_again_at_its_own_times(kind: str) -> None:
    scene = made(kind)
    scene.turn()
    scene.dies(layout.PORT_OWNER)
    assert scene.port.board.burst in scene.pass_time()
    row = scene.port.board.repeats_ns[SUPERVISOR_ROW]
    assert stops(scene, max((150 * MS, *row))) == list(row)


def test_a_port_owner_that_serves_repeats_its_own_stop() -> None:
    """A repeat of an old stop must not cut into the motion that comes after it."""
    scene = made("hoverboard")
    scene.turn()
    scene.dies(layout.PORT_OWNER)
    scene.pass_time()
    scene.pass_time(150 * MS)
    scene.wire.read()
    scene.dies(layout.PORT_OWNER)
    scene.pass_time()
    scene.supervisor.processes.restart_due(scene.now_ns + 10_000 * MS)
    scene.employ(layout.PORT_OWNER)
    assert stops(scene, 60 * MS) == []


def test_an_answer_that_proves_no_stop_only_says_that_the_board_hears() -> None:
    """Of a board that reports its command nothing but zeros prove it: a servo that answers may have lost the stop."""
    scene = made("feetech")
    scene.stops("the first")
    written_ns = scene.port_owner.word("written_ns").get()
    told = records.PROVED.pack(written_ns + MS, written_ns + 2 * MS)
    scene.telemetry.latest_writer("answered").write(told)
    scene.turn(3 * MS)
    assert (scene.read("link"), scene.table("stop")["acknowledged_us"]) == (b"alive", None)
    scene.telemetry.latest_writer("proved").write(told)
    scene.turn(MS)
    assert scene.table("stop")["acknowledged_us"] > 0
