"""Scene of the trials in the guest: the board on the guest's vhci_hcd, the client, commands."""

from __future__ import annotations

import contextlib
import os
import subprocess
import threading
import time
from collections.abc import Callable
from pathlib import Path

from failstop.api.errors import FailstopError
from failstop_lab.faults.driving import Driver
from failstop_lab.sim.client import Event, SimBoard
from failstop_lab.trial import TrialError, judge, wait_for
from tests.vm.table import Result

FAILSTOP = "/usr/bin/failstop"
UNIT = "failstop.service"
LINK = "/dev/failstop"
SETTINGS = "/etc/failstop/failstop.toml"
WHOLE_S = 60.0
HAND_S = 1.0
"""From a command to the plug, at a person's fastest."""
IMU_HZ = 50.0
"""Less than the board's 110: the guest's one processor serves board, client and service."""
AFTERMATH_S = 0.6
COMMAND_EVERY_S = 0.05
INTERRUPTS = 70
"""vhci_hcd completes transfers in threads of the kernel; a controller's interrupts come before every process."""


class Scene:
    """The board, the client, and what can be asked of the guest."""

    def __init__(self) -> None:
        self.board = SimBoard("/run/vm-board", usb="vhci", imu_hz=IMU_HZ)
        self.driver = Driver("failstop", client="vm", interlocks=())
        self.floor_ms: list[float] = []

    def run(self, seconds: float) -> None:
        """Command for a while, as often as a robot's planner does: the guest's one processor is slow."""
        until_s = time.monotonic() + seconds
        while (left_s := until_s - time.monotonic()) > 0:
            self.driver.step()
            time.sleep(min(COMMAND_EVERY_S, left_s))

    def until(self, what: str, check: Callable[[], bool], timeout_s: float = 10.0) -> None:
        """Command until `check` is true; an error of the service counts as not yet. Raises TrialError."""
        until_s = time.monotonic() + timeout_s
        while True:
            with contextlib.suppress(FailstopError):
                if check():
                    return
            if time.monotonic() > until_s:
                raise TrialError(f"waited {timeout_s:g} s for {what}")
            self.run(COMMAND_EVERY_S)

    def whole(self) -> None:
        """Wait until the service runs and waits for nothing."""
        self.until("the service to be whole", self._whole, WHOLE_S)

    def _whole(self) -> bool:
        state = self.driver.robot.state
        return state.waiting_for is None and all(process.state == "running" for process in state.processes.values())

    def moving(self) -> None:
        """Have the wheels turn, and forget the events until then."""
        self.whole()
        self.driver.enable()
        self.until("the wheels to turn", lambda: any(self.board.wheels()))
        self.run(0.1)
        self.board.events()

    def pid(self, name: str) -> int:
        """Of a process of the service."""
        return self.driver.robot.state.processes[name].pid

    def node(self) -> str:
        """The board's tty, waited for."""
        wait_for("the board's node", lambda: bool(self.board.info()["node"]), 20.0)
        hurry_transfers()
        return str(self.board.info()["node"])

    def judged(self, name: str, since_ns: int, wait_s: float = 10.0) -> Result:
        """Wait for the first stop after that time, command on for a moment, and judge."""
        found: list[Event] = []

        def stopped() -> bool:
            found.extend(self.board.events())
            return any(event.is_stop and event.arrival_ns >= since_ns for event in found)

        with contextlib.suppress(TrialError):
            self.until("a stop", stopped, wait_s)
        self.run(AFTERMATH_S)
        found.extend(self.board.events())
        seen = judge(found, since_ns, was_turning=True)
        result = Result(name, missed=int(seen.stop_ns is None), after=seen.motion_after)
        if seen.stop_ns is not None:
            result.ms = seen.stop_ns / 1e6
        if any(self.board.wheels()):
            result.wrong.append("the wheels turn at the end")
        return result


def hurry_transfers() -> None:
    """Give the threads that stand for a controller's interrupts the right to come first."""
    for path in Path("/proc").glob("[0-9]*/comm"):
        with contextlib.suppress(OSError):
            if path.read_text().startswith(("vhci_rx", "vhci_tx")):
                os.sched_setscheduler(int(path.parent.name), os.SCHED_FIFO, os.sched_param(INTERRUPTS))


def sh(*words: str, timeout_s: float = 60.0) -> tuple[int, str, float]:
    """Run a command; returns its exit code, what it said and how long it took."""
    start_s = time.monotonic()
    done = subprocess.run(
        words, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True,
        timeout=timeout_s, check=False,
    )  # fmt: skip
    return done.returncode, done.stdout.strip(), time.monotonic() - start_s


def beside(scene: Scene, *words: str, timeout_s: float = 60.0) -> tuple[int, str, float]:
    """Wait while the client goes on commanding."""
    answer: list[tuple[int, str, float]] = []
    thread = threading.Thread(target=lambda: answer.append(sh(*words, timeout_s=timeout_s)))
    thread.start()
    while thread.is_alive():
        scene.run(COMMAND_EVERY_S)
    return answer[0] if answer else (-1, f"not done within {timeout_s:g} s", timeout_s)


def shown(*properties: str) -> dict[str, str]:
    """Properties of the unit."""
    _, text, _ = sh("systemctl", "show", UNIT, *(f"--property={name}" for name in properties))
    return dict(line.split("=", 1) for line in text.splitlines())


def wrong_unless(found: Result, **checks: bool) -> None:
    """Note each check that is false, by its name."""
    found.wrong += [name.replace("_", " ") for name, good in checks.items() if not good]
