"""A fleet on this machine: `python -m tests.fleet.thousand`. Robots with the publisher of real ones on one broker
(mosquitto), a view of all of them, and stops of the whole fleet, timed by their sender.
"""

from __future__ import annotations

import argparse
import contextlib
import fcntl
import os
import pty
import resource
import shutil
import socket
import struct
import subprocess
import sys
import tempfile
import termios
import threading
import time
from collections.abc import Iterator

import psutil

from bench import report, stats
from bench.report import progress
from failstop.fleet import levels, signed
from failstop.fleet.sender import Sender
from failstop.fleet.settings import FleetSettings
from failstop.setup.ending import interruptible
from failstop_lab.trial import TrialError, wait_for
from tests.fleet import bare
from tests.fleet.robots import FLEET

ROBOTS = 1000
STOPS = 20
WORKERS = 4
REST_S = 3.0
"""Between two stops: the robots are reset and drive again."""
IDLE_S = 10.0
BAR_S = 2.0
CONNECT_S = 120.0
WAIT_S = 10.0
MEMORY = "/dev/shm"
"""Each real robot has a disk of its own to remember on; here a thousand would wait for one."""


@contextlib.contextmanager
def broker(folder: str) -> Iterator[tuple[int, int]]:
    """A mosquitto with its own limits as they are shipped; gives its port and pid."""
    program = shutil.which("mosquitto", path=f"{os.environ.get('PATH', '')}:/usr/sbin")
    if program is None:
        raise TrialError("there is no mosquitto here: `make fleet` installs it")
    with socket.create_server(("127.0.0.1", 0)) as found:
        port: int = found.getsockname()[1]
    config = os.path.join(folder, "mosquitto.conf")
    with open(config, "w", encoding="utf-8") as file:
        file.write(f"listener {port} 127.0.0.1\nallow_anonymous true\n")
    process = subprocess.Popen([program, "-c", config], stderr=subprocess.DEVNULL)

    def listens() -> bool:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", port), 1):
            return True
        return False

    try:
        wait_for("mosquitto", listens)
        yield port, process.pid
    finally:
        process.terminate()
        process.wait()


