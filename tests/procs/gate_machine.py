"""The gate's rules as invariants: whatever happens in whatever order, and whenever, none of them is broken."""

from __future__ import annotations

from math import isfinite

from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, invariant, rule

from failstop.procs.gate.core import REST, STILL, Command, GateCore
from failstop.procs.gate.kinematics import Mecanum
from failstop.supervisor.settings import Settings

MS = 1_000_000
TIMEOUT_NS = 300 * MS
REFRESH_NS = 200 * MS
BOUND_NS = 40 * MS
LIMITS = (0.2, 0.2, 1.0)
ACCELERATIONS = (0.5, 0.5, 2.0)
ROBOT = Mecanum(0.08, 0.17706, 0.17165)

# Times that matter and any other: ticks, the deadman's and the refresh's boundaries.
durations = st.sampled_from([0, 1, 5 * MS, 20 * MS, 20 * MS, 20 * MS, 200 * MS, 300 * MS, 300 * MS + 1])
durations |= st.integers(0, 2_000 * MS)
axis = st.sampled_from([0.0, -0.0, 0.05, 0.2, -0.2, 1.0, -1.0, 1e308, -1e308]) | st.floats()
ages = st.sampled_from([0, 0, 0, 100 * MS, 300 * MS, 300 * MS + 1, -1_000 * MS])


class GateMachine(RuleBasedStateMachine):
    """The gate beside a model that keeps only: has it been enabled, what is latched, what was last commanded."""

    def __init__(self) -> None:
        super().__init__()
        self.now = 1_000_000 * MS
        self.core = GateCore(Settings(), ROBOT, self.now)
        self.epoch = 1
        self.enabled = False
        self.latch: str | None = None
        self.latched_in = 0
        self.command: tuple[int, int, tuple[float, float, float]] | None = None
        self.stepped_ns = self.now
        self.frame_ns = 0

    def counts(self) -> bool:
        """A command is there, and young enough."""
        return self.command is not None and self.now - self.command[1] <= TIMEOUT_NS

    def may_move(self) -> bool:
        return self.enabled and self.latch is None and self.counts()

    def fall(self, reason: str) -> None:
        if self.latch is None:
            self.latch, self.latched_in = reason, self.epoch
        self.enabled = False
        self.command = None

    @rule(elapsed_ns=durations)
    def step(self, elapsed_ns: int) -> None:
        """Time passes and a tick comes."""
        self.now += elapsed_ns
        before = self.core.velocity
        speeds_before = self.core.speeds
        speeds = self.core.step(self.now)
        after = self.core.velocity
        passed_s = min(self.now - self.stepped_ns, BOUND_NS) * 1e-9
        self.stepped_ns = self.now
        if not self.enabled:
            assert speeds is None, "disabled: no motion frame at all"
        elif not self.may_move():
            assert after == REST, "blocked: zero at once"
        else:
            assert self.command is not None
            self.check_ramp(before, after, self.command[2], passed_s)
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

    @rule(velocity=st.tuples(axis, axis, axis), session=st.sampled_from([1, 1, 1, 2]), age_ns=ages)
    def take(self, velocity: tuple[float, float, float], session: int, age_ns: int) -> None:
        """A command, as gate/main.py handles it: a fault trips, anything else steps at once."""
        fault = self.core.take(Command(session, f"client {session}", self.now - age_ns, velocity), self.now)
        if not all(map(isfinite, velocity)):
            assert fault == f"command from client {session} is not finite"
        elif self.counts() and self.command is not None and self.command[0] != session:
            assert fault == f"multiple cmd_vel publishers: client {self.command[0]}, client {session}"
        else:
            assert fault == ""
        if fault:
            self.trip(fault)
        else:
            self.command = (session, min(self.now, self.now - age_ns), velocity)
            self.step(0)

    @rule(reason=st.sampled_from(["key1", "gate died", ""]))
    def trip(self, reason: str) -> None:
        assert self.core.trip(reason, self.epoch) is (self.latch is None)
        self.fall(reason)
        assert self.core.velocity == REST

    @rule()
    def epoch_raised(self) -> None:
        """The supervisor stops, or answers a trip."""
        self.epoch += 1
        self.core.trip("supervisor", self.epoch - 1)
        if self.latch is None:
            self.latch, self.latched_in = "supervisor", self.epoch - 1
        self.fall("supervisor")

    @rule(missing=st.sampled_from(["", "", "", "the port"]))
    def enable(self, missing: str) -> None:
        done, text = self.core.enable(self.epoch, missing)
        assert done is (self.latch is None and not missing)
        if self.latch is not None:
            assert text == f"e-stop latched ({self.latch})"
        if done and not self.enabled:
            self.enabled = True
            self.command = None
            assert self.core.epoch == self.epoch

    @rule()
    def disable(self) -> None:
        assert self.core.disable()[0]
        self.enabled = False
        self.command = None

    @rule()
    def reset(self) -> None:
        done, text = self.core.reset(self.epoch)
        if self.latch is None:
            assert (done, text) == (True, "no e-stop is latched")
        elif self.epoch > self.latched_in:
            assert (done, text) == (True, f"e-stop cleared (was: {self.latch}); motion still disabled")
            self.latch = None
        else:
            assert not done

    @rule(session=st.sampled_from([1, 2]))
    def driver_gone(self, session: int) -> None:
        """A client leaves, as gate/main.py handles it."""
        drove = self.command is not None and self.command[0] == session
        assert self.core.driver_gone(session) is drove
        if drove:
            self.command = None
            self.step(0)

    @invariant()
    def enabled_by_nothing_but_enable(self) -> None:
        assert self.core.enabled is self.enabled

    @invariant()
    def latched_until_a_reset_with_the_first_reason(self) -> None:
        assert self.core.latch == self.latch

    @invariant()
    def says_why_it_is_blocked(self) -> None:
        if self.latch is not None:
            expected = f"estop: {self.latch}"
        elif not self.enabled:
            expected = "disabled"
        else:
            expected = "" if self.counts() else "cmd timeout"
        assert self.core.blocked(self.now) == expected

    @invariant()
    def stands_while_blocked(self) -> None:
        if not self.may_move():
            assert self.core.velocity == REST
            assert self.core.speeds == STILL

    @invariant()
    def within_the_limits(self) -> None:
        assert all(-limit <= now <= limit for now, limit in zip(self.core.velocity, LIMITS, strict=True))
        limit_rps = Settings().max_wheel_rps() * (1 + 1e-12)
        assert all(-limit_rps <= rps <= limit_rps for rps in self.core.speeds)


GateMachine.TestCase.settings = settings(max_examples=150, stateful_step_count=40, deadline=None)
