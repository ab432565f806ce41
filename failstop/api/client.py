"""A local client's side of shared memory: its slot, its requests, its commands, and the stop pipe."""

from __future__ import annotations

import contextlib
import os
import weakref
from time import monotonic_ns

from failstop.api.errors import FailstopError, NoService
from failstop.api.held import HeldByThread
from failstop.policy.reply import Reply, unpack
from failstop.shm import bell, claim, instance, layout, records, segment
from failstop.shm.lifeline import pid_namespace
from failstop.shm.words import Barrier

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable
    from typing import TypeVar

    T = TypeVar("T")


REPEAT_NS = 45_000_000
"""A command that repeats the one before it so soon wakes nobody: the gate looks for it at its tick, and before it lets
the one before it time out. A wake-up costs 0.2 to 0.4 ms of processor time."""
RECORDS = ("command", "request", "sensed", "interlocks", "attended", "said", "speed_limit", "arm_goal", "arm_path")
"""What a client writes into its slot, once it has said hello there."""
GIVEN_UP = "given up for a later request of this program"


def runtime_dir(name: str) -> str:
    """Directory of the running service. Raises NoService, FailstopError."""
    return _found(instance.find, name)


def _found(look: Callable[[str], T], where: str) -> T:
    """What is found there. Raises NoService, FailstopError."""
    try:
        return look(where)
    except instance.NoService as error:
        raise NoService(str(error)) from None
    except instance.InstanceError as error:
        raise FailstopError(str(error)) from None


def run(name: str) -> tuple[str, int]:
    """What the segments of the running service are named after, and the uid they belong to. Raises NoService,
    FailstopError."""
    incarnation, owner = _found(instance.run, runtime_dir(name))
    return segment.memory(name, incarnation), owner


def last_run(name: str) -> tuple[str, int]:
    """The same of a service that may have ended and left its segments, if it was this user's. Raises NoService,
    FailstopError."""
    try:
        return run(name)
    except NoService:
        if dead := segment.dead_runs(name):
            return dead[-1], os.geteuid()
        raise


def attach(name: str, which: str, found: tuple[str, int] | None = None) -> segment.Segment:
    """A service segment, for reading; of the run that was `found`, or else of the one that is there. Raises NoService,
    FailstopError."""
    memory, owner = found or run(name)
    try:
        return segment.attach(memory, which, owner=owner)
    except segment.AttachError as error:
        kind = NoService if error.kind == "absent" else FailstopError
        raise kind(str(error)) from None


def send_stop(name: str, reason: str, who: str = "") -> None:
    """Ask for a latched stop: every local user may. The service tells of it as `stop request: REASON (WHO, pid N)`, a
    reason of more than records.ASKED_BYTES cut. Never blocks. Raises NoService, FailstopError."""
    directory, fd = _found(instance.open_stop, name)
    try:
        bell.send(fd, records.asking(reason, who, os.getpid()))
    except OSError as error:
        path = instance.stop_path(directory)
        raise NoService(f"the stop pipe {path} can't be written ({error.strerror}): use `failstop stop`") from None
    finally:
        os.close(fd)


def gone(name: str) -> NoService:
    """The error of every call to a service that was there before."""
    return NoService(f"the service {name!r} has gone: start it with `failstop run{instance.option(name)}`")


class _Held:
    """What a client holds of a service, given back once: by close(), or when nobody has the client any more."""

    def __init__(self) -> None:
        self.claims = -1
        self.bell = -1
        self.slot = -1
        self.segment: segment.Segment | None = None
        self.life: HeldByThread | None = None
        self._pid = os.getpid()

    def give_back(self, farewell: bytes = b"") -> None:
        """A command that lies in the slot stops counting at once. `farewell`: a hello that is a goodbye; without one
        the gate takes it for a death. A process that was forked from the holder touches nothing in the slot."""
        if self.segment:
            if os.getpid() == self._pid:
                # Another process may have the claim before the gate has seen it free.
                with contextlib.suppress(OSError, ValueError):
                    self.segment.wipe()
                    if farewell:
                        self.segment.latest_writer("hello").write(farewell)
                    bell.send(self.bell, bytes([self.slot]))
                if self.life:
                    self.life.let_go()
            self.segment.close()
            self.segment = self.life = None
        for fd in (self.claims, self.bell):
            if fd >= 0:
                os.close(fd)
        self.claims = self.bell = -1


