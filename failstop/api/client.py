"""What a program needs of a service: the running service itself, a client slot, and the stop pipe."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import os
import termios
import time
import weakref
from collections.abc import Callable
from time import monotonic_ns
from typing import Any, TypeVar

import msgpack

from failstop.api import host, reason
from failstop.api.errors import FailstopError, NoService, Undeclared
from failstop.api.held import HeldByThread
from failstop.files import instance
from failstop.messages import layout, records, segments
from failstop.policy.causes import Reply, unpack_reply
from failstop.shm import bell, claim, segment
from failstop.shm.heartbeat import HeartbeatReader
from failstop.shm.lifeline import pid_namespace
from failstop.shm.words import Barrier

T = TypeVar("T")

REPEAT_NS = 45_000_000
"""A command that repeats the one before it within this time wakes nobody. The gate reads it at its next tick, before
the earlier one becomes too old. A wake-up costs 0.2 to 0.4 ms of processor time."""
GIVEN_UP = "replaced by a later request of this program"
LONGEST_SHOWN = 40
OWN_WORDS_S = 0.1
"""If an object is given as the reason of a stop, its own text is sent only if it is ready within this time, s."""


def runtime_dir(name: str) -> str:
    """The runtime directory of the running service. Raises NoService, FailstopError."""
    return _there(instance.find, name)


def run(name: str) -> tuple[str, int]:
    """The name that the segments of the running service share, and the uid of their owner. Raises NoService,
    FailstopError."""
    incarnation, owner = _there(instance.current_run, runtime_dir(name))
    return segments.memory(name, incarnation), owner


def attach(name: str, which: str, found: tuple[str, int] | None = None) -> segment.Segment:
    """Attach a segment for reading, of the run `found`, or of the running one. Raises NoService, FailstopError."""
    memory, owner = found or run(name)
    return _there(segments.attach, memory, which, owner=owner)


def _there(take: Callable[..., T], *what: Any, **how: Any) -> T:
    """Call a function that needs the service, and convert its errors. Raises NoService, FailstopError."""
    try:
        return take(*what, **how)
    except (instance.NoService, instance.InstanceError, segments.AttachError) as error:
        absent = isinstance(error, instance.NoService) or getattr(error, "kind", "") == "absent"
        raise (NoService if absent else FailstopError)(str(error)) from None


def unread(fd: int) -> int:
    """How many bytes in a pipe were not read yet. Raises OSError."""
    return int.from_bytes(fcntl.ioctl(fd, termios.FIONREAD, bytes(4)), "little")


def send_stop(name: str, why: object, who: object = "", row: str = "") -> None:
    """Request a stop, which is then latched. Every local user may do this.

    The service shows `stop request: REASON (says it is WHO, pid N)`, because a pipe does not tell its reader who wrote.
    A reason longer than records.ASKED_BYTES is cut. If the reason is an object, its own text follows in a second
    request, unless it takes longer than OWN_WORDS_S. `row`: the name of the cause that the reason belongs to, one of
    causes.SIGNED, whose remedy is shown. Never blocks on the service. Raises NoService, FailstopError.
    """
    directory, fd = _there(instance.open_stop, name)
    try:
        words, whole = reason.plain(why)
        asks = reason.plain(who)[0]
        bell.send(fd, records.asking(words, asks, os.getpid(), row))
        if not whole:
            _say_more(os.dup(fd), why, asks)
    except OSError as error:
        path = instance.stop_path(directory)
        raise NoService(f"the stop pipe {path} can't be written ({error.strerror}): use `failstop stop`") from None
    finally:
        os.close(fd)


def _say_more(fd: int, why: object, who: str) -> None:
    """Have the object's own text sent, and wait for that, for at most OWN_WORDS_S. A separate thread gets the text,
    because the object's code may never return. `fd`: the stop pipe, which is closed at the end."""
    # Only a reason that has code of its own needs it.
    from threading import Thread

    asking = Thread(target=_own_words, args=(fd, why, who, time.monotonic() + OWN_WORDS_S), daemon=True)
    try:
        asking.start()
    except RuntimeError:  # no more threads, or the interpreter ends: the stop itself is out
        os.close(fd)
    else:
        asking.join(OWN_WORDS_S)


def _own_words(fd: int, why: object, who: str, until_s: float) -> None:
    """Send the object's own text after the first request was read, because the service reports only the first of
    several requests that it reads together. A text that comes too late is dropped, because it would stop the robot
    again after a reset."""
    with contextlib.suppress(BaseException), contextlib.closing(os.fdopen(fd, "wb", buffering=0)):
        words = reason.own(why)
        while unread(fd) and time.monotonic() < until_s:
            time.sleep(OWN_WORDS_S / 100)
        if words and time.monotonic() < until_s:
            bell.send(fd, records.asking(words, who, os.getpid()))


