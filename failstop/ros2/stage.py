"""A stage for the demo and the bench: nodes that publish, and a bridge, as processes in a ROS domain of their own."""

from __future__ import annotations

import os
import signal
import subprocess
from types import TracebackType

from failstop import helpers

DOMAINS = range(60, 100)
"""The values of ROS_DOMAIN_ID to choose from. Robots seldom use them, and Linux has ports for them, unlike for the
highest values."""
END_S = 5.0


def environment() -> dict[str, str]:
    """A domain of its own on this machine alone: nobody's robot hears it."""
    domain = DOMAINS[os.getpid() % len(DOMAINS)]
    alone = {"ROS_LOCALHOST_ONLY": "1", "ROS_AUTOMATIC_DISCOVERY_RANGE": "LOCALHOST"}
    return {**os.environ, "ROS_DOMAIN_ID": str(domain), **alone}


class StageProcess:
    """One of them; a context manager that ends it in order."""

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
        """The next line that it writes; empty when it has ended."""
        assert self.process.stdout is not None
        return self.process.stdout.readline().strip()

    def kill(self, number: int = signal.SIGKILL) -> None:
        """Send it a signal."""
        os.kill(self.process.pid, number)

    def end(self) -> None:
        """SIGTERM, and wait for its end."""
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
    """`failstop ros2`."""
    return StageProcess("failstop", "ros2", "--name", name, log=log)


def publisher(node: str, what: str, hz: float = 20.0) -> StageProcess:
    """A node of publisher.py."""
    return StageProcess("failstop.ros2.publisher", node, what, str(hz))