class Client:
    """A claimed client slot. The claim ends with close(), when nobody refers to this any more, or with the process."""

    def __init__(self, name: str, who: str) -> None:
        """Raises NoService, FailstopError (no permission, another version, all slots taken)."""
        self.name = name
        self.who = who
        directory = runtime_dir(name)
        self._session = int.from_bytes(os.urandom(8), "little") | 1
        self._number = 0
        self._commanded = (b"", 0)
        """The last command, and when it was handed over."""
        self._memory, self._owner = found = run(name)
        self._gate = attach(name, layout.GATE, found)
        self._held = _Held()
        self._drop = weakref.finalize(self, self._held.give_back)
        try:
            self._held.claims = claim.open_claims(instance.claims_path(directory))
            self._bell = self._held.bell = bell.open_pipe_to_write(instance.bell_path(directory))
            self.slot, self._segment = self._claim_slot()
        except PermissionError:
            self._drop()
            raise FailstopError(
                f"this user may stop {name!r} but not drive it: join the group `failstop`, or run as the service's user"
            ) from None
        except segment.AttachError as error:
            self._drop()
            raise FailstopError(str(error)) from None
        except OSError as error:
            self._drop()
            raise NoService(f"the service {name!r} is going away ({error.strerror}): try again") from None
        except FailstopError:
            self._drop()
            raise
        self._held.slot, self._held.segment = self.slot, self._segment
        # Without a thread or memory the gate learns of a death later, when the kernel has taken the process down.
        with contextlib.suppress(RuntimeError, OSError):
            self._held.life = HeldByThread(self._segment.futex("held", write=True))
        self._records = {record: self._segment.latest_writer(record) for record in RECORDS}
        self._reply = self._gate.latest_reader(f"reply.{self.slot}")
        self._hint = bytes([self.slot])
        self._segment.latest_writer("hello").write(self._hello(self._session))
        self._ring()

    def _hello(self, session: int) -> bytes:
        return records.HELLO.pack(session, os.getpid(), pid_namespace(), self.who)

    def _claim_slot(self) -> tuple[int, segment.Segment]:
        damaged = 0
        for index in range(layout.CLIENT_SLOTS):
            if claim.take(self._held.claims, index):
                try:
                    found = segment.attach(
                        self._memory, f"client.{index}", self._gate.incarnation, owner=self._owner, write=True
                    )
                except segment.AttachError as error:
                    if error.kind not in ("damaged", "absent", "owner"):
                        raise
                    claim.drop(self._held.claims, index)
                    damaged += 1
                    continue
                found.wipe()
                return index, found
        raise FailstopError(
            f"all {layout.CLIENT_SLOTS} client slots of {self.name!r} are taken"
            + (f", {damaged} of them damaged by a client: restart the service" if damaged else "")
            + "; close a client: `failstop status` lists them"
        )

    def _ring(self) -> None:
        try:
            bell.send(self._bell, self._hint)
        except BrokenPipeError:
            raise gone(self.name) from None

    def command(self, vx_mps: float, vy_mps: float, wz_radps: float, *, manual: bool, source: str) -> None:
        """Hand a velocity command to the gate; returns at once. What repeats the one just before it waits for the
        gate's tick, which it would have waited for in any case. Raises NoService, and ValueError for a source that is
        too long."""
        command = records.COMMAND.pack(self._session, vx_mps, vy_mps, wz_radps, manual, source)
        self._records["command"].write(command)
        before, self._commanded = self._commanded, (command, monotonic_ns())
        if before[0] != command or self._commanded[1] - before[1] > REPEAT_NS:
            self._ring()

    def sensed(self) -> None:
        """Say that the obstacle sensor delivered just now; the gate sees it at its next tick or command."""
        self._records["sensed"].write(records.HELD.pack(self._session, []))

    def hold(self, names: list[str]) -> None:
        """Say that these interlocks hold now, and no others by this client; the gate sees it at its next tick."""
        self._records["interlocks"].write(records.HELD.pack(self._session, names))

    def attended(self, who: str, t_ns: int) -> None:
        """Say that an operator was there at that time; 0: is there no more. Raises NoService, and ValueError for a name
        that is too long."""
        self._records["attended"].write(records.HELD.pack(self._session, [who]), t_ns)
        self._ring()

    def say(self, sees: str, wrong: str) -> None:
        """Say in a line what this program sees, and what is wrong; the gate passes it on within 0.2 s."""
        self._records["said"].write(records.SAID.pack(self._session, sees, wrong))

    def ask(self, verb: int, asked_ns: int | None = None) -> int:
        """Make a request; returns its number, for answer(). `asked_ns`: when it was asked for (CLOCK_MONOTONIC), if not
        now. Raises NoService."""
        self._number += 1
        self._records["request"].write(records.REQUEST.pack(self._session, self._number, verb), asked_ns)
        self._ring()
        return self._number

    def speed_limit(self, percent: int) -> None:
        """Leave a speed limit for the request that follows."""
        self._records["speed_limit"].write(records.SPEED_LIMIT.pack(self._session, percent))

    def arm_goal(self, mode: int, values: dict[int, float]) -> None:
        """Hand a goal of the arm to the gate; returns at once. Raises NoService, ValueError."""
        self._records["arm_goal"].write(records.ARM_GOAL.pack(self._session, mode, values))
        self._ring()

    def arm_path(self, share: float, servos: list[int], rows: records.Rows) -> None:
        """Leave a trajectory for the request that follows. Raises ValueError."""
        self._records["arm_path"].write(records.ARM_PATH.pack(self._session, share, servos, rows))

    def answer(self, asked: int) -> Reply | None:
        """The answer to a request; None while there is none. What the request has changed is in the state from then
        on. A later request that was answered meanwhile, by another thread, has taken its place."""
        if (entry := self._reply.read()) is not None:
            session, number, reply = unpack(entry[2])
            if session == self._session and number >= asked:
                Barrier()()
                return reply if number == asked else Reply(records.REFUSED, GIVEN_UP)
        return None

    def close(self, *, in_order: bool = True) -> None:
        """Give the slot back; a command of this client stops counting at once. `in_order`: with a goodbye, so that
        people are not told of a death."""
        self._held.give_back(self._hello(records.NOBODY) if in_order else b"")
