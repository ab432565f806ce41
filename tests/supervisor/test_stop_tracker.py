"""After a stop: the first is the one that is followed, wheels that do not rest are stopped for again, until a reset."""

from __future__ import annotations

import re

import pytest

from failstop.messages import layout
from failstop.policy import causes
from failstop.policy.processes import PROCESS_BY_NAME
from failstop.policy.proofs import LINK_DEAF, LINK_UNHEARD, WAITS_FOR
from failstop.procs.loop import GONE
from failstop_lab.machine.process import Process
from tests.support.stage import MS
from tests.support.supervisor_scene import Scene
from tests.support.why import why

PROVED_BY = {"acknowledged_by": "answer", "observed_by": "IMU"}
UNSTILL = str(causes.UNSTILL())
DEAF_REASON = str(causes.DEAF())
FIRST = str(why("the first"))


@pytest.fixture
def scene() -> Scene:
    return Scene(layout.PORT_OWNER)


def shake(scene: Scene, seconds: float) -> None:
    """The IMU shows wheels that turn; every stop is answered."""
    for _ in range(round(seconds / 0.05)):
        scene.judge(still=False)
        scene.turn(50 * MS)
        scene.answers(written_ns=scene.now_ns)


def follow(scene: Scene, elapsed_ns: int, *, listening: bool = True) -> list[tuple[int, str, str]]:
    """StopTracker's own turn; returns the causes that it brought."""
    scene.now_ns += elapsed_ns
    stops = scene.supervisor.tracker.poll(scene.now_ns, listening=listening)
    return [(stop.t_ns, stop.noticed_by, str(stop.cause)) for stop in stops]


def test_of_two_stops_the_first_is_followed_until_a_reset(scene: Scene) -> None:
    scene.stops("the first")
    scene.stops("the second")
    assert scene.told()["reason"] == "the first"
    scene.reset()
    scene.stops("the third")
    assert scene.told()["reason"] == "the third"


def test_wheels_that_do_not_rest_are_stopped_for_again_and_the_command_runs_once() -> None:
    scene = Scene(layout.PORT_OWNER, settings={"still.command": "ring the bell"})
    ran: list[tuple[int, list[str]]] = []

    def shell(process: Process, argv: list[str]) -> int:
        ran.append((process.machine.now_ns, argv))
        return 0

    scene.machine.programs["sh"] = shell
    scene.stops("the first")
    shake(scene, 1.4)
    assert (scene.supervisor.epochs.number, ran) == (2, [])
    shake(scene, 4.8)
    assert scene.supervisor.epochs.number == 6, "after 1.5, 3, 4.5 and 6 s"
    shake(scene, 1.5)
    assert [argv for _, argv in ran] == [["/bin/sh", "-c", "ring the bell"]]
    scene.reset()
    epoch = scene.supervisor.epochs.number
    shake(scene, 5.0)
    assert scene.supervisor.epochs.number == epoch, "a reset ends the question"


def test_an_answer_acknowledges_what_was_written_before_its_ping(scene: Scene) -> None:
    sent_ns = scene.now_ns
    scene.pings()
    scene.turn(2 * MS)
    assert scene.supervisor.tracker.heard == (sent_ns, sent_ns + MS)


def test_a_port_that_was_opened_anew_may_be_another_board(scene: Scene) -> None:
    scene.pings()
    scene.turn(2 * MS)
    assert scene.read("link") == b"alive"
    scene.supervisor.tracker.opened(scene.now_ns, scene.now_ns, sure=True)
    scene.turn(2 * MS)
    assert scene.read("link") == b"unheard"


@pytest.mark.parametrize(("sure", "state"), [(True, b"unproven"), (False, b"unheard")])
def test_a_port_that_was_opened_again_and_never_heard_may_have_another_device(
    scene: Scene, sure: bool, state: bytes
) -> None:
    scene.supervisor.tracker.opened(scene.now_ns, scene.now_ns, sure=sure)
    scene.turn(MS)
    assert scene.read("link") == state


