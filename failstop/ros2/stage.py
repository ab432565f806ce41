"""Stage: starts the bridge and publishing nodes as processes in a separate ROS domain, for the demo and the bench."""

from __future__ import annotations

import os
import signal
import subprocess
from types import TracebackType

from failstop import helpers

DOMAINS = range(60, 100)
"""The values of ROS_DOMAIN_ID to choose from. Robots rarely use them, and unlike for the highest values, Linux has free
ports for them."""
END_S = 5.0


def environment() -> dict[str, str]:
    """The environment for these processes. Their ROS domain is limited to this computer, so no robot can hear them."""
    domain = DOMAINS[os.getpid() % len(DOMAINS)]
    alone = {"ROS_LOCALHOST_ONLY": "1", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    return {**os.environ, "ROS_DOMAIN_ID": str(domain), **alone}


class StageProcess:
    """A process of the stage. Use it as a context manager, which ends the process cleanly."""

    def __init__(self, *words: str, log: str = os.devnull) -> None:
        with open(log, "a") as file:
            self.process = subprocess.Popen(
                helpers.python(*words),
                env=environment(),
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=file,
                text=True,
            )

    def __enter__(self) -> StageProcess:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.end()

    def line(self) -> str:
        """The next line that the process prints. Empty if the process has ended."""
        assert self.process.stdout is not None
        return self.process.stdout.readline().strip()

    def kill(self, number: int = signal.SIGKILL) -> None:
        """Send a signal to the process."""
        os.kill(self.process.pid, number)

    def end(self) -> None:
        """Send SIGTERM, then SIGKILL if the process is still running after END_S. Returns when the process has
        ended."""
        if self.process.poll() is None:
            self.kill(signal.SIGCONT)
            self.kill(signal.SIGTERM)
            try:
                self.process.wait(END_S)
            except subprocess.TimeoutExpired:
                self.kill()
        self.process.wait()
        if self.process.stdout:
            self.process.stdout.close()


def bridge(name: str, log: str = os.devnull) -> StageProcess:
    """Start `failstop ros2` for the service of this name."""
    return StageProcess("failstop", "ros2", "--name", name, log=log)


def publisher(node: str, what: str, hz: float = 20.0) -> StageProcess:
    """Start a node of publisher.py. `what`: the forward speed in m/s, or scan."""
    return StageProcess("failstop.ros2.publisher", node, what, str(hz))
