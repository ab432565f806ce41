"""The bridge to ROS 2, on a real rclpy: `python -m bench.ros2`, with ROS's setup.sh sourced.

Times are the simulated board's, and of publishers that write the time into each message: one clock for all processes.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import random
import re
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator

import psutil

from bench import report, stats
from bench.carriers import Carriers
from bench.report import progress
from failstop.api.errors import FailstopError
from failstop.ros2.command import find_rclpy
from failstop.ros2.contract import IMU, ODOMETRY, STATE
from failstop.ros2.stage import StageProcess, bridge, environment, publisher
from failstop.setup.ending import interruptible
from failstop_lab.trial import Trial, TrialError, wait_for

TIMEOUT_MS = 300.0
CONNECT_S = 20.0
LEASE_S = 30.0
"""Longer than Fast DDS counts a publisher that was killed."""
SETTLED_S = 2.0
MOST_PERCENT = 8.0
"""The share of a core that the bridge may take."""
RIVAL_HZ = 100.0
DEATH_EVERY = 50
BRIDGE_DEATH_EVERY = 100
"""In the rounds of second publishers: so often one is killed, and the bridge."""


class Node:
    """A process of ros2_node.py."""

    def __init__(self, name: str) -> None:
        self.process = subprocess.Popen(
            [sys.executable, "-m", "bench.ros2_node", name],
            env=environment(),
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            bufsize=1,
        )
        self._line()

    def _line(self) -> str:
        assert self.process.stdout is not None
        return self.process.stdout.readline().strip()

    def ask(self, text: str) -> str:
        """Have it do something; returns the answer."""
        assert self.process.stdin is not None
        self.process.stdin.write(f"{text}\n")
        return self._line()

    def kill(self) -> None:
        """It stays in the graph for a while."""
        self.process.kill()
        self.end()

    def end(self) -> None:
        """The end of its input ends it in order."""
        for pipe in (self.process.stdin, self.process.stdout):
            if pipe:
                pipe.close()
        self.process.wait()


class Scene:
    """Board, service, bridge, a lidar and a node that drives."""

    def __init__(self, rest: contextlib.ExitStack) -> None:
        self.rest = rest
        self.trial = rest.enter_context(Trial(f"bench-ros2-{time.monotonic_ns() % 10**6}"))
        self.log = rest.enter_context(tempfile.NamedTemporaryFile("r", suffix=".log"))  # noqa: SIM115
        rest.enter_context(publisher("lidar", "scan", 10.0))
        self.driver = Node("nav")
        rest.callback(self.driver.end)
        self.driver.ask("steady 20")
        self.bridge: StageProcess
        self.start_bridge()

    def start_bridge(self) -> None:
        """Anew, and wait until it passes commands on."""
        self.bridge = bridge(self.trial.name, self.log.name)
        self.rest.callback(self.bridge.end)
        self.ready()

    def sees(self, text: str) -> bool:
        """The bridge that runs now says so: the claim of a killed one may still be there."""
        pid = self.bridge.process.pid
        return any(text in client.sees for client in self.trial.robot.state.clients if client.pid == pid)

    def ready(self) -> None:
        """One node commands, a scan comes."""
        wait_for("the bridge to see nav and lidar", lambda: self.sees("cmd_vel: /nav; scan: /lidar"), LEASE_S)

    def moving(self) -> None:
        """Enabled and driving."""

        def moves() -> bool:
            with contextlib.suppress(FailstopError):
                self.trial.enable()
            return self.trial.turning()

        wait_for("the wheels to turn", moves, LEASE_S)

    def zero_after(self, ns: int) -> int:
        """How long after `ns` the wheels were told to stand; in ns."""
        stop = self.trial.board.wait_for(lambda e: e.is_motor and not any(e.speeds) and e.arrival_ns > ns, 10.0)
        return stop.arrival_ns - ns


def kills(scene: Scene, count: int, carriers: Carriers) -> stats.Row:
    """SIGKILL of the bridge while driving."""
    found = []
    for turn in range(count):
        progress(f"bridge killed, {turn + 1} of {count}")
        scene.moving()
        carriers.first()
        time.sleep(random.uniform(0.1, 0.2))
        scene.trial.board.events()
        killed_ns = time.monotonic_ns()
        scene.bridge.kill()
        found.append(scene.zero_after(killed_ns))
        scene.start_bridge()
    return stats.timing("bridge killed while driving -> wheels zero", found, p50_ms=None, p99_ms=5.0)


def hangs(scene: Scene, count: int) -> stats.Row:
    """SIGSTOP of the bridge while driving."""
    found = []
    for turn in range(count):
        progress(f"bridge stopped, {turn + 1} of {count}")
        scene.moving()
        time.sleep(random.uniform(0.1, 0.2))
        scene.trial.board.events()
        stopped_ns = time.monotonic_ns()
        scene.bridge.kill(signal.SIGSTOP)
        found.append(scene.zero_after(stopped_ns))
        scene.bridge.kill(signal.SIGCONT)
        scene.ready()
    return stats.timing("bridge stopped (SIGSTOP) while driving -> zero", found, p50_ms=None, p99_ms=TIMEOUT_MS + 20)


def seconds(scene: Scene, count: int, seed: int) -> list[stats.Row]:
    """Second publishers that join, leave and die, and bridges that die meanwhile."""
    chance = random.Random(seed)
    rival = Node("rival")
    wrong, moved, latched, worst = 0, 0, 0, 0
    for turn in range(count):
        progress(f"second publishers, {turn + 1} of {count}")
        scene.moving()
        scene.trial.board.events()
        rival.ask(f"join {RIVAL_HZ}")
        if turn % BRIDGE_DEATH_EVERY == BRIDGE_DEATH_EVERY - 1:
            time.sleep(chance.uniform(0.0, 0.1))
            scene.bridge.kill()
            rival.ask("leave")
            scene.start_bridge()
        else:
            wait_for("the stop", lambda: bool(scene.trial.robot.state.estop), CONNECT_S)
            latched += 1
            time.sleep(chance.uniform(0.0, 0.1))
            if turn % DEATH_EVERY == DEATH_EVERY - 1:
                rival.kill()
                rival = Node("rival")
            else:
                rival.ask("leave")
        events = [event for event in scene.trial.board.events() if event.is_motor]
        wrong += sum(event.speeds[0] < 0 for event in events)
        stops = [event for event in events if event.is_stop]
        moved += sum(event.is_motion for event in events if stops and event.index > stops[-1].index)
        worst = max(worst, len(stops))
    rival.end()
    return [
        stats.count("second publisher: its commands that reached a wheel", wrong, count),
        stats.Row("rounds that latched", f"{latched} of {count}", "-", None, {"latched": latched, "of": count}),
    ]


def latency(scene: Scene, seconds_s: float, carriers: Carriers) -> stats.Row:
    """From the publisher to the motor frame, against an empty callback of rclpy's in the same run."""
    listener = Node("listener")
    listener.ask("listen")
    scene.moving()
    wait_for("the listener to hear commands", lambda: listener.ask("told"), LEASE_S)
    scene.trial.board.events()
    carriers.first()
    progress(f"latency, {seconds_s:g} s")
    arrivals = _changes(scene, seconds_s)
    empty = [int(word) for word in listener.ask("told").split()]
    listener.end()
    share_ms = stats.percentiles(empty)[0]
    row = stats.timing("cmd_vel published -> motor frame at the board", arrivals, p50_ms=share_ms + 1, p99_ms=None)
    row.result += f"  (rclpy's own share: p50 {share_ms:.2f} ms)"
    return row


