"""Robot and AsyncRobot: drive and stop a robot from Python. Robot is for threads: its calls block until they are done.
AsyncRobot is for asyncio: you await enable, disable, reset, limit_speed and wait_for, and drive never waits. For
example:

    match robot.drive(0.2, 0.0, 0.0):
        case Preempted(by=who): print(who, "drives")
        case Blocked(block=Block.NO_SCAN): look_at_the_sensor()
"""

from __future__ import annotations

import contextlib
import dataclasses
import time
from collections.abc import AsyncIterator, Callable, Iterator
from math import isfinite
from typing import TYPE_CHECKING, Any

from failstop.api.arm import Arm
from failstop.api.client import send_stop
from failstop.api.errors import FailstopError
from failstop.api.events import LOOK_S, Event, EventLog
from failstop.api.session import POLL_S, Progress, Session, Steps, T, Word, sleep_through
from failstop.api.snapshot import Block, Sample, State, Velocity
from failstop.messages import records
from failstop.policy.causes import Cause
from failstop.policy.settings import FIRST_SOURCE
from failstop.version import Renamed

if TYPE_CHECKING:
    from failstop.api.why import Why

MOST_OF_A_NAME = 64
"""The longest name of an operator, in bytes. A longer name is cut."""


@dataclasses.dataclass(frozen=True)
class Driving:
    """The result of drive() if the command that you sent moves the wheels."""

    velocity: Velocity
    """The velocity that the gate commands at present. It does not jump to the requested velocity, but approaches it
    along the ramp, and stays within the limits."""


@dataclasses.dataclass(frozen=True)
class Preempted:
    """The result of drive() if a source with a higher priority drives. Your command moves nothing and is not kept, so
    keep sending commands."""

    by: str
    """The name and pid of the program that drives."""
    source: str
    """The name of the source that the driving program uses. This source has a higher priority than yours."""

    def __bool__(self) -> bool:
        return False


@dataclasses.dataclass(frozen=True)
class Blocked:
    """The result of drive() if the wheels are stopped."""

    block: Block
    """Why the wheels are stopped. NO_COMMAND means that the gate did not get the command in time."""
    why: str
    """Why the wheels are stopped, in words. If a stop is latched, this is the text of its cause."""

    def __bool__(self) -> bool:
        return False


Answer = Driving | Preempted | Blocked
"""What drive() returns. In an `if`, only Driving counts as true."""


def judge(decided: dict[str, Any], source: str, cause: Cause | None) -> tuple[Answer, bool]:
    """Return (answer, final) for a command. `decided`: the gate's last decision, which may be older than the command.
    `final`: False if drive() should wait for the gate's next decision. Pure."""
    block = Block.LATCHED if cause else Block.of(decided["blocked"])
    if block in (Block.LATCHED, Block.DISABLED):
        return Blocked(block, str(cause or block.value)), True
    rows = {row["source"]: row for row in decided["sources"]}
    if source not in rows:
        return Blocked(Block.NO_COMMAND, "the gate has not taken the command yet"), False
    if rows[source]["state"] == "held":
        return Blocked(Block.HELD, "commanded before motion was enabled: send zero or pause, then drive"), False
    driver = next((row for row in rows.values() if row["state"] == "drives"), rows[source])
    if driver["source"] != source:
        return Preempted(driver["who"], driver["source"]), False
    if block:
        return Blocked(block, block.value), False
    return Driving(Velocity(*decided["body_vel"])), True


