"""Guarded: the same failures of the same throw-away driver, through the guard port of a service that runs for so long.

The service stops the wheels when the probe dies, so no watcher is needed. The board's own reports judge, as its bytes
came.
"""

from __future__ import annotations

import contextlib
import os
import select
import subprocess
import tempfile
import time
from collections.abc import Callable

from failstop import helpers
from failstop.api.errors import FailstopError
from failstop.api.robot import Robot
from failstop.board.interface import Board
from failstop.policy.halted import Halted
from failstop.setup.ending import end_with_parent, uninterrupted
from failstop.setup.halt import Halt
from failstop_lab.probe import judge
from failstop_lab.probe.card import Row
from failstop_lab.probe.serial import PERIOD_S, ROWS, SIGNALS, TURN_S, TURNS_S
from failstop_lab.prove.watch import Watch
from failstop_lab.trial import Service, wait_for, write_settings

HELD_BY_SERVICE = "the service stays at the port"
STARTS_S = 10.0


class GuardProbe:
    """A context manager: a service and its guard port, from its beginning to its end."""

    def __init__(
        self,
        port: str,
        kind: str,
        baud: int,
        board: Board,
        frame: bytes,
        shaking: judge.Shaking | None,
        say: Callable[[str], None],
    ) -> None:
        """`shaking`: how the IMU of a board that reports no wheels judges; None: the wheels' reports do. `say`: prints
        a line for people."""
        self._port, self._kind, self._baud, self._board, self._frame = port, kind, baud, board, frame
        self._shaking = shaking
        self._halt = Halt(port, board, say)
        self._rest = contextlib.ExitStack()
        self._watch = Watch(port, board)

    def __enter__(self) -> GuardProbe:
        try:
            self._start()
        except BaseException:
            self._rest.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        """End the service, which stops the wheels, and ask the board whether they are stopped."""
        with uninterrupted():
            try:
                self._rest.close()
            finally:
                self._halt.now()

    @property
    def outcome(self) -> Halted | None:
        """What is known of the wheels at the end."""
        return self._halt.last

    def _start(self) -> None:
        folder = self._rest.enter_context(tempfile.TemporaryDirectory(prefix="failstop-probe-"))
        settings, self._path = os.path.join(folder, "settings.toml"), os.path.join(folder, "port")
        write_settings(
            settings,
            {"board.kind": self._kind, "board.baud": self._baud, "scan.gate": "off", "incidents.save": "off"},
        )
        name = f"probe-{os.getpid()}"
        service = Service(name, self._port, folder, ("--config", settings))
        self._rest.callback(service.close)
        service.ready_s += self._board.port.deaf_ns / 1e9
        service.start()
        guard = subprocess.Popen(
            helpers.python("failstop", "guard", "--name", name, "--path", self._path),
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            preexec_fn=end_with_parent,
        )
        self._rest.callback(_end, guard)
        wait_for("the guard port", lambda: os.path.exists(self._path), STARTS_S)
        self._robot = self._rest.enter_context(Robot(name, client="probe"))
        self._watch.attach(name)

    def run_row(self, name: str) -> Row:
        """Make one row; the wheels are stopped at its end. Raises FailstopError, OSError."""
        if name == "plug":
            return Row(name, ROWS[name], skipped=HELD_BY_SERVICE)
        self._robot.enable()
        words = [self._path, "115200", "0", "0", self._frame.hex(), str(PERIOD_S)]
        driver = subprocess.Popen(
            helpers.python("failstop_lab.probe.driver", *words),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            text=True,
            preexec_fn=end_with_parent,
        )
        try:
            return self._of(name, driver)
        finally:
            driver.kill()
            driver.communicate()
            with contextlib.suppress(FailstopError):  # a Ctrl-C in the terminal ends the service too
                self._robot.disable()
                self._until(judge.RESTS_S)

    def _of(self, name: str, driver: subprocess.Popen[str]) -> Row:
        assert driver.stdin
        driver.stdin.write("drive\n")
        driver.stdin.flush()
        assert driver.stdout
        if not select.select([driver.stdout], [], [], STARTS_S)[0]:
            raise FailstopError(f"the driver did not start within {STARTS_S:g} s")
        self._watch.forget()
        if not self._until(STARTS_S, self._turns):
            raise FailstopError(f"no wheel turned through the guard port: {self._robot.state.blocked}")
        self._watch.forget()
        self._until(TURNS_S)
        if judge.rested(self._watch.samples, self._rest_ns()):
            return Row(name, ROWS[name], unjudged=judge.NOT_TURNING)
        self._watch.forget()
        cause_ns = time.monotonic_ns()
        os.kill(driver.pid, SIGNALS[name])
        samples = self._watch.samples
        stands = self._until(judge.NEVER_S + judge.RESTS_S, lambda: judge.believed(samples, self._rest_ns()))
        by = judge.OWN_WORD if self._shaking is None else judge.GYRO
        rest = self._rest_ns()
        if not stands or rest is None:
            unseen = judge.silent(self._watch.samples, time.monotonic_ns())
            return Row(name, ROWS[name], None, by, unjudged=judge.NO_REPORTS.format("the board") if unseen else "")
        seconds, within_s = judge.dated(self._watch.samples, cause_ns, rest)
        return Row(name, ROWS[name], seconds, by, within_s=within_s, cause_ns=cause_ns)

    def _turns(self) -> bool:
        samples, rest = self._watch.samples, self._rest_ns()
        return len(samples) > 1 and (rest is None or rest == samples[-1][0])

    def _rest_ns(self) -> int | None:
        return self._shaking.rest_ns(self._watch.samples) if self._shaking else judge.rest_ns(self._watch.samples)

    def _until(self, seconds: float, found: Callable[[], bool] = lambda: False) -> bool:
        until_s = time.monotonic() + seconds
        while time.monotonic() < until_s:
            self._watch.look(time.monotonic_ns())
            if found():
                return True
            time.sleep(TURN_S)
        return False


def _end(process: subprocess.Popen[bytes]) -> None:
    process.terminate()
    try:
        process.wait(STARTS_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
