"""LeRobot as the tests have it, the stand-in or the real one, with the plugin; and a robot with wheels and an arm."""

from __future__ import annotations

import itertools
import json
import os
import shutil
import subprocess
import sys
import time
from collections.abc import Iterator
from contextlib import contextmanager
from itertools import takewhile
from pathlib import Path
from typing import Any

import pytest

from failstop.supervisor import status
from failstop_lab.faults.arm import ArmTrial
from failstop_lab.trial import Trial
from tests.support.pages import blocks

HERE = Path(__file__).resolve().parent
ROOT = HERE.parents[2]
CHECKOUT = (str(ROOT), str(ROOT / "lab"))
"""What a program finds failstop and its laboratory by."""
PLUGIN = ROOT / "integrations" / "lerobot"
PAGE = ROOT / "docs" / "lekiwi.md"
REQUIRED = "FAILSTOP_LEROBOT"
"""The Python of an environment with the real LeRobot: `make lerobot` sets it. Without it the stand-in is tried."""
RECORDED: dict[str, dict[str, dict[str, Any]]] = json.loads((HERE / "facts.json").read_text())
"""The facts of the oldest LeRobot that the plugin is for, and what differs in each newer one that was seen."""
VERSIONS = tuple(RECORDED)
JOINTS = {"shoulder_pan": "base", "shoulder_lift": "shoulder", "elbow_flex": "elbow"}
JOINTS |= {"wrist_flex": "wrist", "wrist_roll": "roll", "gripper": "gripper"}
"""LeKiwi's joints by the names of the simulated robot's settings."""
RANGES = {
    "shoulder_pan": (1, 0, 300, 700),
    "shoulder_lift": (2, 1, 200, 800),
    "elbow_flex": (3, 0, 100, 900),
    "wrist_flex": (4, 0, 100, 900),
    "wrist_roll": (5, 0, 100, 900),
    "gripper": (10, 0, 400, 600),
}
"""Servo, drive mode, and the calibrated range in pulses of the simulated servos."""
CALIBRATION = {
    f"arm_{name}": {"id": servo, "drive_mode": mode, "homing_offset": 0, "range_min": low, "range_max": high}
    for name, (servo, mode, low, high) in RANGES.items()
}
SETTINGS: dict[str, object] = {
    status.LEASE: status.LEASE_WITHOUT_S,
    "scan.gate": "off",
    "arm.auto_tuck": "off",
}
_numbers = itertools.count()


def facts(version: str) -> dict[str, dict[str, Any]]:
    """The facts of the newest recorded version that is not newer than this one."""
    found: dict[str, dict[str, Any]] = {}
    for recorded, differences in RECORDED.items():
        if ordered(recorded) <= ordered(version):
            found = {about: {**found.get(about, {}), **rows} for about, rows in {**found, **differences}.items()}
    return found


def ordered(version: str) -> tuple[int, ...]:
    """A version as versions compare."""
    return tuple(map(int, version.split(".")))


KIWI = facts(VERSIONS[0])["kiwi"]


class LeRobot:
    """One of the two: its Python, and an environment with the plugin and homes of its own."""

    def __init__(self, kind: str, folder: Path, version: str = VERSIONS[0]) -> None:
        """`version`: of the stand-in; the real one has its own."""
        self.python = sys.executable
        path = [str(HERE / "standin"), str(PLUGIN), *CHECKOUT]
        if kind == "real":
            self.python = os.environ.get(REQUIRED, "")
            if not self.python:
                pytest.skip("`make lerobot` tries it on the real LeRobot")
            path = [str(installed(self.python, folder / "site")), *CHECKOUT]
        self.home = folder / "lerobot"
        self.environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(path),
            "HOME": str(folder),
            "HF_HOME": str(folder / "hf"),
            "HF_LEROBOT_HOME": str(self.home),
            "HF_HUB_OFFLINE": "1",
            "STANDIN": version,
        }
        self.version = version
        if kind == "real":
            self.version = self.run("-c", "import lerobot; print(lerobot.__version__)").strip()
        self.facts = facts(self.version)
        calibrations = self.home / KIWI["calibration folder"]
        calibrations.mkdir(parents=True)
        (calibrations / "kiwi.json").write_text(json.dumps(CALIBRATION))

    def run(self, *words: str, timeout_s: float = 400.0) -> str:
        """Run a program to its end; what it has printed."""
        done = subprocess.run(
            [self.python, *words],
            env=self.environment,
            capture_output=True,
            text=True,
            timeout=timeout_s,
        )
        assert done.returncode == 0, f"{done.stdout}{done.stderr}"
        return done.stdout


def installed(python: str, site: Path) -> Path:
    """The plugin as pip installs it, in a folder of its own: LeRobot finds it by its distribution."""
    source = site.with_name("source")
    shutil.copytree(PLUGIN, source)
    words = (python, "-m", "pip", "install", "--quiet", "--no-deps", "--no-build-isolation", "--target", str(site))
    subprocess.run([*words, str(source)], check=True, timeout=240)
    return site


@contextmanager
def robot_with_an_arm() -> Iterator[ArmTrial]:
    """Its service, board and a client of its own; no obstacle sensor."""
    with ArmTrial(f"lerobot-{os.getpid()}-{next(_numbers)}", SETTINGS) as trial:
        yield trial


@contextmanager
def started(lerobot: LeRobot, *words: str) -> Iterator[subprocess.Popen[str]]:
    """A program that is killed at the end."""
    process = subprocess.Popen(
        # Where the tests run without a terminal or in the background, these may be ignored, which a child inherits.
        ["env", "--default-signal=HUP,INT", lerobot.python, *words],
        env=lerobot.environment,
        stdin=subprocess.DEVNULL,
        stdout=subprocess.PIPE,
        stderr=subprocess.STDOUT,
        text=True,
    )
    try:
        yield process
    finally:
        process.kill()
        process.communicate()


@contextmanager
def policy(lerobot: LeRobot, trial: Trial, part: str) -> Iterator[subprocess.Popen[str]]:
    """A policy's program that streams actions of `part` (bench/kiwi_policy.py), thirty a second; killed at the end."""
    with started(lerobot, str(ROOT / "bench/kiwi_policy.py"), trial.name, part) as process:
        assert process.stdout
        said = list(takewhile(lambda line: line != "streams\n", process.stdout))
        assert process.poll() is None, "".join(said)
        yield process


def of_the_page(about: str, service: str) -> str:
    """The program of docs/lekiwi.md in which this word stands, for the simulated robot of that service."""
    (found,) = (block.text for block in blocks(PAGE) if block.language == "python" and about in block.text)
    program = found.replace('id="my_kiwi"', f"id='kiwi', service={service!r}, joints={JOINTS!r}")
    assert program != found
    return program


def until(what: Any, timeout_s: float = 10.0) -> None:
    """Call `what`, thirty times a second, until it is true."""
    until_s = time.monotonic() + timeout_s
    while not what():
        assert time.monotonic() < until_s, what
        time.sleep(1 / 30)
