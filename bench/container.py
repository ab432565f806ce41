"""A container whose first process is this machine's own systemd: units are tried on the real thing, in a second.

Its root is an overlay of the machine's files, so that it may write anywhere and the machine never sees it; or of those
of another system, which then brings its own systemd. It has its
own process, mount, network, host name, IPC and control group namespaces, and of the machine's units only those of BASE.
Shared with the machine are /dev/pts, so that a simulated board out here is a board in there, and the monotonic clock.
Not as on a machine: no udev and no device units, no memory or processor limits, and rlimits end at the caller's own.

Needs root, systemd, util-linux and a cgroup2 hierarchy. To be made by the main thread: its processes are tied to the
thread that started them, so that however a run ends, its container ends with it.
"""

from __future__ import annotations

import contextlib
import itertools
import json
import os
import shutil
import signal
import subprocess
import tempfile
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from types import TracebackType
from typing import Any, NamedTuple

from failstop import config
from failstop_lab.trial import TrialError, wait_for

SYSTEMD = "/lib/systemd/systemd"
UNITS = "usr/lib/systemd/system"
"""Where a system has the units that come with its packages, unless /lib is a folder of its own."""
TOOLS = (SYSTEMD, "systemctl", "journalctl", "unshare", "nsenter", "setpriv", "pivot_root")
SHELL_PATH = "/usr/local/sbin:/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin"
NAMESPACES = ("--pid", "--mount", "--uts", "--ipc", "--net", "--cgroup")
DIRECTORY = "failstop-container-"
END_S = 10.0
TIMEOUT_S = 120.0
"""How long a command in the container may take. It is long because an installation waits for the disk."""
POLL_S = 0.03  # each look at a unit costs some 10 ms of a processor

BASE = (
    *(f"{name}.target" for name in ("basic", "sysinit", "sockets", "paths", "timers", "slices", "multi-user")),
    *(f"{name}.target" for name in ("local-fs", "local-fs-pre", "network", "nss-user-lookup", "time-sync")),
    *(f"{name}.target" for name in ("shutdown", "umount", "final", "exit", "poweroff", "reboot", "halt")),
    "systemd-journald.service",
    "systemd-journald.socket",
    "systemd-journald-dev-log.socket",
)
"""The units of the machine that the container has."""
WANTED = {
    "sysinit.target": ("systemd-journald.service",),
    "sockets.target": ("systemd-journald.socket", "systemd-journald-dev-log.socket"),
}

INSTALLED = ("/opt/failstop", config.FOLDER, "/var/lib/failstop")
"""Where a machine may have something of failstop's besides the package."""
ANEW = f"""
[ ! -e "$root/var/lib/dpkg/info/failstop.list" ] || chroot "$root" dpkg --purge failstop
for path in {" ".join(INSTALLED)}; do
  rm -rf "$root$path"
done
userdel --force --prefix "$root" failstop 2>/dev/null || :
groupdel --prefix "$root" failstop 2>/dev/null || :
"""
"""Takes away what the machine has of failstop: what is tried in there is what was put there."""
BOOT = (
    """
set -eu
base=$1 root=$1/root vendor=$2 systemd=$3 lower=$4
mount --make-rprivate /
mount -t tmpfs -o mode=755 overlay "$base/changes"
mkdir "$base/changes/files" "$base/changes/work"
mount -t overlay -o "lowerdir=$lower,upperdir=$base/changes/files,workdir=$base/changes/work" overlay "$root"
mount -t proc -o nosuid,nodev,noexec proc "$root/proc"
mount --bind "$root/proc/sys" "$root/proc/sys"
mount -o remount,bind,ro "$root/proc/sys"
mount -t sysfs -o ro,nosuid,nodev,noexec sysfs "$root/sys"
mount -t cgroup2 -o nosuid,nodev,noexec cgroup2 "$root/sys/fs/cgroup"
for own in dev run tmp; do
  mount -t tmpfs -o mode=755,nosuid tmpfs "$root/$own"
done
chmod 1777 "$root/tmp"
mkdir "$root/dev/pts" "$root/dev/shm"
mount --bind /dev/pts "$root/dev/pts"
mount -t tmpfs -o mode=1777,nosuid,nodev tmpfs "$root/dev/shm"
while read -r name major minor; do
  mknod -m 666 "$root/dev/$name" c "$major" "$minor"
done <<NODES
null 1 3
zero 1 5
full 1 7
random 1 8
urandom 1 9
tty 5 0
ptmx 5 2
NODES
for number in 0:stdin 1:stdout 2:stderr; do
  ln -s "/proc/self/fd/${number%%:*}" "$root/dev/${number#*:}"
done
ln -s /proc/self/fd "$root/dev/fd"
mount --bind "$base/vendor" "$root$vendor"
mount --bind "$base/units" "$root/etc/systemd/system"
for generators in /lib/systemd/system-generators /etc/systemd/system-generators; do
  [ ! -d "$root$generators" ] || mount -t tmpfs -o mode=755 tmpfs "$root$generators"
done
mkdir -p "$root/etc/systemd/journald.conf.d"
printf '[Journal]\\nStorage=volatile\\n' > "$root/etc/systemd/journald.conf.d/container.conf"
: > "$root/etc/fstab"
"""
    + ANEW
    + """
while read -r source target mode; do
  if [ -d "$source" ]; then
    mkdir -p "$root$target"
  else
    mkdir -p "$(dirname "$root$target")"
    [ -e "$root$target" ] || : > "$root$target"
  fi
  mount --bind "$source" "$root$target"
  mount -o "remount,bind,$mode" "$root$target"
done < "$base/binds"
mkdir "$root/run/machine"
cd "$root"
pivot_root . run/machine
umount -l /run/machine
rmdir /run/machine
# What systemd expects of whoever starts it in a container: mounts made later are seen in its services' namespaces.
mount --make-rshared /
sh -eu /run/setup
exec env -i container=failstop LANG=C.UTF-8 PATH="$PATH" "$systemd" --system --unit=multi-user.target --show-status=no
"""
)


