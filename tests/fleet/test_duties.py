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
RUN = "run 1"
NEXT_RUN = "run 2"
WHEELS: dict[str, Any] = {"observed_by": "wheels"}
IMU = Imu(1, (0.0, 0.0, 9.8), (0.0, 0.0, 0.0))


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


def begin(robot: Duties, given: Order, now_s: float = 0.0, before: State | None = BEFORE, run: str = RUN) -> None:
    assert robot.hear(given.message(KEY), now_s, UNIX_S) == (given, None)
    robot.begin(given, now_s, UNIX_S, before, run)


def look(robot: Duties, state: State | None, now_s: float, run: str = RUN) -> list[StopAnswer]:
    return robot.look(state, now_s, run)


def told(answers: list[StopAnswer]) -> list[list[str]]:
    return [list(answer.reached) for answer in answers]


def test_each_level_is_told_of_when_it_is_known_and_once(robot: Duties) -> None:
    begin(robot, order())
    assert robot.waits(0.0)
    assert told(look(robot, states.state(epoch=EPOCH), 0.01)) == [[levels.ASKED]]
    assert look(robot, states.state(epoch=EPOCH), 0.02) == []
    (written,) = look(robot, stopped(written_s=0.0002, **WHEELS), 0.03)
    reached = {levels.ASKED: 0.0, levels.WRITTEN: 0.03}
    assert written == StopAnswer(order().id, "robot-1", reached, "", observes=True)
    assert look(robot, stopped(written_s=0.0002, **WHEELS), 0.04) == []
    (acknowledged,) = look(robot, stopped(written_s=0.0002, acknowledged_s=0.004, **WHEELS), 0.05)
    assert acknowledged.reached == {**written.reached, levels.ACKNOWLEDGED: 0.05}
    assert acknowledged.observes
    assert robot.busy(0.05)
    assert not robot.waits(0.05), "what is left is watched, and waited for by nobody"
    known = stopped(written_s=0.0002, acknowledged_s=0.004, observed_s=0, **WHEELS)
    assert told(look(robot, known, 0.9)) == [[levels.ASKED, *levels.PROOFS]]
    assert not robot.busy(0.9)


@pytest.mark.parametrize(
    ("link", "imu", "known", "confirms", "confirmed"),
    [
        ("alive", IMU, {}, levels.ACKNOWLEDGED, False),
        ("unproven", IMU, {}, levels.ACKNOWLEDGED, False),
        ("unasked", IMU, {}, levels.OBSERVED, False),
        ("unasked", IMU, {"observed_s": 0.3}, levels.OBSERVED, True),
        # An IMU that felt no motion before the stop either is no better than none.
        ("unasked", IMU, {"observed_s": 0.0}, levels.WRITTEN, True),
        ("unasked", None, {}, levels.WRITTEN, True),
        ("unasked", None, {"observed_by": ""}, levels.WRITTEN, True),
        ("unasked", None, WHEELS, levels.OBSERVED, False),
        ("unasked", None, {"observed_s": 0.0, **WHEELS}, levels.OBSERVED, True),
        ("unasked", None, {"acknowledged_s": 0.02, "acknowledged_by": "echo", **WHEELS}, levels.ACKNOWLEDGED, True),
    ],
)
def test_what_confirms_is_what_the_board_and_the_imu_can_give(
    robot: Duties, link: Any, imu: Imu | None, known: dict[str, Any], confirms: str, confirmed: bool
) -> None:
    begin(robot, order())
    found = stopped(**{"written_s": 0.0002, "observed_by": "IMU", **known})
    changed = dataclasses.replace(found, device=dataclasses.replace(found.device, link=link), imu=imu)
    (answer,) = look(robot, changed, 0.1)
    assert levels.read_answer(KEY, answer.message(KEY)).confirms == confirms
    assert (answer.confirms in answer.reached, robot.waits(0.1)) == (confirmed, not confirmed)


def test_an_answer_of_an_older_version_confirms_by_the_board() -> None:
    body = {"id": order().id, "robot": "r", "reached": {levels.WRITTEN: 0.1}, "why": ""}
    assert levels.read_answer(KEY, signed.sign(KEY, signed.ANSWER_PURPOSE, body)).confirms == levels.ACKNOWLEDGED
    for wrong in ("asked", "nothing", 7, None):
        with pytest.raises(signed.Forged):
            levels.read_answer(KEY, signed.sign(KEY, signed.ANSWER_PURPOSE, {**body, "confirms": wrong}))


