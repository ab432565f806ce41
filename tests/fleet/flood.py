"""A flood of forged stops: `python -m tests.fleet.flood`. One robot with the publisher of real ones, a stranger who
sends so many forged stops a second, and genuine stops meanwhile, timed by their sender.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import os
import socket
import struct
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Iterator

import psutil

from bench import report, stats
from bench.report import progress
from failstop.fleet import signed, topics
from failstop.fleet.levels import Order
from failstop.fleet.publisher import Publisher
from failstop.fleet.sender import Sender
from failstop.fleet.settings import FleetSettings
from failstop_lab.trial import TrialError
from tests.fleet.robots import FLEET, Pretended
from tests.fleet.thousand import MEMORY, broker

RATES = (1_000, 5_000, 10_000, 20_000, 40_000)
STOPS = 5
WAIT_S = 10.0
FLOODED_S = 3.0
"""Before a stop: what piles up has piled up."""
BATCH_S = 0.005
BAR_S = 2.0
ROBOT = "robot-1"
CONNECT = b"\x10\x13\x00\x04MQTT\x04\x02\x00\x00\x00\x07flooder"


def packet(topic: str, payload: bytes, qos: int) -> bytes:
    """A message as MQTT has it."""
    name = topic.encode()
    rest = struct.pack(">H", len(name)) + name + (b"\x00\x01" if qos else b"") + payload
    length, size = len(rest), b""
    while True:
        length, digit = divmod(length, 128)
        size += bytes([digit | (0x80 if length else 0)])
        if not length:
            return bytes([0x30 | qos << 1]) + size + rest


class Flooder:
    """Sends forged stops, so many a second, until the context ends."""

    def __init__(self, port: int, rate: int, qos: int) -> None:
        junk = Order("f" * 32, time.time(), "smoke", "ann").message(bytes(32))
        self._each = max(1, round(rate * BATCH_S))
        self._batch = packet(topics.stop(FLEET), junk, qos) * self._each
        self._socket = socket.create_connection(("127.0.0.1", port))
        self._socket.sendall(CONNECT)
        self._ended = threading.Event()
        self._threads = [threading.Thread(target=part, daemon=True) for part in (self._send, self._drop)]
        self.sent = 0

    def __enter__(self) -> Flooder:
        self.since_s = time.monotonic()
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._ended.set()
        with contextlib.suppress(OSError):
            self._socket.shutdown(socket.SHUT_RDWR)
        for thread in self._threads:
            thread.join()
        self._socket.close()

    def rate(self) -> float:
        """Messages a second that the broker has taken."""
        return self.sent / (time.monotonic() - self.since_s)

    def _send(self) -> None:
        with contextlib.suppress(OSError):
            for number in itertools.count(1):
                if self._ended.wait(max(0.0, self.since_s + number * BATCH_S - time.monotonic())):
                    return
                self._socket.sendall(self._batch)
                self.sent += self._each

    def _drop(self) -> None:
        """The broker's acknowledgements."""
        with contextlib.suppress(OSError):
            while self._socket.recv(1 << 16):
                pass


@contextlib.contextmanager
def robot(port: int, key: str, folder: str) -> Iterator[psutil.Process]:
    """One robot in a process of its own, connected."""
    words = [sys.executable, "-m", "tests.fleet.flood", "--robot", str(port), key, folder]
    with subprocess.Popen(words, stdout=subprocess.PIPE, stderr=subprocess.DEVNULL, text=True) as running:
        assert running.stdout is not None
        try:
            if running.stdout.readline() != "ready\n":
                raise TrialError("the process of the robot ended")
            yield psutil.Process(running.pid)
        finally:
            running.kill()


def publish(port: int, key: str, folder: str) -> None:
    """Be that robot."""
    settings = FleetSettings({"broker.port": port, "stop.key_file": key, "robot.fleet": FLEET})
    publisher = Publisher(settings, "failstop", Pretended(1), ROBOT, folder)
    while not publisher.broker.listening:
        publisher.turn()
    print("ready", flush=True)
    while True:
        publisher.turn()


def flooded(settings: FleetSettings, port: int, rate: int, qos: int, watched: psutil.Process) -> stats.Row:
    """How many genuine stops are confirmed meanwhile, and when the last one is."""
    took_ns, whys = [], []
    progress("a stop without a flood, until no robot may still be connecting to the new broker")
    if not Sender(settings, "bench", "bench").run():
        raise TrialError("a stop was not confirmed even without a flood")
    with Flooder(port, rate, qos) as flooder:
        time.sleep(FLOODED_S)
        before_s, begin_s = sum(watched.cpu_times()[:2]), time.monotonic()
        for number in range(STOPS):
            progress(f"{rate} a second, quality of service {qos}: stop {number + 1} of {STOPS}")
            sender = Sender(settings, "bench", "bench")
            if sender.run(WAIT_S):
                took_ns.append(round(sender.tally.times_s("acknowledged")[-1] * 1e9))
            else:
                whys += [*(row.why for row in sender.tally.missing()), *sender.doubts]
        percent = 100 * (sum(watched.cpu_times()[:2]) - before_s) / (time.monotonic() - begin_s)
        real = flooder.rate()
    slowest_s = max(took_ns, default=0) / 1e9
    result = f"{len(took_ns)} of {STOPS} confirmed, the last after {slowest_s:.2f} s, {percent:.0f} % of a core"
    result += "".join(f"; {why}" for why in sorted(set(whys)))
    met = len(took_ns) == STOPS and slowest_s <= BAR_S
    measure = f"{real:,.0f} forged a second ({rate:,} wanted), sent with QoS {qos}"
    numbers = {"rate": real, "confirmed": len(took_ns), "slowest_s": slowest_s, "percent": percent}
    return stats.Row(measure, result, f"all within {BAR_S:g} s", met, numbers)


def main() -> int:
    """Run it; 1 when a stop was not confirmed in time."""
    parser = argparse.ArgumentParser(prog="python -m tests.fleet.flood", description=__doc__)
    parser.add_argument("--rates", type=int, nargs="*", default=RATES)
    parser.add_argument("--robot", nargs=3, help=argparse.SUPPRESS)
    parser.add_argument("--json", metavar="FILE")
    arguments = parser.parse_args()
    if arguments.robot:
        port, key, folder = arguments.robot
        publish(int(port), key, folder)
    rows = []
    for rate, qos in itertools.product(arguments.rates, (0, 1)):
        with tempfile.TemporaryDirectory(prefix="bench-fleet-", dir=MEMORY) as folder, broker(folder) as (port, _):
            key = os.path.join(folder, "key")
            signed.make_key(key)
            settings = FleetSettings({"broker.port": port, "stop.key_file": key, "robot.fleet": FLEET})
            with robot(port, key, folder) as watched:
                rows.append(flooded(settings, port, rate, qos, watched))
    return report.end(rows, arguments.json)


if __name__ == "__main__":
    sys.exit(main())
