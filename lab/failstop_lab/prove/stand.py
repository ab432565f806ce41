"""The stand: a run of the service of its own on the board, the driving client, and the way back to wheels at rest."""

from __future__ import annotations

import contextlib
import os
import sys
import time
from collections.abc import Callable
from typing import TYPE_CHECKING

from failstop import config
from failstop.api.errors import FailstopError
from failstop.api.robot import Robot
from failstop.board.kinds import board_of
from failstop.cli import style
from failstop.policy import scale
from failstop.policy.halted import Halted
from failstop.policy.settings import Settings
from failstop.setup.ending import uninterrupted
from failstop.setup.halt import WAITS_S, Halt
from failstop_lab.faults.driving import Driver
from failstop_lab.prove.held import Held
from failstop_lab.prove.means import Means, means_of
from failstop_lab.prove.others import SAFE, Others
from failstop_lab.prove.watch import Watch
from failstop_lab.sim.client import SimBoard
from failstop_lab.stand import Stand
from failstop_lab.trial import COMMAND_EVERY_S, Service, write_settings

if TYPE_CHECKING:
    from failstop_lab.prove.swing import Swing

LOOK_EVERY_S = 0.001
SIM_WAITS_S = 0.5
"""How long an unplugged port is waited for that is a simulated board's: it may have ended with the same Ctrl-C."""
AGAIN_S = 5.0
"""How long an unplugged port is waited for in the middle of a test."""
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
SIM_OVERRIDES: dict[str, object] = {"battery.stop_mv": -1}
"""On a simulated board too: its battery is not the robot's."""
OPERATOR = "stand test"


def settings_for(user: dict[str, object]) -> dict[str, object]:
    """The user's settings, with those of the test over them. The robot's own limits hold, and no cap where the test
    confirms the scale before anything else. Raises SettingError."""
    found = {**{key: value for key, value in user.items() if key != "device.path"}, **OVERRIDES}
    if per_rps := confirms(user):
        found[scale.PER_RPS_CONFIRMED] = per_rps
    return found


def confirms(user: dict[str, object]) -> float:
    """The scale that the test confirms, because nobody has and the board reports in a unit of its own; 0: none. Raises
    SettingError."""
    board = board_of(*config.checked(dict(user)).board())
    return board.per_rps if board.scale_assumed and board.reports.own_scale else 0.0


def driven(user: dict[str, object]) -> Settings:
    """The settings that the service of a test runs with: while nobody has confirmed the scale of the wheels, it caps
    the limits. Raises SettingError."""
    settings = config.checked(dict(user))
    return scale.capped(settings, assumed=board_of(*settings.board()).scale_assumed)


def _alarm(text: str) -> None:
    print(style.paint(text, style.FAIL), file=sys.stderr, flush=True)


class Attending(Robot):
    """The test's client on a robot that moves only for an operator (attend.required): with the interlocks, it reports
    the person who has started the test."""

    def assert_interlocks(self, *interlocks: str) -> None:
        super().assert_interlocks(*interlocks)
        self.attend(OPERATOR)


class AttendingDriver(Driver):
    """The driving client on such a robot."""

    @property
    def robot(self) -> Robot:
        if self._robot is None:
            self._robot = Attending(self.name, client=self._client, disable_on_exit=False)
        return self._robot


class ProveStand(Stand):
    """A context manager. At its end it stops the wheels, whatever happens; `outcome` is what is known then."""

    def __init__(self, device: str, user: dict[str, object], folder: str, board: SimBoard | None = None) -> None:
        """`user`: the settings of the user's file; `folder`: for files of this run; `board`: the simulated one, which
        then judges too. Raises SettingError."""
        self.device = device
        values = {**settings_for(user), **(SIM_OVERRIDES if board else {})}
        self.confirms_scale = confirms(user) > 0
        self.user: Settings = driven(user)
        self.settings: Settings = driven(values)
        self.language = board_of(*self.settings.board())
        self.means: Means = means_of(self.settings.text("board.kind"), self.language, imu=self.settings.on("board.imu"))
        path = os.path.join(folder, "prove.toml")
        write_settings(path, values)
        service = Service(f"prove-{os.getpid()}", device, folder, ("--config", path))
        driving = AttendingDriver if self.settings.on("attend.required") else Driver
        driver = driving(service.name, "prove", tuple(self.settings.interlocks()))
        super().__init__(service, driver, board)
        self.service.ready_s += self.language.port.deaf_ns / 1e9
        self.watch = Watch(device, self.language)
        self.others = Others()
        self.driver.each = self.look
        self.driver.may_reset = self.others.check
        self.held = Held(others=self._beside)
        self._halt = Halt(device, self.language, _alarm)
        self._started = False
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
        self._started = True
        self.service.start()
        self.watch.attach(self.name)
        self.others.attach(self.name)

    def let_go(self) -> None:
        self.others.let_go()
        super().let_go()
        self.watch.let_go()

    def look(self) -> None:
        """Take in what the board sent meanwhile. Raises StoppedByOthers while the test commands."""
        self.watch.look(time.monotonic_ns())
        self.others.look_now_and_then()
        if self.others.why and self.driver.commands:
            self.others.check()

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

    def _beside(self) -> dict[str, int]:
        """Processes that the machine has to run in time, beside this one."""
        return {**({"the simulated board": self.board.pid} if self.board else {}), **self.service.known}

    def safe(self, waits_s: float = AGAIN_S) -> Halted:
        """Stop the wheels by every means, the quickest first, and find out whether they are stopped. `waits_s`: how
        long a port that is unplugged is waited for."""
        with contextlib.suppress(FailstopError):
            self.ask(SAFE)
        self.end()
        return self._halt.now(SIM_WAITS_S if self.board else waits_s)

    @property
    def outcome(self) -> Halted | None:
        """What is known of the wheels after the newest safe(); None: nothing has been started."""
        return self._halt.last

    def close(self) -> None:
        """safe(), and let everything go."""
        with uninterrupted():
            try:
                if self._started:
                    self.safe(WAITS_S)
                self.service.close()
            finally:
                self.held.end()