def test_an_answer_to_an_older_question_proves_that_the_board_hears_and_not_the_stop(scene: Scene) -> None:
    asked_ns = scene.now_ns
    scene.turn(MS)
    scene.stops("the first")
    assert scene.table("stop")["believed"] is False
    scene.answered(asked_ns, scene.now_ns)
    scene.turn(MS)
    assert scene.read("link") == b"alive"
    assert (scene.table("stop")["acknowledged_us"], scene.table("stop")["believed"]) == (None, True)
    scene.answered(scene.now_ns, scene.now_ns + MS)
    scene.turn(2 * MS)
    assert scene.table("stop")["acknowledged_us"] > 0


def test_a_verdict_that_is_given_anew_meanwhile_is_looked_at_the_next_time() -> None:
    """Its two words may be of different moments: still of before, judged of now."""
    between, release = "failstop.shm.words", "self._release()"
    acts, act = "LINE_BYTES = 64; MEANWHILE = []", f"{release}; MEANWHILE and MEANWHILE.pop()()"
    scene = Scene(layout.PORT_OWNER, patches=((between, "LINE_BYTES = 64", acts), (between, release, act)))
    scene.stops("the first")
    shake(scene, 0.1)
    scene.judge(still=True)
    judges = lambda: scene.telemetry.word("judged_ns").set(scene.now_ns)  # noqa: E731
    scene.load(between).MEANWHILE.extend([judges, lambda: None])  # the last is for the barrier of the link's words
    scene.turn(MS)
    assert scene.table("stop")["observed_ms"] is None
    assert scene.supervisor.epochs.number == 2
    scene.turn(MS)
    assert scene.table("stop")["observed_ms"] is not None
    written = scene.number("stop")
    scene.turn(MS)
    assert scene.number("stop") == written, "what is known is not written again"


def test_people_are_told_of_each_change_of_the_link(scene: Scene) -> None:
    scene.pings()
    assert follow(scene, 2 * MS) == []
    assert scene.said() == [("link", "notice", "the board answers", {"state": "alive"})]
    scene.now_ns += 500 * MS
    scene.pings(answered=False)
    assert follow(scene, 600 * MS) == [], "motion is disabled"
    text = "the board no longer hears: use the POWER SWITCH, then check its cable"
    assert scene.said() == [("link", "critical", text, {"state": "deaf"})]
    scene.port_owner.word("moving").set(1)
    assert follow(scene, 600 * MS) == [(scene.now_ns, layout.SUPERVISOR, DEAF_REASON)], "it was enabled all the same"
    assert follow(scene, 600 * MS) == [], "once"
    scene.port_owner.word("moving").set(0)
    scene.pings()
    follow(scene, 2 * MS)
    assert scene.said() == [("link", "notice", "the board answers again", {"state": "alive"})]
    scene.supervisor.handover.lost({scene.port.fd: GONE}, scene.now_ns)
    scene.supervisor.tracker.link.opened(scene.now_ns)
    scene.said()
    follow(scene, MS)
    text = "nobody knows whether the board hears until it answers"
    assert scene.said() == [("link", "info", text, {"state": "unheard"})]
    scene.pings(answered=False)
    follow(scene, MS)
    follow(scene, 1_000 * MS)
    text = "nothing has answered since the port came back, so it may not be the board: use the POWER SWITCH"
    assert scene.said() == [("link", "critical", text, {"state": "unheard"})]
    follow(scene, 1_000 * MS)
    assert scene.said() == [], "once"
    scene.pings()
    follow(scene, 2 * MS)
    assert scene.said() == [("link", "notice", "the board answers again", {"state": "alive"})]


@pytest.mark.parametrize("state", [LINK_DEAF, LINK_UNHEARD])
def test_motion_waits_for_a_board_that_was_heard_and_is_heard_no_more(state: str) -> None:
    scene = Scene(*PROCESS_BY_NAME)
    for name in (layout.STOPPER, layout.TELEMETRY):
        scene.has_port(name)
    scene.answers()
    scene.pings()
    scene.tick(2 * MS, beating=tuple(PROCESS_BY_NAME))
    assert scene.waits_for() == ""
    if state == LINK_UNHEARD:
        scene.supervisor.tracker.link.opened(scene.now_ns)
    for _ in range(5):
        scene.pings(answered=False)
        scene.tick(400 * MS, beating=tuple(PROCESS_BY_NAME))
    assert scene.read("link") == state.encode()
    assert scene.waits_for() == WAITS_FOR[state]
    scene.pings()
    scene.tick(2 * MS, beating=tuple(PROCESS_BY_NAME))
    assert scene.waits_for() == "", "it answers again"


