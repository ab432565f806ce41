"""A gate with an arm, turn by turn: the test is its clients, and its port owner and its board are the port owner's own
rules and the simulated board's own servos, without processes between them."""

from __future__ import annotations

import heapq
from pathlib import Path
from typing import Any, ClassVar

import msgpack
import pytest

from failstop.board import decoder, servos
from failstop.board.framing import BUS_SERVO
from failstop.board.interface import BOARD
from failstop.lab.sim.servos import Servos
from failstop.policy.causes import Cause
from failstop.policy.reply import Reply, unpack
from failstop.procs.loop import NEVER
from failstop.procs.port_owner.admission import ServoBus
from failstop.shm import layout, records
from tests.support.arm_settings import ARM, SERVOS
from tests.support.gate_scene import GateStage
from tests.support.stage import MS

SESSION = 11
OTHER = 12
"""The second client's session."""
ANSWER_NS = 1 * MS
"""From the board through port owner and telemetry."""


class ArmScene(GateStage):
    """The gate of a robot with an arm. Time passes by run(); what the wheels and the servos are told is judged by the
    board. The test is the supervisor: it latches what it is told to (stop), and what the gate stops for."""

    changed: ClassVar[dict[str, object]] = ARM

    def __init__(self, directory: Path, monkeypatch: pytest.MonkeyPatch, seed: int = 0) -> None:
        super().__init__(directory, monkeypatch)
        self._asked = self.own.word("resets_asked")
        self._epoch = 1
        self.ready(1)
        self.start_gate()
        self._client = self.join(SESSION, "test")
        self._other = self.join(OTHER, "other")
        self.servos = Servos(self.clock(), seed)
        self.bus = ServoBus(SERVOS)
        self.wheels_move = False
        self.said: dict[int, list[int]] = {servo: [] for servo in SERVOS}
        """The last answers about each servo's position."""
        self.moves: list[tuple[int, bytes]] = []
        """When, and the data of each frame that moved servos."""
        self.dropped = 0
        self._telemetry = self.views[layout.TELEMETRY].ring_writer("servos")
        self._pad = self.views[layout.TELEMETRY].latest_writer("pad_arm")
        self._answers: list[tuple[int, bytes]] = []
        self._numbers = [0, 0]

    def stop(self, cause: Cause) -> None:
        """The supervisor latches and raises the epoch; the port owner's burst stops wheels and servos."""
        self._epoch += 1
        self._latch_record.write(
            records.LATCH.pack(self._epoch, self.clock(), self.clock(), cause.pack()), self.clock()
        )
        self.raise_epoch(self._epoch)
        self._burst()

    def _decide_resets(self) -> None:
        if self._asked.get() != self._resets_word.get():
            self._latch_record.write(records.LATCH.pack(0, 0, self.clock(), b""), self.clock())
            self._reset_record.write(Reply(records.DONE, "reset").pack(0, 0), self.clock())
            self._resets_word.set(self._asked.get())

    def _burst(self) -> None:
        self.wheels_move = False
        for servo in SERVOS:
            self.servos.execute(bytes((servos.STOP, 1, servo)), self.clock())

    def run(self, seconds: float) -> None:
        """Let time pass, as the gate asks for it."""
        until_ns = self.clock() + round(seconds * 1e9)
        while self.clock() < until_ns:
            self.turn(until_ns)

    def turn(self, until_ns: int = NEVER) -> None:
        """One wake-up of the gate, when it asks for it."""
        due_ns = max(min(self.clock() + 20 * MS, self.gate.loop.due_ns()), self.clock() + 10_000)
        if self._answers:
            due_ns = min(due_ns, max(self._answers[0][0], self.clock()))
        self.clock.now_ns = min(due_ns, until_ns)
        self.beat(layout.SUPERVISOR)
        while self._answers and self._answers[0][0] <= self.clock():
            t_ns, answer = heapq.heappop(self._answers)
            self._telemetry.put(answer, t_ns)
        self._decide_resets()
        self.gate.turn({})
        self._carry_out()

    def _carry_out(self) -> None:
        now_ns = self.clock()
        while entry := self._made.next():
            _, kind, body = records.FRAME.unpack(entry[2])
            if kind == records.STOP:
                self._burst()
            elif kind == records.MOTION:
                self.wheels_move = True
                self.on_motion(body)
            elif kind == records.ARM:
                assert not self.bus.check(body), body.hex()
                due_ns = self.bus.due_ns(body, now_ns, wheels_move=self.wheels_move)
                if due_ns < NEVER:
                    # On this clock the gate is never late, so no frame has to wait for the one before it.
                    assert due_ns == now_ns
                    self.bus.wrote(body, now_ns)
                    self._execute(body[4:-1])
                else:
                    self.dropped += 1

    def on_motion(self, frame: bytes) -> None:
        """A frame for the wheels."""

    def _execute(self, data: bytes) -> None:
        now_ns = self.clock()
        done_ns = now_ns + self.servos.holds_ns(data)
        if data[0] == servos.MOVE:
            self.moves.append((now_ns, data))
        if answer := self.servos.execute(data, done_ns):
            found = decoder.servo_reply(BUS_SERVO, answer[4:-1])
            assert found
            servo, what, value = found
            if what == servos.POSITION:
                self.said[servo] = [*self.said[servo][-1:], -1 if value is None else value]
            heapq.heappush(self._answers, (done_ns + ANSWER_NS, records.SERVO.pack(*found)))

    # Clients.

    def segment_of(self, client: int) -> Any:
        return (self._client, self._other)[client]

    def ask_for(self, verb: int, client: int = 0, asked_ns: int = 0) -> None:
        """A client asks, now or for what was asked for then; the answer comes by answered()."""
        self._numbers[client] += 1
        session = (SESSION, OTHER)[client]
        request = records.REQUEST.pack(session, self._numbers[client], verb)
        self.segment_of(client).latest_writer("request").write(request, asked_ns or self.clock())

    def answered(self, client: int = 0) -> tuple[int, str]:
        """(done, text) of the last request."""
        entry = self.own.latest_reader(f"reply.{client}").read()
        if entry is None:
            return records.UNDER_WAY, ""
        _, number, reply = unpack(entry[2])
        return (reply.done, str(reply)) if number == self._numbers[client] else (records.UNDER_WAY, "")

    def goal(self, mode: int, values: dict[int, float], client: int = 0) -> None:
        """A goal of a stream."""
        packed = records.ARM_GOAL.pack((SESSION, OTHER)[client], mode, values)
        self.segment_of(client).latest_writer("arm_goal").write(packed, self.clock())

    def assert_lid(self) -> None:
        """The interlock `lid`, which a test's settings may have, holds now."""
        self._other.latest_writer("interlocks").write(records.HELD.pack(OTHER, ["lid"]), self.clock())

    def pad(self, joint: int, share: float) -> None:
        """What telemetry says of the gamepad in its joint mode."""
        self._pad.write(records.PAD_ARM.pack(joint, share), self.clock())

    def travel(self, values: dict[int, float], over_s: float = 0.0, client: int = 0) -> None:
        """A trajectory to one point, and the request for it."""
        packed = records.ARM_PATH.pack((SESSION, OTHER)[client], 1.0, list(values), [(over_s, list(values.values()))])
        self.segment_of(client).latest_writer("arm_path").write(packed, self.clock())
        self.ask_for(records.ARM_MOVE, client)

    def finish(self, client: int = 0, most_s: float = 10.0) -> tuple[int, str]:
        """Let time pass until the last request is answered for good."""
        for _ in range(round(most_s / 0.02)):
            self.run(0.02)
            if (answer := self.answered(client))[0] != records.UNDER_WAY:
                return answer
        raise AssertionError(f"no answer in {most_s:g} s, the last: {self.answered(client)}")

    def state(self) -> dict[str, Any]:
        """The arm's part of the gate's state."""
        entry = self.own.latest_reader("state").read()
        assert entry
        found: dict[str, Any] = msgpack.unpackb(entry[2])["arm"]
        return found

    def at(self, servo: int) -> float:
        """Where it is in truth."""
        return self.servos.by_id[servo].leg.at(self.clock())


ZERO_WHEELS = BOARD.stop
