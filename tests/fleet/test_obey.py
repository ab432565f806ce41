"""A stop of the fleet on the robot's side: what is carried out, and what is answered when."""

from __future__ import annotations

from typing import Any

import pytest

from failstop.api.state import State
from failstop.fleet import levels, obey
from failstop.fleet.levels import Answer, Order
from failstop.fleet.obey import Obedience
from failstop.fleet.replay import Seen
from tests.support import states

KEY = bytes(range(32))
UNIX_S = states.NOW_S
EPOCH = 7


def order(number: int = 1, dated_s: float = UNIX_S) -> Order:
    return Order(f"{number:032x}", dated_s, "smoke", "ann@desk")


def stopped(epoch: int = EPOCH + 1, **changed: Any) -> State:
    """After a stop in that epoch, of which nothing but `changed` is known."""
    proofs = {"written_s": None, "acknowledged_s": None, "observed_s": None}
    return states.latched(epoch=epoch, last_stop=states.stop(epoch=epoch, **{**proofs, "t": UNIX_S + 0.1, **changed}))


@pytest.fixture
def robot() -> Obedience:
    return Obedience(KEY, "robot-1", Seen(10.0))


def begin(
    robot: Obedience, given: Order, now_s: float = 0.0, problem: str = "", epoch: int | None = EPOCH
) -> list[Answer]:
    found, answers = robot.hear(given.message(KEY), now_s, UNIX_S)
    assert (found, answers) == (given, [])
    return robot.begin(given, problem, now_s, UNIX_S, epoch)


def told(answers: list[Answer]) -> list[str]:
    return [answer.level for answer in answers]


def test_each_level_is_told_of_once_and_when_it_is_known(robot: Obedience) -> None:
    assert told(begin(robot, order())) == [levels.ASKED]
    assert told(robot.look(states.state(epoch=EPOCH), 0.01)) == []
    (written,) = robot.look(stopped(written_s=2e-4), 0.02)
    assert (written.level, written.after_s, written.robot, written.id) == (levels.WRITTEN, 0.02, "robot-1", order().id)
    assert robot.look(stopped(written_s=2e-4), 0.03) == []
    assert told(robot.look(stopped(written_s=2e-4, acknowledged_s=4e-3), 0.04)) == [levels.ACKNOWLEDGED]
    assert robot.busy(0.05)
    known = stopped(written_s=2e-4, acknowledged_s=4e-3, observed_s=0.0)
    assert told(robot.look(known, 0.9)) == [levels.OBSERVED]
    assert not robot.busy(0.9)


def test_levels_may_come_at_once_and_out_of_order(robot: Obedience) -> None:
    begin(robot, order())
    assert told(robot.look(stopped(written_s=1e-6, observed_s=0.3), 1.0)) == [levels.WRITTEN, levels.OBSERVED]
    known = stopped(written_s=1e-6, observed_s=0.3, acknowledged_s=9e-6)
    assert told(robot.look(known, 1.1)) == [levels.ACKNOWLEDGED]


def test_a_stop_of_before_the_request_confirms_nothing(robot: Obedience) -> None:
    begin(robot, order())
    old = stopped(epoch=EPOCH, written_s=1e-6, acknowledged_s=1e-6, observed_s=1e-3)
    assert robot.look(old, 1.0) == []
    assert robot.look(None, 1.0) == []


def test_whatever_stop_came_after_the_request_confirms_it(robot: Obedience) -> None:
    begin(robot, order())
    assert told(robot.look(stopped(epoch=EPOCH + 3, written_s=1e-6), 1.0)) == [levels.WRITTEN]


@pytest.mark.parametrize(("t", "confirms"), [(UNIX_S - 1, False), (UNIX_S + 0.1, True)])
def test_where_the_epoch_was_not_known_the_time_decides(robot: Obedience, t: float, confirms: bool) -> None:
    begin(robot, order(), epoch=None)
    assert bool(robot.look(stopped(epoch=1, written_s=1e-6, t=t), 1.0)) is confirms


def test_latched_but_not_written_is_no_confirmation_until_it_is_written(robot: Obedience) -> None:
    begin(robot, order())
    (failed,) = robot.look(stopped(), 0.1)
    assert (failed.level, "NOT written" in failed.why) == (levels.FAILED, True)
    assert robot.look(stopped(), 0.2) == [], "once"
    assert told(robot.look(stopped(written_s=9.0), 3.0)) == [levels.WRITTEN], "the port came back"


def test_nothing_to_ask_is_said_and_tried_again_when_the_sender_repeats(robot: Obedience) -> None:
    (failed,) = begin(robot, order(), problem="no service named 'failstop' is running")
    assert (failed.level, failed.why) == (levels.FAILED, "no service named 'failstop' is running")
    assert not robot.busy(0.0)
    assert told(begin(robot, order(), now_s=0.5)) == [levels.ASKED]


def test_a_repeated_message_is_answered_and_not_carried_out_again(robot: Obedience) -> None:
    begin(robot, order())
    robot.look(stopped(written_s=1e-6), 0.1)
    found, answers = robot.hear(order(dated_s=UNIX_S + 1).message(KEY), 0.5, UNIX_S + 1)
    assert found is None
    assert told(answers) == [levels.ASKED, levels.WRITTEN]
    assert robot.hear(order().message(KEY), 0.6, UNIX_S + 1) == (None, []), "not more often than that"


def test_a_recorded_message_is_refused_and_says_why(robot: Obedience) -> None:
    found, (answer,) = robot.hear(order(dated_s=UNIX_S - 60).message(KEY), 1.0, UNIX_S)
    assert found is None
    assert (answer.level, "old by 60 s" in answer.why) == (levels.REFUSED, True)
    flood = [robot.hear(order(number, UNIX_S - 60).message(KEY), 1.1, UNIX_S) for number in range(100)]
    assert flood == [(None, [])] * 100, "a flood of them is not answered each time"


def test_over_a_restart_it_is_answered_and_not_carried_out() -> None:
    seen = Seen(10.0)
    robot = Obedience(KEY, "robot-1", seen)
    begin(robot, order())
    anew = Obedience(KEY, "robot-1", Seen.load(seen.dump(), 10.0))
    found, (answer,) = anew.hear(order().message(KEY), 5.0, UNIX_S + 1)
    assert found is None
    assert (answer.level, "started anew" in answer.why) == (levels.ASKED, True)


def test_another_key_is_counted_and_not_answered(robot: Obedience) -> None:
    for _ in range(3):
        assert robot.hear(order().message(bytes(32)), 0.0, UNIX_S) == (None, [])
    assert (robot.forged, robot.last_forged) == (3, "signed with another key")


def test_it_is_followed_for_a_while_and_no_longer(robot: Obedience) -> None:
    begin(robot, order())
    assert robot.busy(obey.FOLLOWED_S)
    assert not robot.busy(obey.FOLLOWED_S + 0.1)


def test_a_flood_of_genuine_stops_keeps_a_bounded_number() -> None:
    robot = Obedience(KEY, "robot-1", Seen(10.0))
    for number in range(200):
        begin(robot, order(number, UNIX_S + number * 1e-3))
    assert len(robot.look(stopped(written_s=1e-6), 0.1)) == obey.MOST_DUTIES
