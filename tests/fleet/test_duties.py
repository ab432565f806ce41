"""A stop of the fleet on the robot's side: what is carried out, and what is answered when."""

from __future__ import annotations

import dataclasses
from typing import Any

import pytest

from failstop.api.snapshot import Device, Imu
from failstop.api.state import State
from failstop.fleet import duties, levels, signed
from failstop.fleet.duties import Duties
from failstop.fleet.levels import Order, StopAnswer
from failstop.fleet.replay import Seen
from failstop.policy import causes
from tests.support import states

KEY = bytes(range(32))
UNIX_S = states.NOW_S
EPOCH = 7


def order(number: int = 1, dated_s: float = UNIX_S) -> Order:
    return Order(f"{number:032x}", dated_s, "smoke", "ann@desk")


def stopped(epoch: int = EPOCH + 1, **changed: Any) -> State:
    """A state after a stop in that epoch, of which nothing but `changed` is known."""
    proofs = {"written_s": None, "acknowledged_s": None, "observed_s": None}
    return states.latched(epoch=epoch, last_stop=states.stop(epoch=epoch, **{**proofs, "t": UNIX_S + 0.1, **changed}))


@pytest.fixture
def robot() -> Duties:
    return Duties(KEY, "robot-1", Seen(10.0))


BEFORE = states.state(epoch=EPOCH)


def begin(robot: Duties, given: Order, now_s: float = 0.0, before: State | None = BEFORE) -> None:
    assert robot.hear(given.message(KEY), now_s, UNIX_S) == (given, None)
    robot.begin(given, now_s, UNIX_S, before)


def told(answers: list[StopAnswer]) -> list[list[str]]:
    return [list(answer.reached) for answer in answers]


def test_each_level_is_told_of_when_it_is_known_and_once(robot: Duties) -> None:
    begin(robot, order())
    assert robot.waits(0.0)
    assert told(robot.look(states.state(epoch=EPOCH), 0.01)) == [[levels.ASKED]]
    assert robot.look(states.state(epoch=EPOCH), 0.02) == []
    (written,) = robot.look(stopped(written_s=0.0002), 0.03)
    assert written == StopAnswer(order().id, "robot-1", {levels.ASKED: 0.0, levels.WRITTEN: 0.03}, "")
    assert robot.look(stopped(written_s=0.0002), 0.04) == []
    (acknowledged,) = robot.look(stopped(written_s=0.0002, acknowledged_s=0.004), 0.05)
    assert acknowledged.reached == {**written.reached, levels.ACKNOWLEDGED: 0.05}
    assert robot.busy(0.05)
    assert not robot.waits(0.05), "what is left is watched, and waited for by nobody"
    known = stopped(written_s=0.0002, acknowledged_s=0.004, observed_s=0)
    assert told(robot.look(known, 0.9)) == [[levels.ASKED, *levels.PROOFS]]
    assert not robot.busy(0.9)


@pytest.mark.parametrize(
    ("link", "imu", "confirms"),
    [
        ("alive", True, levels.ACKNOWLEDGED),
        ("unproven", True, levels.ACKNOWLEDGED),
        ("unasked", True, levels.OBSERVED),
        ("unasked", False, levels.WRITTEN),
    ],
)
def test_what_confirms_is_what_the_board_and_the_imu_can_give(
    robot: Duties, link: Any, imu: bool, confirms: str
) -> None:
    begin(robot, order())
    found = stopped(written_s=0.0002)
    seen = Imu(1, (0.0, 0.0, 9.8), (0.0, 0.0, 0.0)) if imu else None
    changed = dataclasses.replace(found, device=dataclasses.replace(found.device, link=link), imu=seen)
    (answer,) = robot.look(changed, 0.1)
    assert levels.read_answer(KEY, answer.message(KEY)).confirms == confirms
    assert robot.waits(0.1) is (confirms != levels.WRITTEN)