def test_levels_may_come_at_once_and_out_of_order(robot: Duties) -> None:
    begin(robot, order())
    assert told(look(robot, stopped(written_s=1e-06, observed_s=0.3), 1.0)) == [
        [levels.ASKED, levels.WRITTEN, levels.OBSERVED]
    ]
    known = stopped(written_s=1e-06, observed_s=0.3, acknowledged_s=9e-06)
    (all_of_them,) = look(robot, known, 1.1)
    assert set(all_of_them.reached) == {levels.ASKED, *levels.PROOFS}


def test_a_stop_of_before_the_request_confirms_nothing(robot: Duties) -> None:
    begin(robot, order())
    old = stopped(epoch=EPOCH, written_s=1e-06, acknowledged_s=1e-06, observed_s=0.001)
    assert told(look(robot, old, 1.0)) == [[levels.ASKED]]
    assert look(robot, old, 1.1) == []


def test_whatever_stop_came_after_the_request_confirms_it(robot: Duties) -> None:
    begin(robot, order())
    assert told(look(robot, stopped(epoch=EPOCH + 3, written_s=1e-06), 1.0)) == [[levels.ASKED, levels.WRITTEN]]


def test_a_stop_that_is_latched_already_confirms_it_once_the_service_has_heard_it(robot: Duties) -> None:
    before = stopped(epoch=EPOCH, written_s=1e-06, acknowledged_s=4e-03)
    begin(robot, order(), before=before)
    assert told(look(robot, before, 0.1)) == [[levels.ASKED]], "not heard yet"
    heard = dataclasses.replace(before, epoch=EPOCH + 1)
    deaf = dataclasses.replace(heard, device=dataclasses.replace(heard.device, link="deaf"))
    assert told(look(robot, deaf, 0.2)) == [[levels.ASKED]], "with the reason"
    another = dataclasses.replace(heard, cause=causes.DIED("gate"))
    assert look(robot, another, 0.3) == [], "it was reset meanwhile, and the answer to the new one comes soon"
    assert told(look(robot, heard, 0.4)) == [[levels.ASKED, levels.WRITTEN, levels.ACKNOWLEDGED]]


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
    (answer,) = look(robot, dataclasses.replace(heard, **changed), 0.1)
    assert list(answer.reached) == [levels.ASKED]
    assert why in answer.why
    assert robot.waits(0.1)
    (answer,) = look(robot, heard, 0.2)
    assert (set(answer.reached), answer.why) == ({levels.ASKED, *levels.PROOFS}, "")


def test_wheels_that_begin_to_turn_again_are_not_observed_to_be_still(robot: Duties) -> None:
    before = stopped(epoch=EPOCH, written_s=1e-06, acknowledged_s=4e-03, observed_s=0.3)
    begin(robot, order(), before=before)
    turns = dataclasses.replace(before, epoch=EPOCH + 1, turning=states.TURNS)
    assert told(look(robot, turns, 0.1)) == [[levels.ASKED, levels.WRITTEN, levels.ACKNOWLEDGED]]


@pytest.mark.parametrize(("does", "observed"), [("still", True), ("unknown", False), ("turning", False)])
def test_an_older_stop_is_observed_only_while_the_wheels_are_seen_still(
    robot: Duties, does: Any, observed: bool
) -> None:
    """The IMU may have fallen silent since."""
    before = stopped(epoch=EPOCH, written_s=1e-06, acknowledged_s=4e-03, observed_s=0.3)
    begin(robot, order(), before=before)
    seen = dataclasses.replace(states.STILL, does=does)
    (answer,) = look(robot, dataclasses.replace(before, epoch=EPOCH + 1, turning=seen), 0.1)
    assert levels.ACKNOWLEDGED in answer.reached
    assert (levels.OBSERVED in answer.reached) is observed


@pytest.mark.parametrize(
    "changed",
    [{"turning": states.TURNS_ON}, {"turning": states.MOVES_ON}, {"device": Device("/dev/x", "open", "deaf")}],
)
def test_a_new_stop_that_the_wheels_contradict_is_answered_again_when_that_begins_and_when_it_ends(
    robot: Duties, changed: dict[str, Any]
) -> None:
    begin(robot, order())
    known = stopped(written_s=0.0002, acknowledged_s=0.004)
    (confirmed,) = look(robot, dataclasses.replace(known, turning=states.TURNS), 0.05)
    assert confirmed.why == "", "right after a stop the wheels still turn"
    (doubted,) = look(robot, wrong := dataclasses.replace(known, **changed), 1.6)
    assert (doubted.reached, bool(doubted.why)) == (confirmed.reached, True)
    assert look(robot, wrong, 1.7) == [], "once"
    (again,) = look(robot, known, 1.8)
    assert (again.reached, again.why) == (confirmed.reached, "")


