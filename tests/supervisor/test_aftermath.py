"""After a stop: the first is the one that is followed, wheels that do not rest are stopped for again, until a reset."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.shm import layout, records, segment
from tests.supervisor.test_answers import MS, Scene
from tests.waiting import until


class Watched(Scene):
    """Telemetry's words too."""

    def __init__(self, directory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        super().__init__(directory, monkeypatch)
        self.telemetry = segment.attach(self.resources.name, layout.TELEMETRY, write=True)
        self.link = segment.attach(self.resources.name, layout.SUPERVISOR).latest_reader("link")

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


def test_a_port_that_was_opened_anew_may_be_another_board(scene: Watched) -> None:
    scene.port_owner.word("ping_0").set(scene.now_ns)
    scene.telemetry.word("pong").set(records.pong(scene.now_ns + MS, 0))
    scene.turn(2 * MS)
    assert scene.link.read()[2] == b"alive"  # type: ignore[index]
    port = scene.port_owner.latest_writer("port")
    port.write(records.pack_port(2, scene.now_ns, records.PORT_OPEN, "/dev/board"))
    scene.turn(2 * MS)
    assert scene.link.read()[2] == b"unproven"  # type: ignore[index]
