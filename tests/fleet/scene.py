"""A broker of the tests' own (mosquitto), robots that are pretended, and a view of what was published."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import pwd
import shutil
import socket
import subprocess
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path
from typing import Any

from failstop.api.errors import FailstopError, NoService
from failstop.api.events import Event
from failstop.api.state import State
from failstop.fleet.broker import Broker
from failstop.fleet.publisher import Publisher
from failstop.fleet.sender import Sender
from failstop.fleet.settings import FleetSettings
from failstop.fleet.tally import Tally
from failstop.policy import causes
from failstop_lab.trial import wait_for
from tests.support import states

MOSQUITTO = shutil.which("mosquitto", path=f"{os.environ.get('PATH', '')}:/usr/sbin:/usr/local/sbin")
LONGEST_S = 20.0
LONG_AGO_S = 1000.0
"""A robot of a fleet is usually connected for longer than any of the times that a stop waits for."""


class Mosquitto:
    """A broker on a port of its own; can be killed and started anew."""

    def __init__(self, folder: Path, *lines: str) -> None:
        self.folder = folder
        self.port = 0
        self._lines = lines or ("allow_anonymous true",)
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> None:
        """Start it on the port that it had, or on one that is free."""
        assert MOSQUITTO is not None
        if not self.port:
            with socket.create_server(("127.0.0.1", 0)) as found:
                self.port = found.getsockname()[1]
        config = self.folder / "mosquitto.conf"
        me = pwd.getpwuid(os.getuid()).pw_name
        config.write_text("\n".join([f"listener {self.port} 127.0.0.1", f"user {me}", *self._lines, ""]))
        with (self.folder / "mosquitto.log").open("ab") as log:
            self._process = subprocess.Popen([MOSQUITTO, "-v", "-c", str(config)], stdout=log, stderr=log)
        wait_for(f"mosquitto ({self.folder}/mosquitto.log)", self._listens)

    def _listens(self) -> bool:
        assert self._process is not None
        assert self._process.poll() is None, (self.folder / "mosquitto.log").read_text()
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.port), 1):
            return True
        return False

    def kill(self) -> None:
        """SIGKILL."""
        if self._process:
            self._process.kill()
            self._process.wait()
            self._process = None

    def signal(self, number: int) -> None:
        """To its process, as SIGSTOP."""
        assert self._process is not None
        self._process.send_signal(number)

    def settings(self, **changed: object) -> FleetSettings:
        """Settings to get there; `changed`: with `__` for the dot."""
        given = {key.replace("__", "."): value for key, value in changed.items()}
        return FleetSettings({"broker.port": self.port, "broker.keepalive_s": 2, **given})


@contextlib.contextmanager
def mosquitto(folder: Path, *lines: str) -> Iterator[Mosquitto]:
    broker = Mosquitto(folder, *lines)
    broker.start()
    try:
        yield broker
    finally:
        broker.kill()


class Pretended:
    """A robot without a service: it is stopped by being asked to, with all proofs at once, unless told otherwise."""

    def __init__(self, state: State | None = None) -> None:
        self.run = "run 1"
        self.state: State | None = state or states.driving()
        self.asked: list[tuple[str, str]] = []
        self.proofs: dict[str, Any] = {
            "written_s": 2e-4,
            "acknowledged_s": 4e-3,
            "observed_s": 0.3,
            "observed_by": "wheels",
        }
        self.told: list[Event] = []
        self.problem = ""

    def read(self) -> State | FailstopError:
        return self.state or NoService("no service named 'failstop' is running")

    def events(self) -> list[Event]:
        told, self.told = self.told, []
        return told

    def stop(self, reason: str, by: str) -> str:
        self.asked.append((reason, by))
        if self.state and not self.problem:
            cause = causes.REQUESTED(reason, by, 1)
            epoch = self.state.epoch + 1
            stop = states.stop(cause, epoch=epoch, t=time.time(), **self.proofs)
            self.state = dataclasses.replace(states.latched(cause), epoch=epoch, last_stop=stop)
        return self.problem


class Robot(Publisher):
    """A publisher that counts the stops, or what claims to be one, that it has dealt with."""

    heard = 0

    def _hear(self, topic: str, payload: bytes, retained: bool) -> None:
        super()._hear(topic, payload, retained)
        self.heard += not topic.endswith("/connection")

    def hears(self, payload: bytes) -> None:
        """Take it as a message that has come now."""
        self._hear("", payload, False)


class Listener:
    """Everything that is published, by topic."""

    def __init__(self, settings: FleetSettings, *wanted: str) -> None:
        self.last: dict[str, bytes] = {}
        self.all: list[tuple[str, bytes]] = []
        self.broker = Broker(settings, f"listener-{time.monotonic_ns()}", wanted or ("#",), self._hear)

    def _hear(self, topic: str, payload: bytes, _retained: bool) -> None:
        self.last[topic] = payload
        self.all.append((topic, payload))

    def turn(self, longest_s: float) -> None:
        self.broker.turn(longest_s)


def everywhere(tally: Tally, level: str) -> bool:
    """Whether every robot has reached this level, and there is one."""
    return bool(tally.robots()) and tally.reached(level) == tally.robots()


def pump(what: str, until: Callable[[], object], *turning: Publisher | Listener | Broker) -> None:
    """Let them turn until that is so."""
    end_s = time.monotonic() + LONGEST_S
    while not until():
        assert time.monotonic() < end_s, f"waited {LONGEST_S:g} s for {what}"
        for each in turning:
            each.turn(0.005)


def stop_all(
    settings: FleetSettings, *turning: Publisher | Listener, wait_s: float | None = 10.0, reason: str = "smoke"
) -> tuple[bool, Sender]:
    """Stop the fleet as another program does, while these go on. Gives whether every robot is known to have stopped,
    and the sender with its report."""
    sender = Sender(settings, reason, "ann")
    with ThreadPoolExecutor(1) as pool:
        running = pool.submit(sender.run, wait_s)
        while not running.done():
            for each in turning:
                each.turn(0.005)
            time.sleep(0.001)
        return running.result(), sender
