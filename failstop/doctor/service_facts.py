"""Facts of the service: what runs, of which version, and what systemd and logind are told about it."""

from __future__ import annotations

import os
import subprocess

from failstop import instances
from failstop.api.client import last_run, runtime_dir
from failstop.api.errors import FailstopError, NoService
from failstop.api.state import StateReader
from failstop.doctor.facts import RemoveIpc, Service, Unit
from failstop.doctor.system import System, user_name
from failstop.install.layout import unit_of
from failstop.shm import layout, segment, slot
from failstop.version import VERSION

SYSTEMCTL_S = 1.0
PROPERTIES = ("LoadState", "ActiveState", "SubState", "UnitFileState", "Result", "User", "NeedDaemonReload")
NUMBERS = ("MainPID", "NRestarts")
LOGIND_FOLDERS = ("/etc", "/run", "/usr/local/lib", "/usr/lib", "/lib")


def service(name: str, system: System) -> Service | None:
    """The running service of this name; None: there is none."""
    version = version_of(name, system)
    try:
        state = StateReader(name).read()
    except NoService:
        return None
    except FailstopError as error:
        return Service(_pid(name), version, problem=str(error))
    pid = state.processes[layout.SUPERVISOR].pid
    try:
        user = user_name(os.stat(system.path(f"/proc/{pid}")).st_uid)
    except OSError:
        user = ""
    return Service(pid, version, user, state)


def _pid(name: str) -> int:
    """Of a service whose memory can't be read, where this user may look; else 0."""
    try:
        return int(instances.holder(runtime_dir(name)) or 0)
    except FailstopError:
        return 0


def version_of(name: str, system: System) -> str:
    """The version of failstop that a run's shared memory is of; empty when there is none."""
    try:
        memory, _ = last_run(name)
        with open(system.path(segment.path_of(memory, layout.SUPERVISOR)), "rb") as file:
            entry = slot.check(file.read(layout.HEADER_BYTES), segment._HEADER_SEED)
    except (FailstopError, OSError):
        return ""
    if entry is None or len(entry[2]) != segment._HEADER.size:
        return ""
    version: bytes = segment._HEADER.unpack(entry[2])[-1]
    return version.rstrip(b"\0").decode("ascii", "replace")


def client_version() -> str:
    """This program's."""
    return VERSION


def unit(name: str) -> Unit | None:
    """What systemd says of the unit; None when it does not answer."""
    which = unit_of(name)
    try:
        done = subprocess.run(
            ["systemctl", "show", which, "--property", ",".join((*PROPERTIES, *NUMBERS))],
            capture_output=True,
            text=True,
            timeout=SYSTEMCTL_S,
            check=False,
        )
    except (OSError, subprocess.TimeoutExpired):
        return None
    return parse_unit(which, done.stdout) if done.returncode == 0 else None


def parse_unit(which: str, text: str) -> Unit:
    """The output of `systemctl show`."""
    values = dict(line.split("=", 1) for line in text.splitlines() if "=" in line)
    main_pid, restarts = (int(text) if (text := values.get(key, "")).isdigit() else 0 for key in NUMBERS)
    return Unit(
        name=which,
        load=values.get("LoadState", ""),
        active=values.get("ActiveState", ""),
        sub=values.get("SubState", ""),
        enabled=values.get("UnitFileState", ""),
        result=values.get("Result", ""),
        user=values.get("User", "") or "root",
        needs_reload=values.get("NeedDaemonReload") == "yes",
        main_pid=main_pid,
        restarts=restarts,
    )


def remove_ipc(system: System) -> RemoveIpc:
    """logind's RemoveIPC, as logind reads its files: the first logind.conf there is, then the drop-ins by name, those
    of /etc in the place of others' of the same name; the last word counts."""
    files = [f"{folder}/systemd/logind.conf" for folder in LOGIND_FOLDERS]
    files = [path for path in files if system.read(path) is not None][:1]
    drop_ins: dict[str, str] = {}
    for folder in reversed(LOGIND_FOLDERS):
        place = f"{folder}/systemd/logind.conf.d"
        drop_ins.update({name: f"{place}/{name}" for name in system.names(place) if name.endswith(".conf")})
    found = RemoveIpc(True, "")
    for path in (*files, *(drop_ins[name] for name in sorted(drop_ins))):
        for line in (system.read(path) or "").splitlines():
            key, _, value = line.partition("=")
            if key.strip() == "RemoveIPC":
                found = RemoveIpc(value.strip().lower() in ("yes", "true", "on", "1", "y", "t"), path)
    return found