def gone(name: str) -> NoService:
    """The error for every call if the service has been running before and has ended."""
    return NoService(f"the service {name!r} has ended: start it with {host.start(name)}")


class SeenRun:
    """The run that exists when this object is made: whether it still runs, and what its settings declare. Not
    thread-safe.

    A run publishes its name only after everything that is read here exists (supervisor/entry.py), and each check asks
    the kernel whether the run's supervisor is alive. So what is read here does not change during the run.
    """

    def __init__(self, name: str) -> None:
        """Raises NoService, FailstopError."""
        self._life = -1
        self.name = name
        self.found = run(name)
        """The name that the run's segments share, and their owner."""
        self.supervisor = attach(name, layout.SUPERVISOR, self.found)
        self._life = _there(segments.open_life, *self.found)
        self._beat = HeartbeatReader(self.supervisor)
        self.began_ns, self._rules = self.run_record("rules")
        """When the supervisor published the rules, which it does once (CLOCK_MONOTONIC)."""

    def __del__(self) -> None:
        if self._life >= 0:
            with contextlib.suppress(OSError):  # a program that closes descriptors which are not its own
                os.close(self._life)

    def shares_pids(self) -> bool:
        """True if a pid of the service means the same process in this program's pid namespace."""
        return bool(pid_namespace() == self._rules["pid_namespace"] != 0)

    def run_record(self, record: str) -> tuple[int, dict[str, Any]]:
        """Returns when the supervisor wrote a record, which was before it published the run's name, and the record's
        content. Raises FailstopError if it is damaged."""
        entry = self.supervisor.latest_reader(record).read()
        if entry is None:
            raise FailstopError(f"shared memory of {self.name!r} is damaged: restart the service")
        return entry[1], msgpack.unpackb(entry[2])

    def over(self) -> bool:
        """True if this run has ended, because its supervisor has died. It takes one system call, so it is cheap enough
        for every call."""
        try:
            return not segments.lives(self._life)
        except OSError:  # a program that closes descriptors which are not its own: the next look opens another
            self._life = -1  # the number may be another file's from now on
            return True

    def silent(self, now_ns: int) -> bool:
        """True if the supervisor's lease has ended, so that no motion is admitted."""
        return bool(self._beat.age_ns(now_ns) > self._rules["lease_ns"])

    def check(self, kind: str, *names: str) -> None:
        """Raise Undeclared if the settings do not declare one of these names. `kind`: "source" or "interlock"."""
        declared: list[str] = self._rules[f"{kind}s"]
        for name in names:
            if name not in declared:
                told = f"no {kind} {name[:LONGEST_SHOWN]!r} in the settings of {self.name!r}, which declare"
                hint = f"add [{kind}s.NAME] and restart the service"
                raise Undeclared(f"{told}: {', '.join(declared) or 'none'}; {hint}")


