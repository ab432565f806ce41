"""Root stands in somebody else's folder, which holds a module of every name: no command runs one of them."""

from __future__ import annotations

import contextlib
import importlib.metadata
import json
import os
import signal
import subprocess
import sys
import urllib.error
import urllib.request
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.api.errors import FailstopError
from failstop.api.robot import Robot
from failstop_lab.sim.client import SimBoard
from failstop_lab.trial import wait_for
from tests.support.amounts import LONG
from tests.support.boards import own_folder
from tests.support.children import NOBODY
from tests.support.waiting import STORY_S

HOSTILE = """\
with open({log!r}, "a") as _log, open("/proc/self/cmdline") as _line:
    _log.write(__name__ + " in " + _line.read().replace("\\0", " ")[-200:] + "\\n")
raise ImportError("of the foreign folder")
"""
OF_NO_PACKAGE = ("failstop", "rclpy", "sitecustomize", "usercustomize", "wire", "codec", "receiver", "supervisor")
SCRIPT = "import sys\nfrom failstop.cli.main import main\nsys.exit(main())\n"
"""The script that pip installs as the command."""
WITHIN_S = 90.0


class Folder:
    """Somebody else's folder, with a module of every name that anything here might import."""

    def __init__(self, at: Path) -> None:
        self.path, self._log = at / "theirs", at / "log"
        self._script = at / "bin" / "failstop"
        self._script.parent.mkdir()
        self._script.write_text(SCRIPT)
        self.path.mkdir()
        for name in {*sys.stdlib_module_names, *importlib.metadata.packages_distributions(), *OF_NO_PACKAGE}:
            if name.isidentifier():
                (self.path / f"{name}.py").write_text(HOSTILE.format(log=str(self._log)))
        for path in (self.path, *self.path.iterdir()):
            if os.geteuid() == 0:
                os.chown(path, NOBODY, NOBODY)
        state = at / "state"
        state.mkdir()
        kept = {name: value for name, value in os.environ.items() if not name.startswith("PYTHON")}
        self.environment = {**kept, "STATE_DIRECTORY": str(state), "XDG_STATE_HOME": str(state)}

    def begin(self, *words: str, **changed: str) -> subprocess.Popen[str]:
        """Start `failstop WORDS` there."""
        pipe = subprocess.PIPE
        return subprocess.Popen(
            [sys.executable, str(self._script), *words],
            cwd=self.path, env={**self.environment, **changed}, stdin=subprocess.DEVNULL, stdout=pipe, stderr=pipe,
            text=True,
        )  # fmt: skip

    def run(self, *words: str, **changed: str) -> tuple[int, str]:
        """Run it to its end: its exit code and what it said."""
        with self.begin(*words, **changed) as process:
            try:
                said = process.communicate(timeout=WITHIN_S)
            except subprocess.TimeoutExpired:
                process.terminate()
                raise
        return process.returncode, "".join(said)

    def ran(self) -> list[str]:
        """Of the folder's modules those that somebody has run, and who."""
        return self._log.read_text().splitlines() if self._log.exists() else []


@pytest.fixture
def folder(tmp_path: Path) -> Folder:
    return Folder(tmp_path)


def test_the_folder_notices_who_imports_from_it(folder: Folder) -> None:
    """The control: this is what `python -m` does."""
    done = subprocess.run(
        [sys.executable, "-m", "failstop", "--version"], cwd=folder.path, env=folder.environment, capture_output=True,
        check=False,
    )  # fmt: skip
    assert done.returncode
    assert folder.ran()


SHORT = {
    "help": ("--help",),
    "config": ("config",),
    "doctor": ("doctor", "--quick", "--device", "{port}"),
    "no ros": ("ros2",),
    "no service": ("status", "--name", "of-nobody"),
    "stop": ("stop", "--device", "{port}"),
    "own board": ("stop", "--device", "{port}", "--config", "{own}"),
    "fleet": ("fleet", "--broker", "127.0.0.1:9", "list"),
    "chaos": ("chaos", "--count", "1", "--only", "kill-gate"),
    "chaos of the stop tool": ("chaos", "--count", "1", "--only", "usb-drop-unwatched"),
    "demo": ("demo",),
    "prove": ("prove", "--sim", "--only", "kill-gate", "--at", "0.2"),
    "prove frozen": ("prove", "--sim", "--board", "ugv", "--only", "frozen", "--at", "0.2"),
    "probe": ("probe", "serial", "--board", "rrc", "--port", "{port}", "--yes", "--rows", "silence", "--out", "{out}"),
    "simulate": ("simulate", "--scenario", "drive", "--call", "1041", "--fault", "dies"),
    "setup": (
        *("setup", "--port", "{port}", "--board", "rrc", "--robot", "other", "--layout", "differential"),
        *("--stand", "yes", "--wheel-0", "rl+", "--wheel-1", "fl+", "--wheel-2", "fr+", "--wheel-3", "rr+"),
        *("--forward", "yes", "--turn", "yes", "--diameter-m", "0.08", "--wheelbase-m", "0.2", "--track-m", "0.2"),
        *("--vx-mps", "0.2", "--vy-mps", "0.2", "--wz-radps", "1"),
        *("--prove", "yes" if LONG else "no", "--unproved", "yes"),
        *("--file", "{out}.toml"),
    ),
}  # fmt: skip
"""Commands that end by themselves."""
FAILS = {"no ros": 78, "no service": 3, "own board": 1, "fleet": 1, "probe": 1}
"""Their exit codes where they are not 0; a probe's robot keeps its last speed."""


