"""The C library as two Debian packages: libfailstop0, which programs run with, and libfailstop-dev, which they are
compiled with. Built from clients/c by the machine's compiler, or by a cross compiler for another architecture."""

from __future__ import annotations

import os
import shutil
import subprocess
import tempfile
from pathlib import Path

from tree import BuildError

CHECKOUT = Path(__file__).resolve().parents[2]
SOURCE = CHECKOUT / "clients" / "c"
RUNTIME, DEVELOPMENT = "libfailstop0", "libfailstop-dev"
TRIPLETS = {"amd64": "x86_64-linux-gnu", "arm64": "aarch64-linux-gnu", "armhf": "arm-linux-gnueabihf"}
"""The names of compilers and of libraries' folders, by Debian's word for the architecture."""
FLAGS = "-O2 -fstack-protector-strong -D_FORTIFY_SOURCE=2"
"""As Debian's own packages are built; no paths of the builder are in the result."""


def compiler(architecture: str, ours: str) -> str:
    """The C compiler for an architecture, `ours` being this machine's. Raises BuildError with what to install."""
    crossed = f"{TRIPLETS.get(architecture, architecture)}-gcc"
    names = (crossed, "gcc", "cc") if architecture == ours else (crossed,)
    found = next((name for name in names if shutil.which(name)), "")
    if found and shutil.which("make"):
        return found
    package = "gcc libc6-dev" if architecture == ours else f"gcc-{TRIPLETS.get(architecture, architecture)}"
    raise BuildError(
        f"{RUNTIME} and {DEVELOPMENT} need a C compiler for {architecture} and make: apt install make {package}"
    )


def files(architecture: str, ours: str) -> tuple[dict[str, bytes | str], dict[str, bytes | str]]:
    """The content of both packages by path, a link as `-> target`. Raises BuildError."""
    command, triplet = compiler(architecture, ours), TRIPLETS[architecture]
    folder = f"usr/lib/{triplet}"
    with tempfile.TemporaryDirectory(prefix="failstop-c-") as name:
        root = Path(name)
        _make(root, command, f"DESTDIR={root / 'root'}", "PREFIX=/usr", f"LIBDIR=lib/{triplet}", "install")
        tool = command.removesuffix("gcc").removesuffix("cc")
        placed = root / "root" / folder
        plain = ("--remove-section=.comment", "--remove-section=.note")
        _run(f"{tool}strip", "--strip-unneeded", *plain, placed / "libfailstop.so.0")
        _run(f"{tool}strip", "--strip-debug", "--enable-deterministic-archives", *plain, placed / "libfailstop.a")
        library = {f"{folder}/libfailstop.so.0": (placed / "libfailstop.so.0").read_bytes()}
        rest: dict[str, bytes | str] = {
            str(path.relative_to(root / "root")): path.read_bytes()
            for path in sorted((root / "root").rglob("*"))
            if path.is_file() and not path.is_symlink() and path.name != "libfailstop.so.0"
        }
    example = (SOURCE / "examples" / "patrol.c").read_text()
    return {**library}, {
        **rest,
        f"{folder}/libfailstop.so": "-> libfailstop.so.0",
        f"usr/share/doc/{DEVELOPMENT}/examples/patrol.c": example,
    }


def control(version: str) -> dict[str, str]:
    """Files of DEBIAN/ that the runtime package has beside its control file: what else links with it, and the cache
    that the loader looks into."""
    return {
        "DEBIAN/shlibs": f"libfailstop 0 {RUNTIME} (>= {version})\n",
        "DEBIAN/triggers": "activate-noawait ldconfig\n",
    }


def _make(root: Path, command: str, *words: str) -> None:
    """Without the warnings that are errors while one develops: a newer compiler has others."""
    settings = (f"BUILD={root / 'build'}", f"CC={command}", f"CFLAGS={FLAGS}", "LDFLAGS=-Wl,--build-id=sha1", "WARN=")
    _run("make", "--silent", "-C", SOURCE, *settings, *words)


def _run(*words: str | Path) -> None:
    done = subprocess.run(
        words, capture_output=True, text=True, check=False, env={**os.environ, "LC_ALL": "C", "ZERO_AR_DATE": "1"}
    )
    if done.returncode:
        raise BuildError(f"{' '.join(map(str, words[:3]))} failed: {done.stdout}{done.stderr}")