def test_a_board_that_reports_no_more_is_silent_until_it_reports_again(scene: Scene) -> None:
    said, patience = (scene.telemetry.word(name) for name in ("said_ns", "patience_ns"))
    patience.set(700 * MS)
    follow(scene, 5_000 * MS)
    assert scene.said() == [], "it has said nothing yet"
    said.set(scene.now_ns)
    follow(scene, 699 * MS)
    follow(scene, 500 * MS, listening=False)
    follow(scene, 699 * MS)
    assert scene.read("link") == b"unproven", "while nobody listens it can't be heard"
    scene.port_owner.word("moving").set(1)
    reason = str(causes.BOARD_SILENT())
    assert follow(scene, MS) == [(scene.now_ns, layout.SUPERVISOR, reason)]
    assert scene.read("link") == b"silent"
    [(kind, level, text, fields)] = scene.said()
    assert (kind, level, fields) == ("link", "critical", {"state": "silent"})
    assert "failstop can't tell which" in text
    assert follow(scene, MS) == [], "once"
    said.set(scene.now_ns)
    follow(scene, MS)
    assert scene.said() == [("link", "notice", "the board reports again", {"state": "unproven"})]


def test_a_board_that_obeyed_zeros_while_motion_was_written_is_deaf_until_the_reset() -> None:
    scene = Scene(layout.PORT_OWNER, settings={"board.kind": "hoverboard"})
    scene.stops("the first")
    link = scene.supervisor.tracker.link
    link.said(scene.now_ns, 0)
    link.check_echo(scene.now_ns - 1_000 * MS)
    follow(scene, MS)
    assert scene.read("link") == b"deaf"
    scene.reset()
    follow(scene, MS)
    assert scene.read("link") == b"unasked"


def test_a_board_is_not_deaf_while_nobody_listens(scene: Scene) -> None:
    scene.pings()
    follow(scene, 2 * MS)
    scene.now_ns += 500 * MS
    scene.pings(answered=False)
    assert follow(scene, 600 * MS, listening=False) == []
    assert follow(scene, 600 * MS) == [], "nor for the ping whose answer nobody could hear"


def test_a_silence_that_the_machine_explains_stops_the_robot_and_names_the_machine() -> None:
    both = (layout.PORT_OWNER, layout.TELEMETRY)
    scene = Scene(*both)
    scene.pings()
    scene.tick(20 * MS, beating=both)
    scene.port_owner.word("moving").set(1)
    scene.enabled()
    scene.pings(answered=False)
    scene.tick(160 * MS, beating=(layout.PORT_OWNER,))
    for _ in range(3):
        scene.tick(300 * MS, beating=both)
        scene.pings(answered=False)
    since, reason = scene.cause()
    assert since > 0
    assert re.fullmatch(r"no answer from the board for 1\d\d\d ms \(the machine is starved\)", reason)
    assert scene.read("link") == b"alive", "nobody knows that it is deaf"
    assert not [text for kind, _, text, _ in scene.said() if kind == "link" and "POWER SWITCH" in text]
    for _ in range(4):
        scene.tick(300 * MS, beating=both)
        scene.pings(answered=False)
    assert scene.read("link") == b"deaf", "and nothing held anybody up since"


