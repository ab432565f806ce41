"""Look: what the checks of the doctor share. A Look holds the question (which service, which port), and finds each fact
when a check first needs it. A Finding is one result of a check, with a remedy."""

from __future__ import annotations

import contextlib
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
from failstop.policy.settings import BY_KEY, Settings

OK = "ok"
SKIP = "skip"
WARN = "warn"
FAIL = "fail"
LEVELS = (OK, SKIP, WARN, FAIL)
"""The levels of a finding. `ok`: checked, and fine. `skip`: not checked, or nothing to check. `warn`: failstop works,
but less reliably than it could. `fail`: a stop may be missing or late, or the service can't run."""

DEVICE = "device.path"
BOARD = "board."
PROPERTIES = (
    "LoadState,ActiveState,SubState,UnitFileState,Result,MainPID,NRestarts,"
    "User,SupplementaryGroups,ExecStart,ProtectHome,PrivateTmp"
)


@dataclasses.dataclass(frozen=True)
class Finding:
    """One result of a check."""

    level: str
    text: str
    fix: str = ""
    """A command that can be pasted into a shell. Empty if no command helps."""
    advice: str = ""
    """What a person must do, or must know about the command."""


def _found(level: str, text: str, fix: str = "", advice: str = "") -> list[Finding]:
    return [Finding(level, text, fix, advice)]


ok, skip, warn, fail = (partial(_found, level) for level in LEVELS)
"""Functions that return the result of a check as a list with one Finding. The arguments are text, fix and advice."""


def _named(path: str | None) -> Settings:
    """The defaults, but with the port and the board that the file names, if these can be read and are allowed."""
    found: dict[str, object] = {}
    with contextlib.suppress(SettingError):
        read = config.read(path)
        for key in (each for each in read if each in BY_KEY and (each == DEVICE or each.startswith(BOARD))):
            with contextlib.suppress(SettingError):
                found[key] = BY_KEY[key].check(read[key])
        return Settings(found)
    return Settings()


@dataclasses.dataclass(eq=False)
class Look:
    """The service and the port to check, and the facts about them. Each fact is found when it is first needed. A test
    may set a fact beforehand."""

    name: str = DEFAULT_NAME
    config_path: str | None = None
    device_path: str | None = None
    quick: bool = False
    """True to leave out the measurement of wake-up delays."""
    system: System = dataclasses.field(default_factory=System)
    tried: tuple[list[Finding], list[Finding]] | None = None
    """Findings from opening the port: about the board, and about the stop path. None if the port was not opened."""

    @cached_property
    def settings(self) -> tuple[str, Settings, str]:
        """(path of the settings file, settings, problem). The path is empty if there is no file. If the file can't be
        used, `problem` is one line about it. Then the settings are the defaults, but with the port and the board that
        the file names, because the service uses those even if another setting is wrong."""
        path = config.chosen(self.name, self.config_path)
        try:
            return path or "", config.load(path), ""
        except SettingError as error:
            return path or "", _named(path), str(error)

    @cached_property
    def active_settings(self) -> Settings:
        """The settings of the running service. Without a running service, the settings that it would start with."""
        return Settings(dict(StateReader(self.name).settings())) if self.state else self.settings[1]

    @property
    def kind(self) -> str:
        """The kind of board that the active settings name."""
        return self.active_settings.text("board.kind")

    @cached_property
    def board(self) -> Board:
        """The board that the active settings name."""
        try:
            return board_of(*self.active_settings.board())
        except ValueError as error:
            return Unknown(str(error))

    @cached_property
    def service(self) -> tuple[State | None, str, str]:
        """(state of the running service, its version, problem). `problem` is one line about why the state can't be
        read. All three are empty if no service is running."""
        try:
            return StateReader(self.name).read(), segments.version(client.run(self.name)[0]), ""
        except NoService:
            return None, "", ""
        except FailstopError as error:
            return None, "", str(error)

    @property
    def state(self) -> State | None:
        """The state of the running service. None if no service is running, or if its state can't be read."""
        return self.service[0]

    @property
    def pid(self) -> str:
        """The pid of the service's supervisor, as a name in /proc. Without a running service it is `self`, because this
        user would start the service."""
        return str(self.state.processes[layout.SUPERVISOR].pid) if self.state else "self"

    @cached_property
    def _shown(self) -> str | None:
        """What systemd says about the service's unit. None if it can't be asked."""
        return self.system.said("systemctl", "show", unit_of(self.name), "--property", PROPERTIES)

    @property
    def unit_unknown(self) -> bool:
        """True if systemd is running, but did not say whether it has a unit of the service."""
        return not self.unit and self._shown is None and self.system.booted()

    @cached_property
    def unit(self) -> dict[str, str]:
        """The properties of the service's systemd unit. Empty if systemd has no such unit, is not running, or can't be
        asked (unit_unknown)."""
        found = dict(line.split("=", 1) for line in (self._shown or "").splitlines() if "=" in line)
        return found if found.get("LoadState") == "loaded" else {}

    @cached_property
    def device(self) -> tuple[str, str]:
        """The path of the board's port, and where this path comes from."""
        if self.device_path:
            return self.device_path, "--device"
        if self.state:
            return self.state.device.path, "from the running service"
        path, found, problem = self.settings
        named = found.text(DEVICE)
        return named, "the default" if problem and named == Settings().text(DEVICE) else path or "the default"

    @cached_property
    def node(self) -> Node | None:
        """The device file of the port. None if the path is no character device."""
        return self.system.node(self.device[0])

    @cached_property
    def usb_id(self) -> str:
        """vendor:product of the port's USB device, in hexadecimal. Empty if it is not a USB device."""
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
        """True if another serial port looks the same: same vendor and product, and the same serial number or none."""
        return look_alikes(self._usb, self.system.path("/sys"))[1]

    @cached_property
    def holders(self) -> tuple[tuple[Holder, ...], int]:
        """The processes that have the port open, and how many processes could not be checked."""
        return self.system.holders(self.node.resolved) if self.node else ((), 0)

    def again(self) -> str:
        """The words after `failstop` that repeat this check."""
        device = f" --device {shlex.quote(self.device_path)}" if self.device_path else ""
        return f"doctor{option(self.name)}{device}"
