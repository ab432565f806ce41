"""The errors that calls of failstop raise, each with the exit code of a command that fails with it."""

from __future__ import annotations

from failstop.messages.records import CAUSE

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.policy.causes import Cause


class FailstopError(Exception):
    """Base class; the message is one line that names the thing and the remedy."""

    exit_code = 1
    """Exit code of a command that fails with this error."""


class Refused(FailstopError):
    """The service refused the request. The message is the reason and, if there is one, the next step."""

    exit_code = 2
    """Exit code of a command that fails with this error."""

    def __init__(self, template: str, cause: Cause | None = None, step: str = "", refused_for: int = 0) -> None:
        """`template`: the reason, with CAUSE in place of the cause's own text; `refused_for`: 1 for a latched stop, 2
        for an interlock, 0 for anything else."""
        super().__init__(template, cause, step, refused_for)
        self.refused_for = refused_for
        self.template = template
        self.cause = cause
        """The cause of the stop because of which the request was refused; None if there was another reason."""
        self.step = step
        """The next step, with commands in backquotes; empty if the reason says everything."""

    @property
    def reason(self) -> str:
        """Why it was refused."""
        return self.template.replace(CAUSE, str(self.cause))

    def __str__(self) -> str:
        return f"{self.reason}; next: {self.step}" if self.step else self.reason


class NoService(FailstopError):
    """No service of that name is running, or it has ended."""

    exit_code = 3
    """Exit code of a command that fails with this error."""


class Undeclared(FailstopError, ValueError):
    """The settings of the service do not declare this source or interlock, or clients may not use it."""


class TimedOut(FailstopError, TimeoutError):
    """The state that Robot.wait_for() waited for was not reached in time. The message says what the state is, and what
    to do."""


class NoAnswer(FailstopError):
    """The service is running but did not answer in time."""