class ContainerMissing(Exception):
    """There can be no container here; says what it needs."""


class Bind(NamedTuple):
    """A file or directory of the machine that the container has too; `mode` is ro or rw."""

    source: str
    target: str
    mode: str = "ro"


class Container:
    """A context manager: booted on entry, and gone with everything in it on exit."""

    _numbers = itertools.count()

    def __init__(
        self,
        units: Mapping[str, str] | None = None,
        binds: Sequence[Bind] = (),
        setup: str = "",
        system: Path = Path("/"),
    ) -> None:
        """`units`: text by name, below /etc/systemd/system; `setup`: shell commands that run inside before systemd
        does; `system`: the folder of another system, which is only read. Raises ContainerMissing."""
        self._system = system
        merged = system / UNITS
        self._vendor = f"/{UNITS}" if merged.is_dir() else "/lib/systemd/system"
        self._process: subprocess.Popen[bytes] | None = None
        self._directory = tempfile.TemporaryDirectory(prefix=f"{DIRECTORY}{os.getpid()}-")
        self.base = Path(self._directory.name)
        """The container's files, as seen from outside."""
        self.pid = 0
        """The pid of the container's systemd, as seen from outside."""
        self.boot_s = 0.0
        try:
            self._group = _new_group(f"failstop-{os.getpid()}-{next(self._numbers)}")
        except BaseException:
            self._directory.cleanup()
            raise
        try:
            self._lay_out(units or {}, binds, setup)
            self._boot()
        except (OSError, TrialError, subprocess.SubprocessError) as error:
            said = self.said()
            self.close()
            raise ContainerMissing(f"no systemd in a container here: {error}{said and f': {said}'}") from None
        except BaseException:
            self.close()
            raise

    def __enter__(self) -> Container:
        return self

    def __exit__(self, kind: type[BaseException] | None, error: BaseException | None, at: TracebackType | None) -> None:
        self.close()

    # The start and the end.

    def _lay_out(self, units: Mapping[str, str], binds: Sequence[Bind], setup: str) -> None:
        """Everything that the boot script finds in its directory."""
        for name in ("changes", "root", "units", "vendor"):
            (self.base / name).mkdir()
        for name in BASE:
            if (found := self._system / self._vendor.lstrip("/") / name).exists():
                shutil.copy(found, self.base / "vendor" / name)
        for target, wanted in WANTED.items():
            wants = self.base / "vendor" / f"{target}.wants"
            wants.mkdir()
            for name in wanted:
                (wants / name).symlink_to(f"../{name}")
        for name, text in units.items():
            self.unit(name, text)
        (self.base / "setup").write_text(setup)
        every = [*binds, Bind(str(self.base / "setup"), "/run/setup")]
        (self.base / "binds").write_text("".join(f"{bind.source} {bind.target} {bind.mode}\n" for bind in every))

    def _boot(self) -> None:
        """Start systemd in its control group, tied to this thread, and wait until the boot is through."""
        start_s = time.monotonic()
        enter = 'echo $$ > "$0/cgroup.procs"; exec "$@"'
        boot = ["unshare", *NAMESPACES, "--fork", "--kill-child=KILL", "sh", "-c", BOOT, "boot"]
        words = [*boot, str(self.base), self._vendor, SYSTEMD, str(self._system)]
        with open(self.base / "log", "wb") as out:
            self._process = subprocess.Popen(
                ["setpriv", "--pdeathsig", "KILL", "sh", "-c", enter, str(self._group), *words],
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=out,
                env={"PATH": SHELL_PATH},
            )
        wait_for("systemd to take requests", self._listens)
        self.ctl("start", "multi-user.target")
        self.boot_s = time.monotonic() - start_s

    def _listens(self) -> bool:
        assert self._process is not None
        if self._process.poll() is not None:
            raise TrialError("the container has ended")
        pid = self._process.pid
        with open(f"/proc/{pid}/task/{pid}/children", encoding="ascii") as file:
            self.pid = int((file.read().split() or ["0"])[0])
        return self.pid != 0 and os.path.exists(f"/proc/{self.pid}/root/run/systemd/private")

    def said(self) -> str:
        """The words of the boot and of systemd itself outside the journal."""
        with contextlib.suppress(OSError):
            return (self.base / "log").read_text(errors="replace").strip()
        return ""

    def close(self) -> None:
        """Kill everything in it, and take its control groups away."""
        if self._process is not None:
            self._end(self._process)
            self._process = None
        until_s = time.monotonic() + END_S
        while not _remove_group(self._group) and time.monotonic() < until_s:
            time.sleep(POLL_S)
        self._directory.cleanup()

    def _end(self, process: subprocess.Popen[bytes]) -> None:
        """With the container's first process the kernel kills all others; whoever started it collects it, and ends."""
        if self.pid and process.poll() is None:
            with contextlib.suppress(ProcessLookupError):
                os.kill(self.pid, signal.SIGKILL)
            with contextlib.suppress(subprocess.TimeoutExpired):
                process.wait(END_S)
        process.kill()
        process.wait()

    # Commands inside.

    def entering(self, *words: str) -> list[str]:
        """The command line, out here, of a command inside, as root and in no unit."""
        # Where this process keeps what is its own means nothing in there.
        inside = ("env", "--chdir=/", "--ignore-environment", "LANG=C.UTF-8", f"PATH={SHELL_PATH}")
        return ["nsenter", "-t", str(self.pid), "-m", "-u", "-i", "-n", "-p", "-C", *inside, *words]

    def run(self, *words: str, check: bool = True, timeout_s: float = TIMEOUT_S) -> subprocess.CompletedProcess[str]:
        """Run a command inside. Raises TrialError with what it said when it fails, unless not `check`."""
        done = subprocess.run(
            self.entering(*words),
            stdin=subprocess.DEVNULL,
            capture_output=True,
            text=True,
            timeout=timeout_s,
            check=False,
        )
        if check and done.returncode:
            raise TrialError(f"{' '.join(words)}: exit code {done.returncode}: {done.stdout}{done.stderr}".strip())
        return done

    def ctl(self, *words: str, check: bool = True, timeout_s: float = TIMEOUT_S) -> str:
        """Run systemctl; returns its output."""
        return self.run("systemctl", *words, check=check, timeout_s=timeout_s).stdout

    def show(self, unit: str, *properties: str) -> dict[str, str]:
        """Properties of a unit; without one, of systemd itself."""
        lines = self.ctl("show", *filter(None, [unit]), *(f"--property={name}" for name in properties)).splitlines()
        return dict(line.split("=", 1) for line in lines)

    def wait(self, unit: str, timeout_s: float = END_S, **wanted: str) -> None:
        """Wait until a unit has these properties. Raises TrialError with those it has, and its journal."""
        until_s = time.monotonic() + timeout_s
        while (found := self.show(unit, *wanted)) != wanted:
            if time.monotonic() > until_s:
                raise TrialError(f"waited {timeout_s:g} s for {unit} to be {wanted}: {found}\n{self.log_text(unit)}")
            time.sleep(POLL_S)

    def journal(self, *words: str) -> list[dict[str, Any]]:
        """Entries of the journal, as journalctl with these words finds them, each with all of its fields."""
        self.run("journalctl", "--sync")
        lines = self.run("journalctl", "--output=json", "--no-pager", "--quiet", *words).stdout.splitlines()
        return [json.loads(line) for line in lines]

    def log_text(self, unit: str, since_s: float = 0.0) -> str:
        """The journal of a unit as people read it, from a moment on (time.time())."""
        self.run("journalctl", "--sync")
        options = ("--output=short-monotonic", "--no-pager", "--quiet", f"--since=@{since_s:.6f}")
        return self.run("journalctl", *options, f"--unit={unit}").stdout

    # Files, units and processes, seen from out here.

    def path(self, inside: str) -> Path:
        """A path of the container's."""
        return Path(f"/proc/{self.pid}/root", inside.lstrip("/"))

    def write(self, inside: str, text: str) -> None:
        """Write a file of the container's, with the directories it needs."""
        path = self.path(inside)
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(text)

    def unit(self, name: str, text: str) -> None:
        """Write a unit or a drop-in below /etc/systemd/system; `ctl("daemon-reload")` has it read."""
        path = self.base / "units" / name
        path.parent.mkdir(exist_ok=True)
        path.write_text(text)

    def group(self, unit: str) -> Path:
        """The control group of a service."""
        return self._group / "system.slice" / unit

    def pids(self, unit: str) -> list[int]:
        """Pids, out here, of a service's processes; none when its control group is gone, or goes meanwhile."""
        try:
            return [int(word) for word in (self.group(unit) / "cgroup.procs").read_text().split()]
        except OSError:
            return []

    def main_pid(self, unit: str) -> int:
        """The pid, out here, of a service's main process; 0 when it has none."""
        inside = self.show(unit, "MainPID")["MainPID"]
        return next((pid for pid in self.pids(unit) if _pid_inside(pid) == inside), 0)


