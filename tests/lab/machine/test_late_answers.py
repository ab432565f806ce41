"""No stop is acknowledged before the board has handled it, whatever its line does.

The judge is the board's receiver. The line holds bytes back for up to two seconds each way, for another time at each
stop, and loses questions and answers, so that old ones are answered while new ones are asked. Telemetry and port owner
are killed with questions under way. Of a board that is asked nothing the command wire breaks now and then while it
drives, and the stop never arrives.
"""

from __future__ import annotations

import random
from collections.abc import Iterator

import msgpack
import pytest

from failstop.policy.layouts import BOARDS
from failstop_lab.machine.port import Port
from tests.support.amounts import amount
from tests.support.simulated import FORWARD, Simulated

LATEST_S = 2.0
EARLY_NS = 5_000_000
"""A stop may be written so long before its cause counts as noticed: a thread writes it that only waits for a death."""
TRIALS = 1_000
"""Of each board, in a long campaign (FAILSTOP_CAMPAIGN=long)."""
EACH = 50
"""Trials of one service."""


class Judge:
    """Compares the stops that the service calls acknowledged with those that the receiver handled."""

    def __init__(self, kind: str, rng: random.Random) -> None:
        self.sim = Simulated(kind=kind)
        self._rng, self._kind = rng, kind
        attach = self.sim.load("failstop.api.client").attach
        self._record = attach("failstop", "supervisor").latest_reader("stop")
        self.stops: dict[int, int] = {}
        """Of each stop, by when it was noticed, when it was acknowledged; 0: not yet."""
        self.handled: list[tuple[int, int]] = []
        """Of each stop frame that the receiver has handled: when it was written, and when it was handled."""
        self.sim.lab.board.on_frame = self._take
        self._loss = 0.0
        """The share of questions, and of what the board says, that is lost. Not of stops: that a question which was
        written behind a stop comes no further than the stop is taken for granted (docs/reference/assumptions.md,
        PING)."""
        self._lose()

    def _lose(self) -> None:
        line = self.sim.lab.board
        receive, send, pings = line.model.receive, line._send, line.traits.language.pings

        def received(chunk: bytes, t_ns: int) -> None:
            if chunk not in pings or self._rng.random() >= self._loss:
                receive(chunk, t_ns)

        def sent(port: Port, data: bytes) -> None:
            if self._rng.random() >= self._loss:
                send(port, data)

        line.model.receive, line._send = received, sent  # type: ignore[method-assign]

    def _take(self, frame: object) -> None:
        if frame.is_stop:  # type: ignore[attr-defined]
            arrival_ns: int = frame.arrival_ns  # type: ignore[attr-defined]
            written_ns = self.sim.lab.board.written_ns.get(arrival_ns, arrival_ns)
            self.handled.append((written_ns, frame.executed_ns))  # type: ignore[attr-defined]

    def look(self) -> None:
        if entry := self._record.read():
            stop = msgpack.unpackb(entry[2])
            heard_us = stop["acknowledged_us"]
            self.stops[stop["noticed_ns"]] = 0 if heard_us is None else stop["noticed_ns"] + round(heard_us * 1000)

    def trial(self) -> None:
        sim, rng, line = self.sim, self._rng, self.sim.lab.board
        if rng.random() < 0.7:
            line.down_ns, line.up_ns = (round(rng.choice((1.0, 0.2)) * rng.uniform(0, LATEST_S) * 1e9) for _ in "du")
            self._loss = rng.choice((0.0, 0.0, 0.1, 0.4))
        self.wait(rng.uniform(0, 2.5))
        if rng.random() < 0.2:
            self.kill("telemetry", "port_owner")
            self.wait(0.5)
        try:
            sim.enable()
            breaks = not line.traits.language.pings and rng.random() < 0.15
            breaks_ns = sim.now_ns() + (rng.randrange(0, 2_000) * 1_000_000 if breaks else 1 << 60)

            def each() -> None:
                self.look()
                if sim.now_ns() >= breaks_ns:
                    sim.board.deaf(True)

            for _ in range(rng.randrange(1, 4)):
                sim.lab.drive(sim.robot, rng.uniform(0.05, 1.5), (rng.uniform(0.05, 0.2), 0.0, 0.0), each)
        except (sim.failstop.FailstopError, AssertionError):
            pass  # the line is so bad that a stop has come by itself
        if rng.random() < 0.1:
            self.kill("telemetry", "port_owner", "gate")
            self.wait(0.01)
        if sim.robot.state.estop is None:
            sim.robot.estop("hand near wheel")
        self.wait(rng.choice((0.2, 2.0, 2 * LATEST_S + 0.5)))
        sim.board.deaf(False)

    def kill(self, *names: str) -> None:
        """SIGKILL one of these, unless it is down for having died too often."""
        if (name := self._rng.choice(names)) in self.sim.living():
            self.sim.die(name)

    def wait(self, seconds: float) -> None:
        until_ns = self.sim.now_ns() + round(seconds * 1e9)
        while self.sim.now_ns() < until_ns:
            self.look()
            self.sim.wait(0.05)

    def false(self) -> list[int]:
        """The stops that were told as acknowledged before the board had handled any frame of theirs."""
        self.sim.lab.board.catch_up()
        found = []
        for noticed_ns, acknowledged_ns in self.stops.items():
            by_then = [handled_ns for written_ns, handled_ns in self.handled if written_ns >= noticed_ns - EARLY_NS]
            if acknowledged_ns and min(by_then, default=acknowledged_ns + 1) > acknowledged_ns:
                found.append(noticed_ns)
        return found


