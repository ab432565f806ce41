"""The gate's state as telemetry reads it, and a gate that is silent."""

from __future__ import annotations

import msgpack
import pytest

from failstop.procs.telemetry.main import GateState

MS = 1_000_000


class Published:
    """A stand-in for the gate's record."""

    def __init__(self) -> None:
        self.entry: tuple[int, int, bytes] | None = None

    def read(self) -> tuple[int, int, bytes] | None:
        return self.entry

    def put(self, t_ns: int, **changed: object) -> None:
        state = {"enabled": True, "estop": None, "blocked": None, "epoch": 7, "body_vel": [0.1, 0.0, -0.5], **changed}
        self.raw(t_ns, msgpack.packb(state))

    def raw(self, t_ns: int, payload: bytes) -> None:
        self.entry = ((self.entry[0] if self.entry else 0) + 1, t_ns, payload)


@pytest.fixture
def published() -> Published:
    return Published()


@pytest.fixture
def gate(published: Published) -> GateState:
    return GateState(published)  # type: ignore[arg-type]


def test_before_the_first_nothing_moves_or_is_latched(gate: GateState) -> None:
    assert not gate.read(10_000 * MS)
    assert (gate.enabled, gate.latched, gate.commanded) == (False, False, False)


def test_a_state_is_news_once(gate: GateState, published: Published) -> None:
    published.put(100 * MS)
    assert gate.read(101 * MS)
    assert (gate.enabled, gate.latched, gate.velocity, gate.since_ns) == (True, False, (0.1, 0.0, -0.5), 100 * MS)
    assert gate.commanded
    assert not gate.read(102 * MS)


def test_a_latch_is_any_reason(gate: GateState, published: Published) -> None:
    published.put(100 * MS, estop="", body_vel=[0, 0, 0])
    gate.read(100 * MS)
    assert gate.latched
    assert not gate.commanded


@pytest.mark.parametrize("velocity", [[0.1, 0.0, -0.5], [0, 0, 0]])
def test_a_gate_silent_for_250_ms_moves_and_enables_nothing(
    gate: GateState, published: Published, velocity: list[float]
) -> None:
    published.put(100 * MS, body_vel=velocity)
    gate.read(100 * MS)
    assert gate.enabled
    assert not gate.read(350 * MS)
    assert gate.read(350 * MS + 1)
    assert (gate.commanded, gate.enabled, gate.since_ns) == (False, False, 350 * MS + 1)
    assert not gate.read(400 * MS), "told once"
    published.put(500 * MS)
    assert gate.read(500 * MS)
    assert gate.commanded


def test_the_state_of_a_dead_gate_is_old_at_once(gate: GateState, published: Published) -> None:
    published.put(100 * MS)
    assert gate.read(900 * MS)
    assert not gate.commanded


@pytest.mark.parametrize("payload", [b"", b"\xc1", msgpack.packb(7), msgpack.packb({"enabled": True})])
def test_a_payload_that_is_no_state_changes_nothing(gate: GateState, published: Published, payload: bytes) -> None:
    published.put(100 * MS)
    gate.read(100 * MS)
    published.raw(110 * MS, payload)
    assert not gate.read(110 * MS)
    assert gate.commanded
