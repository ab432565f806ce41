"""The facts that the checks judge: plain values, gathered once. None stands for what could not be found out."""

from __future__ import annotations

import dataclasses
import shlex

from failstop.api.snapshot import State
from failstop.shm.instance import DEFAULT_NAME

NAMED = "--device"
"""The origin of a device that the user named."""


@dataclasses.dataclass(frozen=True)
class User:
    """Somebody who is to open the port."""

    name: str
    uid: int
    gids: frozenset[int]


@dataclasses.dataclass(frozen=True)
class Node:
    """The device's file."""

    path: str
    resolved: str
    """The path behind all links."""
    character: bool
    pseudo: bool
    """A pseudo-terminal, as the simulated board's."""
    mode: int
    uid: int
    gid: int
    group: str
    usb_id: str | None = None
    """vendor:product in hexadecimal."""
    product: str = ""
    modem_ignored: bool | None = None
    """Whether udev tells ModemManager to leave it alone."""
    acl: bool = False
    """Access is refined by an access control list."""
    accessible: bool = False
    """This process may read and write it."""
    link: str = ""
    """The name that udev's rule gives this same device, if it is another; empty: none."""


@dataclasses.dataclass(frozen=True)
class Holder:
    """A process that has the device open."""

    pid: int
    name: str
    unit: str = ""
    """Its systemd service, if it is in one."""
    ours: bool = False
    """One of the processes of the running service of this name."""
    instance: str = ""
    """Whose service it belongs to, if it is one of failstop's processes."""
    gone: str = ""
    """It has not the device open, but this one, whose file an unplug has removed."""


@dataclasses.dataclass(frozen=True)
class Rights:
    """What this process may ask the kernel for."""

    realtime_limit: int
    """Highest SCHED_FIFO priority by limit; 0: none."""
    memory_limit: int
    """Bytes that may be locked; -1: no limit."""
    nice_capability: bool
    """CAP_SYS_NICE: real-time whatever the limit."""
    lock_capability: bool
    """CAP_IPC_LOCK: locked memory whatever the limit."""
    realtime_granted: bool
    """The kernel did give SCHED_FIFO when asked."""
    container: bool = False
    """It runs in one."""
    runtime_us: int | None = None
    """kernel.sched_rt_runtime_us: of each second, what real-time processes may use; -1: no limit, 0: none."""
    early_news: bool = True
    """The kernel tells of a death before it takes the memory down."""


@dataclasses.dataclass(frozen=True)
class Clock:
    """The clocks."""

    source: str | None
    available: tuple[str, ...]
    backward_ns: int
    """The furthest that CLOCK_MONOTONIC went back between two readings; 0: never."""
    resolution_ns: int
    synchronized: bool | None
    offset_s: float | None
    """That the kernel still has to correct."""


@dataclasses.dataclass(frozen=True)
class Leftover:
    """Shared memory of an instance whose service is not running."""

    instance: str
    segments: int
    size: int
    owner: str
    ours: bool
    """The service's user could remove it."""


@dataclasses.dataclass(frozen=True)
class SharedMemory:
    """/dev/shm."""

    present: bool
    writable: bool
    free: int | None
    needed: int
    leftovers: tuple[Leftover, ...] = ()
    living: tuple[str, ...] = ()
    """Names of the services that run."""


@dataclasses.dataclass(frozen=True)
class Service:
    """The running service."""

    pid: int
    version: str
    user: str = ""
    state: State | None = None
    problem: str = ""
    """Why there is no state, in one line."""


@dataclasses.dataclass(frozen=True)
class Unit:
    """Its systemd unit."""

    name: str
    load: str
    active: str
    sub: str
    enabled: str
    result: str
    user: str
    needs_reload: bool
    main_pid: int
    restarts: int
    """By systemd itself, since the last start by a person or the boot."""


@dataclasses.dataclass(frozen=True)
class RemoveIpc:
    """Whether logind deletes the shared memory of a user whose last session ends."""

    on: bool
    origin: str
    """The file that says so; empty: systemd's default."""


@dataclasses.dataclass(frozen=True)
class Idle:
    """A sleep state of the processor that is in use."""

    name: str
    exit_us: int
    """What waking from it takes."""


@dataclasses.dataclass(frozen=True)
class Cpu:
    """The processor."""

    cores: int
    governors: tuple[str, ...]
    """Each that some core uses; empty: frequency is not scaled here."""
    slowest_idle: Idle | None


@dataclasses.dataclass(frozen=True)
class Ticks:
    """How late a process was woken, against the moments that it asked for."""

    realtime: bool
    count: int
    median_us: float
    p99_us: float
    worst_us: float


@dataclasses.dataclass(frozen=True)
class StopTest:
    """One writer's burst, and the board's answer to a ping behind it."""

    writer: str
    written: bool
    answered_ms: float | None
    """From before the burst to the answer; None: there was none."""
    problem: str = ""


@dataclasses.dataclass(frozen=True)
class Ros2:
    """What is seen of ROS 2."""

    users: tuple[str, ...] = ()
    """Who has files of Fast DDS in /dev/shm."""
    pid: int = 0
    """The bridge's; 0: none is connected."""
    user: str = ""
    own_profile: bool = False
    """The bridge was started with a Fast DDS profile of the user's, which may use shared memory."""


@dataclasses.dataclass(frozen=True)
class Facts:
    """Everything. The defaults are for what was not looked at."""

    name: str
    device: str
    device_origin: str
    user: User
    service_user: User | None
    """The account of the installed service; None: there is none."""
    rights: Rights
    clock: Clock
    memory: SharedMemory
    cpu: Cpu
    lease_s: float
    period_s: float
    settings_file: str = ""
    """Where the settings come from; empty: the defaults."""
    settings_problem: str = ""
    """What is wrong with them, in one line; they are then not used here."""
    node: Node | None = None
    candidates: tuple[tuple[str, str], ...] = ()
    """(path, description) of serial devices, when the one that was asked for is not there."""
    holders: tuple[Holder, ...] = ()
    unplugged: tuple[Holder, ...] = ()
    """Who has a serial device open that an unplug has removed, and so keeps its number from the board."""
    unseen_processes: int = 0
    """Whose open files this user may not see."""
    grabbers: tuple[Holder, ...] = ()
    """Running programs that are known to open serial ports by themselves."""
    service: Service | None = None
    systemd: bool = False
    unit: Unit | None = None
    remove_ipc: RemoveIpc | None = None
    ros2: Ros2 = Ros2()
    ticks: tuple[Ticks, ...] = ()
    stops: tuple[StopTest, ...] = ()
    stop_skipped: str = ""
    """Why the stop path was not tested."""
    stop_fix: str = ""
    """The command by which it would be."""
    stop_wanted: bool = False
    """It was asked for."""
    commands: tuple[str, str] = ("failstop", "failstop")
    """How this program is called: from this shell, and by way of sudo."""

    @property
    def state(self) -> State | None:
        """Of the running service; None: it can't be read, or none runs."""
        return self.service.state if self.service else None


def again(facts: Facts, *options: str) -> str:
    """The command that asks the same once more."""
    words = ["failstop", "doctor", *options]
    if facts.name != DEFAULT_NAME:
        words += ["--name", facts.name]
    if facts.device_origin == NAMED:
        words += ["--device", facts.device]
    return shlex.join(words)
