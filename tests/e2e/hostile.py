"""Clients that misbehave, each a program of its own: `python -m tests.e2e.hostile PROGRAM NAME [WORDS]`.

They run as user nobody in the group that may drive, where this machine lets them become that. A program says a line
when it has begun what it does, and goes on until it is killed.
"""

from __future__ import annotations

import os
import random
import signal
import sys
from collections.abc import Callable

from failstop import FailstopError, Robot
from failstop.api.client import Client, run
from failstop.files import instance
from failstop.messages import layout, segments
from failstop.shm import bell, cell

NOBODY = 65534


def become_nobody(name: str) -> None:
    """User nobody, in the group of the service's client slots."""
    if os.getuid() == 0:
        gid = os.stat(instance.claims_path(instance.find(name))).st_gid
        os.setgroups([])
        os.setresgid(gid, gid, gid)
        os.setresuid(NOBODY, NOBODY, NOBODY)


def begun(said: object = "begun") -> None:
    """Tell the test."""
    print(said, flush=True)


def slot_file(name: str, index: int) -> int:
    """A slot's memory, by the right that the group has."""
    return os.open(segments.path_of(run(name)[0], f"client.{index}"), os.O_RDWR | os.O_CLOEXEC)


def nursery(name: str) -> None:
    """Forks a child for every line on stdin, and says its pid; the child calls anything until it is killed."""
    signal.signal(signal.SIGCHLD, signal.SIG_IGN)
    begun()
    while sys.stdin.readline():
        pid = os.fork()
        if pid == 0:
            try:
                call_anything(name, random.Random(os.getpid()))
            finally:
                os._exit(1)
        begun(pid)


def call_anything(name: str, dice: random.Random) -> None:
    """One call after the other, without a rest."""
    while True:
        with Robot(name, client="to be killed") as robot:
            for _ in range(dice.randrange(1, 12)):
                try:
                    call_one(robot, dice)
                except FailstopError:
                    continue


def call_one(robot: Robot, dice: random.Random) -> None:
    """Any call, drive() and enable() more often than the others."""
    calls: tuple[Callable[[], object], ...] = (
        lambda: robot.drive(dice.choice((-5.0, 5.0)), 0.0, 0.0, manual=True),
        lambda: robot.drive(0.1, 0.1, 1.0),
        robot.sensed,
        robot.enable,
        robot.enable,
        robot.disable,
        robot.reset,
        lambda: robot.estop("random"),
        lambda: robot.assert_interlocks("anything"),
        lambda: robot.state,
    )
    dice.choice(calls)()


def scribble(name: str, *slots: str) -> None:
    """Random bytes at random places of these slots, as fast as it goes; without any, of a slot that it has claimed."""
    dice = random.Random(1)
    client = Client(name, "scribbler") if not slots else None
    indices = [client.slot] if client else [int(slot) for slot in slots]
    files = [slot_file(name, index) for index in indices]
    size = layout.SEGMENT_BY_NAME["client.0"].size
    to_bell = bell.open_pipe_to_write(instance.bell_path(instance.find(name)))
    begun()
    while True:
        for fd in files:
            for _ in range(20):
                os.pwrite(fd, dice.randbytes(dice.choice((1, 8, 200))), dice.randrange(size - 200))
        bell.send(to_bell, bytes(indices))


def garble(name: str, index: str) -> None:
    """Random bytes into the velocity that another client commands, as fast as it goes, and nothing else: what is there
    still looks like a command of its session."""
    dice = random.Random(1)
    fd = slot_file(name, int(index))
    spec = layout.SEGMENT_BY_NAME[f"client.{index}"]
    size = cell.cell_bytes(spec.records["command"].capacity)
    velocity = spec.offsets["command"] + cell.CELL_HEADER_BYTES + 8  # after the session
    begun()
    while True:
        for half in (0, size):
            os.pwrite(fd, dice.randbytes(2), velocity + half + 6)  # sign, exponent and the first bits of vx


def flood(name: str) -> None:
    """Writes into the bell without an end."""
    fd = os.open(instance.bell_path(instance.find(name)), os.O_WRONLY | os.O_CLOEXEC)  # blocks while it is full
    begun()
    block = random.Random(1).randbytes(1 << 16)
    while True:
        os.write(fd, block)


if __name__ == "__main__":
    become_nobody(sys.argv[2])
    {each.__name__: each for each in (nursery, scribble, garble, flood)}[sys.argv[1]](*sys.argv[2:])
