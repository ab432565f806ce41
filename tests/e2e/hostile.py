"""Clients that misbehave, each a program of its own: `python -m tests.e2e.hostile PROGRAM NAME [WORDS]`.

They run as user nobody in the group that may drive, where this machine lets them become that. A program says a line
when it has begun what it does, and goes on until it is killed.
"""

from __future__ import annotations

import errno
import fcntl
import os
import random
import signal
import stat
import struct
import sys
import time
from collections.abc import Callable

from failstop import FailstopError, Robot
from failstop.api.client import Client, attach, run, send_stop
from failstop.files import instance
from failstop.messages import layout, records, segments
from failstop.shm import bell, cell, claim, segment
from failstop.shm.lifeline import pid_namespace

NOBODY = 65534
REST_S = 0.02


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


def rest() -> None:
    """Do nothing until killed."""
    while True:
        signal.pause()


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
        lambda: robot.hold("anything"),
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


def resize(name: str, size: str) -> None:
    """Truncates, or grows, the memory of the slot that it has."""
    client = Client(name, "resizer")
    fd = slot_file(name, client.slot)
    os.ftruncate(fd, int(size))
    client.command(0.1, 0.0, 0.0, manual=True, source="cmd_vel") if int(size) else None
    begun(client.slot)
    rest()


def vandal(name: str) -> None:
    """Tries to remove and to replace what the service has in the file system; says what it could."""
    directory = instance.find(name)
    things = [os.path.join(directory, one) for one in sorted(os.listdir(directory))]
    things += sorted("/dev/shm/" + one for one in os.listdir("/dev/shm") if one.startswith(f"failstop.{name}."))
    done = []
    for path in things:
        for verb, action in (
            ("unlink", os.unlink),
            ("rename", lambda it: os.rename(it, it + "-gone")),
            ("chmod", lambda it: os.chmod(it, 0o777)),
            ("replace", lambda it: os.rename(_fifo(), it)),
            ("truncate", lambda it: os.truncate(it, 0)),
        ):
            if verb == "truncate" and stat.S_ISFIFO(os.stat(path).st_mode):
                continue
            try:
                action(path)
            except OSError:
                continue
            done.append(f"{verb} {os.path.basename(path)}")
    os.unlink(_fifo())
    begun(len(things))
    begun(", ".join(done))


def _fifo() -> str:
    """A FIFO of its own, to put in another's place."""
    path = f"/tmp/hostile-{os.getpid()}"
    if not os.path.exists(path):
        os.mkfifo(path)
    return path


def ring(name: str) -> None:
    """Rings the bell, one byte at a time, whether or not there is room."""
    fd = bell.open_pipe_to_write(instance.bell_path(instance.find(name)))
    begun()
    while True:
        bell.send(fd, b"\0")


def flood(name: str, pipe: str) -> None:
    """Writes into the bell or the stop pipe without an end."""
    directory = instance.find(name)
    path = {"bell": instance.bell_path, "stop": instance.stop_path}[pipe](directory)
    fd = os.open(path, os.O_WRONLY | os.O_CLOEXEC)  # blocks when it is full: every byte goes through the service
    begun()
    block = random.Random(1).randbytes(1 << 16)
    while True:
        os.write(fd, block)


def hold_all(name: str) -> None:
    """Takes every slot that is free; says how many."""
    clients: list[Client] = []
    try:
        while True:
            clients.append(Client(name, f"holder {len(clients)}"))
    except FailstopError:
        begun(len(clients))
    rest()


def claim_bytes(name: str) -> None:
    """Takes the claims of all free slots, with nobody in them; says how many."""
    fd = claim.open_claims(instance.claims_path(instance.find(name)))
    begun(sum(claim.acquire(fd, index) for index in range(layout.CLIENT_SLOTS)))
    rest()


def lock_everything(name: str) -> None:
    """One lock over the whole claims file, and far beyond; says whether it got it."""
    fd = claim.open_claims(instance.claims_path(instance.find(name)))
    whole = struct.pack("hhqqi4x", fcntl.F_WRLCK, os.SEEK_SET, 0, 0, 0)
    try:
        fcntl.fcntl(fd, fcntl.F_OFD_SETLK, whole)
    except OSError as error:
        begun(errno.errorcode[error.errno or 0])
    else:
        begun("locked")
    rest()


