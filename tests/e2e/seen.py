"""A running service as a person at the command line sees it, beside what the board saw."""

from __future__ import annotations

import contextlib
import json
import subprocess
from collections.abc import Callable
from typing import Any

from failstop import Refused
from failstop.api.errors import FailstopError
from failstop.lab.sim.client import Event
from failstop.lab.trial import Trial, judge, wait_for
from failstop.policy import causes
from tests.support.commands import FAILSTOP

FORWARD = (0.2, 0.0, 0.0)
LATEST_MS = 100.0
"""A generous absolute limit for shared and busy machines; the bars are in the bench, beside their floor."""
EVERY_S = 0.02


class Seen:
    """A service, and what a person at the command line sees of it."""

    def __init__(self, trial: Trial) -> None:
        self.trial = trial

    def command(self, *words: str, each: Callable[[], None] = lambda: None) -> tuple[int, str, str]:
        """Run `failstop ...`, calling `each` every 20 ms meanwhile; (exit code, what it printed, its errors)."""
        process = subprocess.Popen(
            [*FAILSTOP, *words, "--name", self.trial.name],
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )
        each()
        while True:
            try:
                out, err = process.communicate(timeout=EVERY_S)
            except subprocess.TimeoutExpired:
                each()
            else:
                return process.returncode, out, err

    def status(self, each: Callable[[], None] = lambda: None) -> dict[str, Any]:
        """What `failstop status --json` prints; the arm stays in its pose meanwhile, however long that takes."""

        def hold() -> None:
            with contextlib.suppress(FailstopError):
                self.trial.robot.hold("arm")
            each()

        code, out, err = self.command("status", "--json", each=hold)
        assert (code, err) == (0, "")
        found: dict[str, Any] = json.loads(out)
        return found

    def refused(self, *words: str) -> str:
        """The one line of a command that the service refuses."""
        code, out, err = self.command(*words)
        assert (code, out) == (2, "")
        assert err.count("\n") == 1
        return err.rstrip("\n")

    def enable(self) -> None:
        """Whatever was before: nothing latched, motion enabled."""

        def enabled() -> bool:
            self.trial.robot.hold("arm")
            try:
                self.trial.enable()
            except Refused:
                return False
            return True

        wait_for("motion to be enabled", enabled)

    def set_off(self) -> None:
        """Drive forward; the board's past is forgotten."""
        self.enable()
        self.trial.drive(0.15)
        assert self.trial.moving()
        self.trial.board.events()

    def command_on(self) -> None:
        """What a client that does not notice anything goes on doing, with its sensor."""
        self.trial.robot.sensed()
        self.trial.robot.drive(*FORWARD)


def latched(found: dict[str, Any], reason: str) -> None:
    """Status says it in each of its places."""
    assert found["estop"] == reason
    assert found["blocked"] == f"estop: {reason}"
    assert found["enabled"] is False
    assert found["body_vel"] == [0.0, 0.0, 0.0]
    assert found["last_stop"]["reason"] == reason
    assert found["last_stop"]["cause"] == found["cause"]
    name, arguments = found["cause"]["name"], {key: value for key, value in found["cause"].items() if key != "name"}
    assert str(causes.of(name, arguments)) == reason


def stopped(seen: Seen, fault_ns: int) -> None:
    """The board: stopped soon, and nothing moved after it."""
    found = judge(seen.trial.board.events(), fault_ns, was_moving=True)
    assert found.stop_ns is not None
    assert found.stop_ns < LATEST_MS * 1e6
    assert found.still_ns is not None
    assert found.motion_after == 0
    assert not seen.trial.moving()


def is_zero(event: Event) -> bool:
    """A motor frame after which every wheel stands."""
    return event.is_motor and not any(event.speeds)


def pid_of(found: dict[str, Any], process: str) -> int:
    pid: int = found["processes"][process]["pid"]
    return pid
