"""A gate at work, turn by turn: the test is its supervisor and its clients, and its port owner and its arm's board are
the port owner's own rules and the simulated board's own servos, without processes between them."""

from __future__ import annotations

import heapq
import os
from collections.abc import Callable
from typing import Any

import msgpack

from failstop.board import servos
from failstop.board.rrc import decoder
from failstop.board.rrc.framing import BUS_SERVO
from failstop.files import instance
from failstop.messages import layout, records
from failstop.messages.packing import Note
from failstop.policy import causes
from failstop.policy.causes import Cause, unpack_reply
from failstop.procs.loop import NEVER
from failstop.procs.port_owner.admission import BusSchedule
from failstop.supervisor.latch import Latch
from failstop.supervisor.stops import Stop
from failstop_lab.sim.servos import Servos
from tests.support.arm_settings import SERVOS
from tests.support.stage import MS, RUNTIME_DIR, Stage
from tests.support.why import why

SESSION = 11
OTHER = 12
"""The second client's session."""
CLAIMS = instance.claims_path(RUNTIME_DIR)
BELL = instance.bell_path(RUNTIME_DIR)
NAMESPACE = "/proc/self/ns/pid"
ANSWER_NS = 1 * MS
"""The time of an answer from the board through port owner and telemetry."""


class Client:
    """A client as far as memory and claims go."""

    def __init__(self, stage: Stage, index: int, session: int, name: str, pid: int, namespace: int | None) -> None:
        self.session, self.pid, self.number = session, pid, 0
        self._stage, self._index = stage, index
        claim = stage.load("failstop.shm.claim")
        self._claims: int = claim.open_claims(CLAIMS)
        self.segment = stage.owned(f"client.{index}")
        assert claim.acquire(self._claims, index)
        self.hello(session, name, pid, namespace)

    def hello(self, session: int, name: str, pid: int = 0, namespace: int | None = None) -> None:
        """`namespace`: that of the pid; None for the gate's own."""
        if namespace is None:
            namespace = self._stage.load("failstop.shm.lifeline").pid_namespace()
        self.write("hello", records.HELLO.pack(session, pid, namespace, name))

    def succeed(self, session: int, name: str) -> None:
        """Give the slot to another session, which counts its requests from the first again."""
        self.session, self.number = session, 0
        self.hello(session, name)

    def goodbye(self) -> None:
        self.write("left", records.goodbye(self.session, b""))

    def write(self, record: str, payload: bytes, t_ns: int | None = None) -> None:
        self.segment.latest_writer(record).write(payload, t_ns)

    def command(
        self, vx: float = 0.1, *, session: int | None = None, t_ns: int | None = None, manual: bool = False
    ) -> None:
        whose = self.session if session is None else session
        self.write("command", records.COMMAND.pack(whose, vx, 0.0, 0.0, manual, "cmd_vel"), t_ns)

    def request(self, verb: int = records.ENABLE, *, session: int | None = None, asked_ns: int | None = None) -> int:
        self.number += 1
        whose = self.session if session is None else session
        self.write("request", records.REQUEST.pack(whose, self.number, verb), asked_ns)
        return self.number

    def ring(self) -> None:
        bell = self._stage.os.open(BELL, os.O_WRONLY | os.O_NONBLOCK)
        self._stage.os.write(bell, bytes((self._index,)))
        self._stage.os.close(bell)

    def leave(self) -> None:
        """The process dies: its claim goes, its memory stays."""
        self._stage.os.close(self._claims)
        self.segment.close()


