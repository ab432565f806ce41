"""The death of a driver: a client that has given a command and ends without a goodbye."""

from __future__ import annotations

import pytest

from failstop.policy import causes
from failstop.procs.gate.core import REST

from .client_side import Service
from .gate_bench import MS, NO_SPEEDS, Gate, stands

VELOCITY = (0.2, 0.0, 0.0)
TOLD = "motion disabled: client 1, which had driven, has died"


def gate(driver_death: str, **changed: float | str) -> Gate:
    """Enabled, at full speed forward."""
    made = Gate(gate__driver_death=driver_death, **changed)
    made.enable()
    made.drive(VELOCITY, 40)
    return made


@pytest.mark.parametrize("silent_ns", [0, 299 * MS, 301 * MS, 3_600_000 * MS])
def test_a_death_disables_motion_however_long_ago_its_driver_commanded(silent_ns: int) -> None:
    """A program that hung, was killed for it and is started again must not drive on either."""
    dying = gate("disable")
    dying.step(silent_ns)
    dying.core.notes.clear()
    assert dying.gone(1) is None
    assert (dying.blocked, dying.core.latch) == ("disabled", None)
    assert stands(dying)
    assert dying.step() is None
    (note,) = dying.core.notes
    assert (note.kind, note.text, note.fields) == ("driver_gone", TOLD, {"who": "client 1", "source": "cmd_vel"})
    assert dying.take(VELOCITY, session=2) == ""
    assert dying.step() is None, "nothing drives before an enable"
    dying.enable()
    dying.take(VELOCITY, session=2)
    assert dying.step() != NO_SPEEDS


@pytest.mark.parametrize("dies", [1, 2])
def test_a_client_that_waits_is_a_driver_as_well(dies: int) -> None:
    """A client that commanded before motion was enabled is one too."""
    dying = Gate(sources__teleop__priority=10)
    dying.take(VELOCITY)
    dying.enable()
    dying.take(REST, 2, manual=True, source="teleop")
    dying.step()
    dying.gone(dies)
    assert dying.blocked == "disabled"


def test_a_client_that_has_commanded_nothing_is_no_driver() -> None:
    dying = gate("disable")
    dying.gone(2)
    assert dying.blocked == ""
    assert dying.take(VELOCITY, 3, source="stranger") == ""
    dying.core.notes.clear()
    dying.gone(3)
    assert dying.blocked == "", "its commands were of no source"
    assert not dying.core.notes


def test_a_death_is_told_of_each_time_however_often() -> None:
    dying = gate("disable")
    for _ in range(50):
        dying.gone(1)
        dying.enable()
        dying.drive(VELOCITY, 3)
    assert dying.told() == [TOLD] * 50


def test_a_death_latches_or_leaves_motion_enabled_where_the_settings_say_so() -> None:
    dying = gate("latch")
    assert dying.gone(1) == causes.DRIVER_DIED("client 1")
    assert dying.gone(1) is None, "once"
    dying = gate("stay")
    assert dying.gone(1) is None
    assert dying.step(0) == NO_SPEEDS
    assert dying.blocked == "cmd timeout"
    assert [note.kind for note in dying.core.notes] == ["driver_gone"]


@pytest.mark.parametrize("driver_death", ["disable", "latch", "stay"])
def test_an_orderly_end_leaves_motion_enabled(driver_death: str) -> None:
    ending = gate(driver_death)
    assert ending.gone(1, parted=True) is None
    assert ending.step(0) == NO_SPEEDS
    assert ending.blocked == "cmd timeout"
    (note,) = ending.core.notes
    assert (note.kind, note.fields) == ("driver_ended", {"who": "client 1", "source": "cmd_vel"})
    assert note.text == "client 1 ended its command: the wheels are stopped"


def test_the_orderly_end_of_a_client_that_waits_is_no_news() -> None:
    ending = gate("disable", sources__teleop__priority=10)
    ending.take(VELOCITY, 2, source="teleop")
    ending.take(VELOCITY, 3, source="stranger")
    ending.step()
    ending.gone(1, parted=True)
    ending.gone(2, parted=True)
    assert [note.kind for note in ending.core.notes] == ["ignored", "driver_ended"]


@pytest.mark.parametrize("driver_death", ["disable", "latch"])
def test_a_death_while_motion_is_disabled_is_no_news(driver_death: str) -> None:
    dying = gate(driver_death)
    dying.core.disable()
    dying.core.notes.clear()
    assert dying.gone(1) is None
    assert not dying.core.notes


# What the gate hears of the slots.


def test_a_client_that_takes_the_slot_at_once_makes_no_death_of_an_orderly_end(service: Service) -> None:
    first = service.known(session=21)
    first.goodbye()
    first.segment.wipe()
    first.leave()
    heir = service.join(session=22)
    heir.segment.wipe()
    heir.hello(22, "heir", 0)
    assert service.look() == [("gone", 21)]
    assert service.parted is True
    assert service.sessions() == [22]


def test_the_goodbye_of_another_session_or_a_damaged_one_does_not_count(service: Service) -> None:
    first = service.known(session=21)
    first.goodbye()
    first.segment.wipe()
    first.leave()
    service.look()
    service.join(session=22).leave()
    last = service.join(session=23)
    assert service.look() == []
    last.leave()
    assert service.look() == [("gone", 23)]
    assert service.parted is False
    dying = service.known(session=24)
    dying.segment.latest_writer("left").write(b"24")
    dying.leave()
    assert service.look() == [("gone", 24)]
    assert service.parted is False


def test_a_program_that_is_started_again_is_not_heard_before_its_death_is(service: Service) -> None:
    """Its slot is another one, and its ring hints at that alone."""
    dying = service.known(index=3, session=21)
    dying.leave()
    again = service.join(index=1, session=22)
    again.command()
    assert service.look(bytes([1])) == [("gone", 21), ("command", 22, 0.1)]
