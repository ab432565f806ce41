"""Proofs of a stop (acknowledged, observed, told); and the link: unproven, alive, deaf."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import pytest

from failstop.policy.proofs import (
    LINK_ALIVE,
    LINK_DEAF,
    LINK_SILENT,
    LINK_UNASKED,
    LINK_UNHEARD,
    LINK_UNPROVEN,
    NEVER_SEEN,
    UNMOVED,
    observer,
    still_after,
)
from failstop.procs.starved import LONGEST_NS
from failstop.supervisor.proof import ACKNOWLEDGE_NS, JUDGED_AFTER_NS, JUDGED_WITHIN_NS, Link, Proof
from failstop.supervisor.stops import Stop
from tests.support.why import why

MS = 1_000_000
T0 = 10_000 * MS
AFTER = 1_500 * MS


def proof(written_ms: float = 0.5, by: str = "IMU", followed_ms: float = 0, acknowledges: str = "answer") -> Proof:
    """`written_ms`: after the cause, 0 for never; `followed_ms`: when the supervisor began to follow it; `by`: what
    observes the stop; `acknowledges`: what acknowledges it, "" for nothing."""
    stop = Stop(T0, "gate", why("gate died"))
    stop.answered_by("port owner", T0 + round(written_ms * MS) if written_ms else 0, stop, 2)
    return Proof(stop, AFTER, T0 + round(followed_ms * MS), 1.0 + followed_ms / 1e3, (acknowledges, by))


def test_a_stop_that_is_followed_late_has_its_cause_s_time_and_a_whole_wait() -> None:
    late_ns = T0 + 6_000 * MS
    found = proof(1.0, followed_ms=6_000)
    assert found.as_record()["t"] == 1.0
    assert not found.complete(late_ns + ACKNOWLEDGE_NS - 1)
    assert found.complete(late_ns + AFTER + JUDGED_WITHIN_NS)


@pytest.mark.parametrize(("written_ms", "written_us"), [(0.5, 500.0), (0, None), (-0.5, 0.0)])
def test_a_stop_has_the_time_at_which_it_was_written(written_ms: float, written_us: float | None) -> None:
    record = proof(written_ms).as_record()
    assert (record["written_us"], record["acknowledged_us"], record["observed_ms"]) == (written_us, None, None)


@pytest.mark.claim("PROOF-1")
def test_a_ping_from_before_the_stop_proves_nothing() -> None:
    last = proof()
    assert not last.ponged(T0 + MS // 2 - 1, T0 + 2 * MS)
    assert last.ponged(T0 + MS // 2, T0 + 3 * MS)
    assert last.as_record()["acknowledged_us"] == 3_000.0
    assert not last.ponged(T0 + 5 * MS, T0 + 6 * MS), "the first answer counts"


@pytest.mark.claim("PROOF-1")
def test_what_was_not_written_is_not_acknowledged() -> None:
    assert not proof(0).ponged(T0 + 100 * MS, T0 + 101 * MS)


def test_wheels_that_come_to_rest() -> None:
    last = proof()
    for ms in range(0, 900, 10):
        assert not last.judged(0, T0 + ms * MS, T0 + ms * MS)
    assert not last.judged(T0 + 380 * MS, T0 + 900 * MS, T0 + 900 * MS)
    assert last.as_record()["observed_ms"] == 380.0
    assert "wheels still after about 0.4 s" in last.outcome("alive")


JUST_MS = 1e-6
EARLY_MS = JUDGED_AFTER_NS / MS
SILENT_MS = 1_600 + JUDGED_WITHIN_NS / MS + JUST_MS


@pytest.mark.parametrize(
    ("by", "looks_ms", "observed_ms"),
    [
        ("IMU", [(-5_000, EARLY_MS - JUST_MS, EARLY_MS)], None),  # from before the stop
        ("IMU", [(-5_000, EARLY_MS - JUST_MS, EARLY_MS), (-5_000, EARLY_MS, EARLY_MS)], 0.0),
        # A supervisor that was held up takes the IMU's word: wheels that stood all the while did not shake.
        ("IMU", [(150, 700, 705)], 150.0),
        ("IMU", [(-5_000, 900, 905)], 0.0),
        # A verdict that only began anew, since telemetry was restarted, is no shaking.
        ("IMU", [(-5_000, -10, 5), (200, 900, 905)], 0.0),
        # An IMU that is silent judges nothing.
        ("IMU", [(None, 1_600, SILENT_MS)], None),
        ("IMU", [(400, 1_600, SILENT_MS)], None),
        # Wheels that a board reports to stand since after the cause have turned; an IMU's window may end so by chance.
        ("wheels", [(40, 40, 45)], 40.0),
        ("IMU", [(40, 40, 45)], None),
        ("wheels", [(-5_000, 900, 905)], 0.0),
    ],
)
def test_the_rest_of_the_wheels_is_when_they_stood(
    by: str, looks_ms: list[tuple[float | None, float, float]], observed_ms: float | None
) -> None:
    """Each look: since when they have stood, when that was judged, and when it is looked at."""
    last = proof(by=by)
    for still_ms, *at_ms in looks_ms:
        judged_ns, now_ns = (T0 + round(ms * MS) for ms in at_ms)
        assert not last.judged(0 if still_ms is None else T0 + round(still_ms * MS), judged_ns, now_ns)
    assert last.as_record()["observed_ms"] == observed_ms
    if observed_ms == 0:
        assert last.outcome("alive").endswith(f", {NEVER_SEEN[by]}")


@pytest.mark.parametrize(
    ("by", "verdict_ms", "look_ms", "observed_ms", "told"),
    [
        # They turned, then nothing was read for long: when they came to rest is not known.
        ("IMU", (None, -600), (6_000, 6_800), 6_000.0, "wheels still after at most 6.0 s"),
        ("wheels", (None, -100), (6_000, 6_000), 6_000.0, "wheels still after at most 6.0 s"),
        ("wheels", (None, -20), (300, 300), 300.0, "wheels still after about 0.3 s"),
        # They were still, and the verdict only began anew.
        ("wheels", (-5_000, -20), (300, 900), 0.0, NEVER_SEEN["wheels"]),
        ("IMU", (-5_000, -600), (6_000, 6_800), 0.0, NEVER_SEEN["IMU"]),
        # They had turned, and came to rest long before the cause.
        ("IMU", (None, -6_000), (-5_000, 900), 0.0, NEVER_SEEN["IMU"]),
        # A verdict that the supervisor reads late, of wheels that came to rest after the cause, is none from before it.
        ("wheels", (40, 40), (40, 45), 40.0, "wheels still after less than 0.2 s"),
    ],
)
def test_whether_the_wheels_turned_is_known_from_the_newest_verdict_however_old(
    by: str, verdict_ms: tuple[float | None, float], look_ms: tuple[float, float], observed_ms: float, told: str
) -> None:
    """Each verdict: since when they were still (None: they turned), and when that was judged."""
    stop = proof().stop
    still_ms, judged_ms = verdict_ms
    verdict = (0 if still_ms is None else T0 + round(still_ms * MS), T0 + round(judged_ms * MS))
    last = Proof(stop, AFTER, T0 + MS, 1.0, ("answer", by), verdict)
    for ms in range(1, 500, 10):
        assert not last.judged(*verdict, T0 + ms * MS)
    judged_ns = T0 + round(look_ms[1] * MS)
    assert not last.judged(T0 + round(look_ms[0] * MS), judged_ns, judged_ns)
    assert last.as_record()["observed_ms"] == observed_ms
    assert last.outcome("alive").endswith(f", {told}")


@pytest.mark.claim("BOARD-1")
def test_wheels_that_do_not_come_to_rest_are_a_cause_again_and_again() -> None:
    last = proof()
    found = [ms for ms in range(0, 4_000, 20) if last.judged(0, T0 + ms * MS, T0 + ms * MS)]
    assert found == [1_500, 3_000]
    assert "NOT seen still" in last.outcome("alive")


def test_a_stop_that_could_be_written_only_later_is_proven_from_then_on() -> None:
    last = proof(0)
    assert last.complete(T0 + AFTER + JUDGED_WITHIN_NS)
    back_ns = T0 + 5_000 * MS
    last.written_at_last(back_ns, "port owner")
    assert last.as_record()["written_us"] == 5_000_000.0
    assert not last.ponged(back_ns - 1, back_ns + MS)
    assert not last.judged(0, back_ns + 1_400 * MS, back_ns + 1_400 * MS), "the wheels have their time from then"
    assert last.judged(0, back_ns + AFTER, back_ns + AFTER)
    assert last.ponged(back_ns, back_ns + 3 * MS)
    assert last.complete(back_ns + AFTER), "and it is told again"


def test_it_is_told_once_when_all_is_known() -> None:
    last = proof()
    last.ponged(T0 + MS, T0 + 2_050_001)
    assert not last.complete(T0 + 900 * MS)
    last.judged(0, T0 + 500 * MS, T0 + 500 * MS)
    last.judged(T0 + 300 * MS, T0 + 1_000 * MS, T0 + 1_000 * MS)
    assert last.complete(T0 + 1_000 * MS)
    assert not last.complete(T0 + 1_020 * MS)
    assert last.outcome("alive") == "gate died: acknowledged by the board after 2.1 ms, wheels still after about 0.3 s"


def test_it_is_told_at_last_without_answer_and_without_imu() -> None:
    last = proof()
    assert not last.complete(T0 + AFTER)
    assert last.complete(T0 + AFTER + JUDGED_WITHIN_NS)
    assert last.outcome("unproven") == "gate died: not acknowledged (link unproven), not observed"


def test_what_the_kernel_still_holds_is_not_said_to_be_sent() -> None:
    last = proof()
    last.held = True
    assert last.outcome("deaf") == "gate died: handed over, NOT sent: the board accepts no bytes, not observed"
    assert last.fields("deaf")["sent"] is False
    assert last.as_record()["sent"] is False
    assert last.ponged(T0 + MS, T0 + 2 * MS), "it takes them again"
    assert last.as_record()["sent"] is True


def test_a_stop_that_another_device_may_have_taken_is_believed_once_the_board_has_answered() -> None:
    last = proof()
    assert last.as_record()["believed"] is True, "the supervisor says when it is not"
    last.believed = False
    assert last.as_record()["believed"] is False
    assert last.ponged(T0 + MS, T0 + 2 * MS)
    assert last.as_record()["believed"] is True


@pytest.mark.parametrize(
    ("acknowledges", "by", "link", "told"),
    [
        ("echo", "", LINK_UNASKED, UNMOVED),
        ("", "wheels", LINK_UNASKED, "not acknowledged (link unasked)"),
        ("echo", "wheels", LINK_DEAF, "not acknowledged (link deaf)"),
    ],
)
def test_a_board_whose_echo_acknowledges_had_nothing_to_obey(acknowledges: str, by: str, link: str, told: str) -> None:
    """Its echo changes only if it obeyed motion before."""
    last = proof(by=by, acknowledges=acknowledges)
    assert last.outcome(link).startswith(f"gate died: {told}, ")


def test_a_board_that_has_not_echoed_the_end_of_a_motion_has_not_obeyed() -> None:
    last = Proof(proof().stop, AFTER, T0 + MS, 1.0, ("echo", "wheels"), (0, T0 - MS))
    last.judged(T0 + 600 * MS, T0 + 600 * MS, T0 + 600 * MS)
    assert last.outcome(LINK_UNASKED).startswith("gate died: not acknowledged (link unasked), wheels still after")


def test_a_rest_within_the_resolution_is_told_as_that() -> None:
    assert still_after(0.19) == "less than 0.2 s"
    assert still_after(0.2) == "about 0.2 s"
    assert still_after(1.25) == "about 1.2 s"


def test_without_an_imu_nothing_is_observed_nor_waited_for() -> None:
    blind = proof(1.0, observer("IMU", imu=False))
    assert not blind.judged(0, T0 + AFTER, T0 + AFTER)
    assert not blind.complete(T0 + 2 * MS)
    assert blind.ponged(T0 + MS, T0 + 3 * MS)
    assert blind.complete(T0 + 4 * MS)
    assert blind.outcome("alive").endswith("after 3.0 ms, not observed: the robot has no IMU")
    assert (observer("IMU", imu=True), observer("wheels", imu=False)) == ("IMU", "wheels")


def test_what_programs_are_told_of_it() -> None:
    last = proof()
    told = {"reason": "gate died", "cause": "died", "noticed_ns": T0, "epoch": 2, "link": "alive", "sent": True}
    told |= {"acknowledged_by": "answer", "observed_by": "IMU"}
    assert last.fields("alive") == {**told, "acknowledged_us": None, "observed_ms": None, "wheels": "unknown"}
    assert last.ponged(T0 + MS, T0 + 2 * MS)
    last.judged(0, T0 + AFTER, T0 + AFTER)
    assert last.fields("alive") == {**told, "acknowledged_us": 2_000.0, "observed_ms": None, "wheels": "unstill"}
    last.judged(T0 + 2 * AFTER - 1, T0 + 2 * AFTER, T0 + 2 * AFTER)
    observed_ms = (2 * AFTER - 1) / 1e6
    told |= {"observed_late": True}  # nothing was read for a whole AFTER
    assert last.fields("alive") == {**told, "acknowledged_us": 2_000.0, "observed_ms": observed_ms, "wheels": "still"}
    assert last.as_record() == {
        "cause": why("gate died").pack(),
        "latched": why("gate died").pack(),
        "noticed_by": "gate",
        "noticed_ns": T0,
        "written_by": "port owner",
        "t": 1.0,
        "epoch": 2,
        "sent": True,
        "believed": True,
        "written_us": 500.0,
        "acknowledged_us": 2_000.0,
        "acknowledged_by": "answer",
        "observed_ms": observed_ms,
        "observed_by": "IMU",
        "observed_late": True,
    }


def test_one_that_is_observed_waits_a_while_for_its_acknowledgement() -> None:
    last = proof()
    last.judged(T0 - 5_000 * MS, T0 + JUDGED_AFTER_NS, T0 + JUDGED_AFTER_NS)
    assert not last.complete(T0 + ACKNOWLEDGE_NS - 1)
    assert last.complete(T0 + ACKNOWLEDGE_NS)


DEAF_NS = 1_000 * MS


def heard(at_ns: int) -> Link:
    link = Link(DEAF_NS)
    link.answered(at_ns)
    return link


def deaf_after_ms(link: Link, pings_ms: Sequence[int], until_ms: int = 5_000) -> int | None:
    """Look every 20 ms, from T0 on, with pings sent at these times; returns when it became deaf."""
    for ms in range(0, until_ms, 20):
        newest = max([T0 + at * MS for at in pings_ms if at <= ms], default=0)
        if link.gone_deaf(newest, T0 + ms * MS):
            return ms
    return None


def test_a_board_without_pings_is_never_unproven_nor_deaf() -> None:
    link = Link(1_000 * MS, asked=False)
    assert link.state == LINK_UNASKED
    assert not link.gone_deaf(T0 + 10_000 * MS, T0 + 20_000 * MS)
    link.opened(T0)
    assert link.state == LINK_UNASKED


@pytest.mark.claim("BOARD-1")
@pytest.mark.parametrize(
    ("link_of", "pings_ms", "deaf_ms"),
    [
        (lambda: Link(DEAF_NS), range(0, 5_000, 500), None),  # it has never answered
        (lambda: heard(T0), [0, 500, 1_000, 1_500], 1_020),  # the ping at 1,000 may still be answered
        (lambda: heard(T0), [3_000], 3_500),  # silence counts from the first question, as after a port owner's hang
        (lambda: heard(T0), [0, 3_000], 3_500),  # it has answered the last one
        (lambda: heard(T0), [0, 400], 1_000),  # not before its time from the last answer
    ],
)
def test_a_board_that_has_answered_and_is_silent_for_a_second_is_deaf_once(
    link_of: Callable[[], Link], pings_ms: Sequence[int], deaf_ms: int | None
) -> None:
    link = link_of()
    assert deaf_after_ms(link, pings_ms) == deaf_ms
    assert link.state == (LINK_DEAF if deaf_ms else LINK_UNPROVEN)
    assert deaf_after_ms(link, [6_000, 6_500], 9_000) is None, "once"
    link.answered(T0 + 9_500 * MS)
    assert link.state == LINK_ALIVE


def test_a_board_that_answers_is_alive() -> None:
    link = heard(T0)
    for ms in range(0, 10_000, 500):
        assert not link.gone_deaf(T0 + ms * MS, T0 + ms * MS + 20 * MS)
        link.answered(T0 + ms * MS)
    assert link.state == LINK_ALIVE


def test_silence_while_nobody_listened_does_not_count() -> None:
    link = heard(T0)
    assert not link.gone_deaf(T0 + 500 * MS, T0 + 990 * MS)
    link.listen(T0 + 1_500 * MS)
    assert not link.gone_deaf(T0 + 1_500 * MS, T0 + 2_400 * MS), "nobody heard the answer to that one"
    assert not link.gone_deaf(T0 + 2_500 * MS, T0 + 2_510 * MS)
    assert link.gone_deaf(T0 + 2_500 * MS, T0 + 3_010 * MS)


@pytest.mark.parametrize(
    ("held_up_ms", "deaf_ms"), [(None, 1_020), (0, 2_020), (300, 2_020), (980, 2_020), (-100, 1_020)]
)
def test_a_silence_in_which_the_machine_held_the_service_up_is_counted_again(
    held_up_ms: int | None, deaf_ms: int
) -> None:
    link = heard(T0 - 10 * MS)
    unheard_ms = []
    for ms in range(0, 5_000, 20):
        if held_up_ms is not None and ms == max(0, held_up_ms):
            link.held_up(T0 + held_up_ms * MS)
        if link.gone_deaf(T0 + ms // 250 * 250 * MS, T0 + ms * MS):
            assert ms == deaf_ms
            break
        if found_ns := link.pop_unheard():
            unheard_ms.append((ms, found_ns // MS))
    assert link.state == LINK_DEAF
    assert unheard_ms == ([(1_020, 1_030)] if deaf_ms > 2_000 else [])


def test_a_busy_machine_excuses_no_board_for_long() -> None:
    link = heard(T0)
    for ms in range(20, 10_000, 20):
        link.held_up(T0 + ms * MS)
        if link.gone_deaf(T0 + ms // 500 * 500 * MS, T0 + ms * MS):
            break
    assert LONGEST_NS // MS <= ms <= LONGEST_NS // MS + 1_100


@pytest.mark.parametrize(("silent_ns", "state"), [(LONGEST_NS - 1, LINK_ALIVE), (LONGEST_NS, LINK_SILENT)])
def test_a_silence_is_excused_for_as_long_as_a_healthy_service_may_be_held_up(silent_ns: int, state: str) -> None:
    link = heard(T0)
    link.said(T0, T0)
    link.held_up(T0 + silent_ns)
    link.check_silence(silent_ns, T0 + silent_ns)
    assert link.state == state


def test_a_machine_that_was_held_up_makes_no_board_silent() -> None:
    link = heard(T0)
    link.said(T0, T0)
    link.held_up(T0 + 600 * MS)
    link.check_silence(700 * MS, T0 + 700 * MS)
    assert (link.state, link.pop_unheard()) == (LINK_ALIVE, 700 * MS)
    assert link.pop_unheard() == 0, "once"
    link.check_silence(700 * MS, T0 + 1_380 * MS)
    assert link.state == LINK_ALIVE
    link.check_silence(700 * MS, T0 + 1_400 * MS)
    assert link.state == LINK_SILENT


@pytest.mark.parametrize("sure", [True, False])
def test_at_another_port_a_board_that_was_heard_is_to_be_heard_again(sure: bool) -> None:
    link = heard(T0)
    link.opened(T0 + MS, sure=sure)
    assert (link.state, link.believed) == (LINK_UNHEARD, False)
    assert deaf_after_ms(link, list(range(0, 5_000, 500))) is None
    link.answered(T0)
    assert link.state == LINK_UNHEARD, "that was the device before this one"
    link.answered(T0 + MS)
    assert (link.state, link.believed) == (LINK_ALIVE, True)


@pytest.mark.parametrize("asked", [True, False])
def test_of_a_board_that_was_never_heard_as_much_is_known_as_of_its_device(asked: bool) -> None:
    link = Link(DEAF_NS, asked=asked)
    first = link.state
    link.opened(T0)
    assert link.state == first
    link.opened(T0, sure=False)
    assert link.state == LINK_UNHEARD
    link.opened(T0)
    assert link.state == first


def test_a_board_without_pings_is_heard_by_its_reports() -> None:
    link = Link(DEAF_NS, asked=False)
    link.said(T0, 0)
    link.opened(T0 + MS)
    link.said(T0, 0)
    assert link.state == LINK_UNHEARD, "that report is of before"
    link.said(T0 + 2 * MS, 0)
    assert link.state == LINK_UNASKED


@pytest.mark.parametrize("asked", [True, False])
def test_a_device_that_should_have_answered_by_now_is_missed_once(asked: bool) -> None:
    link = Link(DEAF_NS, asked=asked)
    link.opened(T0, sure=False)
    link.gone_deaf(T0 + MS, T0 + MS)
    since_ns = T0 + MS if asked else T0  # the first ping, or the opening, after which it should have reported
    assert not link.missed(since_ns + DEAF_NS - 1)
    assert link.missed(since_ns + DEAF_NS)
    assert not link.missed(since_ns + 2 * DEAF_NS)


def test_a_board_that_says_nothing_at_all_is_silent_and_not_deaf() -> None:
    """A ping of up to half a second before may already be late when the silence is not yet sure."""
    link = heard(T0)
    link.said(T0 + 450 * MS, T0)
    for ms in range(460, 1_150, 20):
        link.check_silence(700 * MS, T0 + ms * MS)
        assert not link.gone_deaf(T0 + 500 * MS, T0 + ms * MS)
    link.check_silence(700 * MS, T0 + 1_150 * MS)
    assert link.state == LINK_SILENT
    link.said(T0 + 450 * MS, T0)
    assert link.state == LINK_SILENT, "that is what it had said before"


@pytest.mark.parametrize(
    ("patience_ms", "said_ms", "deaf"),
    [
        (0, 500, True),  # it reports nothing by itself
        (0, 1_100, True),
        (700, None, True),  # it has not reported at all, so it does not go silent either
        (700, 751, True),
        (700, 750, False),  # half of its patience has gone
        (1_000, 600, False),
        (1_001, 100, True),  # it would be known to be deaf before it is known to be silent
    ],
)
def test_a_board_is_deaf_unless_it_may_soon_be_known_to_be_silent(
    patience_ms: int, said_ms: int | None, deaf: bool
) -> None:
    link = heard(T0)
    if said_ms is not None:
        link.said(T0 + said_ms * MS, T0)
    link.check_silence(patience_ms * MS, T0 + (said_ms or 0) * MS)
    assert not link.gone_deaf(T0 + 500 * MS, T0 + 500 * MS)
    assert link.gone_deaf(T0 + 500 * MS, T0 + 1_100 * MS) is deaf


def test_a_board_of_which_one_part_does_not_answer_is_not_deaf_while_the_others_are_heard() -> None:
    link = heard(T0)
    for ms in range(0, 6_520, 20):
        now_ns, ping_ns = T0 + ms * MS, T0 + ms // 500 * 500 * MS
        if ms < 5_000:
            link.said(now_ns, ping_ns)
        link.answered_in_part(ping_ns, now_ns)
        assert not link.gone_deaf(ping_ns, now_ns)
    assert link.gone_deaf(T0 + 6_500 * MS, T0 + 6_520 * MS)


def test_a_part_that_does_not_answer_excuses_no_whole_second_of_silence() -> None:
    link = heard(T0)
    link.said(T0, T0)
    assert not link.gone_deaf(T0 + 400 * MS, T0 + 400 * MS)
    link.answered_in_part(T0 + 400 * MS, T0 + DEAF_NS)
    assert link.gone_deaf(T0 + 400 * MS, T0 + DEAF_NS)


def echoing() -> Link:
    link = Link(DEAF_NS, asked=False, echo_ns=50 * MS)
    link.said(T0, 0)
    return link


def test_zeros_while_motion_is_written_are_deafness_until_the_reset() -> None:
    link = echoing()
    link.said(T0 + 349 * MS, 0)
    link.check_echo(T0 + 100 * MS)
    assert link.state == LINK_UNASKED
    link.said(T0 + 350 * MS, 0)
    link.check_echo(T0 + 100 * MS)
    assert (link.state, link.forbids) == (LINK_DEAF, False)
    link.check_echo(0)
    assert link.state == LINK_DEAF, "after the stop it says zero whether it hears or not"
    link.cleared()
    assert link.state == LINK_UNASKED


def test_an_answer_after_an_echo_of_zeros_counts_only_once_the_stop_is_cleared() -> None:
    link = Link(DEAF_NS, echo_ns=50 * MS)
    link.said(T0 + 350 * MS, 0)
    link.check_echo(T0 + 100 * MS)
    link.answered(T0 + 400 * MS)
    assert link.state == LINK_DEAF
    link.cleared()
    assert link.state == LINK_UNPROVEN
    link.answered(T0 + 500 * MS)
    assert link.state == LINK_ALIVE


def test_a_board_that_does_not_report_its_command_is_never_deaf_by_its_reports() -> None:
    link = heard(T0)
    link.said(T0 + 1_000 * MS, T0)
    link.check_echo(T0)
    assert link.state == LINK_ALIVE


def test_a_pause_of_the_reports_is_no_echo_of_zeros() -> None:
    link = echoing()
    link.check_silence(700 * MS, T0 + 600 * MS)
    link.check_echo(T0)
    assert link.state == LINK_UNASKED


def test_a_board_that_was_silent_has_its_time_to_answer() -> None:
    link = heard(T0)
    link.said(T0, 0)
    link.check_silence(700 * MS, T0 + 700 * MS)
    assert (link.state, link.forbids) == (LINK_SILENT, True)
    assert not link.gone_deaf(T0 + 500 * MS, T0 + 1_600 * MS), "what is silent is not called deaf too"
    link.said(T0 + 2_000 * MS, T0 + 1_900 * MS)
    assert link.state == LINK_ALIVE
    assert not link.gone_deaf(T0 + 2_000 * MS, T0 + 2_400 * MS)
    link.said(T0 + 2_890 * MS, T0 + 2_000 * MS)
    assert link.gone_deaf(T0 + 2_000 * MS, T0 + 2_900 * MS)


@pytest.mark.parametrize(("known", "forbids"), [(True, True), (False, False)])
def test_a_board_that_was_heard_must_be_heard_again_before_motion(known: bool, forbids: bool) -> None:
    link = heard(T0) if known else Link(DEAF_NS)
    link.opened(T0 + MS, sure=False)
    assert (link.state, link.forbids) == (LINK_UNHEARD, forbids)
