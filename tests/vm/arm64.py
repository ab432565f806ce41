"""`make vm-arm64`: the tests of what processes share, and a demo, on Debian's arm64 kernel. Exit code 1 when one fails.

python -m tests.vm.arm64 [TEST ...]

An emulated machine with one processor and a clock that counts instructions (guest.py), made without running anything
of it here: Debian's packages are unpacked and no more, wheels too, and its init is a script that runs what is asked
for. It shows that the code runs there, system calls by their numbers, wheels and all. What one processor can't show is
the order in which another one sees what it writes: model/aarch64/README.md has that.
"""

from __future__ import annotations

import os
import re
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from tests.vm import image, initrd
from tests.vm.guest import LEAPS
from tests.vm.image import PYTHON, ROOT, SUITE, ImageError

TESTS = (
    *(f"tests/shm/test_{name}.py" for name in ("words", "ring", "latest", "barrier", "bell", "claim", "lifeline")),
    *(f"tests/procs/test_{name}.py" for name in ("loop", "wire", "port_owner", "stopper", "gate_shell", "starved")),
)
"""Those that most of the machine goes into: shared memory, the kernel's news of deaths, ports and clocks."""
DEMO = "demo"
PACKAGES = (
    *("bash", "base-files", "coreutils", "dash", "debianutils", "findutils", "grep", "kmod", "mount", "procps"),
    *("python3", "sed", "tar", "util-linux", "linux-image-arm64", "klibc-utils"),
)
NEEDED = {
    "qemu-system-aarch64": "qemu-system-arm",
    "mmdebstrap": "mmdebstrap",
    "mke2fs": "e2fsprogs",
    "depmod": "kmod",
    "setpriv": "util-linux",
}
BESIDE = ("hypothesis", "pytest", "pytest-timeout")
"""Packages that the tests need besides failstop's own."""
PLATFORMS = tuple(f"manylinux{glibc}_aarch64" for glibc in ("2014", "_2_17", "_2_28"))
DISK_SIZE, PAYLOAD_SIZE = "2G", 64 << 20
MEMORY_MB = 1536
CPU = "cortex-a72"
"""The Raspberry Pi 4's."""
TEST_S, WHOLE_S = 900, 3600.0
USERS = "root:x:0:0:root:/root:/bin/sh\nnobody:x:65534:65534:nobody:/nonexistent:/usr/sbin/nologin\n"
GROUPS = "root:x:0:\nnogroup:x:65534:\n"
INIT = """\
#!/bin/sh
export PATH=/usr/sbin:/usr/bin HOME=/root PYTHONPATH=/srv/failstop:/srv/failstop/lab:/srv/site
mount -o remount,rw /
mount -t proc proc /proc
mount -t sysfs sysfs /sys
mkdir -p /dev/pts /dev/shm
mount -t devpts devpts /dev/pts -o gid=5,mode=620,ptmxmode=666
for place in /dev/shm /run /tmp; do mount -t tmpfs tmpfs $place; done
tar --extract --warning=no-timestamp --file /dev/vdb --directory /srv/failstop
cd /srv/failstop
# What waits for the disk waits for a time that this clock does not count.
find /srv /usr/lib/python3* -type f -exec cat {} + >/dev/null
. /srv/failstop/asked.sh
sync
echo o >/proc/sysrq-trigger
sleep 60
"""
ENDED = re.compile(r"ENDED (\S+) (\d+) ([\d.]+)")


def check() -> None:
    """Raise ImageError, with the remedy, when something is missing."""
    image.check(NEEDED)


def make() -> tuple[Path, Path, Path]:
    """Disk, kernel and initrd, made as far as they are not there. Raises ImageError."""
    needed = [*image.dependencies(), *BESIDE]
    name = image.key(SUITE, *PACKAGES, *needed, INIT, USERS, GROUPS, DISK_SIZE, Path(initrd.__file__).read_text())
    place = image.cache() / f"arm64-{name}"
    if not place.is_dir():
        image.cache().mkdir(parents=True, exist_ok=True)
        with image.new(place) as beside, tempfile.TemporaryDirectory(dir=image.cache(), prefix="root-") as directory:
            beside.mkdir()
            _fill(Path(directory, "root"), Path(directory, "wheels"), needed, beside)
    return place / "disk.img", place / "vmlinuz", place / "initrd.img"


def _fill(root: Path, wheels: Path, needed: list[str], place: Path) -> None:
    image.say(f"getting Debian ({SUITE}) for arm64 ...")
    image.run(
        *("mmdebstrap", "--quiet", "--mode=root", "--variant=extract", "--architectures=arm64", "--format=directory"),
        *("--hook-dir=/usr/share/mmdebstrap/hooks/merged-usr", f"--include={','.join(PACKAGES)}"),
        '--aptopt=Acquire::Languages "none"',
        *(f"--dpkgopt=path-exclude={left}" for left in image.LEFT_OUT),
        *(SUITE, str(root)),
    )
    image.run("depmod", "--basedir", str(root), next((root / "lib/modules").iterdir()).name)
    for name in ("proc", "sys", "run", "root", "srv/failstop", "srv/site"):
        (root / name).mkdir(parents=True, exist_ok=True)
    (root / "etc/passwd").write_text(USERS)
    (root / "etc/group").write_text(GROUPS)
    (root / "srv/init").write_text(INIT)
    (root / "srv/init").chmod(0o755)
    image.wheels(wheels, needed, PLATFORMS)
    for wheel in wheels.glob("*.whl"):
        image.run(sys.executable, "-m", "zipfile", "-e", str(wheel), str(root / "srv/site"))
    shutil.copyfile(next((root / "boot").glob("vmlinuz-*")), place / "vmlinuz")
    (place / "initrd.img").write_bytes(initrd.make(root, "/srv/init"))
    image.run("truncate", "--size", DISK_SIZE, str(place / "disk.img"))
    image.run("mke2fs", "-q", "-t", "ext4", "-d", str(root), str(place / "disk.img"))


