"""The errors that failstop's calls raise. A failstop command that fails with such an error exits with the error's
`exit_code`."""

from __future__ import annotations

from failstop.messages.records import CAUSE

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.policy.causes import Cause


class FailstopError(Exception):
    """The base class of failstop's errors. The message is one line that says what is wrong and what to do."""

    exit_code = 1
    """Exit code of a command that fails with this error."""


class Refused(FailstopError):
    """The service refused a request. The message gives the reason and, if there is one, the next step."""

    exit_code = 2
    """Exit code of a command that fails with this error."""

    def __init__(self, template: str, cause: Cause | None = None, step: str = "", refused_for: int = 0) -> None:
        """`template`: the reason, with CAUSE in the place of the text of `cause`. `step`: the next step. `refused_for`:
        1 if a stop is latched, 2 if an interlock does not hold, 3 if the wheels may turn, otherwise 0."""
        super().__init__(template, cause, step, refused_for)
        self.refused_for = refused_for
        self.template = template
        self.cause = cause
        """The cause of the stop for which the request was refused. None if it was refused for another reason."""
        self.step = step
        """The next step, with commands in backquotes. Empty if no step is known."""

    @property
    def reason(self) -> str:
        """The reason why the request was refused."""
        return self.template.replace(CAUSE, str(self.cause))

    def __str__(self) -> str:
        return f"{self.reason}; next: {self.step}" if self.step else self.reason


class NoService(FailstopError):
    """No service with this name is running, or it has ended."""

    exit_code = 3
    """Exit code of a command that fails with this error."""


class Undeclared(FailstopError, ValueError):
    """The program named a source or an interlock that is not in the service's settings, or that is reserved, such as
    the source `gamepad`."""


class TimedOut(FailstopError, TimeoutError):
    """Robot.wait_for() waited too long. The message says what the state is, and what to do."""


class NoAnswer(FailstopError):
    """The service is running, but it did not answer in time."""
