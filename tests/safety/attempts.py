"""Each attempt of the table, made by one user on a running service: True when it succeeds.

What a user does is done in a process of that user's. The service is root's here, so that its user is uid 0 without any
capability: the owner of everything, and nothing more.
"""

from __future__ import annotations

import contextlib
import ctypes
import fcntl
import os
import stat
import struct
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from failstop import FailstopError, Robot, instances
from failstop.api.client import run, send_stop
from failstop.api.events import EventLog
from failstop.board.port import PortError, open_port
from failstop.board.rrc.board import RRC_PORT
from failstop.files import instance
from failstop.messages import layout, segments
from failstop.shm import claim
from failstop_lab.trial import Trial, TrialError
from tests.safety.table import MEMBER, SERVICE, STRANGER, USERS
from tests.support.children import NOBODY, Child
from tests.support.shared_trial import IMU_HZ

VICTIM = 61_000 + os.getpid() % 4000
"""A user that no one is, another one in each process of the tests."""
WITHIN_S = 5.0
_CAPABILITIES_3 = 0x20080522


def become(user: str, group: int) -> None:
    """Be this user from here on; `group`: the one whose members may drive."""
    if user in (STRANGER, MEMBER):
        gid = group if user == MEMBER else NOBODY
        os.setgroups([])
        os.setresgid(gid, gid, gid)
        os.setresuid(NOBODY, NOBODY, NOBODY)
    elif user == SERVICE:
        libc = ctypes.CDLL(None, use_errno=True)
        header = (ctypes.c_uint32 * 2)(_CAPABILITIES_3, 0)
        if libc.capset(header, (ctypes.c_uint32 * 6)()):
            raise OSError(ctypes.get_errno(), "capset")


class Attempt:
    """A running service, and one who tries something."""

    def __init__(self, trial: Trial, user: str, folder: Path) -> None:
        self.trial = trial
        self.name = trial.name
        self.user = user
        self.folder = folder
        self.directory = instance.find(trial.name)
        self.memory, _ = run(trial.name)
        self.group = os.stat(instance.claims_path(self.directory)).st_gid

    def does(self, work: Callable[[], object], user: str = "") -> Any:
        """The result of the work, done as this user; False when that is refused."""

        def does(_send: object, _wait: object) -> object:
            become(user or self.user, self.group)
            try:
                return work()
            except (FailstopError, OSError, segments.AttachError, instance.InstanceError, PortError):
                return False

        with Child(does) as child:
            return child.result()

    def opens(self, path: str, flags: int) -> bool:
        return self.does(lambda: os.open(path, flags | os.O_NONBLOCK) >= 0)


def _soon(condition: Callable[[], object]) -> bool:
    until_s = time.monotonic() + WITHIN_S
    while not condition():
        if time.monotonic() > until_s:
            return False
        time.sleep(0.005)
    return True


def stop(attempt: Attempt) -> bool:
    attempt.does(lambda: send_stop(attempt.name, "from the table"))
    return _soon(lambda: "from the table" in (attempt.trial.robot.state.estop or ""))


def read_state(attempt: Attempt) -> bool:
    def read() -> bool:
        with Robot(attempt.name) as robot:
            return robot.state.blocked is not None and len(EventLog(attempt.name).read()) > 0

    return bool(attempt.does(read))


def read_reasons(attempt: Attempt) -> bool:
    send_stop(attempt.name, "words of another")
    return bool(
        attempt.does(lambda: _soon(lambda: any("words of another" in it.text for it in EventLog(attempt.name).read())))
    )


def keep_stopped(attempt: Attempt) -> bool:
    """Go on asking: an enable in between meets the next request."""

    def ask(send: Callable[[object], None], _wait: Callable[[], None]) -> None:
        become(attempt.user, attempt.group)
        send("begun")
        until_s = time.monotonic() + WITHIN_S
        while time.monotonic() < until_s:
            send_stop(attempt.name, "again")
            time.sleep(0.001)

    with Child(ask) as child:
        child.receive()
        for _ in range(10):
            if not _soon(lambda: attempt.trial.robot.state.estop):
                return False
            with contextlib.suppress(FailstopError):
                attempt.trial.enable()
                attempt.trial.drive(0.02)
    attempt.trial.board.wait_wheels(turning=False, timeout_s=WITHIN_S)
    return True


def _enabled(robot: Robot) -> bool:
    if robot.state.estop:
        robot.reset()
    robot.enable()
    return robot.state.enabled