def test_people_are_told_of_wheels_that_do_not_rest(scene: Scene) -> None:
    noticed_ns = scene.now_ns
    scene.stops("the first")
    scene.said()
    scene.telemetry.word("judged_ns").set(scene.now_ns + 1_600 * MS)
    assert follow(scene, 1_600 * MS) == [(scene.now_ns, layout.SUPERVISOR, UNSTILL)]
    told = {"reason": FIRST, "epoch": 2}
    outcome = {
        **told,
        "cause": "piped",
        "noticed_ns": noticed_ns,
        "link": "unproven",
        "sent": True,
        **PROVED_BY,
        "wheels": "unstill",
    }
    assert scene.said() == [
        ("unstill", "critical", f"CRITICAL: {UNSTILL}: use the POWER SWITCH ({FIRST}; 1.6 s ago)", told),
        ("stop_outcome", "error", f"{FIRST}: not acknowledged (link unproven), wheels NOT seen still", outcome),
    ]
    scene.telemetry.word("still_ns").set(scene.now_ns)
    scene.telemetry.word("judged_ns").set(scene.now_ns + MS)
    assert follow(scene, MS) == []
    assert scene.said() == [], "it was told of"


def test_a_stop_that_another_follows_is_told_of_with_what_is_known(scene: Scene) -> None:
    noticed_ns = scene.now_ns
    scene.stops("the first")
    scene.said()
    scene.pings()
    scene.turn(2 * MS)
    scene.reset()
    scene.stops("the second")
    outcome = next(event for event in scene.said() if event[0] == "stop_outcome")
    acknowledged_us = outcome[3].pop("acknowledged_us")
    assert acknowledged_us == 2_000.0
    assert outcome[3].pop("noticed_ns") == noticed_ns
    text = f"{FIRST}: acknowledged by the board after 2.0 ms, not observed"
    fields = {"reason": FIRST, "cause": "piped", "epoch": 2, "link": "alive", "sent": True, "wheels": "unknown"}
    fields |= PROVED_BY
    assert outcome == ("stop_outcome", "notice", text, fields)


def test_a_stop_that_could_not_be_written_is_that_of_the_opening(scene: Scene) -> None:
    opened = scene.supervisor.tracker.opened
    stop = scene.made_stop(why("the first"), layout.GATE)
    stop.answered_by("supervisor", 0, stop, 1)
    scene.supervisor.tracker.answered(stop, ending=False)
    assert scene.told() == {"reason": "the first", "written_by": "supervisor", "written_us": None}
    for burst_ns in (0, stop.t_ns):
        opened(burst_ns, scene.now_ns, sure=True)
        assert scene.told()["written_us"] is None, "no burst was written since"
    for late_ms in (1, 2):
        opened(stop.t_ns + late_ms * MS, scene.now_ns, sure=True)
        told = {"reason": "the first", "written_by": "supervisor", "written_us": 1_000.0}
        assert scene.told() == told, "once"


def test_a_stop_that_went_to_another_device_is_that_of_the_board_s_opening(scene: Scene) -> None:
    """The bytes that the other device took prove nothing; those that the board takes do once it has answered."""
    scene.pings()
    scene.turn(2 * MS)
    opened = scene.supervisor.tracker.opened
    opened(scene.now_ns, scene.now_ns, sure=False)
    stop = scene.made_stop(why("the first"), layout.GATE)
    stop.answered_by("supervisor", stop.t_ns + MS, stop, 1)
    scene.supervisor.tracker.answered(stop, ending=False)
    found = [(scene.told()["written_us"], scene.table("stop")["believed"])]
    scene.now_ns += 5 * MS
    opened(stop.t_ns + 5 * MS, scene.now_ns, sure=True)
    found.append((scene.told()["written_us"], scene.table("stop")["believed"]))
    scene.pings()
    scene.turn(2 * MS)
    found.append((scene.told()["written_us"], scene.table("stop")["believed"]))
    assert found == [(1_000.0, False), (5_000.0, False), (5_000.0, True)]


@pytest.mark.parametrize("answered", [False, True])
def test_the_monitor_tells_of_a_stop_that_the_kernel_holds_unless_the_board_answered(
    scene: Scene, answered: bool
) -> None:
    scene.wire.hold()  # of a later write, where the board has answered
    scene.stops("the first")
    scene.said()
    scene.pings(answered=answered)
    scene.turn(2 * MS)
    scene.reset()
    scene.stops("the second")
    [(_, level, text, fields)] = [event for event in scene.said() if event[0] == "stop_outcome"]
    assert (fields["sent"], level) == ((True, "notice") if answered else (False, "error"))
    assert ("handed over, NOT sent" in text) is not answered
