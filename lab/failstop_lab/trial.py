"""Trials: a simulated board, a service of its own and a client that drives it, for the demo, the bench and the tests.

The board is the judge: every time is taken on its side of the wire, and whether the wheels stopped is its word.
"""

from __future__ import annotations

import contextlib
import json
import os
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Mapping
from types import TracebackType
from typing import TYPE_CHECKING

from failstop import helpers
from failstop.api.errors import FailstopError, Refused
from failstop.api.robot import Robot
from failstop.board.kinds import is_described, wire_of
from failstop.messages import layout
from failstop.setup import leftovers
from failstop.setup.ending import end_with_parent
from failstop_lab.boards.traits import traits_of
from failstop_lab.sim.client import SimBoard
from failstop_lab.stopped import Stopped as Stopped
from failstop_lab.stopped import judge as judge

if TYPE_CHECKING:
    from typing_extensions import Self

READY_S = 10.0
NOT_UP = "a process or the port is not up yet"
"""The gate refuses an enable in these words while one of the processes misses a beat."""
COMMAND_EVERY_S = 0.02
AFTERMATH_S = 0.25
"""How long the client goes on commanding after a fault, while nothing may move."""


class TrialError(FailstopError):
    """The trial could not be carried out; says what was waited for and what was seen."""


def wait_for(what: str, check: Callable[[], object], timeout_s: float = READY_S) -> None:
    """Poll until `check` is true. Raises TrialError after `timeout_s`."""
    until_s = time.monotonic() + timeout_s
    while not check():
        if time.monotonic() > until_s:
            raise TrialError(f"waited {timeout_s:g} s for {what}")
        time.sleep(0.002)


def write_settings(path: str, values: Mapping[str, object]) -> None:
    """A settings file of these values by whole key. Raises OSError."""
    with open(path, "w", encoding="utf-8") as file:
        for key, value in values.items():
            # A table that a file left empty can't be given twice: what is set in it makes it. JSON's values are TOML's.
            if value != {} or not any(other.startswith(f"{key}.") for other in values):
                file.write(f"{key} = {json.dumps(value)}\n")


def is_ours(pid: int) -> bool:
    """Whether the process is still one of a service's: its number may belong to another by now."""
    try:
        with open(f"/proc/{pid}/comm", encoding="utf-8") as file:
            return file.read().startswith("fs:")
    except OSError:
        return False


def state_in(path: str) -> str:
    """The state in a stat file of a process or thread, a letter of proc(5); X if it is gone."""
    try:
        with open(path, encoding="ascii", errors="replace") as file:
            return file.read().rpartition(") ")[2][:1]  # behind the name, which may contain any character
    except OSError:
        return "X"


def _lives(pid: int) -> bool:
    """Whether one of a service's is more than a number that nobody has collected yet."""
    return is_ours(pid) and state_in(f"/proc/{pid}/stat") not in ("Z", "X")


LOG_CHARACTERS = 2000
"""Characters of its log in an error."""


