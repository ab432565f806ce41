"""Where faults happen: a trial with the settings of a campaign, its driving client, and the part of systemd."""

from __future__ import annotations

import os
import random
import signal
import subprocess
import tempfile
import time

from failstop import helpers
from failstop.api.errors import FailstopError
from failstop.config import checked, read
from failstop.messages.layout import SUPERVISOR
from failstop.policy.layouts import BOARDS
from failstop.supervisor import status
from failstop_lab.boards.traits import traits_of
from failstop_lab.faults.arm import ArmTrial
from failstop_lab.faults.driving import INTERLOCK, WHOLE_S, Driver
from failstop_lab.sim.client import SimBoard
from failstop_lab.stand import Stand
from failstop_lab.trial import Trial, TrialError, write_settings

SETTINGS: dict[str, object] = {
    "restart.deaths": 100_000,
    "restart.backoff_s": 0.001,
    "battery.log": "on",
    "battery.log_s": 1.0,
    "battery.directory": "",
    f"interlocks.{INTERLOCK}.timeout_s": 0.5,
    status.LEASE: status.LEASE_S,
}
"""Settings that a campaign needs, which replace the user's. A campaign's many deaths are no crash loop, and the lease
is the one that the bars assume, whatever rights the service has."""
GONE_S = 5.0


class Scene(Stand):
    """A context manager. `chance` is the injector's source of random choices."""

    board: SimBoard

    def __init__(self, name: str, config: str | None = None, kind: str = BOARDS[0]) -> None:
        """`config`: a TOML file whose settings hold beside those of a campaign; `kind`: the board's. Raises
        SettingError."""
        self.traits = traits_of(kind)
        self.chance = random.Random(0)
        self.was_turning = False
        """The board's word just before the fault."""
        self._folder = tempfile.TemporaryDirectory(prefix="failstop-chaos-")
        self._config = os.path.join(self._folder.name, "chaos.toml")
        theirs = read(config)
        checked(theirs, config)  # values that a campaign overrides are refused too
        write_settings(self._config, {**theirs, **SETTINGS, **self.traits.settings})
        self._tool: subprocess.Popen[bytes] | None = None
        self.tool_ns = 0
        """When the stop tool was started last (CLOCK_MONOTONIC)."""
        self._arm: ArmTrial | None = None
        self.spoiled = self.arm_spoiled = False
        """A fault went wrong here, so the next one gets a new board and a new service, from refresh()."""
        self._start_new(name)

    def _start_new(self, name: str) -> None:
        """A board, a service and a driving client that nothing was done to."""
        self.trial = Trial(name, ("--config", self._config), kind=self.traits.kind)
        super().__init__(self.trial.service, Driver(name), self.trial.board)

    @property
    def arm(self) -> ArmTrial:
        """A board and a service of their own, with an arm; from when they are asked for first."""
        if self._arm is None:
            self._arm = ArmTrial(f"{self.name}-arm", kind=self.traits.kind)
            self._arm.__enter__()
        return self._arm

    def _end_arm(self) -> None:
        if self._arm:
            self._arm.close()
            self._arm = None

    def __enter__(self) -> Scene:
        self.trial.__enter__()
        return self

    def __exit__(self, *_: object) -> None:
        self.close()
        self._folder.cleanup()

    def close(self) -> None:
        """End everything, whatever state it is in."""
        self._end_arm()
        self._end_tool()
        process = self.service.process
        self.service.signal_known(signal.SIGCONT)
        if process and process.poll() is None and self._stopped_by_fault():
            self.service.kill()
        self.end()
        self.trial.close()

    def _stopped_by_fault(self) -> bool:
        """Whether the service is too damaged to end in order."""
        try:
            return self.driver.robot.state.processes[SUPERVISOR].age_s > 0.5
        except FailstopError:
            return True
        finally:
            self.driver.leave()

    def refresh(self) -> None:
        """A new board and a new service, if the fault before went wrong. Raises TrialError, and others, if the old ones
        don't end or the new ones don't start."""
        if self.arm_spoiled:
            self._end_arm()
            self.arm_spoiled = False
        if self.spoiled:
            self.close()
            self._start_new(self.name)
            self.trial.__enter__()
            self.spoiled = False

    def realtime(self) -> bool:
        """Whether every process of the service has a real-time priority, as each says itself."""
        return all(process.realtime for process in self.driver.robot.state.processes.values())

    @property
    def whole_s(self) -> float:
        """A service is whole within so long, on a board that may be deaf first."""
        return WHOLE_S + self.traits.deaf_ns / 1e9

    # The part of systemd.

    def start_stop_tool(self) -> None:
        """Do as ExecStopPost does, once the supervisor is gone: end what is left of the run, and stop the wheels. The
        command itself finds what is left by the control group, which a run without systemd does not have."""
        if self.service.process:
            self.service.process.wait(GONE_S)
        self.service.kill_rest()
        command = helpers.python(
            "failstop", "stop", "--config", self._config, "--device", self.trial.link, "--wait", "5"
        )
        self.tool_ns = time.monotonic_ns()
        self._tool = subprocess.Popen(command, stdin=subprocess.DEVNULL, stdout=subprocess.DEVNULL)

    def wait_for_stop_tool(self) -> None:
        """Go on commanding until the stop tool has ended. Raises TrialError when it failed."""
        if tool := self._tool:
            self.driver.until("the stop tool to end", lambda: tool.poll() is not None)
            self._tool = None
            if tool.returncode:
                raise TrialError(f"the stop tool ended with exit code {tool.returncode}")

    def _end_tool(self) -> None:
        if self._tool:
            self._tool.kill()
            self._tool.wait()
            self._tool = None

    def restart(self) -> None:
        """End what is left of the run, as systemd does, and start a new one; the clients go on commanding."""
        self.bury()
        self.service.exec()
        self.driver.until("the service to be ready again", self.service.ready, self.whole_s)
        self.driver.leave()
