"""systemd as a peer: a service whose ExecStopPost runs the stop tool, under a systemd of its own.

That systemd is the first process of a container: its own process, mount, network, host name and control group
namespaces, over the machine's files, which it sees read-only. Its one target needs none of the machine's units.
Needs root, systemd, util-linux and a cgroup2 hierarchy.
"""

from __future__ import annotations

import contextlib
import errno
import os
import shutil
import subprocess
import sys
import tempfile
import time

from bench.peer import ROOT, PeerMissing
from failstop.trial import TrialError, wait_for

SYSTEMD = "/lib/systemd/systemd"
TOOLS = (SYSTEMD, "systemctl", "unshare", "nsenter", "setpriv")
TARGET = "[Unit]\nDefaultDependencies=no\n"
SERVICE = """
[Unit]
DefaultDependencies=no
StartLimitIntervalSec=0
[Service]
Type=exec
WorkingDirectory={root}
ExecStart={python} -m bench.peer_driver {link}
ExecStopPost={python} -m failstop stop --device {link}
"""
BOOT = """
set -eu
mount --make-rprivate /
mount -t proc proc /proc
mount --bind /proc/sys /proc/sys
mount -o remount,bind,ro /proc/sys
mount -t cgroup2 cgroup2 /sys/fs/cgroup
mount -t tmpfs tmpfs /run
mount --bind "$1" /etc/systemd/system
mount -o remount,bind,ro /
exec env -i container=bench PATH=/usr/sbin:/usr/bin:/sbin:/bin "$2" --system --unit=bench.target \
  --default-standard-output=null --default-standard-error=null --log-target=console --log-level=warning --show-status=no
"""
NAMESPACES = ("--pid", "--mount", "--uts", "--ipc", "--net", "--cgroup")
END_S = 10.0


class Systemd:
    """A systemd of its own. Raises PeerMissing when there can be none here."""

    label = "systemd, ExecStopPost runs `failstop stop`"

    def __init__(self, link: str) -> None:
        self._process: subprocess.Popen[bytes] | None = None
        self._group = os.path.join(_hierarchy(), f"failstop-bench-{os.getpid()}")
        self._units = os.path.join(self._group, "system.slice", "driver.service", "cgroup.procs")
        self._directory = tempfile.TemporaryDirectory(prefix="failstop-peer-")
        units = os.path.join(self._directory.name, "units")
        os.mkdir(units)
        service = SERVICE.format(root=ROOT, python=sys.executable, link=link)
        for name, text in (("bench.target", TARGET), ("driver.service", service)):
            with open(os.path.join(units, name), "w", encoding="utf-8") as file:
                file.write(text)
        try:
            os.mkdir(self._group)
            self._boot(units)
        except (OSError, TrialError, subprocess.SubprocessError) as error:
            self.close()
            raise PeerMissing(f"no systemd in a container here: {error}") from None
        except BaseException:
            self.close()
            raise

    def _boot(self, units: str) -> None:
        """Start it in its control group, tied to this process, and wait until it takes requests."""
        enter = 'echo $$ > "$0/cgroup.procs"; exec "$@"'
        boot = ["unshare", *NAMESPACES, "--fork", "--kill-child=KILL", "sh", "-c", BOOT, "boot", units, SYSTEMD]
        log = os.path.join(self._directory.name, "log")
        with open(log, "wb") as out:
            self._process = subprocess.Popen(
                ["setpriv", "--pdeathsig", "KILL", "sh", "-c", enter, self._group, *boot],
                stdin=subprocess.DEVNULL,
                stdout=out,
                stderr=out,
            )
        try:
            wait_for("systemd to take requests", self._listens)
        except TrialError as error:
            with open(log, encoding="utf-8", errors="replace") as said:
                raise TrialError(f"{error}: {said.read().strip()}") from None

    def _first(self) -> int:
        """The pid, out here, of the container's first process; 0 before there is one."""
        assert self._process is not None
        if self._process.poll() is not None:
            raise TrialError("the container has ended")
        pid = self._process.pid
        with open(f"/proc/{pid}/task/{pid}/children", encoding="ascii") as file:
            return int((file.read().split() or ["0"])[0])

    def _listens(self) -> bool:
        return os.path.exists(f"/proc/{self._first()}/root/run/systemd/private")

    def start(self) -> int:
        """Have the driver's service started; returns its pid out here."""
        command = ["nsenter", "-t", str(self._first()), "--mount", "--pid", "systemctl", "start", "driver.service"]
        subprocess.run(command, check=True, capture_output=True, timeout=END_S)
        return int(self._service()[0])

    def _service(self) -> list[str]:
        """Pids of the driver's service; none when its control group is gone, or goes between the open and the read."""
        try:
            with open(self._units, encoding="ascii") as file:
                return file.read().split()
        except OSError as error:
            if error.errno in (errno.ENOENT, errno.ENODEV):
                return []
            raise

    def settle(self) -> None:
        """Wait for the stop tool to be through."""
        wait_for("the driver's service to end", lambda: not self._service(), END_S)

    def close(self) -> None:
        """Kill the container and take its control groups away."""
        if self._process is not None:
            if self._process.poll() is None:
                self._process.kill()
            self._process.wait()
        until_s = time.monotonic() + END_S
        while os.path.isdir(self._group) and time.monotonic() < until_s:
            for group, _, _ in os.walk(self._group, topdown=False):
                # Until the last process of the container is gone.
                with contextlib.suppress(OSError):
                    os.rmdir(group)
            time.sleep(0.01)
        self._directory.cleanup()


def _hierarchy() -> str:
    """Where the machine's cgroup2 hierarchy is mounted. Raises PeerMissing, for anything else that is needed too."""
    if os.geteuid():
        raise PeerMissing("a systemd in a container needs root")
    if absent := [tool for tool in TOOLS if not shutil.which(tool)]:
        raise PeerMissing(f"not installed: {', '.join(absent)}")
    with open("/proc/self/mounts", encoding="utf-8") as file:
        for line in file:
            _, where, kind, *_ = line.split()
            if kind == "cgroup2":
                return where
    raise PeerMissing("no cgroup2 hierarchy is mounted")