def enable(attempt: Attempt) -> bool:
    return bool(attempt.does(lambda: _enabled(Robot(attempt.name))))


def drive(attempt: Attempt) -> bool:
    def go() -> bool:
        with Robot(attempt.name) as robot:
            _enabled(robot)

            def moves() -> bool:
                robot.drive(0.1, 0.0, 0.0, manual=True)
                return any(robot.state.wheels_radps)

            return _soon(moves)

    return bool(attempt.does(go))


def pose(attempt: Attempt) -> bool:
    _enabled(attempt.trial.robot)
    slot = attempt.trial.robot.state.clients[0].slot
    return attempt.opens(segments.path_of(attempt.memory, f"client.{slot}"), os.O_RDWR)


def take_slot(attempt: Attempt) -> bool:
    def take() -> bool:
        fd = claim.open_claims(instance.claims_path(attempt.directory))
        return any(claim.acquire(fd, index) for index in range(layout.CLIENT_SLOTS))

    return bool(attempt.does(take))


def overhear(attempt: Attempt) -> bool:
    return attempt.opens(instance.stop_path(attempt.directory), os.O_RDONLY)


def write_memory(attempt: Attempt) -> bool:
    paths = [segments.path_of(attempt.memory, of) for of in (*layout.PROCESS_NAMES, "lifelines")]
    return any(attempt.opens(path, os.O_RDWR) for path in paths)


def replace(attempt: Attempt) -> bool:
    paths = [segments.path_of(attempt.memory, layout.GATE), segments.path_of(attempt.memory, "client.7")]
    paths += [at(attempt.directory) for at in (instance.stop_path, instance.bell_path, instance.lock_path)]

    def rename() -> list[str]:
        done = []
        for path in paths:
            with contextlib.suppress(OSError):
                os.rename(path, f"{path}.away")
                done.append(path)
                os.rename(f"{path}.away", path)
        return done

    done = attempt.does(rename)
    assert done in ([], paths)
    return bool(done)


def hold_lock(attempt: Attempt) -> bool:
    return attempt.opens(instance.lock_path(attempt.directory), os.O_RDONLY)


def signal_it(attempt: Attempt) -> bool:
    pids = list(attempt.trial.service.pids().values())
    return bool(attempt.does(lambda: [os.kill(pid, 0) for pid in pids]))


def open_port_too(attempt: Attempt) -> bool:
    """Open the port, whatever its mode."""
    os.chmod(attempt.trial.link, 0o666)
    os.chmod(os.path.dirname(attempt.trial.link), 0o755)
    assert not attempt.does(lambda: open_port(attempt.trial.link, exclusive=True, line=RRC_PORT))
    return bool(attempt.does(lambda: open_port(attempt.trial.link, exclusive=False, line=RRC_PORT)))


_TAKEN: dict[str, bool] = {}


def take_names(attempt: Attempt) -> bool:
    """Take names before the service starts, as if they were a run's: all users at once, each another one."""
    if attempt.name not in _TAKEN:
        _TAKEN[attempt.name] = _take_names(attempt)
    return _TAKEN[attempt.name]


def _take_names(attempt: Attempt) -> bool:
    name = f"{attempt.name}-next"
    names = ("supervisor", "gate", "0000000000000007.supervisor", "0000000000000007.gate")
    files = {f"/dev/shm/failstop.{name}.{of}": user for of, user in zip(names, USERS, strict=True)}

    def plant(path: str) -> bool:
        os.close(os.open(path, os.O_CREAT | os.O_EXCL | os.O_RDWR, 0o600))
        return True

    try:
        for path, user in files.items():
            assert attempt.does(lambda path=path: plant(path), user)  # type: ignore[misc]
        with Trial(name, imu_hz=IMU_HZ) as trial:
            return not _enabled(trial.robot)
    except TrialError:
        return True
    finally:
        for path in files:
            with contextlib.suppress(FileNotFoundError):
                os.unlink(path)


