"""Payload of the trials: this checkout, its laboratory and the trials, as a tar that the guest sees as a disk of its
own."""

from __future__ import annotations

import compileall
import subprocess
import sys
import tempfile
from pathlib import Path

from tests.vm.image import PYTHON, ROOT, ImageError

SIZE = 32 << 20
"""One size each time: a saved guest knows its disks by their sizes."""
DISK = "/dev/vdb"
TRIALS = ("tests/__init__.py", "tests/support/terminal.py", "tests/vm", "packaging", "systemd", "LICENSE")
"""What the guest runs the trials of, and builds the package of, besides the installed failstop."""
SITE = f"lib/python{PYTHON}/site-packages"
UNPACK = f"""set -e
blockdev --flushbufs {DISK}
mkdir -p /srv/trials
tar --extract --warning=no-timestamp --file {DISK} --directory /srv/trials
cp --archive /srv/trials/site/. /srv/venv/{SITE}
rm -r /srv/trials/site
"""
"""As pip does with a wheel; its start alone takes the guest ten seconds."""


def blank(path: Path) -> Path:
    """A disk of that size with nothing on it, to boot with."""
    with path.open("wb") as file:
        file.truncate(SIZE)
    return path


def make(path: Path) -> Path:
    """Build the wheels, unpack them and write the disk. Raises ImageError."""
    with tempfile.TemporaryDirectory() as directory:
        tracked = _output("git", "-C", str(ROOT), "ls-files", "-z", "--cached", "--others", "--exclude-standard")
        source = Path(directory, "source")
        source.mkdir()
        names = "\0".join(name for name in tracked.split("\0") if name and (ROOT / name).exists())
        copied = subprocess.run(
            ["tar", "-C", str(ROOT), "--null", "-T", "-", "-cf", "-"],
            input=names.encode(),
            stdout=subprocess.PIPE,
            check=True,
        )
        subprocess.run(["tar", "-C", str(source), "-xf", "-"], input=copied.stdout, check=True)
        pip = (sys.executable, "-m", "pip", "wheel", "--quiet", "--disable-pip-version-check", "--no-deps")
        _output(*pip, "--wheel-dir", directory, str(source), str(source / "lab"))
        for wheel in Path(directory).glob("*.whl"):
            _output(sys.executable, "-m", "zipfile", "-e", str(wheel), f"{directory}/site")
        if sys.version_info[:2] == tuple(int(part) for part in PYTHON.split(".")):
            # As pip leaves them, where this Python can do it for the guest's.
            compileall.compile_dir(f"{directory}/site", quiet=2)
        _output("tar", "-cf", str(path), "-C", directory, "site", "-C", str(source), *TRIALS)
    if path.stat().st_size > SIZE:
        raise ImageError(f"{path} is larger than {SIZE} bytes: raise tests/vm/payload.py's SIZE")
    with path.open("r+b") as file:
        file.truncate(SIZE)
    return path


def _output(*words: str) -> str:
    done = subprocess.run(words, check=False, capture_output=True, text=True, stdin=subprocess.DEVNULL)
    if done.returncode:
        raise ImageError(f"{' '.join(words[:3])} failed: {done.stderr.strip()[-500:]}")
    return done.stdout