class Calls(Session):
    """The methods that never wait. Robot and AsyncRobot both inherit them."""

    def _command(
        self, vx: float, vy: float, wz: float, *, manual: bool, source: str, proven_ns: int | None = None
    ) -> None:
        """Send a command to the gate, which reads it a moment later. Raises the same errors as drive()."""
        if not (isfinite(vx) and isfinite(vy) and isfinite(wz)):
            raise ValueError(f"drive({vx}, {vy}, {wz}): every value must be finite")
        with self._lock:
            run = self._current()
            run.check("source", source)
            self._slot(run).command(vx, vy, wz, manual=manual, source=source, t_ns=proven_ns)

    def _of_wheels(self, speeds_radps: tuple[float, ...], steering_rad: float | None) -> Velocity:
        """The velocity of the base at these wheel speeds. Raises ValueError, NoService, FailstopError."""
        if not all(map(isfinite, (*speeds_radps, steering_rad or 0.0))):
            raise ValueError(f"drive_wheels{speeds_radps}: every value must be finite")
        with self._lock:
            return self._current().of_wheels(speeds_radps, steering_rad)

    def _judged(self, source: str) -> tuple[Answer, bool]:
        """Judge the command of this source by the gate's last decision. Returns (answer, final), as judge() does."""
        with self._lock:
            decided, cause, *_ = self._current().decided()
        return judge(decided, source, cause)

    def sensed(self) -> None:
        """Report that the obstacle sensor has just delivered a reading. Some program must call this at least every 0.5
        s (setting scan.timeout_s). Otherwise commands without manual=True are blocked with `no scan`, unless the
        setting scan.gate is "off". Raises NoService."""
        with self._lock:
            self._client().write("sensed", [])

    def assert_interlocks(self, *interlocks: str) -> None:
        """Report that these interlocks hold at this moment. Each must be in the settings, as [interlocks.NAME]. Name
        all interlocks of your program in every call, because the gate reads only the newest call. An interlock is lost
        if no call names it within its timeout, so repeat the call before the shortest timeout ends. Motion can be
        enabled only while all interlocks in the settings hold. When one is lost, motion is disabled.

        Raises Undeclared if an interlock is not in the settings, and then reports none of them. Raises NoService when
        no service is running.
        """
        with self._lock:
            run = self._current()
            run.check("interlock", *interlocks)
            self._slot(run).write("interlocks", interlocks)

    hold = Renamed("assert_interlocks")

    def attend(self, who: str, proven_ns: int | None = None) -> None:
        """Report that the operator `who` is present. Repeat this about every 0.1 s. If the setting attend.required is
        "on", the robot moves only while an operator is present.

        `proven_ns`: a time at which the operator was certainly present (CLOCK_MONOTONIC, ns), by default now. For
        example, if the operator answers a question of your program, pass the time of the question.

        An operator is gone after attend.lease_s (1 s) without a report, after leave(), and when your program ends. A
        Robot reports one operator at a time, so a new name replaces the previous operator. If motion is enabled and
        needs an operator, a stop is latched when the last operator is gone. Raises NoService.
        """
        self._attended(operator(who), time.monotonic_ns() if proven_ns is None else proven_ns)

    def leave(self) -> None:
        """Report that the operator leaves. Raises NoService."""
        self._attended("nobody", 0)

    def _attended(self, who: str, t_ns: int) -> None:
        with self._lock:
            self._client().write("attended", [who], t_ns=t_ns, wake=True)

    def say(self, sees: str, wrong: str = "") -> None:
        """Show people one line about what this program sees, and another about what is wrong, if anything. `failstop
        status`, `failstop why`, `failstop doctor` and the events show the newest lines with the program's name. Each
        line can have 190 bytes. Repeat this every few seconds, because people see the age of old lines."""
        with self._lock:
            self._client().write("said", sees, wrong)

    def estop(self, reason: object = "") -> None:
        """Latch a protective stop. This is a stop by software (category 2), not an emergency stop in the sense of ISO
        13850. Motion stays off until reset() and enable(). estop() needs no permission, and works with a service of any
        version, even on a closed Robot. Raises NoService if no service is running.

        People see `stop request: REASON (says it is CLIENT, pid N)`. The name is only a claim, because anyone may ask
        for a stop under any name. The reason may be any object, such as an exception, and is cut to 180 bytes. The stop
        never waits for the object's `__str__`, so the text from it comes later, in the events.
        """
        send_stop(self.name, reason, self.client_name)

    def _limiting(self, share: float, *, awaited: bool = False) -> Steps[str]:
        if not 0.0 < share <= 1.0:
            raise ValueError(f"a speed limit of {share}: must be over 0, and at most 1")
        return self._asking(records.LIMIT, about=("speed_limit", round(100 * share)), awaited=awaited)

    def _resetting(self, seen: int | None, *, awaited: bool = False) -> Steps[str]:
        return self._asking(records.RESET, about=("seen", seen or 0), awaited=awaited)

    def why(self) -> Why:
        """Explain why the wheels are stopped, what proves it, and what to do. str() of the result is the text that
        `failstop why` prints. Raises NoService, FailstopError."""
        from failstop.api import dates  # imported only here, because driving does not need it
        from failstop.api.why import explain

        at = dates.now()
        return explain(*dates.dated(self.state, EventLog(self.name).read(), at), at.unix_s)

    def samples(self) -> list[Sample]:
        """Return the Imu and Pad samples since the last call, and the newest Odometry. Each sample has a time, and is
        returned only once. Only the first call begins to collect Imu and Pad samples. After a restart of the service,
        the next call begins again. Samples that telemetry reads from the port together have the same time. Raises
        NoService, FailstopError."""
        with self._lock:
            return self._current().samples()

    @property
    def arm(self) -> Arm:
        """The robot's arm. Its calls wait, so in an event loop use `await asyncio.to_thread(robot.arm.pose, "drive")`.
        Raises FailstopError if the settings name no joints."""
        return Arm(self)


