"""After a stop: the first is the one that is followed, wheels that do not rest are stopped for again, until a reset."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgpack
import pytest

from failstop.policy import causes
from failstop.procs.loop import GONE
from failstop.shm import layout, records, segment
from failstop.supervisor.stops import Stop
from tests.support.supervisor_scene import MS, Scene
from tests.support.waiting import until
from tests.support.why import why

UNSTILL = str(causes.UNSTILL())
DEAF_REASON = str(causes.DEAF())
FIRST = str(why("the first"))


class Watched(Scene):
    """Telemetry's words too."""

    def __init__(self, directory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        super().__init__(directory, monkeypatch)
        self.telemetry = segment.attach(self.run.memory, layout.TELEMETRY, write=True)
        self.link = segment.attach(self.run.memory, layout.SUPERVISOR).latest_reader("link")

    def stop(self, reason: str) -> None:
        """The gate stops, and the port owner answers."""
        self.gate_stops(reason)
        self.turn()
        self.answers(written_ns=self.now_ns)
        self.turn(MS)

    def shake(self, seconds: float) -> None:
        """The IMU shows wheels that turn; every stop is answered."""
        for _ in range(round(seconds / 0.05)):
            self.telemetry.word("still_ns").set(0)
            self.telemetry.word("judged_ns").set(self.now_ns)
            self.turn(50 * MS)
            self.answers(written_ns=self.now_ns)

    def proofs(self) -> dict[str, Any]:
        """All that is told of the stop."""
        entry = self.stop_record.read()
        assert entry is not None
        found: dict[str, Any] = msgpack.unpackb(entry[2])
        return found

    def follow(self, elapsed_ns: int, *, listening: bool = True) -> list[tuple[int, str, str]]:
        """Aftermath's own turn; returns the causes that it brought."""
        self.now_ns += elapsed_ns
        stops = self.supervisor.aftermath.follow(self.now_ns, listening=listening)
        return [(stop.t_ns, stop.noticed_by, str(stop.cause)) for stop in stops]

    def said(self) -> list[tuple[str, str, str, dict[str, Any]]]:
        """What people were told since the last call."""
        self.supervisor._events.flush()
        return [(event["kind"], event["level"], event["text"], event["fields"]) for event in self.events()]

    def pings(self, index: int, *, answered: bool) -> None:
        """A ping goes out now; its answer comes a millisecond later."""
        self.port_owner.word(f"ping_{index}").set(self.now_ns)
        if answered:
            self.telemetry.word("pong").set(records.pong(self.now_ns + MS, index))


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Watched]:
    made = Watched(tmp_path, monkeypatch)
    yield made
    made.close()


def test_of_two_stops_the_first_is_followed_until_a_reset(scene: Watched) -> None:
    scene.stop("the first")
    scene.stop("the second")
    assert scene.told()["reason"] == "the first"
    scene.reset()
    scene.stop("the third")
    assert scene.told()["reason"] == "the third"


@pytest.mark.starts
def test_wheels_that_do_not_rest_are_stopped_for_again_and_the_command_runs_once(
    scene: Watched, tmp_path: Path
) -> None:
    ran = tmp_path / "ran"
    scene.supervisor.aftermath._command = f"echo ran >> {ran}"
    scene.stop("the first")
    scene.shake(1.4)
    assert scene.supervisor.epoch == 2
    scene.shake(4.8)
    assert scene.supervisor.epoch == 6, "after 1.5, 3, 4.5 and 6 s"
    until(ran.exists, "the command")
    until(lambda: not scene.turn(MS) and not scene.supervisor.aftermath._command_pids, "the command's end")
    scene.shake(1.5)
    assert ran.read_text() == "ran\n"
    scene.reset()
    epoch = scene.supervisor.epoch
    scene.shake(5.0)
    assert scene.supervisor.epoch == epoch, "a reset ends the question"


