"""A look of doctor: what was asked, and what several checks look at, found when the first of them asks for it. And the
finding: what a check has to say, and what helps, a command, or what a person is to do."""

from __future__ import annotations

import contextlib
import dataclasses
import os
import pwd
import shlex
import shutil
import sys
from functools import cached_property, partial

from failstop import config, instances
from failstop.api.client import last_run, runtime_dir
from failstop.api.errors import FailstopError, NoService
from failstop.api.snapshot import State
from failstop.api.state import StateReader
from failstop.doctor.system import Holder, Node, System, User, user
from failstop.instances import unit_of
from failstop.policy.settings import SettingError, Settings
from failstop.shm import layout, segment
from failstop.shm.instance import DEFAULT_NAME, option

OK = "ok"
SKIP = "skip"
WARN = "warn"
FAIL = "fail"
LEVELS = (OK, SKIP, WARN, FAIL)
"""fail: a stop may be missing or late, or the service can't run; warn: it runs, with less certainty than it could;
skip: nobody has looked, or there is nothing here to look at; ok: looked at, and well."""

ACCOUNT = "failstop"
PROPERTIES = "LoadState,ActiveState,SubState,UnitFileState,Result,User,NeedDaemonReload,MainPID,NRestarts"
SUDO_PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
"""As sudo has it on Debian and Ubuntu (secure_path), whatever the user's is."""


@dataclasses.dataclass(frozen=True)
class Finding:
    """One line."""

    level: str
    text: str
    fix: str = ""
    """A command that can be pasted into a shell; empty where none helps."""
    advice: str = ""
    """What a person is to do, or to know of the command."""


def _found(level: str, text: str, fix: str = "", advice: str = "") -> list[Finding]:
    return [Finding(level, text, fix, advice)]


ok, skip, warn, fail = (partial(_found, level) for level in LEVELS)
"""What a check returns: text, fix, advice."""


@dataclasses.dataclass(frozen=True)
class Service:
    """The running service."""

    pid: int
    version: str
    user: str = ""
    state: State | None = None
    problem: str = ""
    """Why there is no state, in one line."""


@dataclasses.dataclass(eq=False)
class Look:
    """One look. A test sets what it likes, and so keeps it from being looked for."""

    name: str = DEFAULT_NAME
    config_path: str | None = None
    device_path: str | None = None
    quick: bool = False
    """Without the timing self-test."""
    stop_wanted: bool = False
    """A running service may be told to stop."""
    system: System = dataclasses.field(default_factory=System)
    stops: list[Finding] | None = None
    """What a self-test of the stop path has found, where there was one."""

    @cached_property
    def settings(self) -> tuple[str, Settings, str]:
        """(the file, empty for none; what is set; what is wrong with it, in one line, and the defaults count)."""
        try:
            path, found = settings_of(self.name, self.config_path)
        except SettingError as error:
            return self.config_path or config.installed(self.name), Settings(), str(error)
        return path or "", found, ""

    @cached_property
    def service(self) -> Service | None:
        """The running service; None: there is none."""
        version, holder = "", ""
        with contextlib.suppress(FailstopError):
            version = segment.version(last_run(self.name)[0])
            holder = instances.holder(runtime_dir(self.name))
        try:
            state = StateReader(self.name).read()
        except NoService:
            return None
        except FailstopError as error:
            return Service(int(holder or 0), version, problem=str(error))
        pid = state.processes[layout.SUPERVISOR].pid
        return Service(pid, version, self.system.owner(f"/proc/{pid}"), state)

    @cached_property
    def others(self) -> list[str]:
        """The names of the other services that run."""
        return [name for name in instances.listening() if name != self.name]

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

    @property
    def installed(self) -> bool:
        """systemd has a unit for it."""
        return self.unit.get("LoadState") == "loaded"

    @cached_property
    def user(self) -> User:
        """Who asks."""
        return user(os.geteuid())

    @cached_property
    def service_user(self) -> User | None:
        """The account of the installed service; None: there is none."""
        try:
            return user(pwd.getpwnam(self.unit.get("User") or "root" if self.installed else ACCOUNT).pw_uid)
        except KeyError:
            return None

    @cached_property
    def device(self) -> tuple[str, str]:
        """The board's port, and who says so."""
        if self.device_path:
            return self.device_path, "--device"
        if self.state and self.state.device.path:
            return self.state.device.path, "of the running service"
        path, found, _ = self.settings
        return found.text("device.path"), path or "the default of device.path"

    @cached_property
    def node(self) -> Node | None:
        """The device's file; None: there is no character device."""
        return self.system.node(self.device[0])

    @cached_property
    def holders(self) -> tuple[tuple[Holder, ...], int]:
        """Who has the device open, and how many processes could not be looked into."""
        return self.system.holders(self.node.resolved) if self.node else ((), 0)

    @cached_property
    def command(self) -> str:
        """How this program is called, from any shell and by way of sudo."""
        own = os.path.join(os.path.dirname(sys.executable), "failstop")
        found = shutil.which("failstop", path=SUDO_PATH)
        if found and os.path.realpath(found) == os.path.realpath(own):
            return "failstop"
        return own if os.access(own, os.X_OK) else f"{sys.executable} -m failstop"

    def again(self) -> str:
        """The command that asks the same once more."""
        device = f" --device {shlex.quote(self.device_path)}" if self.device_path else ""
        return f"failstop doctor{option(self.name)}{device}"


def settings_of(name: str, path: str | None) -> tuple[str | None, Settings]:
    """The file that was named, else the installed one, else the defaults. Raises SettingError."""
    installed = config.installed(name)
    if path is None and os.access(installed, os.R_OK):
        path = installed
    return path, config.load(path)
