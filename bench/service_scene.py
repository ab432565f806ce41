"""A scene: the systemd unit on a real systemd, a simulated board out here, and a client that drives in there.

The board is the judge, as in failstop_lab.trial; it, the kills and all times are outside the container.
"""

from __future__ import annotations

import contextlib
import os
import signal
import subprocess
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from types import TracebackType

from bench import installed
from bench.container import Bind, Container
from failstop.messages import layout
from failstop_lab.sim.client import SimBoard
from failstop_lab.trial import Stopped, TrialError, judge, wait_for

UNIT = "failstop.service"
CONFIG = "/etc/failstop/failstop.toml"
BOARD = "/board/port"
DRIVER = "driver"
STRANGER = "stranger"
"""A user who is in no group of failstop's."""
SETUP = f"""
printf 'u {DRIVER} -\\nm {DRIVER} failstop\\nu {STRANGER} -\\n' > /etc/sysusers.d/{DRIVER}.conf
systemd-sysusers
mkdir -p /etc/failstop
printf '[device]\\npath = "{BOARD}"\\n' > {CONFIG}
"""
DROP_IN = "failstop.service.d/container.conf"
RIGHTS = """
[Service]
# The limits of whoever made the container may be lower than those that the unit asks for: these rights have none.
AmbientCapabilities=CAP_SYS_NICE CAP_IPC_LOCK
CapabilityBoundingSet=CAP_SYS_NICE CAP_IPC_LOCK
"""
HARDY = RIGHTS + "[Unit]\nStartLimitIntervalSec=0\n"
"""With this, so many deaths are no crash loop."""
AFTERMATH_S = 0.25
"""How long the client goes on commanding after a fault, while nothing may move."""
AFTER_STOP_S = 0.1
"""Longer than the stop took, the client goes on too, however late that was."""
NEVER_S = 30.0
"""A stop that has not come by then never comes: a starved machine has systemd run the stop tool late."""


READY = {"ActiveState": "active", "SubState": "running"}
READY_S = 30.0


