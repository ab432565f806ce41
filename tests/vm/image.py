"""The guest's disk: a stock Debian with its own kernel, and a Python environment with what failstop needs.

Each stage is kept under a name that says what it was made from, so that a change makes again what depends on it: the
packages (rootfs-KEY.tar), the disk with kernel and initrd (disk-KEY). Needs root, a Debian mirror, a package index.
"""

from __future__ import annotations

import contextlib
import hashlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

from tests.vm import initrd

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).resolve().parents[2]
HERE = Path(__file__).resolve().parent
SUITE = "bookworm"
PYTHON = "3.11"
"""Of that Debian."""
PACKAGES = (
    "systemd",
    "systemd-sysv",
    "udev",
    "dbus",
    "kmod",
    "procps",
    "psmisc",
    "python3",
    "python3-venv",
    "modemmanager",
)
KERNEL = ("linux-image-amd64", "klibc-utils")
LEFT_OUT = (
    *(f"/usr/share/{name}/*" for name in ("doc", "locale", "man")),
    # tests.vm.initrd makes one.
    "/etc/kernel/postinst.d/initramfs-tools",
)
NEEDED = {
    "qemu-system-x86_64": "qemu-system-x86",
    "qemu-img": "qemu-utils",
    "mmdebstrap": "mmdebstrap",
    "mke2fs": "e2fsprogs",
    "setpriv": "util-linux",
}
"""Programs of this machine, and the Debian packages that have them."""
DISK_SIZE = "2G"
PLATFORMS = tuple(f"manylinux{glibc}_x86_64" for glibc in ("2014", "_2_17", "_2_28"))
MASKED = (
    *("apt-daily.timer", "apt-daily-upgrade.timer", "dpkg-db-backup.timer", "fstrim.timer", "e2scrub_all.timer"),
    *("e2scrub_reap.service", "systemd-timesyncd.service", "getty@tty1.service", "systemd-pstore.service"),
    *("serial-getty@ttyS0.service", "systemd-binfmt.service", "systemd-update-utmp.service"),
    *("systemd-update-utmp-runlevel.service", "dev-hugepages.mount", "dev-mqueue.mount", "sys-kernel-debug.mount"),
    *("sys-kernel-tracing.mount", "sys-kernel-config.mount", "sys-fs-fuse-connections.mount"),
    *(f"modprobe@{name}.service" for name in ("configfs", "dm_mod", "drm", "fuse", "loop")),
)
"""Units that would only take the one processor from what is looked at."""
AGENT_UNIT = """\
[Unit]
Description=commands from the machine outside
DefaultDependencies=no
After=systemd-udevd.service local-fs.target dev-virtio\\x2dports-failstop.vm.device
Wants=dev-virtio\\x2dports-failstop.vm.device
Conflicts=shutdown.target
Before=shutdown.target

[Service]
ExecStart=/usr/bin/python3 /usr/local/sbin/vm-agent
# What it started may be what ends the system.
KillMode=process
OOMScoreAdjust=-1000

[Install]
WantedBy=multi-user.target
"""
AGENT_RULE = 'SUBSYSTEM=="virtio-ports", TAG+="systemd"\n'


class ImageError(Exception):
    """The image can't be made; the message is one line with the remedy."""


class Image(NamedTuple):
    """The things that are booted. `key` says what all of it was made from."""

    key: str
    disk: Path
    kernel: Path
    initrd: Path


def cache() -> Path:
    """Where the stages are kept: FAILSTOP_VM_CACHE, or a folder among the user's caches."""
    named = os.environ.get("FAILSTOP_VM_CACHE")
    return Path(named) if named else Path(os.environ.get("XDG_CACHE_HOME", Path.home() / ".cache")) / "failstop-vm"


def check(needed: dict[str, str] = NEEDED) -> None:
    """Raise ImageError, with the remedy, when something is missing."""
    missing = sorted({package for program, package in needed.items() if shutil.which(program) is None})
    if missing:
        raise ImageError(f"missing here: apt-get install --no-install-recommends {' '.join(missing)}")
    if os.geteuid():
        raise ImageError("a disk with the system's own owners is made by root alone: sudo make vm")


def dependencies() -> list[str]:
    """Packages that failstop needs, and what it and its Debian package are built with."""
    found = tomllib.loads((ROOT / "pyproject.toml").read_text())
    extras = found["project"]["optional-dependencies"]
    needed = [*found["project"]["dependencies"], *extras["fleet"], *extras["web"], *extras["deb"]]
    needed = [one for one in needed if "python_version" not in one and not one.startswith("failstop")]
    return [*needed, *found["build-system"]["requires"], "wheel"]


