"""A look of doctor: what was asked, and what several checks look at, found when the first of them asks for it. And the
finding: what a check has to say, and what helps, a command, or what a person is to do."""

from __future__ import annotations

import dataclasses
import os
import shlex
from functools import cached_property, partial

from failstop import config
from failstop.api import client
from failstop.api.errors import FailstopError, NoService
from failstop.api.snapshot import State
from failstop.api.state import StateReader
from failstop.board.asking import Unknown
from failstop.board.finder import Device, identity, look_alikes
from failstop.board.interface import Board
from failstop.board.kinds import board_of
from failstop.doctor.system import Holder, Node, System
from failstop.files.instance import DEFAULT_NAME, option
from failstop.instances import unit_of
from failstop.messages import layout, segments
from failstop.policy.setting import SettingError
from failstop.policy.settings import Settings

OK = "ok"
SKIP = "skip"
WARN = "warn"
FAIL = "fail"
LEVELS = (OK, SKIP, WARN, FAIL)
"""fail: a stop may be missing or late, or the service can't run; warn: it runs, with less certainty than it could;
skip: nobody has looked, or there is nothing here to look at; ok: looked at, and well."""

PROPERTIES = "LoadState,ActiveState,SubState,UnitFileState,Result,MainPID,NRestarts"


@dataclasses.dataclass(frozen=True)
class Finding:
    """One line."""

    level: str
    text: str
    fix: str = ""
    """A command that can be pasted into a shell; empty where none helps."""
    advice: str = ""
    """A thing that a person is to do, or to know of the command."""


def _found(level: str, text: str, fix: str = "", advice: str = "") -> list[Finding]:
    return [Finding(level, text, fix, advice)]


ok, skip, warn, fail = (partial(_found, level) for level in LEVELS)
"""The result of a check: text, fix, advice."""


@dataclasses.dataclass(eq=False)
class Look:
    """One look. A test sets what it likes, and so keeps it from being looked for."""

    name: str = DEFAULT_NAME
    config_path: str | None = None
    device_path: str | None = None
    quick: bool = False
    """Without the timing self-test."""
    system: System = dataclasses.field(default_factory=System)
    tried: tuple[list[Finding], list[Finding]] | None = None
    """Findings of a try at the port, on the board and on the stop path; None: the port was not opened."""

    @cached_property
    def settings(self) -> tuple[str, Settings, str]:
        """(the file, empty for none; what is set; what is wrong with it, in one line, and the defaults count)."""
        path = config.chosen(self.name, self.config_path)
        try:
            return path or "", config.load(path), ""
        except SettingError as error:
            return path or "", Settings(), str(error)

    @cached_property
    def active_settings(self) -> Settings:
        """The settings of the running service, else those that a start would read."""
        return Settings(dict(StateReader(self.name).settings())) if self.state else self.settings[1]

    @property
    def kind(self) -> str:
        """The board's, as these settings name it."""
        return self.active_settings.text("board.kind")

    @cached_property
    def board(self) -> Board:
        """The board that they name."""
        try:
            return board_of(*self.active_settings.board())
        except ValueError as error:
            return Unknown(str(error))

    @cached_property
    def service(self) -> tuple[State | None, str, str]:
        """(the running service's state, its version; why it can't be read, in one line). Nothing: there is none."""
        try:
            return StateReader(self.name).read(), segments.version(client.run(self.name)[0]), ""
        except NoService:
            return None, "", ""
        except FailstopError as error:
            return None, "", str(error)

    @property
    def state(self) -> State | None:
        """The state of the running service. None: no service runs, or its state can't be read."""
        return self.service[0]

    @property
    def pid(self) -> str:
        """The pid of the running service's supervisor, as a name in /proc. `self` if no service runs, because this user
        would start it."""
        return str(self.state.processes[layout.SUPERVISOR].pid) if self.state else "self"

    @cached_property
    def unit(self) -> dict[str, str]:
        """Properties of the service's unit; none: systemd has no such unit, or does not run."""
        said = self.system.said("systemctl", "show", unit_of(self.name), "--property", PROPERTIES)
        found = dict(line.split("=", 1) for line in (said or "").splitlines() if "=" in line)
        return found if found.get("LoadState") == "loaded" else {}

    @cached_property
    def device(self) -> tuple[str, str]:
        """The board's port, and who says so."""
        if self.device_path:
            return self.device_path, "--device"
        if self.state:
            return self.state.device.path, "from the running service"
        path, found, _ = self.settings
        return found.text("device.path"), path or "the default"

    @cached_property
    def node(self) -> Node | None:
        """The device's file; None: there is no character device."""
        return self.system.node(self.device[0])

    @cached_property
    def usb_id(self) -> str:
        """vendor:product of the device in hexadecimal; empty: it is nothing on USB."""
        return f"{self._usb.vendor}:{self._usb.product}" if self._usb else ""

    @cached_property
    def _usb(self) -> Device | None:
        tty = f"/sys/class/tty/{os.path.basename(self.node.resolved)}/device" if self.node else ""
        return identity(self.system.path(tty)) if tty else None

    @cached_property
    def look_alikes(self) -> dict[str, Device]:
        """Other serial ports with the same vendor and product, by their paths."""
        return look_alikes(self._usb, self.system.path("/sys"))[0]

    @cached_property
    def twins(self) -> bool:
        """True if one of them has the same serial number too, or none as the device."""
        return look_alikes(self._usb, self.system.path("/sys"))[1]

    @cached_property
    def holders(self) -> tuple[tuple[Holder, ...], int]:
        """The processes that have the device open, and how many could not be looked into."""
        return self.system.holders(self.node.resolved) if self.node else ((), 0)

    def again(self) -> str:
        """The words after `failstop` that ask the same once more."""
        device = f" --device {shlex.quote(self.device_path)}" if self.device_path else ""
        return f"doctor{option(self.name)}{device}"
