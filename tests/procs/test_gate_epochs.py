"""The gate beside a supervisor that raises epochs: which cause it latches, and which requests came before a stop."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.procs.gate import main
from failstop.procs.gate.main import Gate
from failstop.shm import bell, claim, instance, layout, records, segment
from failstop.shm.bell import EventBell
from failstop.shm.segment import Segment

from .stage import INCARNATION, MS, Stage

SESSION = 11


class Scene(Stage):
    """The gate on a stage, and one client of it."""

    def __init__(self, directory: Path, monkeypatch: pytest.MonkeyPatch) -> None:
        super().__init__(layout.GATE, directory)
        monkeypatch.setattr(main, "monotonic_ns", self.clock)
        self.runtime_dir = str(directory)
        bell.make_pipe(instance.bell_path(self.runtime_dir), 0o600)
        self._fds["client_bell"] = bell.open_pipe(instance.bell_path(self.runtime_dir))
        self._bells["port_owner_bell"] = EventBell.create()
        self._claims = claim.open_claims(instance.claims_path(self.runtime_dir), create=True)
        self._cause = self._views[layout.SUPERVISOR].latest_writer("cause")
        self._client = segment.attach_client_slot(self.name, 0, INCARNATION)
        self._reply = self.own.latest_reader("reply.0")
        self._number = 0
        self.start_gate()
        assert claim.take(self._claims, 0)
        self._client.latest_writer("hello").write(records.pack_hello(SESSION, 0, 0, "test"))

    def client_slots(self) -> list[Segment]:
        return [segment.read_client_slot(self.name, index, INCARNATION) for index in range(layout.CLIENT_SLOTS)]

    def start_gate(self) -> None:
        """For the first time, or after its death."""
        self.gate = Gate(self)  # type: ignore[arg-type]

    def stop(self, epoch: int, since: int, standing: str, newest: str) -> None:
        """The supervisor raises the epoch."""
        self._cause.write(records.pack_cause(since, self.clock(), standing, newest), self.clock())
        self.raise_epoch(epoch)

    def turn(self) -> str | None:
        """Time passes, a tick of the gate; returns the latched reason."""
        self.clock.now_ns += 20 * MS
        self.beat(layout.SUPERVISOR)
        self.gate.turn({})
        return self.gate.core.latch

    def ask(self, verb: int, asked_ns: int | None = None) -> None:
        """The client asks."""
        self._number += 1
        request = records.pack_request(SESSION, self._number, verb)
        self._client.latest_writer("request").write(request, asked_ns or self.clock())

    def answer(self) -> tuple[bool, str]:
        entry = self._reply.read()
        assert entry is not None
        _, number, done, text = records.unpack_reply(entry[2])
        assert number == self._number
        return done, text

    def close(self) -> None:
        for fd in (self._claims, self._fds["client_bell"]):
            os.close(fd)
        self._client.close()
        super().close()


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Scene]:
    made = Scene(tmp_path, monkeypatch)
    yield made
    made.close()


def test_the_first_cause_since_the_reset_is_latched(scene: Scene) -> None:
    assert scene.turn() is None
    scene.stop(2, 2, "key1", "key1")
    assert scene.turn() == "key1"
    scene.stop(3, 2, "key1", "device lost")
    assert scene.turn() == "key1"


def test_a_stop_that_crosses_the_reset_is_latched_with_its_own_cause(scene: Scene) -> None:
    """The supervisor raises the epoch before it sees the reset, and the gate resets before it sees that epoch."""
    scene.stop(2, 2, "key1", "key1")
    scene.turn()
    scene.stop(3, 2, "key1", "device lost")
    scene.gate.client_request(scene.gate.clients.slots[0], 1, records.RESET, scene.clock(), scene.clock())
    assert scene.gate.core.latch is None
    assert scene.turn() == "device lost"
    scene.stop(4, 3, "device lost", "gate died")
    assert scene.turn() == "device lost"
    scene.start_gate()
    assert scene.gate.core.latch == "device lost"


def test_a_successor_finds_what_crossed_the_reset(scene: Scene) -> None:
    scene.stop(2, 2, "key1", "key1")
    scene.turn()
    scene.stop(3, 2, "key1", "gate died")
    scene.gate.client_request(scene.gate.clients.slots[0], 1, records.RESET, scene.clock(), scene.clock())
    scene.start_gate()
    assert scene.gate.core.latch == "gate died"


def test_a_successor_finds_both_causes_together(scene: Scene) -> None:
    scene.stop(3, 2, "key1", "gate died")
    scene.start_gate()
    assert scene.gate.core.latch == "key1"


def test_a_damaged_or_missing_cause_latches_too(scene: Scene) -> None:
    scene.raise_epoch(2)
    assert scene.turn() == "stopped by the supervisor"
    scene._cause.write(b"short")
    scene.raise_epoch(3)
    scene.start_gate()
    assert scene.gate.core.latch == "stopped by the supervisor (its reason is damaged)"


@pytest.mark.parametrize("successor", [False, True])
@pytest.mark.parametrize(("after_ns", "granted"), [(-MS, False), (MS, True)])
def test_who_asked_before_the_stop_did_not_know_of_it(
    scene: Scene, successor: bool, after_ns: int, granted: bool
) -> None:
    """Of a gate that saw the stop, and of one that was started for it."""
    scene.stop(2, 2, "gate died", "gate died")
    stopped_ns = scene.clock()
    if successor:
        scene.start_gate()
    assert scene.turn() == "gate died"
    scene.ask(records.RESET, stopped_ns + after_ns)
    for _ in range(main.LOOK_AT_ALL_EVERY):
        latched = scene.turn()
    done, text = scene.answer()
    assert done == granted
    assert latched == (None if granted else "gate died")
    assert granted or text.startswith("asked before the last stop (gate died)")


def test_nothing_was_stopped_yet_for_the_first_gate(scene: Scene) -> None:
    scene.ask(records.RESET, 1)
    for _ in range(main.LOOK_AT_ALL_EVERY):
        scene.turn()
    assert scene.answer() == (True, "no e-stop is latched")
