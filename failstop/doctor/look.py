"""What was asked of doctor, and what several of its checks look at, found when the first of them asks for it."""

from __future__ import annotations

import dataclasses
import os
import shlex
from functools import cached_property

from failstop import config, instances
from failstop.api.client import last_run, runtime_dir
from failstop.api.errors import FailstopError, NoService
from failstop.api.snapshot import State
from failstop.api.state import StateReader
from failstop.doctor import device, leftovers, paste
from failstop.doctor.device import Holder, Node
from failstop.doctor.leftovers import Leftover
from failstop.doctor.stop_test import StopPath
from failstop.doctor.system import System, User, account, user
from failstop.doctor.ticks import Ticks, measure
from failstop.instances import unit_of
from failstop.policy.settings import SettingError, Settings
from failstop.shm import layout, segment
from failstop.shm.instance import DEFAULT_NAME, check_name, option

NAMED = "--device"
"""The origin of a device that the user named."""
ACCOUNT = "failstop"
PROPERTIES = "LoadState,ActiveState,SubState,UnitFileState,Result,User,NeedDaemonReload,MainPID,NRestarts"


@dataclasses.dataclass(frozen=True)
class Service:
    """The running service."""

    pid: int
    version: str
    user: str = ""
    state: State | None = None
    problem: str = ""
    """Why there is no state, in one line."""


class Look:
    """One look. A test sets what it likes, and so keeps it from being looked for."""

    def __init__(
        self,
        name: str = DEFAULT_NAME,
        config_path: str | None = None,
        device: str | None = None,
        *,
        quick: bool = False,
        stop_wanted: bool = False,
        system: System | None = None,
    ) -> None:
        """`quick`: without the timing self-test; `stop_wanted`: a running service may be told to stop. Raises
        InstanceError for a name that is none."""
        self.name = check_name(name)
        self.quick = quick
        self.stop_wanted = stop_wanted
        self.system = system or System()
        self._config_path = config_path
        self._device = device
        self.stops: StopPath | None = None
        """What a self-test of the stop path has found, where there was one."""

    @cached_property
    def settings(self) -> tuple[str, Settings, str]:
        """(the file, empty for none; what is set; what is wrong with it, in one line, and the defaults count)."""
        try:
            path, found = settings_of(self.name, self._config_path, self.system)
        except SettingError as error:
            return self._config_path or self.system.path(config.installed(self.name)), Settings(), str(error)
        return path or "", found, ""

    @cached_property
    def service(self) -> Service | None:
        """The running service; None: there is none."""
        version = version_of(self.name)
        try:
            state = StateReader(self.name).read()
        except NoService:
            return None
        except FailstopError as error:
            return Service(self._holder(), version, problem=str(error))
        pid = state.processes[layout.SUPERVISOR].pid
        return Service(pid, version, self.system.owner(f"/proc/{pid}"), state)

    def _holder(self) -> int:
        """The pid of a service whose memory can't be read, where this user may look; else 0."""
        try:
            return int(instances.holder(runtime_dir(self.name)) or 0)
        except FailstopError:
            return 0

    @property
    def state(self) -> State | None:
        """Of the running service; None: it can't be read, or none runs."""
        return self.service.state if self.service else None

    @cached_property
    def systemd(self) -> bool:
        """It runs this machine."""
        return os.path.isdir(self.system.path("/run/systemd/system"))

    @cached_property
    def unit(self) -> dict[str, str]:
        """What systemd says of the service's unit; nothing: it does not run, or does not answer."""
        words = ("systemctl", "show", unit_of(self.name), "--property", PROPERTIES)
        said = self.system.said(*words) if self.systemd else None
        return dict(line.split("=", 1) for line in (said or "").splitlines() if "=" in line)

    @cached_property
    def user(self) -> User:
        """Who asks."""
        return user(os.geteuid())

    @cached_property
    def service_user(self) -> User | None:
        """The account of the installed service; None: there is none."""
        return account(self.unit.get("User") or "root" if self.installed else ACCOUNT)

    @property
    def installed(self) -> bool:
        """systemd has a unit for it."""
        return self.unit.get("LoadState") == "loaded"

    @cached_property
    def device(self) -> tuple[str, str]:
        """The board's port, and who says so."""
        if self._device:
            return self._device, NAMED
        if self.state and self.state.device.path:
            return self.state.device.path, "of the running service"
        path, found, _ = self.settings
        return found.text("device.path"), path or "the default of device.path"

    @property
    def named(self) -> bool:
        """The user named the device."""
        return self.device[1] == NAMED

    @cached_property
    def node(self) -> Node | None:
        """The device's file; None: it is not there."""
        return device.node(self.device[0], self.system)

    @cached_property
    def holders(self) -> tuple[tuple[Holder, ...], int]:
        """Who has the device open, and how many processes could not be looked into."""
        ours = {row.pid for row in self.state.processes.values()} if self.state else set()
        return device.holders(self.node.resolved, ours, self.system) if self.node else ((), 0)

    @cached_property
    def runs(self) -> tuple[tuple[Leftover, ...], tuple[str, ...]]:
        """What dead runs left in shared memory, and the names of the services that run."""
        return leftovers.look(self.service_user or self.user, self.system)

    @cached_property
    def commands(self) -> tuple[str, str]:
        """How this program is called: from this shell, and by way of sudo."""
        return paste.commands(os.environ)

    @cached_property
    def ticks(self) -> tuple[Ticks, ...]:
        """The timing self-test."""
        return () if self.quick else measure()

    def again(self) -> str:
        """The command that asks the same once more."""
        device = f" --device {shlex.quote(self.device[0])}" if self.named else ""
        return f"failstop doctor{option(self.name)}{device}"


def settings_of(name: str, path: str | None, system: System) -> tuple[str | None, Settings]:
    """The file that was named, else the installed one, else the defaults. Raises SettingError."""
    installed = system.path(config.installed(name))
    if path is None and os.access(installed, os.R_OK):
        path = installed
    return path, config.load(path)


def version_of(name: str) -> str:
    """The version of failstop that a run's shared memory is of; empty when there is none."""
    try:
        return segment.version(last_run(name)[0])
    except FailstopError:
        return ""
