"""After a stop: the first is the one that is followed, wheels that do not rest are stopped for again, until a reset."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import msgpack
import pytest

from failstop.shm import layout, records, segment
from tests.supervisor.test_answers import MS, Scene
from tests.waiting import until


class Watched(Scene):
    """Telemetry's words too."""

    def __init__(self, directory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        super().__init__(directory, monkeypatch)
        self.telemetry = segment.attach(self.resources.memory, layout.TELEMETRY, write=True)
        self.link = segment.attach(self.resources.memory, layout.SUPERVISOR).latest_reader("link")

    def stop(self, reason: str) -> None:
        """The gate trips, and the port owner answers."""
        self.trip(reason)
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

    def reset(self) -> None:
        self.gate.word("reset_epoch").set(self.supervisor.epoch)


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
    heard_ns = scene.supervisor.aftermath.heard_ns
    assert heard_ns(sent_ns) == heard_ns(sent_ns - MS) == sent_ns + MS
    assert heard_ns(sent_ns + 1) == 0


def test_a_port_that_was_opened_anew_may_be_another_board(scene: Watched) -> None:
    scene.port_owner.word("ping_0").set(scene.now_ns)
    scene.telemetry.word("pong").set(records.pong(scene.now_ns + MS, 0))
    scene.turn(2 * MS)
    assert scene.link.read()[2] == b"alive"  # type: ignore[index]
    port = scene.port_owner.latest_writer("port")
    port.write(records.pack_port(2, scene.now_ns, records.PORT_OPEN, "/dev/board"))
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
    scene.turn(MS)
    assert scene.proofs()["observed_ms"] is not None