def test_an_answer_of_an_older_version_confirms_by_the_board() -> None:
    body = {"id": order().id, "robot": "r", "reached": {levels.WRITTEN: 0.1}, "why": ""}
    assert levels.read_answer(KEY, signed.sign(KEY, signed.ANSWER_PURPOSE, body)).confirms == levels.ACKNOWLEDGED
    for wrong in ("asked", "nothing", 7, None):
        with pytest.raises(signed.Forged):
            levels.read_answer(KEY, signed.sign(KEY, signed.ANSWER_PURPOSE, {**body, "confirms": wrong}))


def test_levels_may_come_at_once_and_out_of_order(robot: Duties) -> None:
    begin(robot, order())
    assert told(robot.look(stopped(written_s=1e-06, observed_s=0.3), 1.0)) == [
        [levels.ASKED, levels.WRITTEN, levels.OBSERVED]
    ]
    known = stopped(written_s=1e-06, observed_s=0.3, acknowledged_s=9e-06)
    (all_of_them,) = robot.look(known, 1.1)
    assert set(all_of_them.reached) == {levels.ASKED, *levels.PROOFS}


def test_a_stop_of_before_the_request_confirms_nothing(robot: Duties) -> None:
    begin(robot, order())
    old = stopped(epoch=EPOCH, written_s=1e-06, acknowledged_s=1e-06, observed_s=0.001)
    assert told(robot.look(old, 1.0)) == [[levels.ASKED]]
    assert robot.look(None, 1.0) == []


def test_whatever_stop_came_after_the_request_confirms_it(robot: Duties) -> None:
    begin(robot, order())
    assert told(robot.look(stopped(epoch=EPOCH + 3, written_s=1e-06), 1.0)) == [[levels.ASKED, levels.WRITTEN]]


def test_a_stop_that_is_latched_already_confirms_it_once_the_service_has_heard_it(robot: Duties) -> None:
    before = stopped(epoch=EPOCH, written_s=1e-06, acknowledged_s=4e-03)
    begin(robot, order(), before=before)
    assert told(robot.look(before, 0.1)) == [[levels.ASKED]], "not heard yet"
    heard = dataclasses.replace(before, epoch=EPOCH + 1)
    deaf = dataclasses.replace(heard, device=dataclasses.replace(heard.device, link="deaf"))
    assert robot.look(deaf, 0.2) == []
    another = dataclasses.replace(heard, cause=causes.DIED("gate"))
    assert robot.look(another, 0.3) == [], "it was reset meanwhile, and what is told of the new one comes soon"
    assert told(robot.look(heard, 0.4)) == [[levels.ASKED, levels.WRITTEN, levels.ACKNOWLEDGED]]


@pytest.mark.parametrize(
    ("changed", "why"),
    [
        ({"device": Device("/dev/x", "lost", "alive")}, "the port /dev/x is lost, so no stop reaches the board"),
        ({"device": Device("/dev/x", "open", "deaf")}, "the board does not hear"),
        ({"turning": states.TURNS_ON}, "the wheels turn although they are told to stop"),
    ],
)
def test_the_proofs_of_an_older_stop_do_not_count_against_what_is_seen_now(
    robot: Duties, changed: dict[str, Any], why: str
) -> None:
    before = stopped(epoch=EPOCH, written_s=1e-06, acknowledged_s=4e-03, observed_s=0.3)
    begin(robot, order(), before=before)
    heard = dataclasses.replace(before, epoch=EPOCH + 1)
    (answer,) = robot.look(dataclasses.replace(heard, **changed), 0.1)
    assert list(answer.reached) == [levels.ASKED]
    assert why in answer.why
    assert robot.waits(0.1)
    (answer,) = robot.look(heard, 0.2)
    assert (set(answer.reached), answer.why) == ({levels.ASKED, *levels.PROOFS}, "")


def test_wheels_that_begin_to_turn_again_are_not_observed_to_be_still(robot: Duties) -> None:
    before = stopped(epoch=EPOCH, written_s=1e-06, acknowledged_s=4e-03, observed_s=0.3)
    begin(robot, order(), before=before)
    turns = dataclasses.replace(before, epoch=EPOCH + 1, turning=states.TURNS)
    assert told(robot.look(turns, 0.1)) == [[levels.ASKED, levels.WRITTEN, levels.ACKNOWLEDGED]]


