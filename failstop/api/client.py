"""Client: connects a program with the service. It finds the running service, takes a client slot to drive, and writes
to the stop pipe."""

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
from failstop.shm import bell, claim, owned, segment
from failstop.shm.heartbeat import HeartbeatReader
from failstop.shm.lifeline import pid_namespace
from failstop.shm.words import Barrier

T = TypeVar("T")

REPEAT_NS = 45_000_000
"""A command does not wake the gate if it repeats a command that was sent less than this many ns earlier. The gate reads
it at its next tick, before the earlier command expires. Each wake-up that this saves would take 0.2 to 0.4 ms of
processor time."""
GIVEN_UP = "replaced by a later request of this program"
LONGEST_SHOWN = 40
OWN_WORDS_S = 0.1
"""How long the `__str__` of an object that is the reason for a stop may take, in seconds. If it takes longer, its text
is not sent."""


def runtime_dir(name: str) -> str:
    """The runtime directory of the running service with this name. Raises NoService, FailstopError."""
    return _there(instance.find, name)


def run(name: str) -> tuple[str, int]:
    """Return the name that all segments of the running service share, and the uid of their owner. Raises NoService,
    FailstopError."""
    incarnation, owner = _there(instance.current_run, runtime_dir(name))
    return segments.memory(name, incarnation), owner


def attach(name: str, which: str, found: tuple[str, int] | None = None) -> segment.Segment:
    """Attach to a segment of the service for reading. `which`: the segment's name. `found`: the run of the service, as
    run() returns it; by default the present run. Raises NoService, FailstopError."""
    memory, owner = found or run(name)
    return _there(segments.attach, memory, which, owner=owner)


def _there(take: Callable[..., T], *what: Any, **how: Any) -> T:
    """Call `take`, a function that needs the service, and turn its errors into NoService or FailstopError."""
    try:
        return take(*what, **how)
    except (instance.NoService, instance.InstanceError, segments.AttachError) as error:
        absent = isinstance(error, instance.NoService) or getattr(error, "kind", "") == "absent"
        raise (NoService if absent else FailstopError)(str(error)) from None


def unread(fd: int) -> int:
    """How many bytes in a pipe are still unread. Raises OSError."""
    return int.from_bytes(fcntl.ioctl(fd, termios.FIONREAD, bytes(4)), "little")


