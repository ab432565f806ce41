"""The plugin and the stand-in of a controller manager, compiled for each release, and kept in build/ until a source
changes."""

from __future__ import annotations

import fcntl
import hashlib
import os
import shutil
import subprocess
from pathlib import Path

import pytest

ROOT = Path(__file__).resolve().parents[3]
STANDIN = Path(__file__).with_name("standin")
PLUGIN = ROOT / "integrations" / "ros2_control"
CLIENT = ROOT / "clients" / "c"
RELEASES = {"humble": 2, "jazzy": 4, "kilted": 5, "lyrical": 6}
"""The first number of hardware_interface's version."""
FLAGS = ("-std=c++17", "-O1", "-g", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Werror")


def without_compiler() -> str:
    """Why nothing can be compiled here; empty if it can."""
    missing = [tool for tool in ("g++", "gcc", "make") if shutil.which(tool) is None]
    return f"no {', '.join(missing)} here, which the ros2_control plugin is compiled with" if missing else ""


def needs_compiler() -> pytest.MarkDecorator:
    return pytest.mark.skipif(bool(without_compiler()), reason=without_compiler())


def includes(release: str) -> list[str]:
    own = STANDIN / ("humble" if release == "humble" else "later")
    return [f"-I{each}" for each in (STANDIN / "any", own, CLIENT / "include")]


def compiled(release: str) -> Path:
    """The folder of `manager` and `plugin.so`. Fails the test with the compiler's words."""
    sources = sorted(path for at in (STANDIN, PLUGIN / "src", CLIENT) for path in at.rglob("*") if _is_source(path))
    seen = hashlib.sha256(repr((release, FLAGS)).encode())
    for path in sources:
        seen.update(path.read_bytes())
    folder = ROOT / "build" / "ros2_control" / seen.hexdigest()[:16]
    folder.mkdir(parents=True, exist_ok=True)
    with open(folder / "lock", "w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not (folder / "whole").exists():
            _compile(release, folder)
            (folder / "whole").touch()
    return folder


def _is_source(path: Path) -> bool:
    return path.suffix in (".c", ".h", ".cpp", ".hpp") or path.name == "Makefile"


def _compile(release: str, folder: Path) -> None:
    number = f"-DRELEASE={RELEASES[release]}"
    run("make", "--silent", "-C", CLIENT, f"BUILD={folder}", folder / "libfailstop.so.0")
    library = folder / "libfailstop.so.0"
    own = sorted((PLUGIN / "src").glob("*.cpp"))
    run("g++", *FLAGS, number, "-fPIC", "-shared", *includes(release), *own, library, "-pthread",
        f"-Wl,-rpath,{folder}", "-o", folder / "plugin.so")  # fmt: skip
    run(
        "g++", *FLAGS, number, *includes(release), STANDIN / "manager.cpp", "-ldl", "-pthread", "-o", folder / "manager"
    )


def run(*words: str | os.PathLike[str]) -> None:
    done = subprocess.run(words, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    if done.returncode:
        pytest.fail(f"{' '.join(map(str, words))}\n{done.stderr[-4000:]}")
