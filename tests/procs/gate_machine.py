"""The gate's rules as invariants: whatever happens in whatever order, and whenever, none of them is broken."""

from __future__ import annotations

from math import isfinite

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from failstop.messages.records import BY_HAND, STANDS_IN
from failstop.policy import causes, kinematics
from failstop.policy.causes import Cause
from failstop.policy.settings import Settings
from failstop.procs.gate.core import REST, GateCore
from failstop.procs.gate.sources import Command
from tests.support.amounts import amount
from tests.support.why import told, why

from .gate_bench import NO_SPEEDS, ROBOT

MS = 1_000_000
SCAN_NS = 500 * MS
ARM_NS = 400 * MS
REFUSAL = "arm is not in the drive pose"
SOURCES = {"teleop": (10, 200 * MS), "cmd_vel": (0, 300 * MS)}
SETTINGS = Settings(
    {
        "sources.cmd_vel.priority": 0,
        "sources.cmd_vel.timeout_s": 0.3,
        "sources.teleop.priority": 10,
        "sources.teleop.timeout_s": 0.2,
        "interlocks.arm.timeout_s": 0.4,
        "interlocks.arm.refusal": REFUSAL,
    }
)
REFRESH_NS = 200 * MS
BOUND_NS = 40 * MS
LIMITS = (0.2, 0.2, 1.0)
ACCELERATIONS = (0.5, 0.5, 2.0)

# Times that matter and any other: ticks, the deadman's and the refresh's boundaries.
durations = st.sampled_from(
    [0, 1, 5 * MS, 20 * MS, 20 * MS, 20 * MS, 200 * MS, 200 * MS + 1, 300 * MS, 300 * MS + 1, 500 * MS]
)
durations |= st.integers(0, 2_000 * MS)
axis = st.sampled_from([0.0, -0.0, 0.05, 0.2, -0.2, 1.0, -1.0, 1e308, -1e308]) | st.floats()
ages = st.sampled_from([0, 0, 0, 100 * MS, 300 * MS, 300 * MS + 1, -1_000 * MS])