def send_stop(name: str, why: object, who: object = "", row: str = "") -> None:
    """Ask the service to latch a stop. Every local user may do this. The request is sent at once. Raises NoService,
    FailstopError.

    The service shows `stop request: REASON (says it is WHO, pid N)`, but can't check who asked. A reason longer than
    records.ASKED_BYTES is cut. If the reason is an object with its own `__str__`, the text from it follows in a second
    request. The call waits for this text, but at most OWN_WORDS_S. After that, no second request is sent. `row`: the
    name of a cause in causes.SIGNED. If it is given, people see the remedy for this cause.
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
        raise NoService(f"the stop pipe {path} can't be written ({error.strerror}): use {host.stop(name)}") from None
    finally:
        os.close(fd)


def _say_more(fd: int, why: object, who: str) -> None:
    """Send the text from the `__str__` of `why` in a second stop request. This takes at most OWN_WORDS_S. Another
    thread makes the text, because `__str__` may never return. `fd`: a descriptor of the stop pipe. It is closed when
    the request was sent or dropped."""
    # Imported only here, because most reasons don't need it.
    from threading import Thread

    asking = Thread(target=_own_words, args=(fd, why, who, time.monotonic() + OWN_WORDS_S), daemon=True)
    try:
        asking.start()
    except RuntimeError:  # no thread can be started, or Python is ending; the stop itself is already sent
        os.close(fd)
    else:
        asking.join(OWN_WORDS_S)


def _own_words(fd: int, why: object, who: str, until_s: float) -> None:
    """Call the `__str__` of `why`, and send its text once the service has read the first request. The service reports
    only the first of several requests that it reads together. After `until_s` nothing is sent, because somebody may
    already have reset the stop, and a late request would stop the robot again."""
    with contextlib.suppress(BaseException), contextlib.closing(os.fdopen(fd, "wb", buffering=0)):
        words = reason.own(why)
        while unread(fd) and time.monotonic() < until_s:
            time.sleep(OWN_WORDS_S / 100)
        if words and time.monotonic() < until_s:
            bell.send(fd, records.asking(words, who, os.getpid()))


def gone(name: str) -> NoService:
    """The error for a call to a service that has ended since this program connected to it."""
    return NoService(f"the service {name!r} has ended: start it with {host.start(name)}")


class SeenRun:
    """Shows whether a run of the service has ended, and what its settings declare. This object stays with the run in
    which it was made. Not thread-safe.

    What the settings declare does not change during the run: the supervisor writes it only once, before clients can
    find the run (supervisor/entry.py).
    """

    def __init__(self, name: str) -> None:
        """Raises NoService, FailstopError."""
        self._life, self._life_file = -1, None
        self.name = name
        self.found = run(name)
        """The name that the run's segments share, and the uid of their owner."""
        self.supervisor = attach(name, layout.SUPERVISOR, self.found)
        self._life = _there(segments.open_life, *self.found)
        self._life_file = owned.inode_of(self._life)
        self._beat = HeartbeatReader(self.supervisor)
        self.began_ns, self._rules = self.run_record("rules")
        """When the run began (CLOCK_MONOTONIC, ns). This is the time of the record `rules`, which the supervisor writes
        only once, at the beginning."""

    def __del__(self) -> None:
        owned.close(self._life, self._life_file)

    def shares_pids(self) -> bool:
        """True if the pids of the service are valid in this program, because both are in the same pid namespace."""
        return bool(pid_namespace() == self._rules["pid_namespace"] != 0)

    def run_record(self, record: str) -> tuple[int, dict[str, Any]]:
        """Return (time, values) of a record: when the supervisor wrote it (CLOCK_MONOTONIC, ns), and its values. Raises
        FailstopError if the record is damaged."""
        entry = self.supervisor.latest_reader(record).read()
        if entry is None:
            raise FailstopError(f"shared memory of {self.name!r} is damaged: restart the service")
        return entry[1], msgpack.unpackb(entry[2])

    def over(self) -> bool:
        """True if this run of the service has ended. A run ends when its supervisor dies. The check takes one system
        call, so every call to the service makes it."""
        if self._life < 0:
            return True
        try:
            return not segments.lives(self._life)
        except OSError:  # the program has closed this descriptor; a new SeenRun opens another
            self._life = -1  # another file may get this number
            return True

    def silent(self, now_ns: int) -> bool:
        """True if the supervisor has been silent for longer than its lease. No motion is allowed during such a
        silence."""
        return bool(self._beat.age_ns(now_ns) > self._rules["lease_ns"])

    def check(self, kind: str, *names: str) -> None:
        """Raise Undeclared if one of these names is not in the settings. `kind`: "source" or "interlock"."""
        declared: list[str] = self._rules[f"{kind}s"]
        for name in names:
            if name not in declared:
                told = f"no {kind} {name[:LONGEST_SHOWN]!r} in the settings of {self.name!r}, which declare"
                hint = f"add [{kind}s.NAME] and restart the service"
                raise Undeclared(f"{told}: {', '.join(declared) or 'none'}; {hint}")


