"""Errors that a user of failstop may meet, each with the exit code that the commands give it."""

from __future__ import annotations

from failstop.messages.records import CAUSE

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.policy.causes import Cause


class FailstopError(Exception):
    """Base of all; the message is one line that names the thing and the remedy."""

    exit_code = 1
    """Of a command that ends with it."""


class Refused(FailstopError):
    """The service answered, and said no. The message is the reason and, where there is one, the next step."""

    exit_code = 2
    """Of a command that ends with it."""

    def __init__(self, template: str, cause: Cause | None = None, step: str = "", refused_for: int = 0) -> None:
        """`template`: the reason, with CAUSE in the place of the cause's own text; `refused_for`: 1 what is latched, 2
        an interlock, 0 anything else."""
        super().__init__(template, cause, step, refused_for)
        self.refused_for = refused_for
        self.template = template
        self.cause = cause
        """Of the stop that it was refused for; None: for something else."""
        self.step = step
        """The remedy, commands in backquotes; empty: the reason says it all."""

    @property
    def reason(self) -> str:
        """Why it was refused."""
        return self.template.replace(CAUSE, str(self.cause))

    def __str__(self) -> str:
        return f"{self.reason}; next: {self.step}" if self.step else self.reason


class NoService(FailstopError):
    """No service of that name runs, or it went away."""

    exit_code = 3
    """Of a command that ends with it."""


class Undeclared(FailstopError, ValueError):
    """A source or an interlock that the service's settings do not name, or that is not a client's to use."""


class TimedOut(FailstopError, TimeoutError):
    """Robot.wait_for waited in vain; the message says how things stand, and what to do."""


class NoAnswer(FailstopError):
    """The service runs but did not answer in time."""