def look_alive(attempt: Attempt) -> bool:
    """Lock a dead run's memory, by the strongest lock that this user may take."""
    memory = segments.memory(f"{attempt.name}-dead", 7)
    segments.create(memory, layout.SUPERVISOR, 7).close()
    path = segments.path_of(memory, layout.SUPERVISOR)

    def lock(send: Callable[[object], None], wait: Callable[[], None]) -> None:
        become(attempt.user, attempt.group)
        writes = os.access(path, os.W_OK)
        fd = os.open(path, os.O_RDWR if writes else os.O_RDONLY)
        kind = fcntl.F_WRLCK if writes else fcntl.F_RDLCK
        fcntl.fcntl(fd, fcntl.F_OFD_SETLK, struct.pack("hhqqi4x", kind, os.SEEK_SET, 0, 0, 0))
        send("locked")
        wait()

    try:
        with Child(lock) as child:
            assert child.receive() == "locked"
            return segments.living(memory)
    finally:
        segments.unlink_all(memory)


def pass_off_memory(attempt: Attempt) -> bool:
    """Make memory under the right name, as after a removal."""
    memory = segments.memory(f"{attempt.name}-other", 7)
    path = segments.path_of(memory, layout.GATE)
    try:
        attempt.does(lambda: segments.create(memory, layout.GATE, 7).close())
        segments.attach(memory, layout.GATE, 7, owner=os.stat(attempt.directory).st_uid)
    except segments.AttachError as error:
        told = str(error)
    else:
        return True
    finally:
        os.unlink(path)
    assert path in told
    assert f"uid {NOBODY}" in told
    return False


def pass_off_directory(attempt: Attempt) -> bool:
    """Make a directory in a place that is everybody's to write; root looks there."""
    place = attempt.folder / "place"
    place.mkdir()
    place.chmod(0o1777)
    base, path = place / "failstop", place / "failstop" / "robot"
    pipe = instance.stop_path(str(path))

    def plant() -> bool:
        os.makedirs(path)
        os.mkfifo(pipe)
        os.chmod(pipe, 0o666)
        return True

    assert attempt.does(plant)
    reading = os.open(pipe, os.O_RDONLY | os.O_NONBLOCK)
    try:
        with pytest.MonkeyPatch.context() as patch:
            patch.setenv("XDG_RUNTIME_DIR", str(place))
            return instance.find("robot") == str(path)
    except instance.NoService as error:
        told = str(error)
    finally:
        os.close(reading)
    assert f"{base} belongs to" in told
    return False


def plant_link(attempt: Attempt) -> bool:
    """Plant a link even in a directory that is this user's to use, and believed to be."""
    base = attempt.folder / "failstop"
    path, victim = base / "robot", attempt.folder / "victim"
    path.mkdir(parents=True)
    victim.write_text("precious")
    owner = NOBODY if attempt.user in (STRANGER, MEMBER) else 0
    for folder in (base, path):
        os.chown(folder, owner, owner)

    def plant() -> bool:
        for at in (instance.stop_path, instance.bell_path, instance.claims_path, instance.lock_path, instance.run_path):
            os.symlink(victim, at(str(path)))
        return True

    assert attempt.does(plant)
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("XDG_RUNTIME_DIR", str(attempt.folder))
        for write in (
            lambda: send_stop("robot", "overwrites it"),
            lambda: instances.lock(str(path)),
            lambda: claim.open_claims(instance.claims_path(str(path)), create=True, mode=0o666),
            lambda: os.close(instance.publish_run(str(path), 7)),
        ):
            with contextlib.suppress(FailstopError, OSError, instance.InstanceError):
                write()
    return victim.read_text() != "precious" or stat.S_IMODE(victim.stat().st_mode) == 0o666


def be_in_the_way(attempt: Attempt) -> bool:
    path = f"/dev/shm/failstop-{VICTIM}"

    def start() -> str:
        os.setgroups([])
        os.setresgid(VICTIM, VICTIM, VICTIM)
        os.setresuid(VICTIM, VICTIM, VICTIM)
        os.environ["XDG_RUNTIME_DIR"] = "/nonexistent"
        try:
            return instances.make_runtime_dir("robot")
        except instance.InstanceError as error:
            return str(error)

    try:
        assert attempt.does(lambda: os.mkdir(path, 0o700) is None)
        with Child(lambda send, wait: start()) as child:
            said = str(child.result())
        return said != f"{path}/robot" and path in said
    finally:
        with contextlib.suppress(OSError):
            os.rmdir(f"{path}/robot")
        os.rmdir(path)


ATTEMPTS: dict[str, Callable[[Attempt], bool]] = {
    name: each
    for name, each in tuple(globals().items())
    if not name.startswith("_") and "attempt" in getattr(each, "__annotations__", {})
}