def test_an_answer_acknowledges_what_was_written_before_its_ping(scene: Watched) -> None:
    sent_ns = scene.now_ns
    scene.port_owner.word("ping_0").set(sent_ns)
    scene.telemetry.word("pong").set(records.pong(sent_ns + MS, 0))
    scene.turn(2 * MS)
    assert scene.supervisor.aftermath.heard == (sent_ns, sent_ns + MS)


def test_a_port_that_was_opened_anew_may_be_another_board(scene: Watched) -> None:
    scene.port_owner.word("ping_0").set(scene.now_ns)
    scene.telemetry.word("pong").set(records.pong(scene.now_ns + MS, 0))
    scene.turn(2 * MS)
    assert scene.link.read()[2] == b"alive"  # type: ignore[index]
    scene.supervisor.aftermath.opened(scene.now_ns)
    scene.turn(2 * MS)
    assert scene.link.read()[2] == b"unproven"  # type: ignore[index]


def test_an_answer_whose_question_was_asked_anew_meanwhile_proves_nothing(scene: Watched) -> None:
    """The words of the questions are used in turn: a late answer must not be taken for one to the newest."""
    scene.stop("the first")
    asked = scene.port_owner.word("ping_0")
    pong = scene.telemetry.word("pong")
    asked.set(scene.now_ns + 2 * MS)
    pong.set(records.pong(scene.now_ns + MS, 0))
    scene.turn(3 * MS)
    assert scene.link.read()[2] == b"unproven"  # type: ignore[index]
    assert scene.proofs()["acknowledged_us"] is None
    pong.set(records.pong(scene.now_ns + MS, 0))
    scene.turn(2 * MS)
    assert scene.link.read()[2] == b"alive"  # type: ignore[index]
    assert scene.proofs()["acknowledged_us"] > 0


class Rewritten:
    """A word that telemetry writes just while the supervisor looks: its first reading is of before."""

    def __init__(self, before_ns: int, after_ns: int) -> None:
        self._values = [before_ns]
        self._after_ns = after_ns

    def get(self) -> int:
        return self._values.pop() if self._values else self._after_ns