def heir(name: str, index: str) -> None:
    """Waits for the claim of somebody else's slot, to keep it held when that one leaves; says when it has it."""
    fd = claim.open_claims(instance.claims_path(instance.find(name)))
    begun()
    while not claim.acquire(fd, int(index)):
        pass
    begun()
    rest()


def replay(name: str, index: str) -> None:
    """Copies a client's memory while it drives, waits until it has left, and plays it back under its own claim."""
    fd = slot_file(name, int(index))
    found = os.pread(fd, layout.SEGMENT_BY_NAME[f"client.{index}"].size, 0)
    begun()
    with Robot(name) as robot:
        while robot.state.clients:
            time.sleep(REST_S)
    claims = claim.open_claims(instance.claims_path(instance.find(name)))
    to_bell = bell.open_pipe_to_write(instance.bell_path(instance.find(name)))
    while not (has_claim := claim.acquire(claims, int(index))):  # who leaves lets go of it last
        time.sleep(REST_S)
    begun(has_claim)
    while True:
        os.pwrite(fd, found, 0)
        bell.send(to_bell, bytes([int(index)]))
        time.sleep(REST_S)


def other_run(name: str) -> None:
    """Hello and commands of a run that is not this one, in a slot that it has claimed as it should."""
    client = Client(name, "of another run")
    incarnation = attach(name, layout.GATE).incarnation ^ 1
    spec = layout.SEGMENT_BY_NAME[f"client.{client.slot}"]
    fd = slot_file(name, client.slot)
    old = segment.Segment(spec, incarnation, fd=fd)
    to_bell = bell.open_pipe_to_write(instance.bell_path(instance.find(name)))
    begun()
    while True:
        old.latest_writer("hello").write(records.HELLO.pack(77, os.getpid(), 0, "of another run"))
        old.latest_writer("command").write(records.COMMAND.pack(77, 0.2, 0.0, 0.0, True, "cmd_vel"))
        old.latest_writer("request").write(records.REQUEST.pack(77, 1, records.DISABLE))
        bell.send(to_bell, bytes([client.slot]))
        time.sleep(REST_S)


def disable_flood(name: str) -> None:
    """Disables as fast as it goes, waiting for no answer, for 0.2 s."""
    robot = Client(name, "disabler")
    requests = robot._segment.latest_writer("request")
    end_s = time.monotonic() + 0.2
    number = 0
    begun()
    while time.monotonic() < end_s:
        number += 1
        requests.write(records.REQUEST.pack(robot._session, number, records.DISABLE))
        robot._ring()
    begun()
    rest()


def unknown_source(name: str) -> None:
    """Commands as a source that no setting names, as fast as it goes, for 0.5 s."""
    client = Client(name, "unknown")
    end_s = time.monotonic() + 0.5
    begun()
    while time.monotonic() < end_s:
        client.command(0.1, 0.0, 0.0, manual=True, source="nowhere")
    begun()
    rest()


def as_the_gamepad(name: str) -> None:
    """Commands as the gamepad, under a session of its own and under the gamepad's, with a hello and without."""
    client = Client(name, "no gamepad")
    hello, command = (client._segment.latest_writer(record) for record in ("hello", "command"))
    begun()
    while True:
        fresh = int.from_bytes(os.urandom(8), "little") | 1
        for said, commanding in ((fresh, fresh), (fresh, 0), (0, fresh), (0, 0)):
            hello.write(records.HELLO.pack(said, os.getpid(), pid_namespace(), "no gamepad"))
            command.write(records.COMMAND.pack(commanding, 0.2, 0.0, 0.0, True, "gamepad"))
            client._ring()
            time.sleep(REST_S)


def stops(name: str) -> None:
    """A client that has no slot and asks for a stop for every line on stdin; says when it asked."""
    begun()
    while sys.stdin.readline():
        now_ns = time.monotonic_ns()
        send_stop(name, "somebody else")
        begun(now_ns)


PROGRAMS: dict[str, Callable[..., None]] = {
    program.__name__: program
    for program in (
        *(nursery, scribble, garble, resize, vandal, ring, flood, hold_all, claim_bytes, lock_everything, heir),
        *(replay, other_run, disable_flood, unknown_source, as_the_gamepad, stops),
    )
}


if __name__ == "__main__":
    become_nobody(sys.argv[2])
    PROGRAMS[sys.argv[1]](*sys.argv[2:])
