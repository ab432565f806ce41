"""A driver that dies, ends or falls silent: what becomes of motion, and what people are told of it."""

from __future__ import annotations

import pytest

from failstop.policy import causes
from failstop.policy.settings import PAD_SOURCE
from failstop.procs.gate.core import REST
from failstop.procs.gate.sources import PAD_SESSION
from tests.support.why import why

from .client_side import Service
from .gate_bench import MS, NO_SPEEDS, TICK, Gate, stands

VELOCITY = (0.2, 0.0, 0.0)
TOLD = "motion disabled: client 1 died after it had driven"
DRIVER = {"who": "client 1", "source": "cmd_vel"}


def gate(driver_death: str, **changed: float | str) -> Gate:
    """Enabled, at full speed forward."""
    made = Gate(gate__driver_death=driver_death, **changed)
    made.enable()
    made.drive(VELOCITY, 40)
    return made


def kinds(gate: Gate) -> list[str]:
    """Kinds of the notes since the last look."""
    found = [note.kind for note in gate.core.notes]
    gate.core.notes.clear()
    return found


# A death, and an orderly end.


@pytest.mark.parametrize("silent_ns", [0, 301 * MS, 3_600_000 * MS])
def test_a_death_disables_motion_however_long_ago_its_driver_commanded(silent_ns: int) -> None:
    """A program that hung, was killed for it and is started again must not drive on either."""
    dying = gate("disable")
    dying.step(silent_ns)
    dying.core.notes.clear()
    assert dying.gone(1) is None
    assert (dying.blocked, dying.core.latch, dying.step()) == ("disabled", None, None)
    assert stands(dying)
    (note,) = dying.core.notes
    assert (note.kind, note.text, note.fields) == ("driver_gone", TOLD, DRIVER)
    assert dying.accept(VELOCITY, session=2) == ""
    assert dying.step() is None, "nothing drives before an enable"


def test_a_program_that_came_again_and_died_before_it_drove_is_not_said_to_have_driven() -> None:
    dying = gate("disable")
    dying.gone(1, parted=True)
    dying.accept(REST)
    dying.core.notes.clear()
    dying.gone(1)
    (note,) = dying.core.notes
    assert note.text != TOLD
    assert note.text.startswith("motion disabled: client 1")


def test_a_driver_is_who_has_commanded_as_a_source_before_motion_was_enabled_too() -> None:
    for dies in (1, 2):
        dying = Gate(sources__teleop__priority=10)
        dying.accept(REST)
        dying.enable()
        dying.accept(REST, 2, manual=True, source="teleop")
        dying.step()
        dying.gone(dies)
        assert dying.blocked == "disabled", "also one that waits"
    dying = gate("disable")
    assert dying.accept(VELOCITY, 3, source="stranger") == ""
    dying.core.notes.clear()
    for stranger in (2, 3):
        dying.gone(stranger)
        assert (dying.blocked, dying.core.notes) == ("", []), "it commanded nothing, or as no source"
    for _ in range(50):
        dying.gone(1)
        dying.enable()
        dying.drive(VELOCITY, 3)
    assert dying.told() == [TOLD] * 50, "each death is told of"


def test_a_driver_that_shows_another_name_dies_under_it() -> None:
    """A guard with two programs at its port can't know which of them drove, also before the second one came."""
    for death in ("disable", "latch"):
        dying = gate(death)
        dying.core.rename(1, "one or two")
        dying.core.rename(7, "nobody who has commanded")
        assert dying.core.sources.driving(dying.now)
        dying.step(3_600_000 * MS)
        dying.core.notes.clear()
        stopped = dying.gone(1)
        if death == "latch":
            assert stopped == causes.DRIVER_DIED("one or two")
        else:
            assert dying.told() == [TOLD.replace("client 1", "one or two")]


def test_who_never_moved_the_robot_had_not_driven() -> None:
    dying = Gate(gate__driver_death="disable", scan__gate="on")
    dying.enable()
    dying.accept((100.0, 0.0, 0.0))
    dying.step(TICK)
    assert (dying.blocked, dying.core.velocity) == ("no scan", REST)
    dying.gone(1)
    assert dying.told()[-1] == "motion disabled: client 1 died; it had commanded but not moved the robot"


def test_a_death_latches_or_leaves_motion_enabled_where_the_settings_say_so() -> None:
    dying = gate("latch")
    assert dying.gone(1) == causes.DRIVER_DIED("client 1")
    assert dying.gone(1) is None, "once"
    dying = gate("stay")
    assert dying.gone(1) is None
    assert (dying.step(0), dying.blocked, kinds(dying)) == (NO_SPEEDS, "cmd timeout", ["driver_gone"])


