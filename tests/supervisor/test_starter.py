"""How processes are started: what they get, and what a terminal must not be able to do to all of them at once."""

from __future__ import annotations

import atexit
import contextlib
import os
import signal
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

import failstop
from failstop.policy.settings import Settings
from failstop.supervisor import starter
from failstop.supervisor.bootstrap import fail
from failstop_lab.machine.process import Replaced
from tests.support.children import Child
from tests.support.supervisor_scene import Scene

SHOW = "import os, time; os.write(int(os.environ['OUT']), b'x'); time.sleep(120)"


def is_inheritable(fd: int) -> bool:
    """Of this process: the test's own runner may have been started with such."""
    try:
        return os.get_inheritable(fd)
    except OSError:
        return False


@pytest.fixture
def child(pipe: tuple[int, int]) -> Iterator[int]:
    """A process started as by the supervisor, which blocks SIGCONT; its program only waits."""
    environ = {**starter.environment(Settings()), "OUT": str(pipe[1])}
    before = signal.pthread_sigmask(signal.SIG_BLOCK, [signal.SIGCONT])
    pid = starter.spawn([sys.executable, "-I", "-S", "-c", SHOW], environ, [pipe[1]])
    signal.pthread_sigmask(signal.SIG_SETMASK, before)
    yield pid
    os.kill(pid, 9)
    os.waitpid(pid, 0)


def test_each_process_has_a_session_of_its_own(child: int) -> None:
    """A terminal's signals, its hang-up above all, go to a whole process group: were they all in it, they would all die
    at once, with nobody left to stop the wheels."""
    assert os.getsid(child) == child
    assert os.getpgid(child) == child


def test_a_process_begins_with_no_signal_blocked(child: int) -> None:
    assert "\nSigBlk:\t0000000000000000\n" in Path(f"/proc/{child}/status").read_text()


def test_the_descriptors_it_is_given_are_its_own_and_no_other(child: int, pipe: tuple[int, int]) -> None:
    assert os.read(pipe[0], 1) == b"x", "written by the child to the descriptor it was given"
    assert not os.get_inheritable(pipe[1]), "the next process is not given it by accident"
    inherited = {fd for fd in map(int, os.listdir("/proc/self/fd")) if is_inheritable(fd)}
    assert {int(fd) for fd in os.listdir(f"/proc/{child}/fd")} <= {*inherited, pipe[1]}


def test_the_environment_is_what_it_needs_and_no_more() -> None:
    found = starter.environment(Settings())
    assert set(found) <= {"FAILSTOP_PATH", "FAILSTOP_SETTINGS", *starter.C_LIBRARY, *starter.PASSED_ON}
    assert Settings.from_lines(found["FAILSTOP_SETTINGS"]).values == Settings().values


def test_the_command_line_becomes_the_supervisor_with_its_lock_and_port(scene: Scene) -> None:
    scene.me.environ |= {"NOTIFY_SOCKET": "/run/notify", "SHELL": "/bin/sh"}
    here, lock, port = scene.load("failstop.supervisor.starter"), scene.os.dup(0), scene.port.fd
    expected = here.environment(scene.settings)
    replaced, programs = scene.os.execve, []
    scene.os.execve = lambda path, *rest: programs.append(path) or replaced(path, *rest)
    with pytest.raises(Replaced) as found:
        here.become_supervisor("left", "/run/x", scene.settings, lock, port, "failstop run --name left")
    arguments = found.value.argv
    assert [arguments[0]] == programs == [scene.system["sys"].executable]
    words = ["name=left", "dir=/run/x", f"lock={lock}", f"port={port}", "again=failstop run --name left"]
    assert arguments[4:] == ["supervisor", *words]
    assert scene.me.environ == {**expected, "NOTIFY_SOCKET": "/run/notify"}
    assert scene.fds() == {0, 1, 2, lock, port}


def test_the_search_path_is_the_package_s_and_what_means_the_same_everywhere(scene: Scene) -> None:
    own = os.path.dirname(os.path.dirname(failstop.__file__))
    scene.me.sys_path = ["", "here", "/abs", own, "/abs"]
    assert scene.load("failstop.supervisor.starter").environment(scene.settings)["FAILSTOP_PATH"] == f"{own}:/abs"


# How a process ends that does not know what to do.


def broken() -> None:
    """Fails as a defect would."""
    raise ValueError("seven\u2026 " + "x" * 10_000 if os.environ.get("LONG") else "seven\u2026")


def failing(stderr: int) -> int:
    """The exit code of a process that fails."""

    def work(*_: object) -> None:
        os.dup2(stderr, 2)
        atexit.register(os.write, 2, b"taken down")
        try:
            broken()
        except ValueError as error:
            fail(error)

    with Child(work) as child:
        return child.wait()


def test_it_says_what_went_wrong_and_is_gone(pipe: tuple[int, int]) -> None:
    """Without what an interpreter does at its end."""
    assert failing(pipe[1]) == 1
    first, *frames, last = os.read(pipe[0], 65536).decode().splitlines()
    assert (first, last) == ("Traceback (most recent call last):", "ValueError: seven\u2026")
    assert len(frames) == 2
    assert frames[1].endswith(", in broken")
    assert f'File "{__file__}", line ' in frames[1]


def test_what_is_long_is_cut(pipe: tuple[int, int], monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("LONG", "1")
    assert failing(pipe[1]) == 1
    assert len(os.read(pipe[0], 65536)) == 4096


def test_nobody_who_reads_it_holds_it_up(pipe: tuple[int, int]) -> None:
    os.set_blocking(pipe[1], False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(pipe[1], bytes(1))
    os.set_blocking(pipe[1], True)
    assert failing(pipe[1]) == 1


def test_nor_does_a_stderr_that_nobody_has_open() -> None:
    read, write = os.pipe()
    os.close(read)
    assert failing(write) == 1
    os.close(write)
