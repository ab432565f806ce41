"""Many pretended robots in one process, each with a connection and the publisher of a real one: a part of
tests.fleet.thousand.

python -m tests.fleet.robots PORT KEY FOLDER FIRST COUNT: says `ready`, then works until its input ends.
"""

from __future__ import annotations

import dataclasses
import os
import select
import sys
import time

from failstop.api.events import Event
from failstop.api.snapshot import Device, Process, State, Stop, Velocity, Wheels
from failstop.fleet.publisher import Publisher
from failstop.fleet.settings import FleetSettings
from failstop.policy import causes

FLEET = "bench"
ACKNOWLEDGED_S = 0.005
OBSERVED_S = 0.9
"""When a real robot knows that."""
MISC_S = 1.0
TURN_S = 0.01
LOOK_TURNS = 100
"""A robot without a stop is looked at once in so many turns: a thousand of them share these processors."""
PROCESS_NAMES = ("supervisor", "port_owner", "stopper", "gate", "telemetry")


class Pretended:
    """A robot without a service; its state changes now and then, and a stop gets its proofs as a real one does."""

    def __init__(self, number: int) -> None:
        self.run = "run 1"
        self._asked_s = 0.0
        self._driving = bool(number % 3)
        process = Process(1, "running", 0.005, 0, None, 0.02, realtime=True, memory_locked=True)
        self._state = State(
            name="failstop", enabled=True, estop=None, cause=None, blocked=None if self._driving else "cmd timeout",
            body_vel=Velocity(0.1 * self._driving, 0.0, 0.0),
            wheels_radps=Wheels((2.5 * self._driving,) * 4), epoch=1, waiting_for=None,
            device=Device("/dev/ttyACM0", "open", "alive"),
            processes=dict.fromkeys(PROCESS_NAMES, process), starved=None, clients=(), sources=(), scan_age_s=0.05,
            last_stop=None, imu=None, gyro_bias=None, odometry=None, pad_mode=None, battery_v=12.0,
            plugged="unknown", age_s=0.01,
        )  # fmt: skip
        self._moving = self._state

    def read(self) -> State:
        """As a service publishes it."""
        stop, age_s = self._state.last_stop, time.monotonic() - self._asked_s
        if stop and stop.observed_s is None:
            acknowledged = 0.005 if age_s > ACKNOWLEDGED_S else None
            known = dataclasses.replace(
                stop, acknowledged_s=acknowledged, observed_s=0.3 if age_s > OBSERVED_S else None
            )
            self._state = dataclasses.replace(self._state, last_stop=known)
        elif stop and age_s > 2 * OBSERVED_S:
            self._state = dataclasses.replace(self._moving, epoch=self._state.epoch)  # reset, and off again
        return self._state

    def events(self) -> list[Event]:
        """None of them is told of."""
        return []

    def stop(self, reason: str, by: str) -> str:
        """Latched and written at once."""
        self._asked_s = time.monotonic()
        cause = causes.REQUESTED(reason, by, 1)
        epoch = self._state.epoch + 1
        stop = Stop(cause, str(cause), time.time(), "port_owner", "port_owner", 2e-4, None, None, epoch)
        self._state = dataclasses.replace(
            self._state, enabled=False, estop=str(cause), cause=cause, blocked=f"estop: {cause}", epoch=epoch,
            body_vel=Velocity(0.0, 0.0, 0.0), wheels_radps=Wheels((0.0,) * 4), last_stop=stop,
        )  # fmt: skip
        return ""


def main(port: int, key: str, folder: str, first: int, count: int) -> None:
    """Run them."""
    publishers = []
    for number in range(first, first + count):
        name = f"robot-{number}"
        store = os.path.join(folder, name)
        os.makedirs(store, exist_ok=True)
        settings = FleetSettings({"broker.port": port, "stop.key_file": key, "robot.fleet": FLEET})
        publishers.append(Publisher(settings, name, Pretended(number), name, store))
    poll = select.epoll()
    by_fd: dict[int, Publisher] = {}
    misc_s, told, turn = 0.0, False, 0
    while True:
        now_s = time.monotonic()
        if not told or now_s >= misc_s:
            misc_s = now_s + MISC_S
            for publisher in publishers:
                publisher.broker.serve(readable=False)
                if publisher.broker.fileno() < 0:
                    publisher.broker.connect(now_s)
                    if (fd := publisher.broker.fileno()) >= 0:
                        by_fd[fd] = publisher
                        poll.register(fd, select.EPOLLIN)
        if not told and not any(publisher.broker.problem for publisher in publishers):
            told = True
            poll.register(0, select.EPOLLIN)
            print("ready", flush=True)
        for fd, _ in poll.poll(TURN_S):
            if fd == 0:
                return
            by_fd[fd].broker.serve(readable=True)
        now_s = time.monotonic()
        turn = (turn + 1) % LOOK_TURNS
        for number, publisher in enumerate(publishers):
            if publisher.busy(now_s) or number % LOOK_TURNS == turn:
                publisher.look(now_s)


if __name__ == "__main__":
    main(int(sys.argv[1]), sys.argv[2], sys.argv[3], int(sys.argv[4]), int(sys.argv[5]))
