"""Fresh Debian systems of other releases, unpacked from the package index and thrown away after use.

Each is a folder that mmdebstrap has made once, below build/debian, with an overlay for what is written to it.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import shutil
import subprocess
import tempfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from bench import BenchError
from bench.report import progress

ROOT = Path(__file__).resolve().parents[2]
KEPT = ROOT / "build/debian"
NOT_VALID = 'Acquire::Check-Valid-Until "false"'
"""A mirror that is behind has a testing suite whose date has passed; its signature still counts."""
FORMATS = Path("/proc/sys/fs/binfmt_misc")
EMULATED = "failstop-qemu-aarch64"
AARCH64 = (
    rb":" + EMULATED.encode() + rb":M::\x7fELF\x02\x01\x01\x00\x00\x00\x00\x00\x00\x00\x00\x00\x02\x00\xb7\x00:"
    rb"\xff\xff\xff\xff\xff\xff\xff\x00\xff\xff\xff\xff\xff\xff\xff\xff\xfe\xff\xff\xff:/usr/bin/qemu-aarch64-static:F"
)
"""The kernel's rule for programs of this kind; F: the emulator is opened now, so no system needs a copy."""
ENTER = """
set -eu
lower=$1 base=$2 script=$3
mount --make-rprivate /
mount -t tmpfs -o mode=755 overlay "$base"
mkdir "$base/up" "$base/work" "$base/root"
mount -t overlay -o "lowerdir=$lower,upperdir=$base/up,workdir=$base/work" overlay "$base/root"
cd "$base/root"
mount -t proc proc proc
mount -t sysfs -o ro sysfs sys
mount --rbind /dev dev
mount -t tmpfs -o mode=1777 shm dev/shm
mkdir -p packages
mount --bind "$4" packages
cp -L /etc/resolv.conf etc/resolv.conf
exec chroot . env -i HOME=/root LANG=C.UTF-8 PATH=/usr/local/bin:/usr/sbin:/usr/bin:/sbin:/bin sh -c "$script"
"""


class Suite(NamedTuple):
    """A release of Debian."""

    name: str
    number: str
    """As people name it."""
    python: str


SUITES = {
    suite.name: suite
    for suite in (Suite("bookworm", "12", "3.11"), Suite("trixie", "13", "3.13"), Suite("forky", "testing", "3.14"))
}


def unpacked(suite: str, include: Sequence[str] = (), architecture: str = "") -> Path:
    """The folder with a fresh minimal system of a suite and of these packages, which is only read; made where there is
    none. Raises BenchError."""
    chosen = hashlib.sha256(" ".join(include).encode()).hexdigest()[:8]
    folder = KEPT / "-".join(filter(None, (suite, architecture, chosen)))
    KEPT.mkdir(parents=True, exist_ok=True)
    with open(folder.with_suffix(".lock"), "w", encoding="ascii") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not folder.exists():
            progress(f"unpacking a fresh Debian: {folder.name}")
            part = folder.with_suffix(".part")
            shutil.rmtree(part, ignore_errors=True)
            words = ["mmdebstrap", "--quiet", "--variant=minbase", f"--aptopt={NOT_VALID}"]
            words += [f"--include={','.join(include)}"] if include else []
            words += [f"--architectures={architecture}"] if architecture else []
            made = subprocess.run([*words, suite, part], capture_output=True, text=True, check=False)
            if made.returncode:
                raise BenchError(f"no fresh Debian {suite} can be made: {made.stdout[-2000:]}{made.stderr[-2000:]}")
            part.rename(folder)
    return folder


@contextlib.contextmanager
def emulated() -> Iterator[None]:
    """The kernel runs programs for arm64 by qemu-user. Raises BenchError with what is missing."""
    if not (Path("/usr/bin/qemu-aarch64-static").exists() and shutil.which("arch-test")):
        raise BenchError("programs for arm64 need an emulator: apt install qemu-user-static arch-test")
    if not (FORMATS / "register").exists():
        subprocess.run(["mount", "-t", "binfmt_misc", "binfmt_misc", FORMATS], check=False)
    here = [path for path in FORMATS.glob("*aarch64*") if path.read_text().startswith("enabled")]
    try:
        if not here:
            (FORMATS / "register").write_bytes(AARCH64)
        yield
    except OSError as error:
        raise BenchError(f"the kernel takes no emulator of arm64: {error}") from None
    finally:
        if not here and (FORMATS / EMULATED).exists():
            (FORMATS / EMULATED).write_text("-1")


def run(system: Path, script: str, packages: Path, timeout_s: float) -> subprocess.CompletedProcess[str]:
    """Run a script as root in a copy of a fresh system, with the network, and with this folder at /packages. Nothing
    that it writes stays, and no process that it starts. Raises BenchError when it takes too long."""
    with tempfile.TemporaryDirectory(prefix="failstop-debian-") as base:
        words = ["unshare", "--mount", "--pid", "--ipc", "--fork", "--kill-child=KILL", "sh", "-c", ENTER, "enter"]
        try:
            return subprocess.run(
                [*words, str(system), base, script, str(packages)],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.PIPE,
                stderr=subprocess.STDOUT,
                text=True,
                errors="replace",
                timeout=timeout_s,
                check=False,
            )
        except subprocess.TimeoutExpired as late:
            printed = (late.stdout or b"").decode(errors="replace").splitlines()
            last = printed[-1] if printed else "nothing"
            raise BenchError(
                f"a script in {system.name} took more than {timeout_s:g} s; it printed last: {last}"
            ) from None