class Client:
    """A claimed client slot. The claim ends with close(), when the object is freed, or with the process."""

    def __init__(self, name: str, who: str, *, pid: int | None = None) -> None:
        """`pid`: the pid that people are shown, of the program that this process speaks for; None: of this process
        itself. Raises NoService, and FailstopError (no permission, another version, all slots taken)."""
        self.name = name
        self.who = who
        directory = runtime_dir(name)
        self._session = int.from_bytes(os.urandom(8), "little") | 1
        self._number = 0
        self._commanded = (b"", 0)
        """The last command, and when it was written."""
        found = run(name)
        gate = attach(name, layout.GATE, found)
        with contextlib.ExitStack() as taken:
            try:
                claims = claim.open_claims(instance.claims_path(directory))
                taken.callback(os.close, claims)
                self._bell = bell.open_pipe_to_write(instance.bell_path(directory))
                taken.callback(os.close, self._bell)
                self.slot, self._segment = self._claim_slot(claims, found, gate.incarnation)
                taken.callback(self._segment.close)
            except PermissionError:
                raise FailstopError(
                    f"this user may stop {name!r} but not drive it: join the group `failstop`, or run as the "
                    "service's user"
                ) from None
            except segments.AttachError as error:
                raise FailstopError(str(error)) from None
            except OSError as error:
                # The two that a service leaves behind are no words for people.
                why = "" if error.errno in (errno.ENXIO, errno.ENOENT) else f" ({error.strerror})"
                raise NoService(f"the service {name!r} is ending{why}: try again") from None
            life = None
            # Without a thread or memory, the gate learns about a death later, when the kernel has freed the process.
            with contextlib.suppress(RuntimeError, OSError):
                life = HeldByThread(self._segment.futex("held", write=True))
            self._farewell: list[bytes] = []
            """The goodbye, once it was written. Without it, the gate takes the end of the slot for a death."""
            own = os.getpid(), _files(self._segment.fileno(), self._bell)
            taken.callback(_give_back, self.slot, self._segment, self._bell, life, self._farewell, *own)
            self._drop = weakref.finalize(self, taken.pop_all().close)
        self._records = {record: self._segment.latest_writer(record) for record in records.OF_SESSION}
        self._reply = gate.latest_reader(f"reply.{self.slot}")
        # The gate must not watch a program that this process speaks for: it may end in order, which this one knows.
        shown = (os.getpid(), pid_namespace()) if pid is None else (pid, 0)
        hello = records.HELLO.pack(self._session, *shown, self.who)
        self._segment.latest_writer("hello").write(hello)
        self._ring()

    @property
    def drove(self) -> bool:
        """True once this client has given a command, so that its death is a driver's death."""
        return bool(self._commanded[0])

    def _claim_slot(self, claims: int, found: tuple[str, int], incarnation: int) -> tuple[int, segment.Segment]:
        memory, owner = found
        damaged = 0
        for index in range(layout.CLIENT_SLOTS):
            if claim.acquire(claims, index):
                try:
                    taken = segments.attach(memory, f"client.{index}", incarnation, owner=owner, write=True)
                except segments.AttachError as error:
                    if error.kind not in ("damaged", "absent", "owner"):
                        raise
                    claim.release(claims, index)
                    damaged += 1
                    continue
                taken.wipe()
                return index, taken
        raise FailstopError(
            f"all {layout.CLIENT_SLOTS} client slots of {self.name!r} are taken"
            + (f", {damaged} of them damaged by a client: restart the service" if damaged else "")
            + "; close a client: `failstop status` lists them"
        )

    def _ring(self) -> None:
        try:
            bell.send(self._bell, bytes([self.slot]))
        except BrokenPipeError:
            raise gone(self.name) from None

    def write(self, record: str, *values: Any, t_ns: int | None = None, wake: bool = False) -> bytes:
        """Write one of records.OF_SESSION; returns what was written. `t_ns`: the time that the values are about
        (CLOCK_MONOTONIC), if not now. The gate reads them at its next tick, or with `wake` at once. Raises NoService,
        ValueError."""
        payload = records.OF_SESSION[record].pack(self._session, *values)
        self._records[record].write(payload, t_ns)
        if wake:
            self._ring()
        return payload

    def command(
        self, vx_mps: float, vy_mps: float, wz_radps: float, *, manual: bool, source: str, t_ns: int | None = None
    ) -> None:
        """Give the gate a velocity command; returns at once. `t_ns`: when it was made, if not now. If it repeats the
        last command, the gate reads it only at its next tick, which loses nothing. Raises NoService, and ValueError for
        a source that is too long."""
        command = self.write("command", vx_mps, vy_mps, wz_radps, manual, source, t_ns=t_ns)
        before, self._commanded = self._commanded, (command, monotonic_ns())
        if before[0] != command or self._commanded[1] - before[1] > REPEAT_NS:
            self._ring()

    def ask(self, verb: int, asked_ns: int | None = None) -> int:
        """Make a request; returns its number. `asked_ns`: when it was made (CLOCK_MONOTONIC), if not now. Raises
        NoService."""
        self._number += 1
        self.write("request", self._number, verb, t_ns=asked_ns, wake=True)
        return self._number

    def answer(self, asked: int) -> Reply | None:
        """The answer to the request with this number; None until it comes. When it has come, the state shows what the
        request has changed. If a later request by another thread was answered in the meantime, that answer has replaced
        this one."""
        if (entry := self._reply.read()) is not None:
            session, number, reply = unpack_reply(entry[2])
            if session == self._session and number >= asked:
                Barrier()()
                return reply if number == asked else Reply(records.REFUSED, GIVEN_UP)
        return None

    def close(self, *, in_order: bool = True) -> None:
        """Give the slot back, so that a command of this client no longer counts. `in_order`: say goodbye, so that the
        gate does not take it for a death."""
        if in_order:
            lies = self._segment.latest_reader("left").read()
            self._farewell.append(records.goodbye(self._session, lies[2] if lies else b""))
        self._drop()


def _files(*fds: int) -> list[tuple[int, int]]:
    """Which files have these descriptor numbers; empty if one of them is closed."""
    try:
        return [(found.st_dev, found.st_ino) for found in map(os.fstat, fds)]
    except OSError:
        return []


def _give_back(
    slot: int,
    held: segment.Segment,
    ring: int,
    life: HeldByThread | None,
    farewell: list[bytes],
    owner: int,
    files: list[tuple[int, int]],
) -> None:
    """Give a slot back, so that a command in it no longer counts. It writes nothing in a fork of its `owner`, nor if
    the program has closed these descriptors, because their numbers may belong to other `files` now."""
    if os.getpid() == owner:
        if _files(held.fileno(), ring) == files:
            # Another process may claim the slot before the gate has seen it free.
            with contextlib.suppress(OSError, ValueError):
                for goodbye in farewell:
                    held.latest_writer("left").write(goodbye)
                held.wipe()
                bell.send(ring, bytes([slot]))
        if life:
            life.let_go()
    held.close()