class Client:
    """Holds one of the service's client slots until close(), until this object is freed, or until the process ends."""

    def __init__(self, name: str, who: str, *, pid: int | None = None) -> None:
        """Take a client slot. `who` and `pid`: the name and the pid that people see. `pid` is by default that of this
        process. To drive on behalf of another program, pass that program's pid. Raises NoService, FailstopError (no
        permission, another version, or all slots taken)."""
        self.name = name
        directory = runtime_dir(name)
        self._session = int.from_bytes(os.urandom(8), "little") | 1
        self._number = 0
        self._commanded = (b"", 0)
        """The last command as bytes, and when it was written."""
        found = run(name)
        gate = attach(name, layout.GATE, found)
        with contextlib.ExitStack() as taken:
            try:
                claims = claim.open_claims(instance.claims_path(directory))
                taken.callback(owned.close, claims, owned.inode_of(claims))
                self._bell = bell.open_pipe_to_write(instance.bell_path(directory))
                taken.callback(owned.close, self._bell, owned.inode_of(self._bell))
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
                # After these two errors, which a service leaves behind, the reason would only confuse people.
                why = "" if error.errno in (errno.ENXIO, errno.ENOENT) else f" ({error.strerror})"
                raise NoService(f"the service {name!r} is ending{why}: try again") from None
            life = None
            # Without this thread, the gate notices a death later, when the kernel has freed the memory of the process.
            with contextlib.suppress(RuntimeError, OSError):
                life = HeldByThread(self._segment.futex("held", write=True))
            self._farewell: list[bytes] = []
            """The goodbye of this client, once close() has made it. If there is no goodbye, the gate takes the end for
            a crash."""
            own = os.getpid(), _files(self._segment.fileno(), self._bell)
            taken.callback(_give_back, self.slot, self._segment, self._bell, life, self._farewell, *own)
            self._drop = weakref.finalize(self, taken.pop_all().close)
            # At the end of Python, finalizers would run before functions that the program has registered earlier with
            # atexit. One of them may be close(), which says goodbye.
            self._drop.atexit = False
        self._records = {record: self._segment.latest_writer(record) for record in records.OF_SESSION}
        self._reply = gate.latest_reader(f"reply.{self.slot}")
        self.rename(who, pid)

    def rename(self, who: str, pid: int | None) -> None:
        """Show this name and pid to people from now on. See __init__(). Raises NoService."""
        self.who = who
        # The gate must not watch a program that this process speaks for. It may end normally, and only this process
        # knows that.
        shown = (os.getpid(), pid_namespace()) if pid is None else (pid, 0)
        self._segment.latest_writer("hello").write(records.HELLO.pack(self._session, *shown, who))
        self._ring()

    @property
    def drove(self) -> bool:
        """True once this client has sent a command. From then on its death counts as the death of a driver."""
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
            + f"; close a client: `failstop status{instance.option(self.name)}` lists them"
        )

    def _ring(self) -> None:
        try:
            bell.send(self._bell, bytes([self.slot]))
        except BrokenPipeError:
            raise gone(self.name) from None

    def write(self, record: str, *values: Any, t_ns: int | None = None, wake: bool = False) -> bytes:
        """Write a record of records.OF_SESSION, and return its bytes. `t_ns`: when the values were true
        (CLOCK_MONOTONIC), by default now. The gate reads the record at its next tick, or with `wake` at once. Raises
        NoService, ValueError."""
        payload = records.OF_SESSION[record].pack(self._session, *values)
        self._records[record].write(payload, t_ns)
        if wake:
            self._ring()
        return payload

    def command(
        self,
        vx_mps: float,
        vy_mps: float,
        wz_radps: float,
        *,
        manual: bool,
        source: str,
        t_ns: int | None = None,
        flags: int = 0,
    ) -> None:
        """Send a velocity command to the gate, and return at once. `t_ns`: when the command was made (CLOCK_MONOTONIC),
        by default now. `flags`: further flags of records.COMMAND. The command does not wake the gate if it repeats a
        command that was sent less than REPEAT_NS earlier. Raises NoService, and ValueError for a source whose name is
        too long."""
        flags |= records.BY_HAND if manual else 0
        command = self.write("command", vx_mps, vy_mps, wz_radps, flags, source, t_ns=t_ns)
        before, self._commanded = self._commanded, (command, monotonic_ns())
        if before[0] != command or self._commanded[1] - before[1] > REPEAT_NS:
            self._ring()

    def ask(self, verb: int, asked_ns: int | None = None) -> int:
        """Send a request, and return its number. `asked_ns`: when the request was made (CLOCK_MONOTONIC), by default
        now. Raises NoService."""
        self._number += 1
        self.write("request", self._number, verb, t_ns=asked_ns, wake=True)
        return self._number

    def answer(self, asked: int) -> Reply | None:
        """Return the answer to the request with this number, or None if it has not come yet. Once this call has
        returned the answer, the service's state shows what the request has changed. The service keeps only its newest
        answer to this client. So if the service has already answered a later request, this call returns a refusal."""
        if (entry := self._reply.read()) is not None:
            session, number, reply = unpack_reply(entry[2])
            if session == self._session and number >= asked:
                Barrier()()
                return reply if number == asked else Reply(records.REFUSED, GIVEN_UP)
        return None

    def close(self, *, in_order: bool = True) -> None:
        """Give the slot back, so that the last command of this client no longer counts. `in_order`: True if the client
        ends normally and says goodbye to the gate; False if the gate must treat its end as a crash."""
        if in_order:
            with contextlib.suppress(OSError):  # the program has closed this descriptor
                lies = self._segment.latest_reader("left").read()
                self._farewell.append(records.goodbye(self._session, lies[2] if lies else b""))
        if kept := self._drop.detach():  # calling it would do nothing at the end of Python
            kept[1]()


def _files(*fds: int) -> list[owned.Inode | None]:
    """The file behind each descriptor."""
    return [owned.inode_of(fd) for fd in fds]


def _give_back(
    slot: int,
    held: segment.Segment,
    ring: int,
    life: HeldByThread | None,
    farewell: list[bytes],
    owner: int,
    files: list[owned.Inode | None],
) -> None:
    """Give a slot back, so that its last command no longer counts. Nothing is written in a forked child, because the
    slot still belongs to the parent process `owner`. Nothing is written either if the program has closed the slot's
    descriptors, because their numbers may now belong to other files. `files`: what _files() returned for these
    descriptors."""
    if os.getpid() == owner:
        if _files(held.fileno(), ring) == files:
            # Write the goodbye, because another process may take the slot before the gate has seen it free.
            with contextlib.suppress(OSError, ValueError):
                for goodbye in farewell:
                    held.latest_writer("left").write(goodbye)
                held.wipe()
                bell.send(ring, bytes([slot]))
        if life:
            life.let_go()
    held.close()