def _ends_in_order(raised: object) -> bool:
    """True if a program that leaves `with` by this exception, or by None, ends normally. A task that is cancelled and a
    generator that is closed do not: usually another part of the program has failed."""
    if isinstance(raised, SystemExit):
        return not raised.code
    return raised is None or isinstance(raised, KeyboardInterrupt)


class AsyncRobot(Calls):
    """A robot for asyncio, from `Robot.connect()`. It is an asynchronous context manager, and belongs to one event
    loop. It has every method of Robot, and only enable, disable, reset, limit_speed and wait_for are awaited. A method
    that is not documented here works as in Robot."""

    async def __aenter__(self) -> AsyncRobot:
        self._check_open()
        return self

    async def __aexit__(self, *raised: object) -> None:
        in_order = _ends_in_order(raised[1])
        try:
            with contextlib.suppress(FailstopError):
                if self._disables_at_end(in_order=in_order):
                    await self._answered(records.DISABLE)
        finally:
            self._end(in_order=in_order)

    def drive(self, vx: float, vy: float, wz: float, *, manual: bool = False, source: str = FIRST_SOURCE) -> Answer:
        """Like Robot.drive, but it never waits. The answer comes from the gate's last decision, so it may still be
        about your previous command."""
        self._command(vx, vy, wz, manual=manual, source=source)
        return self._judged(source)[0]

    def drive_wheels(
        self,
        *speeds_radps: float,
        steering_rad: float | None = None,
        manual: bool = False,
        source: str = FIRST_SOURCE,
    ) -> Answer:
        """Like Robot.drive_wheels, but it never waits; see drive()."""
        return self.drive(*self._of_wheels(speeds_radps, steering_rad), manual=manual, source=source)

    async def _answered(self, verb: int, progress: Progress = None) -> str:
        return await _through(self._asking(verb, progress, awaited=True))

    async def enable(self, progress: Progress = None) -> str:
        """Like Robot.enable."""
        return await self._answered(records.ENABLE, progress)

    async def disable(self) -> str:
        """Like Robot.disable."""
        return await self._answered(records.DISABLE)

    async def reset(self, *, seen: int | None = None) -> str:
        """Like Robot.reset."""
        return await _through(self._resetting(seen, awaited=True))

    async def limit_speed(self, share: float) -> str:
        """Like Robot.limit_speed."""
        return await _through(self._limiting(share, awaited=True))

    async def wait_for(self, what: Word | Callable[[State], bool], timeout_s: float | None = None) -> State:
        """Like Robot.wait_for."""
        return await _through(self._reaching(what, timeout_s))

    def events(self, *, past: bool = False) -> AsyncIterator[Event]:
        """Like Robot.events, but for `async for event in robot.events()`. It yields every event since this call, even
        if a task begins to iterate later. Raises NoService when the service ends."""
        return _follow(EventLog(self.name, past=past))