def _changes(scene: Scene, seconds_s: float) -> list[int]:
    """How long each command took that changes the speed a little: nothing else changes it meanwhile."""
    scene.driver.ask("rest")
    found: list[int] = []
    until_s = time.monotonic() + seconds_s
    for speed in itertools.cycle((0.2, 0.195)):
        if time.monotonic() > until_s:
            break
        time.sleep(0.03 + random.uniform(0, 0.02))
        published_ns = int(scene.driver.ask(f"once {speed}"))
        with contextlib.suppress(TimeoutError):
            event = scene.trial.board.wait_for(
                lambda e, sent_ns=published_ns: e.is_motion and e.arrival_ns > sent_ns,  # type: ignore[misc]
                1.0,  # type: ignore[misc]
            )
            found.append(event.arrival_ns - published_ns)
    scene.driver.ask("steady 20")
    return found


def cost(scene: Scene, seconds_s: float) -> list[stats.Row]:
    """Processor and memory of the bridge at the old driver's rates, with somebody who hears it."""
    eyes = Node("eyes")
    for topic in (IMU, ODOMETRY):
        eyes.ask(f"hear {topic.name} {topic.type}")
    eyes.ask(f"hear /rosorin_board_driver/state {STATE.type}")
    scene.moving()
    progress(f"cost, {seconds_s:g} s")
    share = processor(scene.bridge.process.pid, seconds_s)
    memory = psutil.Process(scene.bridge.process.pid).memory_full_info()
    eyes.end()
    bare, eyes = Node("bare"), Node("eyes")
    for topic in (IMU, ODOMETRY, STATE):
        eyes.ask(f"hear bare/{topic.name.strip('~/')} {topic.type}")
    bare.ask("bare")
    progress(f"the cost of a bare node, {seconds_s:g} s")
    floor = processor(bare.process.pid, seconds_s)
    bare.end()
    eyes.end()
    told = f"a bare rclpy node with the same traffic takes {floor:.1f}"
    what = "bridge: processor, IMU 110 Hz, odometry 50, cmd_vel 20, scan 10"
    return [
        stats.limit(what, share, MOST_PERCENT, "% of a core", told),
        stats.limit("bridge: memory (PSS)", memory.pss / 1e6, 70, "MB", f"resident {memory.rss / 1e6:.1f}"),
    ]