class GateMachine(RuleBasedStateMachine):
    """The gate beside a model that keeps only: has it been enabled, what is latched, what each source commanded last,
    when the sensor delivered and the arm was said to be in its pose."""

    def __init__(self) -> None:
        super().__init__()
        self.now = 1_000_000 * MS
        self.core = GateCore(SETTINGS, ROBOT, self.now)
        self.epoch = 1
        self.enabled = False
        self.latch: Cause | None = None
        self.latched_in = 0
        self.commands: dict[str, tuple[int, int, tuple[float, float, float], bool]] = {}
        self.wanting: set[str] = set()
        """The sources whose newest command is a motion, or a zero that stands in for one."""
        self.driver = ""
        self.held: set[str] = set()
        self.drivers: set[int] = set()
        self.scan_ns: int | None = None
        self.arm_ns: int | None = None
        self.stepped_ns = self.now
        self.frame_ns = 0

    def counts(self, source: str) -> bool:
        """The source has a command, and it is young enough."""
        return source in self.commands and self.now - self.commands[source][1] <= SOURCES[source][1]

    def highest(self) -> str:
        """The source that drives, or an empty text."""
        return next((source for source in SOURCES if self.counts(source) and source not in self.held), "")

    def sees(self) -> bool:
        return self.scan_ns is not None and self.now - self.scan_ns <= SCAN_NS

    def in_pose(self) -> bool:
        return self.arm_ns is not None and self.now - self.arm_ns <= ARM_NS

    def expected_block(self) -> str:
        if self.latch is not None:
            return f"estop: {self.latch}"
        if not self.enabled:
            return "disabled"
        source = self.highest()
        if not source:
            return "let go first" if any(map(self.counts, self.held)) else "cmd timeout"
        return "" if self.commands[source][3] or self.sees() else "no scan"

    def stand(self) -> None:
        self.enabled = False
        self.held = set()
        self.driver = ""

    def fall(self, cause: Cause) -> None:
        if self.latch is None:
            self.latch, self.latched_in = cause, self.epoch
        self.stand()

    @rule(elapsed_ns=durations)
    def step(self, elapsed_ns: int) -> None:
        """Time passes and a tick comes, as gate/main.py handles it: interlocks first."""
        self.now += elapsed_ns
        lost = self.enabled and not self.in_pose()
        assert self.core.check_interlocks(self.now) == (REFUSAL if lost else "")
        if lost:
            self.stand()
        self.move()

    def move(self) -> None:
        before = self.core.velocity
        speeds_before = self.core.speeds
        block = self.expected_block()
        speeds = self.core.step(self.now)
        after = self.core.velocity
        passed_s = min(self.now - self.stepped_ns, BOUND_NS) * 1e-9
        self.stepped_ns = self.now
        source = self.highest() if self.enabled else ""
        fell_back = bool(source and self.driver) and SOURCES[source][0] < SOURCES[self.driver][0]
        self.driver = source or self.driver
        if not self.enabled:
            assert speeds is None, "disabled: no motion frame at all"
        elif block:
            assert after == REST, "blocked: zero at once"
        else:
            self.check_ramp(REST if fell_back else before, after, self.commands[source][2], passed_s)
        if speeds is not None:
            assert speeds == ROBOT.wheels_rps(*after)
            self.frame_ns = self.now
        elif self.enabled:
            assert speeds_before == ROBOT.wheels_rps(*after), "a change that is not sent"
            assert self.now - self.frame_ns < REFRESH_NS, "a refresh that is not sent"

    @staticmethod
    def check_ramp(
        before: tuple[float, ...], after: tuple[float, ...], wanted: tuple[float, ...], passed_s: float
    ) -> None:
        for was, now, want, limit, acceleration in zip(before, after, wanted, LIMITS, ACCELERATIONS, strict=True):
            goal = max(-limit, min(limit, want))
            assert abs(now - was) <= acceleration * passed_s + 1e-12, "more than acceleration x elapsed"
            assert abs(now - goal) <= abs(was - goal), "away from the command"
            assert now == goal or abs(now - was) >= acceleration * passed_s - 1e-12, "slower than the ramp"

    @rule(
        velocity=st.tuples(axis, axis, axis),
        session=st.sampled_from([1, 1, 1, 2]),
        age_ns=ages,
        source=st.sampled_from(["cmd_vel", "cmd_vel", "teleop"]),
        manual=st.booleans(),
        stands_in=st.booleans(),
    )
    def accept(
        self,
        velocity: tuple[float, float, float],
        session: int,
        age_ns: int,
        source: str,
        manual: bool,
        stands_in: bool,
    ) -> None:
        """A command, as gate/main.py handles it: a fault stops, anything else steps at once."""
        who = f"client {session}"
        velocity = REST if stands_in else velocity
        flags = (BY_HAND if manual else 0) | (STANDS_IN if stands_in else 0)
        command = Command(session, who, self.now - age_ns, velocity, source, flags)
        fault = self.core.accept(command, self.now)
        if not all(map(isfinite, velocity)):
            assert fault == causes.NOT_FINITE(who)
        elif self.counts(source) and self.commands[source][0] != session:
            assert fault == causes.TWO_PUBLISHERS(source, f"client {self.commands[source][0]}", who)
        else:
            assert fault is None
        if fault:
            self.halt(fault)
        else:
            t_ns = min(self.now, self.now - age_ns)
            paused = source not in self.commands or t_ns - self.commands[source][1] > SOURCES[source][1]
            wants = stands_in or any(velocity)
            if not wants or paused:
                self.held.discard(source)
            self.wanting = self.wanting | {source} if wants else self.wanting - {source}
            self.commands[source] = (session, t_ns, velocity, manual)
            self.drivers.add(session)
            self.move()

    @rule(velocity=st.tuples(axis, axis, axis))
    def accept_of_no_source(self, velocity: tuple[float, float, float]) -> None:
        """A source that no setting names moves nothing and stops nothing, but for values that are no numbers."""
        fault = self.core.accept(Command(1, "client 1", self.now, velocity, source="stranger"), self.now)
        if fault:
            assert not all(map(isfinite, velocity))
            self.halt(fault)

    @rule()
    def sensor_delivers(self) -> None:
        self.core.scan.deliver(self.now, self.now)
        self.scan_ns = self.now

    @rule()
    def arm_is_in_pose(self) -> None:
        self.core.interlocks.hear(["arm", "no such thing"], self.now, self.now)
        self.arm_ns = self.now

    @rule(cause=st.sampled_from([why("key1"), why("gate died"), why("")]))
    def halt(self, cause: Cause) -> None:
        assert self.core.stop(cause, self.epoch) is (self.latch is None)
        self.fall(cause)
        assert self.core.velocity == REST

    @rule()
    def epoch_raised(self) -> None:
        """The supervisor stops, or answers its own."""
        self.epoch += 1
        if self.latch is None:
            self.latch, self.latched_in = why("supervisor"), self.epoch - 1
        self.core.follow(self.latch, self.epoch)
        self.fall(self.latch)
        self.latched_in = min(self.latched_in, self.epoch - 1)

    @rule(missing=st.sampled_from(["", "", "", "the port"]))
    def enable(self, missing: str) -> None:
        done, text = told(self.core.enable(self.epoch, missing, self.now))
        assert done is (self.latch is None and not missing and self.in_pose())
        if self.latch is not None:
            assert text == f"a stop is latched ({self.latch})"
        if done and not self.enabled:
            self.stand()
            self.enabled = True
            self.held = {source for source in SOURCES if self.counts(source) and source in self.wanting}
            assert ("must send zero or pause" in text) is bool(self.held)
            assert self.core.epoch == self.epoch

    @rule()
    def disable(self) -> None:
        assert self.core.disable().done
        self.stand()

    @rule()
    def reset(self) -> None:
        """The supervisor's, once it has answered: it clears what is latched and nothing else."""
        self.core.follow(None, self.epoch)
        if self.latch is not None and self.epoch > self.latched_in:
            self.latch = None

    @rule(session=st.sampled_from([1, 2]), parted=st.booleans())
    def client_gone(self, session: int, parted: bool) -> None:
        """A client leaves or dies, as gate/main.py handles it: the death of one that has driven disables motion."""
        assert self.core.client_gone(session, self.now, parted=parted) is None
        for source in [source for source, command in self.commands.items() if command[0] == session]:
            del self.commands[source]
        if session in self.drivers and self.enabled and not parted:
            self.stand()
        self.drivers.discard(session)
        self.move()

    @invariant()
    def enabled_by_nothing_but_enable(self) -> None:
        assert self.core.enabled is self.enabled

    @invariant()
    def latched_until_a_reset_with_the_first_reason(self) -> None:
        assert self.core.latch == self.latch

    @invariant()
    def says_why_it_is_blocked(self) -> None:
        assert self.core.blocked(self.now) == self.expected_block()

    @invariant()
    def stands_while_blocked(self) -> None:
        if self.expected_block() and self.stepped_ns == self.now:
            assert self.core.velocity == REST
            assert self.core.speeds == NO_SPEEDS

    @invariant()
    def within_the_limits(self) -> None:
        assert all(-limit <= now <= limit for now, limit in zip(self.core.velocity, LIMITS, strict=True))
        limit_rps = kinematics.max_wheel_rps(Settings()) * (1 + 1e-12)
        assert all(-limit_rps <= rps <= limit_rps for rps in self.core.speeds)


GateMachine.TestCase.settings = settings(max_examples=amount(50, 2_000), stateful_step_count=40, deadline=None)