def test_a_doubt_is_reported_after_all_proofs_too(robot: Duties) -> None:
    begin(robot, order())
    known = stopped(written_s=0.0002, acknowledged_s=0.004, observed_s=0.3)
    assert told(look(robot, known, 0.5)) == [[levels.ASKED, *levels.PROOFS]]
    assert not robot.busy(0.5)
    (doubted,) = look(robot, dataclasses.replace(known, turning=states.TURNS_ON), 3.0)
    assert doubted.why


def repeat(robot: Duties, now_s: float, dated_s: float | None = None) -> tuple[Order | None, StopAnswer | None]:
    """The sender repeats the stop, with a new date."""
    dated_s = UNIX_S + now_s if dated_s is None else dated_s
    return robot.hear(order(dated_s=dated_s).message(KEY), now_s, UNIX_S + now_s)


def test_a_request_that_the_service_has_not_heard_is_made_again_when_the_sender_repeats(robot: Duties) -> None:
    begin(robot, order())
    look(robot, states.state(epoch=EPOCH), 0.01)
    assert repeat(robot, 0.1) == (None, None), "not more often than that"
    assert repeat(robot, 0.3, dated_s=UNIX_S)[0] is None, "not for a recorded message"
    assert repeat(robot, 12.0, dated_s=UNIX_S + 1)[0] is None, "nor for one with an old date"
    assert repeat(robot, 0.5) == (order(dated_s=UNIX_S + 0.5), None)
    assert repeat(robot, 0.6)[0] is None
    robot.begin(order(dated_s=UNIX_S + 0.5), 0.5, UNIX_S + 0.5, BEFORE, RUN)
    assert told(look(robot, stopped(written_s=1e-6), 0.6)) == [[levels.ASKED, levels.WRITTEN]]
    assert repeat(robot, 1.5)[0] is None, "a person may have reset it since"


@pytest.mark.parametrize(
    "first",
    [
        states.state(epoch=EPOCH),
        stopped(written_s=0.0002),
        stopped(written_s=2e-4, acknowledged_s=4e-3, observed_s=0.3),
    ],
    ids=["not heard", "written", "proved"],
)
def test_a_run_that_ends_takes_its_latch_along_so_the_next_run_is_asked_too(robot: Duties, first: State) -> None:
    begin(robot, order())
    look(robot, first, 0.1)
    assert robot.owed(0.1, RUN) == []
    (ended,) = look(robot, None, 0.2, run="")
    assert ended.why == duties.ENDED
    assert robot.owed(0.2, "") == [], "nobody is there to be asked"
    assert robot.busy(20.0)
    assert not robot.waits(20.0)
    assert robot.owed(20.0, NEXT_RUN) == [order()]
    robot.begin(order(), 20.0, UNIX_S + 20.0, states.state(epoch=1), NEXT_RUN)
    assert robot.owed(20.1, NEXT_RUN) == []
    (answer,) = look(robot, states.state(epoch=1), 20.1, NEXT_RUN)
    assert (list(answer.reached), answer.why) == ([levels.ASKED], ""), "nothing that the old run has proved"
    assert told(look(robot, stopped(2, written_s=1e-6), 20.2, NEXT_RUN)) == [[levels.ASKED, levels.WRITTEN]]


def test_a_run_that_ends_after_a_person_has_reset_the_stop_leaves_nothing_to_ask(robot: Duties) -> None:
    begin(robot, order())
    look(robot, stopped(written_s=1e-6), 0.1)
    look(robot, states.driving(epoch=EPOCH + 1, last_stop=stopped(written_s=1e-6).last_stop), 1.0)
    assert look(robot, None, 2.0, run="") == []
    assert robot.owed(2.0, NEXT_RUN) == []
    assert repeat(robot, 2.0)[0] is None