def operator(who: str) -> str:
    """Return the name under which `State.attended_by` has the operator `who`: on one line, and not too long."""
    return records.cut(" ".join(who.split()), MOST_OF_A_NAME).decode() or "somebody"


class Robot(Calls):
    """A connection to the running service `name`. A Robot is a context manager.

    Calls that only read the service's state or events need no permission, and neither does estop(). The first other
    call takes one of the service's client slots. For that, the program's user must be in the group `failstop`, or be
    the service's user.

    If the service is restarted, the next call uses its new run, in which motion is not enabled. While no service is
    running, wait_for() keeps waiting, and the other calls raise NoService. After close(), calls raise FailstopError, in
    every thread; only estop(), events() and close() still work. A Robot that is freed gives its slot back. In a forked
    child, the Robot takes a slot of its own.

    Several threads may use one Robot. For the service it is one client, so the newest drive() of any thread counts. A
    Robot that holds a slot has an extra thread, which only sleeps. The end of this thread shows the gate at once that
    the program has died, however long the kernel takes to free the program's memory.
    """

    connect = AsyncRobot
    """A Robot for asyncio: `async with Robot.connect() as robot`. In an AsyncRobot, calls that take time are
    awaited."""

    def __enter__(self) -> Robot:
        self._check_open()
        return self

    def __exit__(self, *raised: object) -> None:
        self._close(in_order=_ends_in_order(raised[1]))

    def drive(
        self,
        vx: float,
        vy: float,
        wz: float,
        *,
        manual: bool = False,
        source: str = FIRST_SOURCE,
        wait_s: float = 0.01,
        proven_ns: int | None = None,
    ) -> Answer:
        """Command a velocity: m/s forward, m/s left, rad/s counter-clockwise. Values beyond the limits are clamped.
        Repeat the command, because it is valid only for the timeout of its source (0.3 s unless the settings say
        otherwise, 2 s at most). After a restart of the service nothing moves until you enable motion again.

        Returns Driving, Preempted (by which program) or Blocked (why). In an `if`, only Driving counts as true. drive()
        waits until the gate lets this source drive, but at most `wait_s`. If nothing prevents this source from driving,
        the gate needs 0.3 ms on an idle machine. drive() returns at once if this source already drives, a stop is
        latched, or motion is disabled. If this source already drives, or if `wait_s` is very short, the answer may
        still be about your previous command.

        `proven_ns`: the latest time at which the command was certainly wanted (CLOCK_MONOTONIC, ns), by default now.
        The timeout counts from it, so pass it for commands that may be delayed, for example by a network. `manual`:
        True if a person drives; the command then needs no obstacle sensor. `source`: a name from the settings'
        [sources].

        Raises ValueError for a value that is not finite, Undeclared (also a ValueError) for a source that the settings
        do not name, NoService when no service is running.
        """
        self._command(vx, vy, wz, manual=manual, source=source, proven_ns=proven_ns)
        until_s = time.monotonic() + wait_s
        while True:
            answer, settled = self._judged(source)
            if settled or time.monotonic() >= until_s:
                return answer
            time.sleep(POLL_S)

    def drive_wheels(
        self,
        *speeds_radps: float,
        steering_rad: float | None = None,
        manual: bool = False,
        source: str = FIRST_SOURCE,
        wait_s: float = 0.01,
        proven_ns: int | None = None,
    ) -> Answer:
        """Command the speed of each wheel, rad/s, positive forward, in the order of `state.wheels_radps.names`. For a
        steered base, pass the speeds of the rear wheels, which set how fast the base goes and how it turns. If you also
        pass `steering_rad` (positive to the left), their mean sets how fast the base goes, and the angle sets how it
        turns.

        The sizes in the settings turn these speeds into a velocity of the base, which is passed to drive(). So all
        limits, ramps, sources and results are those of drive(). A limit slows all wheels in the same proportion. Four
        mecanum wheels get the closest speeds that they can roll without slip. Raises what drive() raises. Also raises
        ValueError for a wrong number of speeds, or for an angle on a base without steering.
        """
        velocity = self._of_wheels(speeds_radps, steering_rad)
        return self.drive(*velocity, manual=manual, source=source, wait_s=wait_s, proven_ns=proven_ns)

    def enable(self, progress: Progress = None) -> str:
        """Enable motion. Better let a person do it (`failstop enable`), and use wait_for("enabled") in the program. A
        program that enables motion by itself drives off unattended when it is restarted after a crash.

        If the robot has an arm, the arm first moves to its drive pose, which takes seconds. `progress` is called with
        each text about this move. arm.hold(), disable() or a stop ends the move, and motion stays disabled. Raises
        Refused with the reason: for example, a stop is latched, the service is not ready, an interlock does not hold,
        no operator is present, or the robot was stopped after this call was made.
        """
        return sleep_through(self._asking(records.ENABLE, progress))

    def disable(self) -> str:
        """Disable motion, which stops the wheels at once."""
        return sleep_through(self._asking(records.DISABLE))

    def reset(self, *, seen: int | None = None) -> str:
        """Clear the latched stop. Motion stays disabled until enable(). If nothing is latched, this changes nothing.
        Raises Refused if the robot was stopped again after this call was made.

        `seen`: the `epoch` of a State, if a person has decided on the reset by looking at that State. reset() then also
        raises Refused if the robot was stopped after that State was read.
        """
        return sleep_through(self._resetting(seen))

    def limit_speed(self, share: float) -> str:
        """Limit the speed of all drivers. `share` is a number from 0.05 to 1, for example 0.5 for half of the speeds in
        the settings. The limit takes effect at once, but the wheels slow down along the ramps. It holds until somebody
        sets a new limit or the service ends. Raises Refused, ValueError."""
        return sleep_through(self._limiting(share))

    def wait_for(self, what: Word | Callable[[State], bool], timeout_s: float | None = None) -> State:
        """Wait for a state, and return it. `what`: a word such as "enabled" (docs/python.md lists them), or a function
        that returns True for the wanted State. The wait goes on even while no service is running. Raises ValueError for
        an unknown word. After `timeout_s`, raises TimedOut with the state and what to do, or NoService if no service is
        running."""
        return sleep_through(self._reaching(what, timeout_s))

    def events(self, *, past: bool = False) -> Iterator[Event]:
        """Iterate over the service's events as they happen, such as stops, deaths and requests (docs/logs.md). `past`:
        begin with the earlier events of this run (the last 256). Raises NoService when the run ends."""
        return EventLog(self.name, past=past).follow()


async def _through(steps: Steps[T]) -> T:
    """Run a generator of steps, and return its result. Unlike session.sleep_through(), it does not block the event loop
    between two steps."""
    import asyncio  # imported only here, because it takes as long to import as everything else in this module

    try:
        while True:
            await asyncio.sleep(next(steps))
    except StopIteration as done:
        found: T = done.value
        return found
    finally:
        steps.close()


async def _follow(log: EventLog) -> AsyncIterator[Event]:
    import asyncio

    while True:
        found = log.read()
        for event in found:
            yield event
        if not found:
            await asyncio.sleep(LOOK_S)