def asked(tests: list[str]) -> str:
    """The script of what is run: each says with which code it ended, and when (seconds of the guest's time)."""
    pytest = f"python{PYTHON} -m pytest -p no:cacheprovider -o addopts= -q --color=no --timeout {TEST_S}"
    commands = {**{test: f"{pytest} {test}" for test in tests}, DEMO: f"python{PYTHON} -m failstop demo"}
    return "".join(
        f'{command} 2>&1 </dev/null\necho "ENDED {name} $? $(cut -d" " -f1 /proc/uptime)"\n'
        for name, command in commands.items()
    )


def payload(path: Path, script: str) -> None:
    """This checkout and the script, as a tar that the guest sees as a disk."""
    with tempfile.TemporaryDirectory() as directory:
        Path(directory, "asked.sh").write_text(script)
        names = subprocess.run(
            ["git", "-C", str(ROOT), "ls-files", "-z", "--cached", "--others", "--exclude-standard"],
            check=True,
            capture_output=True,
        ).stdout
        there = b"\0".join(name for name in names.split(b"\0") if name and os.path.lexists(ROOT / os.fsdecode(name)))
        tar = ["tar", "-C", str(ROOT), "--null", "--files-from=-", "-cf", str(path)]
        subprocess.run(tar, input=there, check=True)
        subprocess.run(["tar", "-C", directory, "-rf", str(path), "asked.sh"], check=True)
    if path.stat().st_size > PAYLOAD_SIZE:
        raise ImageError(f"{path} is larger than {PAYLOAD_SIZE} bytes: raise tests/vm/arm64.py's PAYLOAD_SIZE")
    with path.open("r+b") as file:
        file.truncate(PAYLOAD_SIZE)


def command(made: tuple[Path, Path, Path], payload_disk: Path) -> list[str]:
    """How qemu is called; the console is its output."""
    disk, kernel, start = made
    drives = (f"file={disk},if=none,id=system,cache=unsafe,snapshot=on", f"file={payload_disk},if=none,id=payload")
    return [
        *("setpriv", "--pdeathsig", "KILL", "qemu-system-aarch64", "-nodefaults", "-no-reboot", "-display", "none"),
        *("-M", "virt", "-cpu", CPU, "-accel", "tcg,thread=single", "-icount", LEAPS, "-m", str(MEMORY_MB)),
        *("-kernel", str(kernel), "-initrd", str(start), "-append", "console=ttyAMA0 quiet panic=-1"),
        *(word for drive in drives for word in ("-drive", f"{drive},format=raw")),
        *(word for name in ("system", "payload") for word in ("-device", f"virtio-blk-pci,drive={name}")),
        *("-device", "virtio-rng-pci", "-serial", "stdio"),
    ]


def lines(words: list[str], whole_s: float = WHOLE_S) -> Iterator[str]:
    """The guest's output, until it has ended. Raises ImageError after `whole_s`."""
    with subprocess.Popen(
        words, stdin=subprocess.DEVNULL, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True, errors="replace"
    ) as process:
        until_s = time.monotonic() + whole_s
        assert process.stdout is not None
        try:
            for line in process.stdout:
                yield line.rstrip()
                if time.monotonic() > until_s:
                    raise ImageError(f"the guest has not ended within {whole_s:g} s")
        finally:
            process.kill()


def main(words: Sequence[str]) -> int:
    """Make it, run these tests in it or those of the table, and say what came of it."""
    tests = list(words or TESTS)
    start_s = time.monotonic()
    found: dict[str, tuple[int, float]] = {}
    try:
        check()
        made = make()
        with tempfile.TemporaryDirectory(prefix="failstop-arm64-") as directory:
            disk = Path(directory, "payload.img")
            payload(disk, asked(tests))
            for line in lines(command(made, disk)):
                if ended := ENDED.fullmatch(line):
                    found[ended[1]] = (int(ended[2]), float(ended[3]))
                else:
                    print(line, flush=True)
    except ImageError as error:
        print(f"make vm-arm64: {error}", file=sys.stderr)
        return 2
    print(f"\n{'run in the guest':<34} {'code':>4}  until, s of its time")
    for name in (*tests, DEMO):
        code, at_s = found.get(name, (-1, float("nan")))
        print(f"{name:<34} {code:>4}  {at_s:.0f}")
    print(f"{time.monotonic() - start_s:.0f} s here")
    return int(any(found.get(name, (-1, 0.0))[0] for name in (*tests, DEMO)))


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