def make() -> Image:
    """The image, made as far as it is not there. Raises ImageError."""
    check()
    cache().mkdir(parents=True, exist_ok=True)
    packages = key(SUITE, *PACKAGES, *KERNEL, *LEFT_OUT)
    made_by = ((HERE / name).read_text() for name in ("agent.py", "initrd.py"))
    name = key(packages, *dependencies(), AGENT_UNIT, AGENT_RULE, *MASKED, DISK_SIZE, *made_by)
    place = cache() / f"disk-{name}"
    if not place.is_dir():
        with new(place) as beside:
            beside.mkdir()
            _disk(_rootfs(packages), beside)
    return Image(name, place / "disk.img", place / "vmlinuz", place / "initrd.img")


def _rootfs(key: str) -> Path:
    path = cache() / f"rootfs-{key}.tar"
    if not path.exists():
        say(f"getting Debian ({SUITE}) ...")
        with new(path) as beside:
            run(
                *("mmdebstrap", "--quiet", "--mode=root", "--variant=minbase", "--format=tar"),
                f"--include={','.join((*PACKAGES, *KERNEL))}",
                '--aptopt=Acquire::Languages "none"',
                *(f"--dpkgopt=path-exclude={left}" for left in LEFT_OUT),
                *(SUITE, str(beside)),
            )
    return path


def _disk(rootfs: Path, place: Path) -> None:
    say("making the guest's disk ...")
    with tempfile.TemporaryDirectory(dir=cache(), prefix="root-") as directory:
        root = Path(directory)
        root.chmod(0o755)
        run("tar", "--extract", "--numeric-owner", "--file", str(rootfs), "--directory", directory)
        # Packed, as Debian ships it: started from its ELF file, past the BIOS, a guest that wakes up from sleep boots.
        shutil.copyfile(next((root / "boot").glob("vmlinuz-*")), place / "vmlinuz")
        (place / "initrd.img").write_bytes(initrd.make(root))
        _environment(root)
        _settle(root)
        run("truncate", "--size", DISK_SIZE, str(place / "disk.img"))
        run("mke2fs", "-q", "-t", "ext4", "-d", directory, str(place / "disk.img"))


def _environment(root: Path) -> None:
    """A venv with everything but failstop itself, which is another at each run."""
    place = root / "srv" / "wheels"
    wheels(place, dependencies(), PLATFORMS)
    inside = ("chroot", str(root), "env", "-i", "PATH=/usr/bin:/bin", "PIP_CONFIG_FILE=/dev/null")
    run(*inside, "python3", "-m", "venv", "/srv/venv")
    pip = ("/srv/venv/bin/pip", "install", "--quiet", "--disable-pip-version-check", "--no-index")
    run(*inside, *pip, "--find-links", "/srv/wheels", *dependencies())
    shutil.rmtree(place)


def wheels(place: Path, needed: list[str], platforms: tuple[str, ...]) -> None:
    """Get the wheels of these packages, and of what they need, for the guest's Python. Raises ImageError."""
    place.mkdir(parents=True)
    run(
        *(sys.executable, "-m", "pip", "download", "--quiet", "--disable-pip-version-check", "--dest", str(place)),
        *("--only-binary=:all:", "--implementation", "cp", "--python-version", PYTHON),
        *(word for platform in platforms for word in ("--platform", platform)),
        *needed,
    )


def _settle(root: Path) -> None:
    """The guest's own configuration."""
    units = root / "etc/systemd/system"
    shutil.copy(HERE / "agent.py", root / "usr/local/sbin/vm-agent")
    (units / "vm-agent.service").write_text(AGENT_UNIT)
    (root / "etc/udev/rules.d/99-vm-agent.rules").write_text(AGENT_RULE)
    wants = units / "multi-user.target.wants"
    wants.mkdir(exist_ok=True)
    (wants / "vm-agent.service").symlink_to("../vm-agent.service")
    for unit in MASKED:
        (units / unit).unlink(missing_ok=True)
        (units / unit).symlink_to("/dev/null")
    (root / "etc/hostname").write_text("vm\n")
    (root / "etc/fstab").write_text("/dev/vda / ext4 defaults,noatime 0 1\n")
    (root / "var/log/journal").mkdir(exist_ok=True)


def key(*parts: str) -> str:
    """A short name of all these."""
    return hashlib.sha256("\0".join(parts).encode()).hexdigest()[:12]


@contextlib.contextmanager
def new(path: Path) -> Iterator[Path]:
    """A name beside it that takes its place when all is well, and goes away otherwise."""
    beside = path.with_name(f"{path.name}.{os.getpid()}.new")
    try:
        yield beside
        beside.rename(path)
    finally:
        if beside.is_dir():
            shutil.rmtree(beside)
        else:
            beside.unlink(missing_ok=True)


def run(*words: str) -> None:
    """Run a program that must succeed. Raises ImageError with what it said."""
    done = subprocess.run(words, check=False, capture_output=True, text=True, stdin=subprocess.DEVNULL)
    if done.returncode:
        said = (done.stderr or done.stdout).strip().splitlines()[-5:]
        raise ImageError(f"{' '.join(words[:2])} failed ({done.returncode}): {' | '.join(said)}")


def say(line: str) -> None:
    """A line for who waits."""
    print(line, flush=True)