class Service:
    """A `failstop run` of its own; stderr is kept in a file, what it keeps itself (incidents, logs) in `state`."""

    def __init__(self, name: str, device: str, state: str, options: tuple[str, ...] = ()) -> None:
        self.name = name
        self._environment = {**os.environ, "STATE_DIRECTORY": state}
        self._log = tempfile.NamedTemporaryFile("w+", prefix=f"{name}-", suffix=".log")  # noqa: SIM115
        self._command = helpers.python("failstop", "run", "--name", name, "--device", device, *options)
        self.started_ns = 0
        self.ready_s = READY_S
        """How long its start may take."""
        self.process: subprocess.Popen[bytes] | None = None
        self.known: dict[str, int] = {}
        """The pid of each process, as it was looked up last: what is to be ended."""

    def become(self, *command: str) -> None:
        """Start it by this command from now on, which takes the service's own as its arguments."""
        self._command = [*command, *self._command]

    def start(self) -> None:
        """Exec the service and wait until motion could be enabled. Raises TrialError with what it said."""
        self.exec()
        try:
            wait_for(f"service {self.name} to be ready", self.ready, self.ready_s)
        except TrialError as error:
            if self.process is None or self.process.poll() is not None:
                raise
            raise TrialError(f"{error}; it said: {self.said()[-LOG_CHARACTERS:].strip()}") from None

    def exec(self) -> None:
        """Exec the service; `started_ns` is just before. When this process is killed, the service stops the wheels and
        ends."""
        if (prefix := self.name.removesuffix(str(os.getpid()))) != self.name:
            leftovers.remove_ended(prefix)  # of programs like this one that were killed with their services
        self.started_ns = time.monotonic_ns()
        self.process = subprocess.Popen(
            self._command,
            stdin=subprocess.DEVNULL,
            stderr=self._log,
            env=self._environment,
            preexec_fn=end_with_parent,
        )

    def ready(self) -> bool:
        """True when every process beats and the port is open. Raises TrialError when the service has ended."""
        if self.process is None or self.process.poll() is not None:
            raise TrialError(f"the service ended: {self.said()[-LOG_CHARACTERS:].strip()}")
        try:
            with Robot(self.name) as robot:
                state = robot.state
                return state.waiting_for is None and state.processes[layout.SUPERVISOR].pid == self.process.pid
        except FailstopError:
            return False

    def said(self, since: int = 0) -> str:
        """Its words on stderr so far, without the first `since` bytes."""
        with open(self._log.name, "rb") as file:
            file.seek(since)
            return file.read().decode("utf-8", "replace")

    def written(self) -> int:
        """How many bytes that is."""
        return os.stat(self._log.name).st_size

    def pids(self) -> dict[str, int]:
        """The pid of each process now. Raises TrialError, with the service's words, when it has ended."""
        try:
            with Robot(self.name) as robot:
                self.known = {name: process.pid for name, process in robot.state.processes.items()}
            return self.known
        except FailstopError:
            if self.process is None or self.process.poll() is None:
                raise
            code, said = self.process.returncode, self.said()[-LOG_CHARACTERS:].strip()
            raise TrialError(f"the service ended with {code}; it said: {said}") from None

    def gone(self) -> bool:
        """No process of the run that was looked up last is left."""
        ended = self.process is None or self.process.poll() is not None
        return ended and not any(map(_lives, self.known.values()))

    def signal_known(self, number: int) -> None:
        """Send a signal to each process that was looked up last and is there."""
        for pid in filter(is_ours, self.known.values()):
            with contextlib.suppress(ProcessLookupError):
                os.kill(pid, number)

    def kill_known(self) -> None:
        """SIGKILL what is left of the run that was looked up last, frozen or not."""
        self.signal_known(signal.SIGKILL)
        self.known = {}

    def kill_rest(self) -> None:
        """SIGKILL every process that the service has started, also one that the supervisor started just before its end:
        what systemd does to a control group."""
        word = f"name={self.name}".encode()
        for pid in filter(str.isdecimal, os.listdir("/proc")):
            with contextlib.suppress(OSError), open(f"/proc/{pid}/cmdline", "rb") as file:
                if word in file.read().split(b"\0"):
                    os.kill(int(pid), signal.SIGKILL)

    def kill(self) -> None:
        """SIGKILL the supervisor and collect it; the rest ends by itself."""
        if self.process:
            self.process.kill()
            self.process.wait()

    def end(self) -> int:
        """SIGTERM; returns the exit code."""
        if self.process is None:
            return 0
        with contextlib.suppress(ProcessLookupError):
            self.process.send_signal(signal.SIGTERM)
        try:
            return self.process.wait(5)
        except subprocess.TimeoutExpired:
            self.kill()
            raise TrialError(f"the service did not end within 5 s: {self.said()}") from None

    def close(self) -> None:
        """End it, whatever state it is in, and take away what it left: a name of its own is used once."""
        try:
            if self.process and self.process.poll() is None:
                self.end()
        finally:
            self._log.close()
            leftovers.remove(self.name)


