"""What can go wrong for a user of failstop, each with the exit code that the commands give it."""

from __future__ import annotations

from failstop.shm.records import CAUSE

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.policy.causes import Cause


class FailstopError(Exception):
    """Base of all; the message is one line that names the thing and the remedy."""

    exit_code = 1
    """Of a command that ends with it."""


class Refused(FailstopError):
    """The service answered, and said no. The message is "refused: " and the reason, which alone is in `args`."""

    exit_code = 2
    """Of a command that ends with it."""

    def __init__(self, template: str, cause: Cause | None = None) -> None:
        """`template`: the reason, with CAUSE in the place of the cause's own text."""
        super().__init__(template.replace(CAUSE, str(cause)))
        self.template = template
        self.cause = cause

    def __str__(self) -> str:
        return f"refused: {super().__str__()}"


class NoService(FailstopError):
    """No service of that name runs, or it went away."""

    exit_code = 3
    """Of a command that ends with it."""


class Undeclared(FailstopError, ValueError):
    """A source or an interlock that the service's settings do not name, or that is not a client's to use."""


class TimedOut(FailstopError, TimeoutError):
    """What Robot.wait_for waited for did not come about in time; the message says what is, and what to do."""


class NoAnswer(FailstopError):
    """The service runs but did not answer in time."""