class Scene(Stage):
    """The gate on its stage. With turn() it is rung by its first client; with run() time passes as the gate asks for
    it. What wheels and servos are told is judged by the board."""

    def __init__(self, changed: dict[str, Any] | None = None, *, clients: int = 2) -> None:
        """`changed`: settings that are not the defaults."""
        super().__init__(layout.GATE, **(changed or {}))
        self.os.makedirs(os.path.dirname(NAMESPACE))
        self.os.close(self.load("failstop.shm.claim").open_claims(CLAIMS, create=True))
        self.os.close(self.os.open(NAMESPACE, os.O_RDWR | os.O_CREAT))
        bell = self.load("failstop.shm.bell")
        bell.make_pipe(BELL, 0o600)
        self._fds["client_bell"] = bell.open_pipe(BELL)
        supervisor, telemetry = self.views[layout.SUPERVISOR], self.views[layout.TELEMETRY]
        self._latch_record, self._reset_record = supervisor.latest_writer("latch"), supervisor.latest_writer("reset")
        self._resets_word = supervisor.word("resets")
        self._made, self._told = self.own.ring_reader("frames"), self.own.ring_reader("notes")
        self._stops = self.own.ring_reader("stops")
        self._servo_answers, self._pad = telemetry.ring_writer("servos"), telemetry.latest_writer("pad_arm")
        self.epoch, self.latch = 1, Latch()
        self.servos = Servos(self.clock(), seed=0)
        self.bus = BusSchedule(self.board.arm, SERVOS)
        self.wheels_move = False
        self.on_motion: Callable[[bytes], None] = lambda frame: None
        """Called with each frame for the wheels."""
        self.said: dict[int, list[int]] = {servo: [] for servo in SERVOS}
        """The last answers about each servo's position."""
        self.moves: list[tuple[int, bytes]] = []
        """Each frame that moved servos: when, and its data."""
        self.dropped = 0
        self._answers: list[tuple[int, bytes]] = []
        self.asked: list[int] = []
        """Kinds of the frames that the last ask() led to."""
        self.ready(1)
        self.start_gate()
        self.clients: list[Client] = []
        for index in range(clients):
            self.join(index, (SESSION, OTHER)[index], ("test", "other")[index])

    def join(self, index: int, session: int, name: str, pid: int = 0, namespace: int | None = None) -> Client:
        self.clients.append(Client(self, index, session, name, pid, namespace))
        return self.clients[-1]

    def start_gate(self) -> None:
        self.gate = self.load("failstop.procs.gate.main").Gate(self)

    # The supervisor.

    def ready(self, word: int) -> None:
        """The word `ready` of the service: 1 when motion may be enabled."""
        self.views[layout.SUPERVISOR].word("ready").set(word)

    def stop(self, cause: Cause | str) -> None:
        """Latch a cause and raise the epoch; the port owner's burst stops wheels and servos."""
        self.epoch += 1
        now_ns, stopped = self.clock(), why(cause) if isinstance(cause, str) else cause
        self.latch.add([Stop(now_ns, layout.SUPERVISOR, stopped)], self.epoch, now_ns)
        self._latch_record.write(self.latch.as_record())
        self.raise_epoch(self.epoch)
        self._burst()

    def decide(self) -> None:
        """Hear of a reset that the gate passes on, and tell the gate what became of it."""
        while (number := self.own.word("resets_asked").get()) != self._resets_word.get():
            reply = self.latch.reset(self.gate.epoch, self.own.word("reset_asked_ns").get())
            if self.latch.newest:
                self._latch_record.write(self.latch.as_record())
            self._reset_record.write(reply.pack(0, number))
            self._resets_word.set(number)
            self.gate.turn({})

    # What the gate does.

    def turn(self, elapsed_ns: int = 0, *, supervisor_beats: bool = True) -> list[int]:
        """Time passes, the client rings; returns the kinds of the frames that the gate made."""
        self.clock.now_ns += elapsed_ns
        self.clients[0].ring()
        made = self._turn(supervisor_beats=supervisor_beats)
        assert self.gate.loop.due_ns() > self.clock(), "a timer was left behind: the loop would spin"
        return made

    def tick(self) -> str | None:
        """Time passes, a tick of the gate, which nobody rang; returns the latched reason."""
        self.clock.now_ns += 20 * MS
        self._turn()
        return self.latched()

    def stop_and_tick(self, cause: str) -> str | None:
        """The supervisor stops, and the gate follows it at a tick; returns the latched reason."""
        self.stop(cause)
        return self.tick()

    def run(self, seconds: float) -> None:
        until_ns = self.clock() + round(seconds * 1e9)
        while self.clock() < until_ns:
            self.wake(until_ns)

    def wake(self, until_ns: int = NEVER) -> None:
        due_ns = max(min(self.clock() + 20 * MS, self.gate.loop.due_ns()), self.clock() + 10_000)
        if self._answers:
            due_ns = min(due_ns, max(self._answers[0][0], self.clock()))
        self.clock.now_ns = min(due_ns, until_ns)
        while self._answers and self._answers[0][0] <= self.clock():
            t_ns, answer = heapq.heappop(self._answers)
            self._servo_answers.put(answer, t_ns)
        self._turn()

    def _turn(self, *, supervisor_beats: bool = True) -> list[int]:
        if supervisor_beats:
            self.beat(layout.SUPERVISOR)
        self.gate.turn(self.gate.loop.wait(0))
        self.decide()
        return self._carry_out()

    def latched(self) -> str | None:
        return str(self.gate.core.latch) if self.gate.core.latch else None

    def stopped(self) -> str:
        entry = self._stops.next()
        return str(causes.read(records.STOPPED.unpack(entry[2])[3])) if entry else ""

    def told(self) -> list[str]:
        found = []
        while entry := self._told.next():
            found.append(Note.unpack(entry[2]).text)
        return found

    def state(self) -> dict[str, Any]:
        entry = self.own.latest_reader("state").read()
        assert entry
        found: dict[str, Any] = msgpack.unpackb(entry[2])["arm"]
        return found

    # Clients.

    def ask_for(self, verb: int, client: int = 0, asked_ns: int | None = None) -> None:
        """A client asks, now or for what was asked for then, and does not ring."""
        self.clients[client].request(verb, asked_ns=asked_ns)

    def replied(self, client: int = 0) -> tuple[int, int, str]:
        """The last reply to a client: to which request (0: none yet), done, the text."""
        entry = self.own.latest_reader(f"reply.{client}").read()
        if entry is None:
            return 0, records.UNDER_WAY, ""
        _, number, reply = unpack_reply(entry[2])
        return number, reply.done, str(reply)

    def answered(self, client: int = 0) -> tuple[int, str]:
        number, done, text = self.replied(client)
        return (done, text) if number == self.clients[client].number else (records.UNDER_WAY, "")

    def ask(self, verb: int, asked_ns: int | None = None) -> tuple[int, str]:
        """The client asks and rings; returns the answer, which comes at once."""
        self.ask_for(verb, asked_ns=asked_ns)
        self.asked = self.turn()
        answer = self.answered()
        assert answer[0] != records.UNDER_WAY
        return answer

    def finish(self, client: int = 0, most_s: float = 10.0) -> tuple[int, str]:
        """Let time pass until the last request is answered for good."""
        for _ in range(round(most_s / 0.02)):
            self.run(0.02)
            if (answer := self.answered(client))[0] != records.UNDER_WAY:
                return answer
        raise AssertionError(f"no answer in {most_s:g} s, the last: {self.answered(client)}")

    def result(self, verb: int, client: int = 0, asked_ns: int | None = None) -> tuple[int, str]:
        """A client asks; returns what its request has come to."""
        self.ask_for(verb, client, asked_ns)
        return self.finish(client)

    def drive(self, vx_mps: float) -> list[int]:
        """A person's command; returns the kinds of the frames that it led to."""
        self.command(vx_mps)
        return self.turn(10 * MS)

    def command(self, vx_mps: float) -> None:
        self.clients[0].command(vx_mps, manual=True)

    def limit(self, percent: int) -> None:
        self.clients[0].write("speed_limit", records.SPEED_LIMIT.pack(SESSION, percent))

    def saw(self, epoch: int) -> None:
        """The client leaves the epoch that its person saw for its request."""
        self.clients[0].write("seen", records.SEEN.pack(SESSION, epoch))

    def assert_lid(self) -> None:
        """The interlock `lid`, which a test's settings may have, holds now."""
        self.clients[1].write("interlocks", records.ASSERTED.pack(OTHER, ["lid"]))

    def goal(self, mode: int, values: dict[int, float], client: int = 0) -> None:
        whose = self.clients[client]
        whose.write("arm_goal", records.ARM_GOAL.pack(whose.session, mode, values))

    def execute(self, values: dict[int, float], over_s: float = 0.0, client: int = 0) -> None:
        self.go(1.0, list(values), [(over_s, list(values.values()))], client)

    def go(self, share: float, joints: list[int], rows: list[tuple[float, list[float]]], client: int = 0) -> None:
        whose = self.clients[client]
        whose.write("arm_path", records.ARM_PATH.pack(whose.session, share, joints, rows))
        self.ask_for(records.ARM_MOVE, client)

    # The gamepad, by telemetry.

    def pad(self, joint: int, share: float) -> None:
        self._pad.write(records.PAD_ARM.pack(joint, share))

    def pad_resets(self) -> None:
        request = records.PAD_REQUEST.pack(records.PAD_RESET, b"")
        self.views[layout.TELEMETRY].ring_writer("pad_requests").put(request)

    # Port owner and board.

    def at(self, servo: int) -> float:
        return self.servos.by_id[servo].leg.at(self.clock())

    def _burst(self) -> None:
        self.wheels_move = False
        for servo in SERVOS:
            self.servos.execute(bytes((servos.SERVO_STOP, 1, servo)), self.clock())

    def _carry_out(self) -> list[int]:
        now_ns, kinds = self.clock(), []
        while entry := self._made.next():
            _, kind, body = records.FRAME.unpack(entry[2])
            kinds.append(kind)
            if kind == records.WRITE_BURST:
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
        return kinds

    def _execute(self, data: bytes) -> None:
        now_ns = self.clock()
        done_ns = now_ns + self.servos.holds_ns(data)
        if data[0] == servos.SERVO_MOVE:
            self.moves.append((now_ns, data))
        if answer := self.servos.execute(data, done_ns):
            found = decoder.servo_reply(BUS_SERVO, answer[4:-1])
            assert found
            servo, what, value = found
            if what == servos.POSITION:
                self.said[servo] = [*self.said[servo][-1:], -1 if value is None else value]
            heapq.heappush(self._answers, (done_ns + ANSWER_NS, records.SERVO.pack(*found)))