def _pid_inside(pid: int) -> str:
    """The pid that a process has in its own namespace; empty when it is gone."""
    with contextlib.suppress(OSError), open(f"/proc/{pid}/status", encoding="utf-8", errors="replace") as file:
        for line in file:
            if line.startswith("NSpid:"):
                return line.split()[-1]
    return ""


def _new_group(name: str) -> Path:
    """Make a control group. Raises ContainerMissing, for anything else that is needed too."""
    check(os.geteuid())
    tree = hierarchy()
    _tidy(tree)
    group = tree / name
    try:
        group.mkdir()
    except OSError as error:
        raise ContainerMissing(f"a systemd in a container needs a control group of its own: {error}") from None
    return group


def _tidy(tree: Path) -> None:
    """Remove what runs that were killed have left; their containers ended with them."""
    for group in tree.glob("failstop-*-*"):
        if not os.path.exists(f"/proc/{group.name.split('-')[1]}"):
            _remove_group(group)
    for directory in Path(tempfile.gettempdir()).glob(f"{DIRECTORY}*-*"):
        if not os.path.exists(f"/proc/{directory.name.removeprefix(DIRECTORY).split('-')[0]}"):
            shutil.rmtree(directory, ignore_errors=True)


def _remove_group(group: Path) -> bool:
    """Remove a control group and those below; false while there are processes in it."""
    for path, _, _ in os.walk(group, topdown=False):
        with contextlib.suppress(OSError):
            os.rmdir(path)
    return not group.exists()


def check(uid: int, tools: Sequence[str] = TOOLS) -> None:
    """Raise ContainerMissing when this user can't have one, or a tool is not there."""
    if uid:
        raise ContainerMissing("a systemd in a container needs root")
    if absent := [tool for tool in tools if not shutil.which(tool)]:
        raise ContainerMissing(f"not installed: {', '.join(absent)}")


def hierarchy() -> Path:
    """Where the control groups are. Raises ContainerMissing."""
    with open("/proc/self/mounts", encoding="utf-8") as file:
        for line in file:
            _, where, kind, *_ = line.split()
            if kind == "cgroup2":
                return Path(where)
    raise ContainerMissing("no cgroup2 hierarchy is mounted")