@pytest.mark.parametrize("driver_death", ["disable", "latch", "stay"])
def test_an_orderly_end_leaves_motion_enabled_and_a_death_while_disabled_is_no_news(driver_death: str) -> None:
    waiting = gate(driver_death, sources__teleop__priority=10)
    waiting.accept(VELOCITY, 2, source="teleop")
    waiting.accept(VELOCITY, 3, source="stranger")
    waiting.step()
    for client in (1, 2):
        waiting.gone(client, parted=True)
    assert kinds(waiting) == ["ignored", "driver_ended"], "the first had waited"
    ending = gate(driver_death)
    assert ending.gone(1, parted=True) is None
    assert (ending.step(0), ending.blocked) == (NO_SPEEDS, "cmd timeout")
    (note,) = ending.core.notes
    assert (note.kind, note.fields) == ("driver_ended", DRIVER)
    assert note.text == "client 1 ended its command, so the wheels are told to stop"
    dying = gate(driver_death)
    dying.core.disable()
    kinds(dying)
    assert dying.gone(1) is None
    assert kinds(dying) == []


# A silence.


def test_a_driver_that_falls_silent_is_told_of_once_with_its_name(driving: Gate) -> None:
    driving.drive(VELOCITY, 3)
    assert kinds(driving) == []
    driving.step(281 * MS)
    (note,) = driving.core.notes
    assert (note.kind, note.fields) == ("driver_silent", note.fields | DRIVER | {"silent_ms": 301})
    assert "client 1 stopped sending commands" in note.text
    kinds(driving)
    for _ in range(100):
        driving.step()
    assert kinds(driving) == []


@pytest.mark.parametrize("kind", ["driver_gone", "driver_silent"])
def test_the_news_of_a_driver_hides_no_other_and_is_told_once(driving: Gate, kind: str) -> None:
    driving.drive(VELOCITY, 3)
    driving.accept(VELOCITY, 2, source="navv")
    if kind == "driver_gone":
        driving.gone(1)
    driving.step(301 * MS)
    assert kinds(driving) == ["ignored", kind]


def by_hand(gate: Gate, source: str = "cmd_vel", session: int = 1) -> None:
    """A person's command, which runs out."""
    assert gate.accept(VELOCITY, session, manual=True, source=source) == ""
    gate.step()
    gate.step(301 * MS)


def test_a_person_s_command_that_runs_out_is_let_go_but_for_the_gamepad_s(driving: Gate) -> None:
    """The gamepad says where its sticks are for as long as it can be heard."""
    by_hand(driving)
    (note,) = driving.core.notes
    assert (note.kind, note.fields) == ("driver_ended", DRIVER)
    assert note.text == "client 1 let go: last command 321 ms ago, so the wheels are told to stop"
    kinds(driving)
    by_hand(driving, PAD_SOURCE, PAD_SESSION)
    assert kinds(driving) == ["driver_silent"]
    for _ in range(50):
        by_hand(driving)
    assert kinds(driving).count("driver_ended") < 20
    driving.drive(VELOCITY, 2)
    driving.step(301 * MS)
    assert kinds(driving) == ["driver_silent"], "ordinary ends without end do not hide it"


@pytest.mark.parametrize("latched", [False, True])
def test_a_driver_that_stopped_the_wheels_before_or_was_latched_is_not_told_of(driving: Gate, latched: bool) -> None:
    driving.drive(VELOCITY, 3)
    if latched:
        driving.core.stop(why("key1"), 1)
    else:
        driving.drive(REST, 30)
    driving.step(301 * MS)
    driving.gone(1, parted=True)
    assert kinds(driving) == []


def test_a_driver_that_falls_silent_without_end_is_told_of_now_and_then(driving: Gate) -> None:
    count = 0
    for _ in range(200):
        driving.drive(VELOCITY, 2)
        driving.step(301 * MS)
        count += len(kinds(driving))
    elapsed_s = 200 * (2 * TICK + 301 * MS) / 1e9
    assert 5 <= count <= 5 + elapsed_s / 10 + 1


# What the gate hears of the slots.


def test_the_client_that_takes_a_slot_next_changes_nothing_of_how_the_last_one_ended(service: Service) -> None:
    first = service.known(session=21)
    first.goodbye()
    first.segment.wipe()
    first.leave()
    heir = service.join(session=22)
    heir.segment.wipe()
    heir.hello(22, "heir", 0)
    assert (service.look(), service.parted, service.sessions()) == ([("gone", 21)], True, [22])
    heir.leave()
    service.look()
    service.join(session=23).leave()
    last = service.join(session=24)
    assert service.look() == []
    last.leave()
    assert (service.look(), service.parted) == ([("gone", 24)], False), "another session's goodbye"
    dying = service.known(session=25)
    dying.write("left", b"25")
    dying.leave()
    assert (service.look(), service.parted) == ([("gone", 25)], False), "a damaged one"


def test_a_program_that_is_started_again_is_not_heard_before_its_death_is(service: Service) -> None:
    """Its slot is another one, and its ring hints at that alone."""
    service.known(index=3, session=21).leave()
    service.join(index=1, session=22).command()
    assert service.look(bytes([1])) == [("gone", 21), ("command", 22, 0.1)]
