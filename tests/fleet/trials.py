"""Fleets that are not as they should be: `python -m tests.fleet.trials`. Real brokers (mosquitto), robots with the
publisher of real ones, and `failstop fleet stop` as a person runs it. The judge is each pretended robot: was it stopped
when the command ended? A full count with exit code 0 while a robot was not stopped is a false confirmation.
"""

from __future__ import annotations

import argparse
import concurrent.futures
import contextlib
import json
import os
import pwd
import random
import shutil
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from bench import report, stats
from failstop.fleet import signed
from failstop.fleet.publisher import Publisher
from failstop.fleet.settings import FleetSettings
from failstop.setup.ending import interruptible
from failstop_lab.trial import TrialError, wait_for
from tests.fleet.robots import Pretended
from tests.fleet.thousand import MEMORY

TRIALS = 20
FLEET = "trials"
PUBLISH_S = 0.5
TURN_S = 0.05
OPERATOR = "operator"
BLIND = f"user {OPERATOR}\ntopic readwrite failstop/v1/#\nuser r1\ntopic readwrite #\nuser r2\ntopic readwrite #\n"
"""An access list by which the operator may send stops and read answers, and sees no connection."""


class Broker:
    """A mosquitto on a port of its own, with these lines in its configuration; it can be killed and started again."""

    def __init__(self, folder: Path, *lines: str) -> None:
        program = shutil.which("mosquitto", path=f"{os.environ.get('PATH', '')}:/usr/sbin")
        if program is None:
            raise TrialError("there is no mosquitto here: `make fleet` installs it")
        with socket.create_server(("127.0.0.1", 0)) as found:
            self.port: int = found.getsockname()[1]
        self._words = [program, "-c", str(folder / "mosquitto.conf")]
        me = pwd.getpwuid(os.getuid()).pw_name
        common = (f"listener {self.port} 127.0.0.1", "allow_anonymous true", f"user {me}")
        (folder / "mosquitto.conf").write_text("\n".join((*common, *lines, "")))
        self.start()

    def start(self) -> None:
        """Start it, and wait until it listens."""
        self._process = subprocess.Popen(self._words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        wait_for("mosquitto", self._listens)

    def _listens(self) -> bool:
        with contextlib.suppress(OSError), socket.create_connection(("127.0.0.1", self.port), 1):
            return True
        return False

    def kill(self) -> None:
        """SIGKILL: it saves nothing."""
        self._process.kill()
        self._process.wait()


class Asked(Pretended):
    """A robot without a service, which knows whether it was ever asked to stop."""

    asked = False

    def stop(self, reason: str, by: str) -> str:
        """Latched and written at once."""
        self.asked = True
        return super().stop(reason, by)


class Robot:
    """A pretended robot, and the publisher of a real one in a thread of its own."""

    def __init__(self, settings: FleetSettings, name: str, folder: Path) -> None:
        folder.mkdir()
        self.name = name
        self._robot = Asked(1)
        self._publisher = Publisher(settings, "failstop", self._robot, name, str(folder))
        self._turns = threading.Event()
        self._turns.set()
        self._ended = False
        self._thread = threading.Thread(target=self._run, daemon=True)
        self._thread.start()

    def _run(self) -> None:
        while not self._ended:
            if self._turns.wait(TURN_S):
                self._publisher.turn(TURN_S)

    def connected(self) -> bool:
        """It hears the stops."""
        return self._publisher.broker.listening

    def stopped(self) -> bool:
        """Its service was asked to stop."""
        return self._robot.asked

    def freeze(self) -> None:
        """Its publisher hangs: its connection stays open, and nothing is read from it."""
        self._turns.clear()

    def drop(self) -> None:
        """Its publisher dies: the broker has its last will to publish."""
        self.end()
        self._publisher.broker.drop()

    def end(self) -> None:
        """The thread ends, and says nothing to the broker."""
        self._ended = True
        self._turns.set()
        self._thread.join()


class Fleet:
    """One trial's broker, robots and stop."""

    def __init__(self, folder: Path, *lines: str) -> None:
        self.folder = folder
        self.broker = Broker(folder, *lines)
        self.robots: list[Robot] = []
        signed.make_key(str(folder / "key"))

    def add(self, name: str, **changed: object) -> Robot:
        """A robot of this name, connected."""
        given = {
            "broker.port": self.broker.port, "broker.keepalive_s": 2, "broker.user": name,
            "stop.key_file": str(self.folder / "key"), "robot.fleet": FLEET, "robot.publish_s": PUBLISH_S,
        }  # fmt: skip
        settings = FleetSettings({**given, **changed})
        robot = Robot(settings, name, self.folder / f"robot-{len(self.robots)}")
        self.robots.append(robot)
        wait_for(f"{name} to be connected", robot.connected)
        return robot

    def stop(self, *more: str) -> tuple[int, dict[str, object], str]:
        """`failstop fleet stop`: its exit code, its report, and what it says on stderr."""
        config = self.folder / "fleet.toml"
        config.write_text(
            f"[broker]\nport = {self.broker.port}\nuser = '{OPERATOR}'\n"
            f"[robot]\nfleet = '{FLEET}'\npublish_s = {PUBLISH_S}\n"
            f"[stop]\nkey_file = '{self.folder / 'key'}'\n" + "\n".join(more)
        )
        words = [sys.executable, "-m", "failstop", "fleet", "stop", "trial", "--json", "--config", str(config)]
        done = subprocess.run(words, capture_output=True, text=True, check=False, timeout=60)
        return done.returncode, json.loads(done.stdout) if done.stdout else {}, done.stderr

    def close(self) -> None:
        """End all of it."""
        for robot in self.robots:
            robot.end()
        self.broker.kill()


def twins(fleet: Fleet, draw: random.Random) -> None:
    """Two robots of one name; one of them may hang. The broker may tell clients apart by their users' names alone."""
    fleet.add("r1")
    time.sleep(draw.uniform(0.0, 1.0))
    second = fleet.add("r1")
    time.sleep(draw.uniform(0.0, 4.0))
    if draw.random() < 0.5:
        second.freeze()


def blind(fleet: Fleet, draw: random.Random) -> None:
    """The operator sees no connections, and one robot of two is gone."""
    fleet.add("r1")
    gone = fleet.add("r2")
    if draw.random() < 0.5:
        gone.drop()
    else:
        gone.freeze()
    time.sleep(draw.uniform(0.0, 1.0))


def forgetful(fleet: Fleet, draw: random.Random) -> None:
    """A broker without persistence was away for some seconds, and is back."""
    for number in range(3):
        fleet.add(f"r{number}")
    fleet.broker.kill()
    time.sleep(draw.uniform(3.0, 12.0))
    fleet.broker.start()
    time.sleep(draw.uniform(0.0, 5.0))


def stale(fleet: Fleet, draw: random.Random) -> None:
    """The file of robots is old: it lacks a robot, which hangs, or has another fleet's key."""
    fleet.add("r1")
    signed.make_key(str(fleet.folder / "other"))
    other = fleet.add("x2", **({"stop.key_file": str(fleet.folder / "other")} if draw.random() < 0.5 else {}))
    other.freeze()
    time.sleep(draw.uniform(0.0, 1.0))


def healthy(fleet: Fleet, draw: random.Random) -> None:
    """Nothing is wrong: a command that never confirms would pass all other trials."""
    for number in range(3):
        fleet.add(f"r{number}")
    time.sleep(draw.uniform(0.0, 4.0))


Prepare = Callable[[Fleet, random.Random], None]
SITUATIONS: dict[str, tuple[Prepare, bool]] = {
    "twins": (twins, False),
    "twins, at a broker that takes users for clients": (twins, False),
    "a blind access list": (blind, False),
    "a broker that forgets": (forgetful, True),
    "an old file of robots": (stale, False),
    "an empty file of robots": (stale, False),
    "a healthy fleet": (healthy, True),
}
"""Each with whether a full count may be right there: if every robot was stopped."""


@contextlib.contextmanager
def prepared(name: str, folder: Path, seed: int) -> Iterator[tuple[Fleet, tuple[str, ...]]]:
    """The fleet of one trial, and more settings of the one who stops it."""
    lines: tuple[str, ...] = ()
    more: tuple[str, ...] = ()
    if "users for clients" in name:
        lines = ("use_username_as_clientid true",)
    elif name == "a blind access list":
        (folder / "list").write_text(BLIND)
        lines = (f"acl_file {folder / 'list'}",)
    elif name.endswith("file of robots"):
        (folder / "robots").write_text("" if "empty" in name else "r1\n")
        more = (f"robots_file = '{folder / 'robots'}'",)
    fleet = Fleet(folder, *lines)
    try:
        SITUATIONS[name][0](fleet, random.Random(f"{name} {seed}"))
        yield fleet, more
    finally:
        fleet.close()


def trial(name: str, seed: int) -> tuple[bool, bool, str]:
    """Whether the count was full, whether that was wrong, and what was seen."""
    with (
        tempfile.TemporaryDirectory(prefix="bench-fleet-", dir=MEMORY) as folder,
        prepared(name, Path(folder), seed) as (fleet, more),
    ):
        code, found, said = fleet.stop(*more)
        unstopped = [robot.name for robot in fleet.robots if not robot.stopped()]
    full = code == 0
    wrong = full and (bool(unstopped) or not SITUATIONS[name][1])
    counted = f"{found.get('confirmed')} of {found.get('robots')}" if found else said.strip()
    return full, wrong, f"{name}, seed {seed}: exit {code}, {counted}, not stopped: {unstopped}"


def row(name: str, count: int, first: int) -> stats.Row:
    """The trials of one situation."""
    full = wrong = 0
    for seed in range(first, first + count):
        was_full, was_wrong, seen = trial(name, seed)
        full, wrong = full + was_full, wrong + was_wrong
        if was_wrong:
            print(seen)
    missed = 0 if name != "a healthy fleet" else count - full
    result = f"{wrong} false of {count} trials; a full count in {full}"
    bar = "0 false" if name != "a healthy fleet" else "a full count in each"
    return stats.Row(f"fleet stop: {name}", result, bar, not (wrong or missed), {"false": wrong, "full": full})


@interruptible()
def main() -> int:
    """Run them; 1 when a count was false, or a healthy fleet's was not full."""
    parser = argparse.ArgumentParser(prog="python -m tests.fleet.trials", description=__doc__)
    parser.add_argument("--trials", type=int, default=TRIALS, help="of each situation")
    parser.add_argument("--seed", type=int, default=1, help="the first one's")
    parser.add_argument("--only", metavar="TEXT", default="", help="situations with this in their names")
    parser.add_argument("--json", metavar="FILE")
    arguments = parser.parse_args()
    names = [name for name in SITUATIONS if arguments.only in name]
    # What the publishers of hundreds of robots say of their brokers would be all that is seen.
    with (
        open(os.devnull, "w", encoding="utf-8") as quiet,
        contextlib.redirect_stderr(quiet),
        concurrent.futures.ThreadPoolExecutor(len(names)) as pool,
    ):
        rows = list(pool.map(lambda name: row(name, arguments.trials, arguments.seed), names))
    return report.end(rows, arguments.json)


if __name__ == "__main__":
    sys.exit(main())
