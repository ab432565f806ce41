"""A program of the laboratory that is ended or killed leaves no service behind: it would go on for ever, with nobody to
end it."""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import sys
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop import Robot
from failstop.api.errors import FailstopError
from failstop_lab.trial import wait_for
from tests.support.commands import FAILSTOP

PROGRAMS = {
    "demo": (*FAILSTOP, "demo"),
    "chaos": (*FAILSTOP, "chaos", "--only", "kill-gate", "--seconds", "60"),
    "trial": (sys.executable, "-m", "bench", "--out", "OUT"),
}
"""By the first part of the name of its service; the second is its pid."""
END_S = 30.0


def processes(name: str) -> list[int]:
    """The pids of this service's processes."""
    found = []
    for pid in map(int, filter(str.isdigit, os.listdir("/proc"))):
        with contextlib.suppress(OSError):
            line = Path(f"/proc/{pid}/cmdline").read_text().replace("\0", " ")
            found += [pid] if f"name={name} " in line or f"--name {name} " in line else []
    return found


def left(name: str) -> list[str]:
    """What is left of this service: processes, and its memory."""
    memory = [file for file in os.listdir("/dev/shm") if file.startswith(f"failstop.{name}.")]
    return [*memory, *map(str, processes(name))]


def ready(name: str) -> bool:
    with contextlib.suppress(FailstopError), Robot(name) as robot:
        return robot.state.waiting_for is None
    return False


@pytest.fixture(params=list(PROGRAMS))
def program(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[tuple[subprocess.Popen[bytes], str]]:
    """One whose service is ready, and the name of that."""
    words = [str(tmp_path / "out.json") if word == "OUT" else word for word in PROGRAMS[request.param]]
    quiet = subprocess.DEVNULL
    # A session of its own, and a signal to it alone: a terminal's would reach the service by itself.
    with subprocess.Popen(words, stdin=quiet, stdout=quiet, stderr=quiet, start_new_session=True) as process:
        name = f"{request.param}-{process.pid}"
        try:
            wait_for(f"{name} to be ready", lambda: ready(name), END_S)
            yield process, name
        finally:
            process.kill()
            for pid in processes(name):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)


@pytest.mark.slow
@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGHUP])
def test_a_program_that_is_ended_ends_its_service_first(
    program: tuple[subprocess.Popen[bytes], str], number: int
) -> None:
    process, name = program
    process.send_signal(number)
    process.wait(END_S)
    assert left(name) == []


@pytest.mark.slow
def test_the_service_of_a_program_that_is_killed_ends_by_itself(
    program: tuple[subprocess.Popen[bytes], str],
) -> None:
    process, name = program
    process.kill()
    process.wait(END_S)
    wait_for(f"{name} to end", lambda: left(name) == [], END_S)