@contextlib.contextmanager
def clients(count: int, *words: str) -> Iterator[None]:
    """So many clients of the broker, connected: `words` is their program with its first arguments."""
    shares = [count // WORKERS + (number < count % WORKERS) for number in range(WORKERS)]
    running = []
    first = 0
    for share in shares:
        running.append(
            subprocess.Popen(
                [sys.executable, "-m", *words, str(first), str(share)],
                stdin=subprocess.PIPE,
                stdout=subprocess.PIPE,
                stderr=subprocess.DEVNULL,
                text=True,
            )
        )
        first += share
    try:
        for process in running:
            assert process.stdout is not None
            if process.stdout.readline() != "ready\n":
                raise TrialError(f"a process of {words[0]} ended")
        yield
    finally:
        for process in running:
            assert process.stdin is not None
            process.stdin.close()
        for process in running:
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(10)
            process.kill()
            process.wait()


class View:
    """`failstop fleet` on a terminal of its own: 200 columns, and rows for all robots."""

    def __init__(self, config: str, count: int) -> None:
        self._shown = b""
        pid, self._terminal = pty.fork()
        if pid == 0:
            os.execv(sys.executable, [sys.executable, "-m", "failstop", "fleet", "--config", config])
        self.process = psutil.Process(pid)
        fcntl.ioctl(self._terminal, termios.TIOCSWINSZ, struct.pack("HHHH", count + 20, 200, 0, 0))
        threading.Thread(target=self._drain, daemon=True).start()

    def _drain(self) -> None:
        with contextlib.suppress(OSError):
            while data := os.read(self._terminal, 1 << 16):
                self._shown = (self._shown + data)[-(1 << 20) :]

    def shows(self, text: str) -> bool:
        """It did so, some time."""
        return text.encode() in self._shown

    def end(self) -> None:
        """As its user does."""
        os.write(self._terminal, b"q")
        os.waitpid(self.process.pid, 0)


def idle(watched: dict[str, psutil.Process], count: int) -> list[stats.Row]:
    """Cost while nothing happens but the robots' states."""

    def used_s() -> dict[str, float]:
        return {name: sum(process.cpu_times()[:2]) for name, process in watched.items()}

    before, begin_s = used_s(), time.monotonic()
    time.sleep(IDLE_S)
    after, took_s = used_s(), time.monotonic() - begin_s
    rows = []
    for name, process in watched.items():
        percent, megabytes = 100 * (after[name] - before[name]) / took_s, process.memory_info().rss / 1e6
        result = f"{percent:.1f} % of a core, {megabytes:.0f} MB"
        numbers = {"percent": percent, "megabytes": megabytes}
        rows.append(stats.Row(f"{name}, {count} robots", result, "-", None, numbers))
    return rows


def bare_stops(port: int, count: int, number: int) -> list[int]:
    """The ns that so many bare clients take until each has answered: broker, MQTT client and these processors alone."""
    with clients(count, "tests.fleet.bare", str(port)):
        found = []
        for done in range(number):
            progress(f"bare stop {done + 1} of {number}")
            found.append(bare.stop(port, count))
        return found


def stops(settings: FleetSettings, count: int, number: int) -> list[stats.Row]:
    """Stops of the whole fleet, while they are watched."""
    each: dict[str, list[int]] = {level: [] for level in levels.PROOFS}
    last: list[int] = []
    missing = 0
    for done in range(number):
        progress(f"stop {done + 1} of {number}")
        time.sleep(REST_S)
        sender = Sender(settings, "bench", "bench")
        if not sender.run(WAIT_S) or len(sender.tally.robots()) != count:
            missing += max(len(sender.tally.missing()), count - len(sender.tally.robots()))
        for level in levels.PROOFS:
            each[level] += [round(took_s * 1e9) for took_s in sender.tally.times_s(level)]
        if times_s := sender.tally.times_s(levels.ACKNOWLEDGED):
            last.append(round(times_s[-1] * 1e9))
    rows = [stats.timing(f"fleet stop -> {level}, each robot", each[level], p50_ms=None, p99_ms=None) for level in each]
    confirmed = stats.timing(f"fleet stop -> confirmed by all {count}", last, p50_ms=None, p99_ms=BAR_S * 1e3)
    return [confirmed, *rows, stats.count("robots that did not confirm", missing, count * number)]


@interruptible()
def main() -> int:
    """Run it; 1 when a bar is missed."""
    parser = argparse.ArgumentParser(prog="python -m tests.fleet.thousand", description=__doc__)
    parser.add_argument("--robots", type=int, default=ROBOTS)
    parser.add_argument("--stops", type=int, default=STOPS)
    parser.add_argument("--json", metavar="FILE")
    arguments = parser.parse_args()
    soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
    resource.setrlimit(resource.RLIMIT_NOFILE, (hard if soft < hard else soft, hard))
    with tempfile.TemporaryDirectory(prefix="bench-fleet-", dir=MEMORY) as folder, broker(folder) as (port, mosquitto):
        key = os.path.join(folder, "key")
        signed.make_key(key)
        settings = FleetSettings({"broker.port": port, "stop.key_file": key, "robot.fleet": FLEET})
        config = os.path.join(folder, "fleet.toml")
        with open(config, "w", encoding="utf-8") as file:
            file.write(f"broker.port = {port}\nrobot.fleet = '{FLEET}'\n")
        bare = bare_stops(port, arguments.robots, -(-arguments.stops // 2))
        progress(f"{arguments.robots} robots connect")
        with clients(arguments.robots, "tests.fleet.robots", str(port), key, folder):
            view = View(config, arguments.robots)
            wait_for("the view to show them", lambda: view.shows(f"{arguments.robots} robots"), CONNECT_S)
            progress("watching")
            rows = idle({"broker": psutil.Process(mosquitto), "view": view.process}, arguments.robots)
            rows = [*stops(settings, arguments.robots, arguments.stops), *rows]
            view.end()
        bare += bare_stops(port, arguments.robots, arguments.stops // 2)
        floor = f"a message -> answered by {arguments.robots} bare clients (the floor)"
        rows.append(stats.timing(floor, bare, p50_ms=None, p99_ms=None))
    return report.end(rows, arguments.json)


if __name__ == "__main__":
    sys.exit(main())
