"""A length that noise has garbled on Feetech's bus: the servos wait for up to 255 bytes, and answer nothing."""

from __future__ import annotations

from typing import Any

import pytest

from failstop.board.feetech import codec
from failstop.board.kinds import wire_of
from failstop.board.wire import Answer
from failstop_lab.boards.feetech import Bus
from failstop_lab.boards.line import arrivals
from tests.support.simulated import Simulated

WIRE = wire_of("feetech")
S = 1_000_000_000


def silent_ns(bus: Bus, first: int) -> int:
    """How long the service hears nothing of the wheels, if it asks them from now on and no motion is written."""
    asks = [question.ask for question in WIRE.questions]
    writes = [(at * WIRE.ping_ns, asks[(first + at) % len(asks)]) for at in range(30)]
    for at_ns, value in arrivals(writes, WIRE.port.byte_ns):
        bus.byte(at_ns, value)
    bus.until(3 * S)
    reader = codec.Replies()
    for at_ns, data in sorted(bus.said):
        if any(isinstance(sample, Answer) for sample in reader.feed(data)):
            return at_ns
    return 3 * S


@pytest.mark.parametrize("first", [0, 1])
def test_the_wheels_answer_again_before_their_silence_would_be_a_restart(first: int) -> None:
    """Whatever length they took for that of a packet, and to whatever servo."""
    heads = [bytes((255, 255, servo, length)) for servo in (*codec.WHEELS, codec.EVERY_SERVO) for length in range(256)]
    longest_ns = max(silent_ns(Bus(heard=head), first) for head in heads)
    # The last answer before it was up to a question earlier, and telemetry takes a little to read.
    assert longest_ns + WIRE.ping_ns + WIRE.ping_ns // 2 <= WIRE.silent_ns


@pytest.mark.parametrize("drives", [False, True])
def test_a_garbled_length_latches_nothing(drives: bool) -> None:
    """A silence of 0.7 s would be a restart, which latches a stop."""
    simulated = Simulated(kind="feetech")
    simulated.wait(1.0)
    if drives:
        simulated.enable()
        simulated.drive(1.0)
    model: Any = simulated.lab.board.model
    bus: Bus = model.receiver
    heard = len(bus.said)
    bus.noise(b"\xff\xff\xfe\xff", 0)
    (simulated.drive if drives else simulated.wait)(3.0)
    assert len(bus.said) > heard + 3 * 20
    assert simulated.robot.state.cause is None
    assert simulated.robot.state.enabled is drives