@pytest.mark.parametrize(("t", "confirms"), [(UNIX_S - 1, False), (UNIX_S + 0.1, True)])
def test_where_the_epoch_was_not_known_the_time_decides(robot: Duties, t: float, confirms: bool) -> None:
    begin(robot, order(), before=None)
    (answer,) = robot.look(stopped(epoch=1, written_s=1e-06, t=t), 1.0)
    assert (levels.WRITTEN in answer.reached) is confirms


def test_latched_but_not_written_is_no_confirmation_until_it_is_written(robot: Duties) -> None:
    begin(robot, order())
    (failed,) = robot.look(stopped(), 0.1)
    assert failed.reached == {levels.ASKED: 0.0, levels.FAILED: 0.1}
    assert "NOT written" in failed.why
    assert robot.look(stopped(), 0.2) == [], "once"
    (written,) = robot.look(stopped(written_s=9), 3.0)
    assert written.reached == {**failed.reached, levels.WRITTEN: 3.0}, "the port came back"
    assert written.why == ""


def test_what_could_not_be_asked_for_is_said_and_tried_again_when_the_sender_repeats(robot: Duties) -> None:
    found, _ = robot.hear(order().message(KEY), 0.0, UNIX_S)
    assert found is not None
    failed = robot.failed(found, "no service")
    assert (failed.reached, failed.why) == ({levels.FAILED: 0.0}, "no service")
    assert not robot.busy(0.0)
    begin(robot, order(), now_s=0.5)
    assert told(robot.look(None, 0.5)) == [[levels.ASKED]]


def test_a_repeated_message_is_answered_and_not_carried_out_again(robot: Duties) -> None:
    begin(robot, order())
    (answered,) = robot.look(stopped(written_s=1e-06), 0.1)
    repeated = order(dated_s=UNIX_S + 1).message(KEY)
    assert robot.hear(repeated, 0.5, UNIX_S + 1) == (None, answered)
    assert robot.hear(repeated, 0.6, UNIX_S + 1) == (None, None), "not more often than that"


def test_a_recorded_message_is_refused_and_says_why(robot: Duties) -> None:
    found, answer = robot.hear(order(dated_s=UNIX_S - 60).message(KEY), 1.0, UNIX_S)
    assert found is None
    assert answer is not None
    assert list(answer.reached) == [levels.REFUSED]
    assert "old by 60 s" in answer.why
    flood = [robot.hear(order(number, UNIX_S - 60).message(KEY), 1.1, UNIX_S) for number in range(100)]
    assert flood == [(None, None)] * 100, "a flood of them is not answered each time"


def test_over_a_restart_it_is_answered_and_not_carried_out() -> None:
    seen = Seen(10.0)
    robot = Duties(KEY, "robot-1", seen)
    begin(robot, order())
    anew = Duties(KEY, "robot-1", Seen.load(seen.dump(), 10.0))
    found, answer = anew.hear(order().message(KEY), 5.0, UNIX_S + 1)
    assert found is None
    assert answer == StopAnswer(order().id, "robot-1", {levels.ASKED: 0.0}, duties.FORGOTTEN)


def test_another_key_is_counted_and_not_answered(robot: Duties) -> None:
    for _ in range(3):
        assert robot.hear(order().message(bytes(32)), 0.0, UNIX_S) == (None, None)
    assert (robot.forged, robot.last_forged) == (3, "it is signed with another key")


def test_it_is_followed_for_a_while_and_no_longer(robot: Duties) -> None:
    begin(robot, order())
    assert robot.busy(duties.FOLLOWED_S)
    assert not robot.busy(duties.FOLLOWED_S + 0.1)


def test_a_flood_of_genuine_stops_keeps_a_bounded_number() -> None:
    robot = Duties(KEY, "robot-1", Seen(10.0))
    for number in range(200):
        begin(robot, order(number, UNIX_S + number * 1e-3))
    assert len(robot.look(stopped(written_s=1e-6), 0.1)) == duties.MOST_DUTIES