def processor(pid: int, seconds_s: float) -> float:
    """A process's use, in % of a core."""
    process = psutil.Process(pid)
    time.sleep(SETTLED_S)
    before, start_s = process.cpu_times(), time.monotonic()
    time.sleep(seconds_s)
    after, took_s = process.cpu_times(), time.monotonic() - start_s
    return 100 * (after.user + after.system - before.user - before.system) / took_s


def starts(scene: Scene) -> stats.Row:
    """From the start of the process to the first state that it published, by its own word."""
    with open(scene.log.name, encoding="utf-8", errors="replace") as file:
        found = [int(float(text) * 1e9) for text in re.findall(r"first state ([\d.]+) s after the start", file.read())]
    row = stats.timing("start of the bridge -> first state published", found, p50_ms=1500, p99_ms=None)
    row.numbers["starts"] = len(found)
    return row


def measure(arguments: argparse.Namespace) -> Iterator[stats.Row]:
    """Every row."""
    with contextlib.ExitStack() as rest:
        scene = Scene(rest)
        carriers = rest.enter_context(Carriers())
        yield from cost(scene, arguments.seconds)
        yield latency(scene, arguments.seconds, carriers)
        yield kills(scene, arguments.kills, carriers)
        yield hangs(scene, arguments.hangs)
        yield starts(scene)
        yield from seconds(scene, arguments.count, arguments.seed)


@interruptible()
def main() -> int:
    """Run it; exit code 1 when a bar is missed."""
    parser = argparse.ArgumentParser(prog="python -m bench.ros2", description=__doc__)
    parser.add_argument("--count", type=int, default=1000, help="joins of a second publisher (default: 1000)")
    parser.add_argument("--kills", type=int, default=100, help="SIGKILLs of the bridge (default: 100)")
    parser.add_argument("--hangs", type=int, default=20, help="SIGSTOPs of the bridge (default: 20)")
    parser.add_argument("--seconds", type=float, default=15.0, help="for the cost, and for the latency (default: 15)")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--json", metavar="FILE", help="write the rows there too")
    arguments = parser.parse_args()
    try:
        find_rclpy()
        rows = list(measure(arguments))
    except (FailstopError, TrialError) as error:
        print(f"bench.ros2: {error}", file=sys.stderr)
        return 1
    return report.end(rows, arguments.json, {"seed": arguments.seed})


if __name__ == "__main__":
    sys.exit(main())
