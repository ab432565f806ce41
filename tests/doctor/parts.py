"""A machine on which all is well; tests change one thing, in what the system says or in what checks share."""

from __future__ import annotations

import dataclasses
from collections.abc import Iterator
from contextlib import contextmanager
from typing import Any

from failstop.api.snapshot import Imu, State
from failstop.board.rrc.board import BOARD
from failstop.doctor.look import Look
from failstop.doctor.machine import PROCESSORS
from failstop.doctor.system import Node, System
from failstop.messages.layout import PROCESS_NAMES
from failstop.policy.settings import Settings
from failstop.version import VERSION
from tests.support.states import process, state, stop

NODE = Node("/dev/ttyACM0", "/dev/ttyACM0", pseudo=False, group="dialout", modem_ignored=True, accessible=True)
STATE = state(
    processes={name: process(pid=100 + at) for at, name in enumerate(PROCESS_NAMES)},
    last_stop=stop(),
    imu=Imu(1, (0.0, 0.0, 9.8), (0.0, 0.0, 0.0)),
)
SERVICE = (STATE, VERSION, "")
NOBODY = (None, "", "")
"""No service."""
UNIT = {"LoadState": "loaded", "ActiveState": "active", "SubState": "running", "UnitFileState": "enabled"}
UNIT |= {"Result": "success", "MainPID": "100", "NRestarts": "0"}
TICKS = (True, [20_000] * 500)
FILES = {f"{PROCESSORS}/cpu0/cpufreq/scaling_governor": "performance"}
KERNEL: dict[str, Any] = {"room": 1 << 30, "early_news": True, "ticks": TICKS, "contained": False}
KERNEL |= {
    "services": [],
    "ports": [],
    "no_room": "",
    "writable": True,
    "barrier": "",
    "through": [],
    "booted": True,
    "exposed": "",
    "hides_processes": False,
    "environ": {"STATE_DIRECTORY": "/state"},
}
KERNEL |= {"account": 998, "refused": "", "portless": []}
"""Results of the functions of System, whatever they are asked."""
SAYS: dict[str, str | None] = {"busctl": "b true\n", "systemctl": ""}
"""The output of a command."""
UIDS = {"root": 0, "failstop": 998, "anna": 1000}
STATE_FOLDER = "/var/lib/failstop/failstop"
OWNERS = {"/proc/100": "failstop", "/proc/self": "anna", STATE_FOLDER: "failstop", "/state": "anna", "/": "root"}
SHARED: dict[str, Any] = {"quick": False, "device_path": None, "settings": ("", Settings(), ""), "service": SERVICE}
SHARED |= {
    "unit": UNIT,
    "device": ("/dev/ttyACM0", "the default"),
    "node": NODE,
    "active_settings": Settings(),
}
SHARED |= {"usb_id": BOARD.usb[0], "look_alikes": {}, "twins": False, "holders": ((), 0)}
"""Options of the call, and values that checks share (Look)."""


class Made(System):
    """A system of these files; None: a file that is not there."""

    def __init__(
        self,
        files: dict[str, str | None] | None = None,
        owners: dict[str, str] | None = None,
        opens: dict[int, set[str]] | None = None,
        says: dict[str, str | None] | None = None,
        realtime: bool = True,
        **kernel: Any,
    ) -> None:
        super().__init__("/nowhere")
        self._files = {path: text for path, text in (FILES | (files or {})).items() if text is not None}
        self._owners = OWNERS | (owners or {})
        self._opens = opens or {}
        self._says = SAYS | (says or {})
        self._realtime = realtime
        for name, says in (KERNEL | kernel).items():
            setattr(self, name, lambda *_, says=says: says)

    def read(self, path: str) -> str | None:
        return self._files.get(path)

    def names(self, path: str) -> list[str]:
        below = (file.removeprefix(f"{path}/") for file in self._files if file.startswith(f"{path}/"))
        return sorted({name.partition("/")[0] for name in below})

    def owner(self, path: str) -> str:
        return self._owners.get(path, "")

    def uid(self, path: str) -> int:
        return UIDS.get(self.owner(path), -1)

    def missing(self, path: str) -> bool:
        return self.uid(path) < 0

    def open_files(self) -> Iterator[tuple[int, set[str] | None]]:
        return iter(self._opens.items())

    def said(self, *words: str, timeout_s: float = 1.0) -> str | None:
        return self._says[words[0]]

    @contextmanager
    def realtime(self, priority: int = 1) -> Iterator[bool]:
        yield self._realtime


def look(name: str = "failstop", **changed: Any) -> Look:
    """All is well but for this: what checks share, or what the system says."""
    system = Made(**{key: value for key, value in changed.items() if key not in SHARED})
    made = Look(name, system=system)
    vars(made).update(SHARED | {key: value for key, value in changed.items() if key in SHARED})
    return made


def on(comm: str, pid: int = 9, command: str = "") -> dict[str, str | None]:
    return {f"/proc/{pid}/comm": comm, f"/proc/{pid}/cmdline": "\0".join(command.split())}


def of(kind: str) -> Settings:
    return Settings({"board.kind": kind})


def serving(**changed: Any) -> tuple[State, str, str]:
    return dataclasses.replace(STATE, **changed), VERSION, ""


def but(part: Any, **changed: Any) -> Any:
    return part | changed if isinstance(part, dict) else dataclasses.replace(part, **changed)