def test_the_next_run_is_not_asked_if_it_comes_much_later_unless_the_sender_still_repeats(robot: Duties) -> None:
    begin(robot, order())
    look(robot, stopped(written_s=1e-6), 0.1)
    look(robot, None, 1.0, run="")
    assert robot.owed(duties.OWED_S + 1, NEXT_RUN) == []
    assert repeat(robot, duties.OWED_S + 1)[0] is not None


@pytest.mark.parametrize("later_s", [duties.FOLLOWED_S + 1, levels.LONGEST_S - 1])
def test_a_confirmation_is_taken_back_however_long_the_sender_waits(robot: Duties, later_s: float) -> None:
    begin(robot, order())
    proved = stopped(written_s=2e-4, acknowledged_s=4e-3, observed_s=0, **WHEELS)
    look(robot, proved, 0.9)
    assert look(robot, proved, later_s) == []
    (answer,) = look(robot, dataclasses.replace(proved, turning=states.TURNS_ON), later_s + 0.2)
    assert "turn" in answer.why
    (answer,) = look(robot, proved, later_s + 0.4)
    assert answer.why == ""
    assert not robot.busy(later_s)


def test_a_latch_that_ends_later_takes_the_confirmation_along_and_the_sender_asks_the_next_run(robot: Duties) -> None:
    """The publisher does not: who restarts a service ten minutes after a stop wants to go on."""
    later_s = 600.0
    begin(robot, order())
    look(robot, stopped(written_s=2e-4, acknowledged_s=4e-3, observed_s=0, **WHEELS), 0.9)
    (answer,) = look(robot, None, later_s, run="")
    assert answer.why == duties.ENDED
    assert robot.owed(later_s, NEXT_RUN) == []
    assert look(robot, states.state(epoch=1), later_s + 0.2, NEXT_RUN) == []
    assert not robot.busy(later_s + 0.2)
    assert repeat(robot, later_s + 1.0)[0] is not None


def test_where_it_is_not_known_which_run_was_asked_the_next_one_that_is_seen_is_asked_too(robot: Duties) -> None:
    begin(robot, order(), before=None, run="")
    assert told(look(robot, None, 0.1, run="")) == [[levels.ASKED]]
    assert robot.owed(10.0, RUN) == [order()]


def test_latched_but_not_written_is_no_confirmation_until_it_is_written(robot: Duties) -> None:
    begin(robot, order())
    (failed,) = look(robot, stopped(), 0.1)
    assert failed.reached == {levels.ASKED: 0.0, levels.FAILED: 0.1}
    assert "NOT written" in failed.why
    assert look(robot, stopped(), 0.2) == [], "once"
    (written,) = look(robot, stopped(written_s=9), 3.0)
    assert written.reached == {**failed.reached, levels.WRITTEN: 3.0}, "the port came back"
    assert written.why == ""


def test_what_could_not_be_asked_for_is_said_and_tried_again_when_the_sender_repeats(robot: Duties) -> None:
    found, _ = robot.hear(order().message(KEY), 0.0, UNIX_S)
    assert found is not None
    failed = robot.failed(found, "no service")
    assert (failed.reached, failed.why) == ({levels.FAILED: 0.0}, "no service")
    assert not robot.busy(0.0)
    begin(robot, order(), now_s=0.5)
    assert told(look(robot, None, 0.5)) == [[levels.ASKED]]


def test_a_repeated_message_is_answered_and_not_carried_out_again(robot: Duties) -> None:
    begin(robot, order())
    (answered,) = look(robot, stopped(written_s=1e-06), 0.1)
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


def test_over_a_restart_a_recorded_stop_is_answered_and_a_repeated_one_is_carried_out_once_more() -> None:
    """Nobody knows whether the service heard the request, or what became of it."""
    seen = Seen(10.0)
    robot = Duties(KEY, "robot-1", seen)
    begin(robot, order())
    anew = Duties(KEY, "robot-1", Seen.load(seen.dump(), 10.0))
    found, answer = anew.hear(order().message(KEY), 5.0, UNIX_S + 1)
    assert found is None
    assert answer == StopAnswer(order().id, "robot-1", {levels.ASKED: 0.0}, duties.FORGOTTEN)
    assert repeat(anew, 5.0) == (order(dated_s=UNIX_S + 5), None)
    anew.begin(order(dated_s=UNIX_S + 5), 5.0, UNIX_S + 5, BEFORE, RUN)
    assert repeat(anew, 5.1, dated_s=UNIX_S + 5)[0] is None


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
    assert len(look(robot, stopped(written_s=1e-6), 0.1)) == duties.MOST_DUTIES