@pytest.mark.slow
@pytest.mark.parametrize("command", SHORT)
def test_a_command_runs_none_of_its_modules(command: str, folder: Folder, tmp_path: Path) -> None:
    port, own = str(tmp_path / "b"), tmp_path / "own.toml"
    own.write_text(f'board.kind = "{own_folder(tmp_path / "tank")}"\n')
    words = [word.format(port=port, out=tmp_path / "out", own=own) for word in SHORT[command]]
    with SimBoard(port):
        code, said = folder.run(*words)
    assert folder.ran() == []
    if command == "chaos of the stop tool":  # how late its stop may be, is a matter of its row's own test
        assert " 0 stops missed" in said, said
    elif command != "doctor":  # it judges this machine
        assert code == FAILS.get(command, 0), said


ENDS_S = 10.0


@contextlib.contextmanager
def ending(process: subprocess.Popen[str]) -> Iterator[None]:
    """Kill it if the test fails within this context, because otherwise the test would wait for its end."""
    try:
        yield
    except BaseException:
        process.kill()
        raise


@pytest.fixture
def running(folder: Folder, tmp_path: Path) -> Iterator[str]:
    """The name of a service that was started there."""
    name, port = f"theirs-{os.getpid()}", str(tmp_path / "b")
    with SimBoard(port), folder.begin("run", "--name", name, "--device", port) as service:
        try:
            wait_for("the service to be ready", lambda: ready(name))
            yield name
        finally:
            service.send_signal(signal.SIGTERM)
            service.communicate(timeout=ENDS_S)


def ready(name: str) -> bool:
    with contextlib.suppress(FailstopError), Robot(name) as robot:
        return robot.state.waiting_for is None
    return False


@pytest.mark.slow
def test_a_service_and_those_that_ask_it_run_none_of_its_modules(folder: Folder, running: str, tmp_path: Path) -> None:
    """Its processes too, after a death as before, and the picture that the page has drawn."""
    with Robot(running) as robot:
        os.kill(robot.state.processes["telemetry"].pid, signal.SIGKILL)
        wait_for("its successor", lambda: robot.state.waiting_for is None)
    for words in ("reset", "enable", "drive 0.1 0 0 --for 0.2", "disable", "limit 50", "status", "why", "events"):
        code, said = folder.run(*words.split(), "--name", running)
        assert code == 0, (words, said)
    code, said = folder.run("stop", "--name", running, "smoke")
    assert code == 0, said
    wait_for("the incident to be saved", lambda: "smoke" in folder.run("incident", "list", "--name", running)[1], 20.0)
    for words in ("show last", "plot last -o {}.png", "export last -o {}.mcap"):
        code, said = folder.run("incident", *words.format(tmp_path / "last").split(), "--name", running)
        assert code == 0, (words, said)
    assert folder.run("metrics", "--name", running)[0] == 0
    with folder.begin("web", "--name", running, "--port", "0") as page, ending(page):
        assert page.stdout
        url = page.stdout.readline().strip()
        [card, *_] = json.loads(asked(f"{url}api/incidents"))["incidents"]
        wait_for("the picture", lambda: asked(f"{url}api/incidents/{card['id']}/picture")[:4] == b"\x89PNG", STORY_S)
        page.send_signal(signal.SIGTERM)
        page.communicate(timeout=ENDS_S)
    assert folder.ran() == []


def asked(url: str) -> bytes:
    """The answer of the page; nothing while it has not made it."""
    try:
        with urllib.request.urlopen(url, timeout=ENDS_S) as answer:
            found: bytes = answer.read()
            return found
    except urllib.error.HTTPError as error:
        error.close()
        return b""