class Trial:
    """A context manager: board, service and driving client under a name of their own."""

    def __init__(
        self,
        name: str | None = None,
        options: tuple[str, ...] = (),
        imu_hz: float = 110.0,
        kind: str = "",
        settings: Mapping[str, object] | None = None,
    ) -> None:
        """`kind`: the board's. The service gets it, and these `settings`, where its `options` name no file of them."""
        self.name = name or f"trial-{os.getpid()}"
        self._directory = tempfile.TemporaryDirectory(prefix="failstop-", ignore_cleanup_errors=True)
        self.link = os.path.join(self._directory.name, "board")
        self.state = os.path.join(self._directory.name, "state")
        """The state directory of the service: nothing of a trial goes to the machine's own."""
        self.board = SimBoard(self.link, imu_hz=imu_hz, board=kind)
        if (kind or settings) and "--config" not in options:
            path = os.path.join(self._directory.name, "settings.toml")
            write_settings(path, {**(traits_of(kind).settings if kind else {}), **(settings or {})})
            options = (*options, "--config", path)
        self.service = Service(self.name, self.link, self.state, options)
        if is_described(kind):
            self.service.ready_s += wire_of(kind).port.deaf_ns / 1e9
        self._robot: Robot | None = None
        self._drove = False
        self.fault_s = 0.0
        self._running_again_s: float | None = None

    def __enter__(self) -> Self:
        try:
            self.board.__enter__()
            self.service.start()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """End everything that was started, whichever part of it does not end as it should."""
        with contextlib.ExitStack() as rest:
            rest.callback(self._directory.cleanup)
            rest.callback(self.board.close)
            rest.callback(self.service.close)
            self.leave()

    @property
    def robot(self) -> Robot:
        """The driving client, connected to the run that is there now."""
        if self._robot is None:
            self._robot = Robot(self.name, client="trial", disable_on_exit=False)
        return self._robot

    def leave(self) -> None:
        """Disconnect the driving client."""
        if self._robot:
            self._robot.close()
            self._robot = None

    def enable(self) -> None:
        """Reset what is latched, as soon as its stop has been carried out, and enable motion, as soon as the service
        is ready: on a busy machine a process may miss a beat."""
        if self.robot.state.estop:
            wait_for("a reset to be taken", self.reset)
        if self._drove:  # else the enable would hold what this client commanded just now
            with contextlib.suppress(FailstopError):
                self.robot.drive(0.0, 0.0, 0.0)
            self._drove = False
        wait_for("every process to be up", self._enabled, self.service.ready_s)

    def _enabled(self) -> bool:
        try:
            self.robot.enable()
        except Refused as refusal:
            if NOT_UP not in str(refusal):
                raise
            return False
        return True

    def reset(self) -> bool:
        """True once a reset was taken: one that a stop has come before is refused."""
        with contextlib.suppress(Refused):
            self.robot.reset()
            return True
        return False

    def drive(
        self,
        seconds: float,
        velocity: tuple[float, float, float] = (0.2, 0.0, 0.0),
        each: Callable[[], None] = lambda: None,
    ) -> None:
        """Command a velocity every 20 ms, calling `each` every time; a service that is gone is commanded in vain."""
        self._drove = True
        until_s = time.monotonic() + seconds
        while (left_s := until_s - time.monotonic()) > 0:
            with contextlib.suppress(FailstopError):
                self.robot.sensed()
                self.robot.drive(*velocity)
                each()
            time.sleep(min(COMMAND_EVERY_S, left_s))

    def turning(self) -> bool:
        """The board's word on whether a wheel turns."""
        return any(self.board.wheels())

    def kill(self, process: str, drive_s: float = 0.15) -> Stopped:
        """SIGKILL one process while driving; the client goes on commanding for AFTERMATH_S."""
        pid = self.service.pids()[process]
        self.board.events()
        self.drive(drive_s)
        was_turning = self.turning()
        self.fault_s = time.monotonic()
        self._running_again_s = None
        fault_ns = time.monotonic_ns()
        os.kill(pid, signal.SIGKILL)
        self.drive(AFTERMATH_S, each=lambda: self._see_restart(process, pid))
        return judge(self.board.events(), fault_ns, was_turning)

    def _see_restart(self, process: str, pid: int) -> None:
        found = self.robot.state.processes[process]
        if self._running_again_s is None and found.pid != pid and found.state == "running":
            self._running_again_s = time.monotonic()

    def recover(self, process: str, pid: int) -> float:
        """Wait until the service is whole again after kill(), `pid` being the killed process's; returns the seconds
        from the kill until the process ran again. A dead supervisor is restarted here, as systemd would: then they
        count from that start."""
        if process == layout.SUPERVISOR:
            self.leave()
            self.service.kill()
            self.service.start()
            return time.monotonic() - self.service.started_ns / 1e9
        wait_for(f"{process} to be restarted", lambda: self.service.ready() and self.service.pids()[process] != pid)
        return (self._running_again_s or time.monotonic()) - self.fault_s