def judged(kind: str, trials: int, seed: int) -> Iterator[Judge]:
    for begin in range(0, trials, EACH):
        judge = Judge(kind, random.Random(f"{kind} {seed} {begin}"))
        for _ in range(min(EACH, trials - begin)):
            judge.trial()
        yield judge


@pytest.mark.claim("PROOF-1")
@pytest.mark.slow
@pytest.mark.timeout(amount(300, 7200))
@pytest.mark.parametrize("kind", BOARDS)
def test_no_stop_is_acknowledged_before_the_board_has_handled_it(kind: str) -> None:
    stops = acknowledged = 0
    for judge in judged(kind, amount(8, TRIALS), 1):
        assert judge.false() == []
        stops += len(judge.stops)
        acknowledged += sum(map(bool, judge.stops.values()))
    print(f"{kind}: {acknowledged} of {stops} stops acknowledged, 0 falsely")
    assert acknowledged > (stops // 8 if stops > 100 else 0), "a proof that is never given is true of nothing"


def broken(kind: str, before_s: float, rng: random.Random) -> tuple[Simulated, str]:
    """A service whose command wire breaks so long before a stop is asked for, at a steady speed; what `why` said just
    before the stop."""
    sim = Simulated(kind=kind)
    sim.enable()
    sim.lab.drive(sim.robot, rng.uniform(0.5, 1.5), FORWARD)
    sim.board.deaf(True)
    sim.lab.drive(sim.robot, before_s, FORWARD)
    said = str(sim.robot.why())
    sim.robot.estop("hand near wheel")
    sim.wait(2.0)
    return sim, said


@pytest.mark.claim("PROOF-1")
@pytest.mark.slow
@pytest.mark.parametrize("before_s", [0.01, 0.2, 0.5, 0.7, 0.78, 0.79, 0.8, 0.81, 0.85, 1.5])
def test_a_stop_that_never_arrives_is_not_acknowledged_by_the_zero_of_the_board_s_own_watchdog(before_s: float) -> None:
    sim, said = broken("hoverboard", before_s, random.Random(before_s))
    stop = sim.robot.state.last_stop
    assert stop.acknowledged_s is None
    if before_s < 0.7:
        assert "NOT acknowledged by the board's echo" in sim.robot.why().proof
    if before_s > 1.4:
        assert "drives" not in said
    sim.leave()
    sim.end()
    assert "acknowledges nothing" not in sim.said
    # Where its watchdog had acted before the stop it is known to be deaf.
    assert f"not acknowledged (link {'deaf' if before_s >= 0.7 else 'unasked'})" in sim.said


@pytest.mark.claim("PROOF-1")
@pytest.mark.slow
def test_a_stop_that_ends_a_steady_speed_is_acknowledged_by_the_echo() -> None:
    """Frames that are sent again differ by a step, so that the echo of a steady speed says that they arrive."""
    sim = Simulated(kind="hoverboard")
    heard = []
    for _ in range(20):
        sim.enable()
        sim.lab.drive(sim.robot, 3.0, FORWARD)
        sim.robot.estop("hand near wheel")
        sim.wait(0.5)
        heard.append(sim.robot.state.last_stop.acknowledged_s)
    assert None not in heard
    assert max(heard) < 0.1
