"""Powers of a process of the unit: tries everything once and prints what came of it, as JSON.

Run by the unit itself, in place of the service.
"""

from __future__ import annotations

import ctypes
import errno
import grp
import json
import mmap
import os
import resource
import signal
import socket
import sys
from collections.abc import Callable

_libc = ctypes.CDLL(None, use_errno=True)
CLONE_NEWUSER = 0x10000000
FIFO_PRIORITY = 33
MCL_ONFAULT = 4
MCL_CURRENT = 1
KEYCTL = {"x86_64": 250, "aarch64": 219}
MOUNT_FLAGS = 0


def outcome(action: Callable[[], object]) -> str:
    """`ok`, or the name of the error."""
    try:
        action()
    except OSError as error:
        return errno.errorcode.get(error.errno or 0, str(error))
    return "ok"


def called(*words: object) -> Callable[[], None]:
    """A call of the C library, by name, that is to return 0 or more."""

    def call() -> None:
        name, *arguments = words
        if getattr(_libc, str(name))(*arguments) < 0:
            number = ctypes.get_errno()
            raise OSError(number, os.strerror(number))

    return call


def write(path: str) -> Callable[[], None]:

    def make() -> None:
        os.close(os.open(path, os.O_WRONLY | os.O_CREAT, 0o644))
        os.unlink(path)

    return make


def device(major: int, minor: int) -> Callable[[], None]:
    return lambda: os.close(os.open(f"/dev/probe-{major}-{minor}", os.O_RDWR | os.O_NONBLOCK | os.O_NOCTTY))


def executable_memory() -> None:
    mmap.mmap(-1, 4096, prot=mmap.PROT_READ | mmap.PROT_WRITE | mmap.PROT_EXEC).close()


def real_time() -> None:
    """Ask for real time as the port owner does, and take it away as the service does from the dying."""
    os.sched_setscheduler(0, os.SCHED_FIFO | os.SCHED_RESET_ON_FORK, os.sched_param(FIFO_PRIORITY))
    os.sched_setscheduler(0, os.SCHED_OTHER | os.SCHED_RESET_ON_FORK, os.sched_param(0))


ATTEMPTS: dict[str, Callable[[], object]] = {
    "write /etc": write("/etc/probe"),
    "write /usr": write("/usr/probe"),
    "write /opt": write("/opt/probe"),
    "write /tmp": write("/tmp/probe"),
    "write /dev/shm": write("/dev/shm/probe"),
    "write /run/failstop": write("/run/failstop/probe"),
    "write /var/lib/failstop": write("/var/lib/failstop/failstop/probe"),
    "write /proc/sys": lambda: os.close(os.open("/proc/sys/kernel/hostname", os.O_WRONLY)),
    "list /root": lambda: os.listdir("/root"),
    "list /home": lambda: os.listdir("/home"),
    "see /proc/1": lambda: os.stat("/proc/1"),
    "signal to another's process": lambda: os.kill(os.getppid(), signal.SIGCONT),
    "device of memory": device(1, 11),
    "device of a serial port that is not the board's": device(207, 16),
    "inet socket": lambda: socket.socket(socket.AF_INET, socket.SOCK_DGRAM),
    "netlink socket": lambda: socket.socket(socket.AF_NETLINK, socket.SOCK_RAW),
    "unix socket": lambda: socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM),
    "executable memory": executable_memory,
    "namespace": called("unshare", CLONE_NEWUSER),
    "mount": called("mount", b"none", b"/mnt", b"tmpfs", MOUNT_FLAGS, None),
    "setuid": lambda: os.setuid(0),
    "keyring": called("syscall", KEYCTL.get(os.uname().machine, -1), 0, 0, 0),
    "suid file": lambda: os.chmod("/run/failstop/suid", 0o4755),
    "chown to its group": lambda: os.chown("/run/failstop/suid", -1, grp.getgrnam("failstop").gr_gid),
    "real time": real_time,
    "locked memory": called("mlockall", MCL_CURRENT | MCL_ONFAULT),
}


def main() -> int:
    os.close(os.open("/run/failstop/suid", os.O_WRONLY | os.O_CREAT, 0o644))
    found: dict[str, object] = {name: outcome(action) for name, action in ATTEMPTS.items()}
    os.unlink("/run/failstop/suid")
    with open("/proc/self/status", encoding="utf-8") as file:
        fields = dict(line.rstrip("\n").split(":\t", 1) for line in file if ":\t" in line)
    with open("/proc/self/oom_score_adj", encoding="utf-8") as file:
        found["oom"] = int(file.read())
    found["groups"] = sorted(grp.getgrgid(gid).gr_name for gid in os.getgroups())
    found["no new privileges"] = fields["NoNewPrivs"]
    found["capabilities"] = [int(fields[key], 16) for key in ("CapEff", "CapPrm", "CapBnd", "CapAmb")]
    found["core"] = resource.getrlimit(resource.RLIMIT_CORE)
    json.dump(found, sys.stdout)
    return 0


if __name__ == "__main__":
    sys.exit(main())