class Scene:
    """A context manager. `drop_in` is added to the unit. Raises bench.container.ContainerMissing."""

    def __init__(self, drop_in: str = RIGHTS, units: Mapping[str, str] | None = None, setup: str = "") -> None:
        self._stack = contextlib.ExitStack()
        try:
            # Under its own name in there, so readable for everybody.
            directory = Path(self._stack.enter_context(tempfile.TemporaryDirectory(prefix="failstop-scene-")))
            directory.chmod(0o755)
            for name in ("board", "installed"):
                (directory / name).mkdir()
            self.board = self._stack.enter_context(SimBoard(directory / "board" / "port", mode=0o666))
            binds = [*installed.lay_out(directory / "installed"), Bind(str(directory / "board"), "/board")]
            units = {**installed.units(), DROP_IN: drop_in, **(units or {})}
            self.box = self._stack.enter_context(Container(units, binds, SETUP + setup))
            self._driver: subprocess.Popen[str] | None = None
            self._began_s = 0.0
        except BaseException:
            self._stack.close()
            raise

    def __enter__(self) -> Scene:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    def close(self) -> None:
        """End everything."""
        try:
            self.leave()
        finally:
            self._stack.close()

    def failstop(self, *words: str, user: str = DRIVER, check: bool = True) -> subprocess.CompletedProcess[str]:
        """Run the command line inside, as this user."""
        return self.box.run(*_as(user), f"{installed.PREFIX}/bin/failstop", *words, check=check)

    def begin(self) -> None:
        """From now on log_text() has the journal."""
        self._began_s = time.time()

    def start(self, *options: str) -> None:
        """Have the service started; systemctl returns when it is ready."""
        self.begin()
        self.box.ctl("start", *options, UNIT)

    def end(self) -> None:
        """Have the service stopped, and what was said of earlier ends forgotten."""
        self.leave()
        self.box.ctl("stop", UNIT)
        self.box.ctl("reset-failed", UNIT, check=False)

    def ready(self) -> bool:
        """True while systemd says that the service runs and is ready."""
        return self.box.show(UNIT, *READY) == READY

    def whole(self) -> bool:
        """True while it is ready, and each of its processes is there."""
        return set(layout.PROCESS_NAMES) <= set(self.pids()) and self.ready()

    def wait_ready(self, timeout_s: float = READY_S) -> None:
        """Wait until systemd says so. Raises TrialError."""
        self.box.wait(UNIT, timeout_s, **READY)

    def restarts(self) -> int:
        """How often systemd has restarted it by itself."""
        return int(self.box.show(UNIT, "NRestarts")["NRestarts"])

    def log_text(self, unit: str = UNIT) -> str:
        """The journal of the service, or of another unit, since start() or begin()."""
        return self.box.log_text(unit, self._began_s)

    # The client that drives.

    def drive(self) -> None:
        """Have motion enabled, and wait until the wheels turn."""
        if self._driver is None:
            words = (f"{installed.PREFIX}/bin/python3", f"{installed.PREFIX}/src/bench/service_driver.py", "failstop")
            self._driver = subprocess.Popen(
                self.box.entering(*_as(DRIVER), *words), stdin=subprocess.PIPE, stdout=subprocess.PIPE, text=True
            )
        assert self._driver.stdin is not None
        assert self._driver.stdout is not None
        self._driver.stdin.write("enable\n")
        self._driver.stdin.flush()
        if (answer := self._driver.stdout.readline().strip()) != "done":
            raise TrialError(f"cannot enable: {answer or 'the client has ended'}\n{self.log_text()}")
        self.board.wait_wheels(True, 5.0)

    def leave(self) -> None:
        """End the client."""
        driver, self._driver = self._driver, None
        if driver is not None:
            with driver:
                assert driver.stdin is not None
                driver.stdin.close()
                try:
                    driver.wait(5)
                except subprocess.TimeoutExpired:
                    driver.kill()

    # Faults.

    def fault(self, what: Callable[[], object], drive_s: float = 0.1, aftermath_s: float = AFTERMATH_S) -> Stopped:
        """Do something to the service while the wheels turn; returns what the board saw of it until `aftermath_s`
        later, and at least until its stop, if one comes at all, and a little longer."""
        self.drive()
        time.sleep(drive_s)
        was_turning = any(self.board.wheels())
        self.board.events()
        fault_ns = time.monotonic_ns()
        what()
        with contextlib.suppress(TimeoutError):
            self.board.wait_for(lambda event: event.is_stop and event.arrival_ns >= fault_ns, NEVER_S)
        time.sleep(max(AFTER_STOP_S, aftermath_s - (time.monotonic_ns() - fault_ns) / 1e9))
        return judge(self.board.events(), fault_ns, was_turning)

    def kill(self, process: str) -> Callable[[], None]:
        """The SIGKILL of one process of the service, to be done later."""
        return self.signal(signal.SIGKILL, self.pid(process))

    @staticmethod
    def signal(number: int, pid: int) -> Callable[[], None]:
        """A signal to a process, to be sent later."""
        return lambda: os.kill(pid, number)

    def kill_all(self) -> None:
        """SIGKILL of the whole control group at once, by the kernel where it can do that."""
        group = self.box.group(UNIT)
        try:
            (group / "cgroup.kill").write_text("1")
        except FileNotFoundError:
            for pid in self.box.pids(UNIT):
                with contextlib.suppress(ProcessLookupError):
                    os.kill(pid, signal.SIGKILL)

    def pid(self, process: str) -> int:
        """The pid, out here, of a process of the service. Raises TrialError."""
        found = self.pids()
        if process not in found:
            raise TrialError(f"no {process} among {sorted(found)}")
        return found[process]

    def pids(self) -> dict[str, int]:
        """Every process of the service by its name, without the prefix fs: that ps shows."""
        found = {}
        for pid in self.box.pids(UNIT):
            with contextlib.suppress(OSError), open(f"/proc/{pid}/comm", encoding="utf-8") as file:
                found[file.read().strip().removeprefix("fs:")] = pid
        return found

    def recover(self, restarts: int) -> None:
        """Wait until systemd has started the service for the `restarts`th time, and it is ready."""
        wait_for(f"restart {restarts}", lambda: self.restarts() >= restarts and self.ready(), 15.0)


def _as(user: str) -> tuple[str, ...]:
    """The program that makes a command another user's."""
    return ("setpriv", f"--reuid={user}", f"--regid={user}", "--init-groups", "--")
