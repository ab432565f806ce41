"""Child processes for tests: forked, watched with deadlines, killed and reaped by their pid."""

from __future__ import annotations

import contextlib
import faulthandler
import os
import pickle
import resource
import select
import signal
import traceback
from collections.abc import Callable, Iterator, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any

import pytest

DEADLINE_S = 20.0
NOBODY = 65534

needs_root = pytest.mark.skipif(os.getuid() != 0, reason="needs root, to become another user")


def become(uid: int, groups: Sequence[int] = ()) -> None:
    os.setgroups(groups)
    os.setresgid(uid, uid, uid)
    os.setresuid(uid, uid, uid)


class Child:
    """A forked process that runs `work(send, wait)`: `send` gives a value to the parent, `wait` waits for `go()`."""

    def __init__(self, work: Callable[[Callable[[object], None], Callable[[], None]], object], uid: int = -1) -> None:
        out_r, out_w = os.pipe()
        in_r, in_w = os.pipe()
        self.pid = os.fork()
        if self.pid == 0:
            code = 99
            try:
                faulthandler.disable()
                resource.setrlimit(resource.RLIMIT_CORE, (0, 0))
                os.close(out_r)
                os.close(in_w)
                if uid >= 0:
                    become(uid)
                code = self._run(work, out_w, in_r)
            finally:
                os._exit(code)
        os.close(out_w)
        os.close(in_r)
        self._in = in_w
        self._out = out_r
        self.status: int | None = None

    @staticmethod
    def _run(work: Callable[..., object], out: int, into: int) -> int:
        def send(value: object) -> None:
            data = pickle.dumps(value)
            os.write(out, len(data).to_bytes(4, "little") + data)

        def wait() -> None:
            if not os.read(into, 1):
                os._exit(98)

        try:
            send(("value", work(send, wait)))
        except BaseException:  # whatever it is, the parent's test shows it
            send(("error", traceback.format_exc()))
            return 1
        return 0

    def receive(self) -> Any:
        """The next value the child sent (a ("value", x) or ("error", text) pair when its work is over)."""
        return pickle.loads(self._exactly(int.from_bytes(self._exactly(4), "little")))

    def _exactly(self, count: int) -> bytes:
        data = b""
        while len(data) < count:
            if not select.select([self._out], [], [], DEADLINE_S)[0]:
                pytest.fail(f"child {self.pid} said nothing within {DEADLINE_S} s")
            part = os.read(self._out, count - len(data))
            if not part:
                pytest.fail(f"child {self.pid} ended early: status {self.wait()}")
            data += part
        return data

    def result(self) -> Any:
        """The result of `work`; fails with the traceback when it raised."""
        kind, value = self.receive()
        self.wait()
        if kind == "error":
            pytest.fail(f"in the child: {value}")
        return value

    def go(self) -> None:
        """Let the child's `wait` return."""
        os.write(self._in, b"g")

    def kill(self) -> None:
        if self.status is None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)
            self.wait()

    def wait(self) -> int:
        """Reap; returns the exit code, negative for a signal."""
        if self.status is None:
            fd = os.pidfd_open(self.pid)
            try:
                if not select.select([fd], [], [], DEADLINE_S)[0]:
                    os.kill(self.pid, signal.SIGKILL)
            finally:
                os.close(fd)
            self.status = os.waitstatus_to_exitcode(os.waitpid(self.pid, 0)[1])
        return self.status

    def close(self) -> None:
        self.kill()
        os.close(self._in)
        os.close(self._out)

    def __enter__(self) -> Child:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()


def call(work: Callable[[], object], uid: int = -1) -> Any:
    """Run `work` in a child, as another user if one is given; returns what it returned."""
    with Child(lambda send, wait: work(), uid) as child:
        return child.result()


def reachable(path: Path) -> None:
    for folder in (path, *path.parents):
        if folder.stat().st_mode & 0o005 != 0o005:
            folder.chmod(0o755)


@contextlib.contextmanager
def scheduled(policy: int, priority: int = 0) -> Iterator[None]:
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    os.sched_setscheduler(0, policy, os.sched_param(priority))
    try:
        yield
    finally:
        os.sched_setscheduler(0, *before)