def test_a_verdict_that_is_given_anew_meanwhile_is_looked_at_the_next_time(
    scene: Watched, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Its two words may be of different moments: still of before, judged of now."""
    scene.stop("the first")
    scene.shake(0.1)
    scene.telemetry.word("still_ns").set(scene.now_ns)
    judged = Rewritten(scene.now_ns, scene.now_ns + MS)
    monkeypatch.setattr(scene.supervisor.aftermath, "_judged", judged)
    scene.turn(MS)
    assert scene.proofs()["observed_ms"] is None
    assert scene.supervisor.epoch == 2
    scene.turn(MS)
    assert scene.proofs()["observed_ms"] is not None
    written = scene.stop_record.read()
    scene.turn(MS)
    assert scene.stop_record.read() == written, "what is known is not written again"


def test_what_is_told_of_the_link(scene: Watched) -> None:
    scene.pings(0, answered=True)
    assert scene.follow(2 * MS) == []
    assert scene.said() == [("link", "notice", "the board answers", {"state": "alive"})]
    scene.now_ns += 500 * MS
    scene.pings(1, answered=False)
    assert scene.follow(600 * MS) == [(scene.now_ns, layout.SUPERVISOR, DEAF_REASON)]
    assert scene.said() == [("link", "critical", "the board answers no more", {"state": "deaf"})]
    assert scene.follow(600 * MS) == [], "once"
    scene.pings(3, answered=True)
    scene.follow(2 * MS)
    assert scene.said() == [("link", "notice", "the board answers again", {"state": "alive"})]
    scene.supervisor.handover.lost({scene.port.fd: GONE}, scene.now_ns)
    scene.supervisor.aftermath.link.opened()
    scene.said()
    scene.follow(MS)
    text = "whether the board hears is not known until it answers"
    assert scene.said() == [("link", "info", text, {"state": "unproven"})]


def test_a_board_is_not_deaf_while_nobody_listens(scene: Watched) -> None:
    scene.pings(0, answered=True)
    scene.follow(2 * MS)
    scene.now_ns += 500 * MS
    scene.pings(1, answered=False)
    assert scene.follow(600 * MS, listening=False) == []
    assert scene.follow(600 * MS) == [], "nor for the ping whose answer nobody could hear"


def test_what_is_told_of_wheels_that_do_not_rest(scene: Watched) -> None:
    scene.stop("the first")
    scene.said()
    scene.telemetry.word("judged_ns").set(scene.now_ns + 1_600 * MS)
    assert scene.follow(1_600 * MS) == [(scene.now_ns, layout.SUPERVISOR, UNSTILL)]
    told = {"reason": FIRST, "epoch": 2}
    outcome = {**told, "cause": "piped", "link": "unproven", "sent": True, "wheels": "unstill"}
    assert scene.said() == [
        ("unstill", "critical", f"CRITICAL: {UNSTILL} ({FIRST}; 1.6 s ago)", told),
        ("stop_outcome", "error", f"{FIRST}: not acknowledged (link unproven), wheels NOT seen still", outcome),
    ]
    scene.telemetry.word("still_ns").set(scene.now_ns)
    scene.telemetry.word("judged_ns").set(scene.now_ns + MS)
    assert scene.follow(MS) == []
    assert scene.said() == [], "it was told of"


def test_a_stop_that_another_follows_is_told_of_with_what_is_known(scene: Watched) -> None:
    scene.stop("the first")
    scene.said()
    scene.pings(0, answered=True)
    scene.turn(2 * MS)
    scene.reset()
    scene.stop("the second")
    outcome = next(event for event in scene.said() if event[0] == "stop_outcome")
    acknowledged_us = outcome[3].pop("acknowledged_us")
    assert acknowledged_us == 2_000.0
    text = f"{FIRST}: acknowledged by the board after 2.0 ms, not observed"
    fields = {"reason": FIRST, "cause": "piped", "epoch": 2, "link": "alive", "sent": True, "wheels": "unknown"}
    assert outcome == ("stop_outcome", "notice", text, fields)


def test_a_stop_that_could_not_be_written_is_that_of_the_opening(scene: Watched) -> None:
    opened = scene.supervisor.aftermath.opened
    noticed_ns = scene.now_ns
    stop = Stop(noticed_ns, layout.GATE, why("the first"))
    stop.answered_by("supervisor", 0, stop, 1)
    scene.supervisor.aftermath.answered(stop, ending=False)
    assert scene.told() == {"reason": "the first", "written_by": "supervisor", "written_us": None}
    for burst_ns in (0, noticed_ns):
        opened(burst_ns)
        assert scene.told()["written_us"] is None, "no burst was written since"
    for late_ms in (1, 2):
        opened(noticed_ns + late_ms * MS)
        told = {"reason": "the first", "written_by": "supervisor", "written_us": 1_000.0}
        assert scene.told() == told, "once"


@pytest.mark.parametrize("answered", [False, True])
def test_a_stop_that_the_kernel_holds_is_told_of_as_that_unless_the_board_has_answered(
    scene: Watched, monkeypatch: pytest.MonkeyPatch, answered: bool
) -> None:
    scene.world.play("unsent_bytes", lambda fd: 1280)  # of a later write, where the board has answered
    scene.stop("the first")
    scene.said()
    scene.pings(0, answered=answered)
    scene.turn(2 * MS)
    scene.reset()
    scene.stop("the second")
    [(_, level, text, fields)] = [event for event in scene.said() if event[0] == "stop_outcome"]
    assert (fields["sent"], level) == ((True, "notice") if answered else (False, "error"))
    assert ("handed over, NOT sent" in text) is not answered
