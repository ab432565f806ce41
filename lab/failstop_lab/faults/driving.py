"""The driving client of a campaign: it commands, senses and holds all the while, whatever becomes of the service."""

from __future__ import annotations

import contextlib
import time
from collections.abc import Callable

from failstop.api.errors import FailstopError, Refused
from failstop.api.robot import Robot
from failstop.policy.causes import Cause
from failstop_lab.trial import COMMAND_EVERY_S, TrialError

INTERLOCK = "arm"
WHOLE_S = 10.0
CLAIM_SEEN_S = 0.06
"""The gate looks at claims once a tick."""


class Driver:
    """Commands a velocity every 20 ms. The switches say what it leaves out; the times are of the last of each."""

    def __init__(self, name: str, client: str = "chaos", interlocks: tuple[str, ...] = (INTERLOCK,)) -> None:
        """`client`: what others see of it; `interlocks`: what it asserts."""
        self.name = name
        self._client = client
        self._interlocks = interlocks
        self.velocity = (0.1, 0.0, 0.0)
        self.commands = self.senses = self.holds = True
        self.sensed_ns = self.held_ns = self.commanded_ns = 0
        self.each: Callable[[], None] = lambda: None
        """Called with every command."""
        self.may_reset: Callable[[Cause | None], None] = lambda cause: None
        """Called before motion is enabled, with the cause that would be reset for that; raises a TrialError if neither
        may happen."""
        self._robot: Robot | None = None

    @property
    def robot(self) -> Robot:
        """Connected to the run that is there now. Raises NoService, FailstopError."""
        if self._robot is None:
            self._robot = Robot(self.name, client=self._client, disable_on_exit=False)
        return self._robot

    def leave(self) -> None:
        """Disconnect."""
        if self._robot:
            self._robot.close()
            self._robot = None

    def hand_over(self) -> None:
        """Let another program drive, and go on sensing and holding. Its last command would make two publishers."""
        self.leave()
        self.commands = False
        self.run(CLAIM_SEEN_S)

    def step(self) -> None:
        """One command; to a service that is gone, in vain."""
        try:
            if self.holds:
                self.robot.assert_interlocks(*self._interlocks)
                self.held_ns = time.monotonic_ns()
            if self.senses:
                self.robot.sensed()
                self.sensed_ns = time.monotonic_ns()
            if self.commands:
                self.commanded_ns = time.monotonic_ns()
                self.robot.drive(*self.velocity)
        except FailstopError:
            self.leave()
        self.each()

    def run(self, seconds: float) -> None:
        """Command for a while."""
        until_s = time.monotonic() + seconds
        while (left_s := until_s - time.monotonic()) > 0:
            self.step()
            time.sleep(min(COMMAND_EVERY_S, left_s))

    def until(self, what: str, check: Callable[[], bool], timeout_s: float = WHOLE_S) -> None:
        """Command until `check` is true; an error of the service counts as not yet. Raises TrialError."""
        now_s = next_s = time.monotonic()
        until_s = now_s + timeout_s
        while True:
            with contextlib.suppress(FailstopError):
                if check():
                    return
            now_s = time.monotonic()
            if now_s > until_s:
                raise TrialError(f"waited {timeout_s:g} s for {what}")
            if now_s >= next_s:
                next_s = now_s + COMMAND_EVERY_S
                self.step()
            time.sleep(0.004)

    def enable(self) -> None:
        """Reset what is latched and enable motion, as soon as the interlock has been seen. Raises TrialError."""
        self.commands = False
        self.senses = self.holds = True
        with contextlib.suppress(FailstopError):
            self.robot.drive(0.0, 0.0, 0.0)  # else the enable would hold what it commanded just now
        refusal = ""
        forbidden: list[TrialError] = []

        def hold(_: str = "") -> None:
            self.robot.assert_interlocks(*self._interlocks)
            self.held_ns = time.monotonic_ns()

        def enabled() -> bool:
            nonlocal refusal
            try:
                hold()
                state = self.robot.state
                try:
                    self.may_reset(state.cause)
                except TrialError as error:
                    forbidden.append(error)
                    return True
                if state.estop:
                    self.robot.reset(seen=state.epoch)
                self.robot.enable(hold)  # an arm's way to its drive pose takes longer than an interlock's time
            except Refused as error:
                refusal = f"refused: {error}"
                return False
            except FailstopError:
                self.leave()
                raise
            return True

        try:
            self.until("motion to be enabled", enabled)
        except TrialError as error:
            raise TrialError(f"{error}: {refusal or 'no answer'}") from None
        if forbidden:
            raise forbidden[0]
        self.commands = True
