"""A controller manager of ros2_control that drives through failstop's plugin, without ROS: a stand-in of its interfaces
and of its loop, compiled with the plugin from the source of failstop. What is built is kept in build/ until a source
changes.
"""

from __future__ import annotations

import contextlib
import fcntl
import hashlib
import os
import re
import shutil
import signal
import subprocess
from collections.abc import Mapping, Sequence
from pathlib import Path

from failstop_lab.trial import TrialError, wait_for

ROOT = Path(__file__).resolve().parents[2]
STANDIN = ROOT / "tests" / "integrations" / "ros2_control" / "standin"
PLUGIN = ROOT / "integrations" / "ros2_control"
CLIENT = ROOT / "clients" / "c"
RELEASES = {"humble": 2, "jazzy": 4, "kilted": 5, "lyrical": 6}
"""The first number of hardware_interface's version."""
NEWEST = "lyrical"
FLAGS = ("-std=c++17", "-O1", "-g", "-Wall", "-Wextra", "-Wconversion", "-Wshadow", "-Werror")
HZ = 50
TOLD_S = 20.0


def uncompilable() -> str:
    """Why it can't be compiled here; empty if it can."""
    if not STANDIN.exists():
        return "the ros2_control plugin is not tried: it needs a checkout of failstop's source"
    missing = [tool for tool in ("g++", "gcc", "make") if shutil.which(tool) is None]
    return f"the ros2_control plugin is not tried: no {', '.join(missing)} here" if missing else ""


def compiled(release: str) -> Path:
    """The folder of `manager` and `plugin.so` for a release. Raises TrialError with the compiler's words."""
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
    return path.suffix in (".c", ".h", ".cpp", ".hpp", ".map") or path.name == "Makefile"


def _compile(release: str, folder: Path) -> None:
    library = folder / "libfailstop.so.0"
    run("make", "--silent", "-C", CLIENT, f"BUILD={folder}", library)
    own = STANDIN / ("humble" if release == "humble" else "later")
    included = [f"-I{each}" for each in (STANDIN / "any", own, CLIENT / "include")]
    words = ("g++", *FLAGS, f"-DRELEASE={RELEASES[release]}", *included, "-pthread")
    sources = sorted((PLUGIN / "src").glob("*.cpp"))
    run(*words, "-fPIC", "-shared", *sources, library, f"-Wl,-rpath,{folder}", "-o", folder / "plugin.so")
    run(*words, STANDIN / "manager.cpp", "-ldl", "-o", folder / "manager")


def run(*words: str | os.PathLike[str]) -> None:
    """Raises TrialError with what the command said."""
    done = subprocess.run(words, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
    if done.returncode:
        raise TrialError(f"{' '.join(map(str, words))}\n{done.stderr[-4000:]}")


def with_wheels(name: str, service: str, wheels: Sequence[str]) -> list[str]:
    """The description of a hardware of these wheels, as the stand-in reads it: each is a joint of its name."""
    joints = [(f"joint {wheel}", f"param wheel {wheel}", "command velocity", "state position") for wheel in wheels]
    return [f"name {name}", f"param service {service}", *(line for joint in joints for line in joint), "end"]


class Manager:
    """A context manager: the process of the stand-in, in a folder of its own."""

    def __init__(
        self, release: str, description: Sequence[str], folder: Path, *, old: bool = False, hz: int = HZ
    ) -> None:
        """`description`: see STANDIN/manager.cpp; `old`: Ctrl-C calls nothing, as before 2025. Raises TrialError."""
        self.release, self.folder = release, folder
        folder.mkdir(exist_ok=True)
        made = compiled(release)
        self._words = [str(made / "manager"), str(made / "plugin.so"), str(hz)]
        self._description = description
        self._environment = {**os.environ, **({"FAILSTOP_STANDIN_OLD": "1"} if old else {})}
        self._out, self._err = folder / "said", folder / "logged"
        self.joints = re.findall(r"^joint (\S+)$", "\n".join(description), re.MULTILINE)

    def __enter__(self) -> Manager:
        with open(self._out, "wb") as out, open(self._err, "wb") as err:
            self.process = subprocess.Popen(
                self._words, stdin=subprocess.PIPE, stdout=out, stderr=err, env=self._environment
            )
        self.send(*self._description)
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait()
        assert self.process.stdin
        with contextlib.suppress(BrokenPipeError):
            self.process.stdin.close()

    def send(self, *lines: str) -> None:
        """Hand it commands: see STANDIN/manager.cpp."""
        assert self.process.stdin
        self.process.stdin.write("".join(f"{line}\n" for line in lines).encode())
        self.process.stdin.flush()

    @property
    def said(self) -> list[str]:
        """What it called and in which state it was, line by line."""
        return self._out.read_text().rpartition("\n")[0].splitlines()

    @property
    def logged(self) -> str:
        """What the plugin logged."""
        return self._err.read_text()

    def until(self, line: str, times: int = 1) -> None:
        """Wait until it has said a line so many times. Raises TrialError with all that it said."""
        try:
            wait_for(f"{line!r}", lambda: self.said.count(line) >= times, TOLD_S)
        except TrialError as error:
            raise TrialError(f"{error}; a controller manager said {self.said} and logged\n{self.logged}") from None

    def claim(self, *names: str) -> None:
        """A controller takes these command interfaces, or all."""
        claimed = self.said.count("claim")
        self.send(" ".join(("claim", *names)))
        self.until("claim", claimed + 1)

    def set(self, values: Mapping[str, float]) -> None:
        """A controller's commands from the next turn on."""
        self.send(*(f"set {name} {value}" for name, value in values.items()))

    def values(self) -> dict[str, float]:
        """Every state interface at the end of the next turn, and the `turns` of the loop so far."""
        before = len(self.said)
        self.send("values")
        found: list[str] = []

        def printed() -> bool:
            found[:] = [line for line in self.said[before:] if line.startswith("values ")]
            return bool(found)

        wait_for("the values of a controller manager", printed, TOLD_S)
        return {name: float(value) for name, _, value in (word.rpartition("=") for word in found[0].split()[1:])}

    def turn(self, turns: int) -> None:
        """Wait for so many more turns of the loop, in each of which the hardware is read and written."""
        until_turn = self.values()["turns"] + turns
        wait_for(f"{turns} turns", lambda: self.values()["turns"] >= until_turn, TOLD_S)

    def signal(self, number: signal.Signals) -> None:
        """Send it a signal."""
        self.process.send_signal(number)
