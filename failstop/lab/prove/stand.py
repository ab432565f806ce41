"""The stand: a run of the service of its own on the board, the driving client, and the way back to wheels at rest."""

from __future__ import annotations

import contextlib
import os
import subprocess
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from failstop import config, stopping
from failstop.api.errors import FailstopError
from failstop.board.kinds import board_of
from failstop.board.port import PortError
from failstop.lab.faults.driving import Driver
from failstop.lab.prove.held import Held
from failstop.lab.prove.means import Means, means_of
from failstop.lab.prove.table import TURNINGS
from failstop.lab.prove.watch import Watch
from failstop.lab.sim.client import SimBoard
from failstop.lab.stand import Stand
from failstop.lab.trial import COMMAND_EVERY_S, Service, write_settings
from failstop.policy.kinematics import max_wheel_rps
from failstop.policy.settings import Settings
from failstop.setup.ending import end_with_parent, uninterrupted

if TYPE_CHECKING:
    from failstop.lab.prove.swing import Swing

OF_SPEEDS = ("limits.vx_mps", "limits.vy_mps", "limits.wz_radps")
LOOK_EVERY_S = 0.001
FREE_S = 5.0
"""The port is to be had again within this time after the service's end."""
SIM_FREE_S = 0.5
"""A simulated board may have ended with the same Ctrl-C."""
OVERRIDES: dict[str, object] = {
    "restart.deaths": 100_000,
    "restart.window_s": 1.0,
    "restart.backoff_s": 0.001,
    "battery.log": "off",
    "battery.directory": "",
    "scan.gate": "on",
}
"""Over the user's settings: so many deaths are no crash loop here, no restart waits for the deaths of earlier runs, and
the scan gate is one of the stop paths."""


class StandService(Service):
    """When the stand test is killed, it ends in order."""

    def exec(self) -> None:
        """As Service.exec, bound to this process."""
        self.started_ns = time.monotonic_ns()
        self.process = subprocess.Popen(
            self._command,
            stdin=subprocess.DEVNULL,
            stderr=self._log,
            env=self._environment,
            preexec_fn=end_with_parent,
        )


def settings_for(user: dict[str, object]) -> dict[str, object]:
    """The user's settings, with limits that let the velocities of the table pass. Raises SettingError."""
    fastest = [max(abs(velocity.command[axis]) for velocity in TURNINGS) for axis in (0, 2)]
    have = Settings({**user})
    limits = {key: have[key] for key in OF_SPEEDS}
    for key, needed in zip((OF_SPEEDS[0], OF_SPEEDS[-1]), fastest, strict=True):
        limits[key] = max(have[key], needed)
    kept = {key: value for key, value in user.items() if key != "device.path"}
    fastest_rps, most_rps = max_wheel_rps(Settings({**kept, **limits})), board_of(*have.board()).most_rps
    if fastest_rps > most_rps:
        # A base that is slower than the table goes as fast as its wheels can in every direction at once.
        limits = {key: value * 0.999 * most_rps / fastest_rps for key, value in limits.items()}
    return {**kept, **OVERRIDES, **limits}


class ProveStand(Stand):
    """A context manager. Whatever happens, the wheels are stopped at its end."""

    def __init__(self, device: str, user: dict[str, object], folder: str, board: SimBoard | None = None) -> None:
        """`user`: the settings of the user's file; `folder`: for files of this run; `board`: the simulated one, which
        then judges too. Raises SettingError."""
        self.device = device
        values = settings_for(user)
        self.user: Settings = config.checked(dict(user))
        self.settings: Settings = config.checked(dict(values))
        self.language = board_of(*self.settings.board())
        self.means: Means = means_of(self.settings.text("board.kind"), self.language, imu=self.settings.on("board.imu"))
        path = os.path.join(folder, "prove.toml")
        write_settings(path, values)
        service = StandService(f"prove-{os.getpid()}", device, folder, ("--config", path))
        driver = Driver(service.name, "prove", tuple(self.settings.interlocks()))
        super().__init__(service, driver, board)
        self.service.ready_s += self.language.port.deaf_ns / 1e9
        self.watch = Watch(device, self.language)
        self.driver.each = self.look
        self.held = Held(others=self._others)
        self.unsafe = ""
        self.swing: Swing | None = None
        """How the arm is moved; chosen by its first run."""

    def __enter__(self) -> ProveStand:
        self.held.__enter__()
        try:
            self.start()
        except BaseException:
            self.close()
            raise
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def start(self) -> None:
        """Start the service, and watch it. Raises TrialError."""
        self.let_go()
        self.service.start()
        self.watch.attach(self.name)

    def let_go(self) -> None:
        super().let_go()
        self.watch.let_go()

    def look(self) -> None:
        """Take in what the board sent meanwhile."""
        self.watch.look(time.monotonic_ns())

    def run(self, seconds: float, until: Callable[[], bool] = lambda: False) -> bool:
        """Let the driving client go on for a while, watching; True as soon as `until` is."""
        now_s = next_s = time.monotonic()
        end_s = now_s + seconds
        while now_s < end_s:
            if now_s >= next_s:
                next_s = now_s + COMMAND_EVERY_S
                self.driver.step()
            self.look()
            if until():
                return True
            time.sleep(LOOK_EVERY_S)
            now_s = time.monotonic()
        return False

    def _others(self) -> dict[str, int]:
        """Processes that the machine has to run in time, beside this one."""
        return {**({"the simulated board": self.board.pid} if self.board else {}), **self.service.known}

    def safe(self) -> str:
        """Wheels at rest, by every means, the quickest first; returns what could not be done, empty if all was."""
        with contextlib.suppress(FailstopError):
            self.ask("prove: safe")
        self.end()
        try:
            stopping.stop(self.device, self.language, lambda _: SIM_FREE_S if self.board else FREE_S, lambda _: None)
        except PortError as error:
            return f"the last stop could not be written: {error}"
        return ""

    def close(self) -> None:
        """safe(), and let everything go; `unsafe` says what could not be done."""
        with uninterrupted():
            try:
                if self.service.process is not None:
                    self.unsafe = self.safe()
                self.service.close()
            finally:
                self.held.end()
