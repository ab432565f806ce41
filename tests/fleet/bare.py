"""Clients of the broker that answer each message at once and do nothing else: the floor of tests.fleet.thousand.

python -m tests.fleet.bare PORT FIRST COUNT: says `ready`, then works until its input ends.
"""

from __future__ import annotations

import select
import sys
import time

import paho.mqtt.client as mqtt
from paho.mqtt.enums import CallbackAPIVersion

TOPIC = "bare/stop"
ANSWERS = "bare/answer"
PROOFS = 3
"""Answers of each client to a stop: as many as a robot gives."""
PAYLOAD = b"x" * 300
"""About as long as a robot's answer."""
WAIT_S = 120.0


def client(port: int, name: str) -> mqtt.Client:
    """A connected client. Raises OSError."""
    made = mqtt.Client(CallbackAPIVersion.VERSION2, client_id=name)
    made.connect("127.0.0.1", port)
    return made


def main(port: int, first: int, count: int) -> None:
    """Run so many."""
    poll = select.epoll()
    by_fd: dict[int, mqtt.Client] = {}
    waiting = count

    def subscribed(*_: object) -> None:
        nonlocal waiting
        waiting -= 1
        if waiting == 0:
            print("ready", flush=True)

    def answer(each: mqtt.Client, name: str, _message: mqtt.MQTTMessage) -> None:
        for _ in range(PROOFS):
            each.publish(f"{ANSWERS}/{name}", PAYLOAD)

    for number in range(first, first + count):
        each = client(port, f"bare-{number}")
        each.user_data_set(f"robot-{number}")
        each.on_connect = lambda made, *_: made.subscribe(TOPIC)
        each.on_subscribe = subscribed
        each.on_message = answer
        connection = each.socket()
        assert connection is not None
        fd = connection.fileno()
        by_fd[fd] = each
        poll.register(fd, select.EPOLLIN)
    poll.register(0, select.EPOLLIN)
    while True:
        for fd, _ in poll.poll():
            if fd == 0:
                return
            by_fd[fd].loop_read()
            while by_fd[fd].want_write():
                by_fd[fd].loop_write()


def stop(port: int, count: int) -> int:
    """Tell all clients once, and hear every answer; returns the ns that took. Raises TimeoutError."""
    heard = 0

    def hear(*_: object) -> None:
        nonlocal heard
        heard += 1

    listening: list[bool] = []
    sender = client(port, "bare-sender")
    sender.on_connect = lambda made, *_: made.subscribe(f"{ANSWERS}/#")
    sender.on_subscribe = lambda *_: listening.append(True)
    sender.on_message = hear
    until_s = time.monotonic() + WAIT_S
    begun_ns = 0
    while heard < PROOFS * count:
        if time.monotonic() > until_s:
            raise TimeoutError(f"{heard} of {PROOFS * count} answers of bare clients came")
        if listening and not begun_ns:
            begun_ns = time.monotonic_ns()
            sender.publish(TOPIC, PAYLOAD)
        sender.loop(0.05)
    took_ns = time.monotonic_ns() - begun_ns
    sender.disconnect()
    return took_ns


if __name__ == "__main__":
    main(int(sys.argv[1]), int(sys.argv[2]), int(sys.argv[3]))
