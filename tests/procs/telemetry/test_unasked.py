"""What telemetry does about wheels that turn although they were told zero: latch, write the stop again, tell."""

from __future__ import annotations

import pytest

from failstop.policy import causes
from failstop.procs.telemetry.unasked import Reaction, Unasked
from failstop.procs.telemetry.wheels import ARE_STILL, SEEN_BY_IMU, SEEN_BY_REPORTS, THEY_TURN, WheelFact

MS = 1_000_000
AFTER_NS = 1500 * MS


class Scene:
    """Looks every 20 ms at a fact that the test sets."""

    def __init__(self) -> None:
        self.unasked, self.fact, self.now_ns = Unasked(AFTER_NS), WheelFact(AFTER_NS), 10**12
        self.still()

    def still(self) -> None:
        self.fact.does, self.fact.by, self.fact.unexpected = ARE_STILL, SEEN_BY_REPORTS, False

    def turn(self, by: int = SEEN_BY_REPORTS) -> None:
        self.fact.does, self.fact.by, self.fact.unexpected = THEY_TURN, by, True

    def look(self, ms: int, *, enabled: bool = False, latched: bool = False, epoch: int = 1) -> list[Reaction]:
        """What came of looking for so long."""
        found = []
        for _ in range(ms // 20):
            self.now_ns += 20 * MS
            act = self.unasked.update(self.fact, self.now_ns, enabled=enabled, latched=latched, epoch=epoch)
            if act.cause or act.again or act.note:
                found.append(act)
        return found


def test_while_motion_is_enabled_it_is_the_gate_that_acts() -> None:
    scene = Scene()
    scene.turn()
    assert scene.look(5000, enabled=True) == []


def test_wheels_that_turn_on_after_motion_was_disabled_for_it_latch_once() -> None:
    scene = Scene()
    scene.turn()
    scene.look(100, enabled=True)
    assert [act.cause for act in scene.look(1520)] == [None, causes.UNSTILL()]
    assert scene.look(10_000, latched=True, epoch=2) == [], "the supervisor looks after that stop"


@pytest.mark.parametrize("between", ["still", "enabled"])
def test_wheels_that_rested_or_were_enabled_again_do_not_latch(between: str) -> None:
    scene = Scene()
    scene.turn()
    scene.look(100, enabled=True)
    scene.look(500)
    if between == "still":
        scene.still()
    else:
        scene.fact.unexpected = False
    scene.look(100, enabled=between == "enabled")
    scene.turn()
    assert not any(act.cause for act in scene.look(8000))


def test_a_robot_that_is_pushed_is_told_of_and_its_stop_written_again() -> None:
    scene = Scene()
    scene.look(1000)
    scene.turn()
    acts = scene.look(6000)
    assert [act.cause for act in acts] == [None] * 4
    assert sum(act.again for act in acts) == 4, "every 1.5 s"
    assert [act.note.kind for act in acts if act.note] == ["wheels_turn"]
    scene.still()
    (act,) = scene.look(1000)
    assert act.note is not None
    assert act.note.fields["state"] == "still"


def test_what_only_an_imu_feels_is_told_and_writes_and_latches_nothing() -> None:
    scene = Scene()
    scene.turn(by=SEEN_BY_IMU)
    scene.look(100, enabled=True)
    acts = scene.look(8000)
    assert [(act.cause, act.again) for act in acts] == [(None, False)]
    assert acts[0].note is not None
    assert (acts[0].note.level, acts[0].note.text[:16]) == ("info", "the robot moves,")


def test_after_a_latched_stop_the_supervisor_acts_until_the_wheels_were_seen_still() -> None:
    scene = Scene()
    scene.turn()
    assert scene.look(5000, latched=True, epoch=2) == []
    scene.still()
    scene.look(500, latched=True, epoch=2)
    scene.turn()
    acts = scene.look(1000, latched=True, epoch=2)
    assert [(act.cause, act.again) for act in acts] == [(None, True)]
    assert scene.look(3000, latched=True, epoch=3) == [], "another stop, and another proof"
