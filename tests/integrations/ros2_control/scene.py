"""A controller manager of the stand-in that drives a robot of the simulated board through the plugin."""

from __future__ import annotations

import os
import re
import signal
import subprocess
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

from failstop.supervisor import status
from failstop_lab.boards.traits import traits_of
from failstop_lab.trial import Stopped, Trial, judge, write_settings
from tests.support.waiting import until

from .build import PLUGIN, compiled

URDFS = PLUGIN / "urdf"
RADPS = 3.0
HZ = 50


def urdf(base: str, *, service: str = "", more: Mapping[str, str] | None = None) -> str:
    """An example's text, for the service of that name, with more parameters of the hardware."""
    text = (URDFS / f"{base}.urdf").read_text()
    text = text.replace('<param name="service">failstop<', f'<param name="service">{service or "failstop"}<')
    added = "".join(f'<param name="{name}">{value}</param>' for name, value in (more or {}).items())
    return text.replace("</hardware>", f"{added}</hardware>")


def described(text: str) -> list[str]:
    """The ros2_control block of a URDF as the stand-in reads it."""
    block = ElementTree.fromstring(text).find("ros2_control")
    assert block is not None
    lines = [f"name {block.get('name')}"]
    lines += [f"param {each.get('name')} {each.text}" for each in block.iterfind("hardware/param")]
    for kind in ("joint", "sensor", "gpio"):
        for component in block.iterfind(kind):
            lines.append(f"{kind} {component.get('name')}")
            lines += [f"param {each.get('name')} {each.text}" for each in component.iterfind("param")]
            for way in ("command", "state"):
                lines += [f"{way} {each.get('name')}" for each in component.iterfind(f"{way}_interface")]
    return [*lines, "end"]


class Manager:
    """A context manager: the process of the stand-in."""

    def __init__(self, release: str, text: str, folder: Path, *, old: bool = False, hz: int = HZ) -> None:
        """`old`: Ctrl-C calls nothing, as before 2025."""
        self.release, self.folder = release, folder
        folder.mkdir(exist_ok=True)
        made = compiled(release)
        self._words = [str(made / "manager"), str(made / "plugin.so"), str(hz)]
        self._description = described(text)
        self._environment = {**os.environ, **({"FAILSTOP_STANDIN_OLD": "1"} if old else {})}
        self._out, self._err = folder / "said", folder / "logged"
        self.joints = re.findall(r"^joint (\S+)$", "\n".join(self._description), re.MULTILINE)

    def __enter__(self) -> Manager:
        with open(self._out, "wb") as out, open(self._err, "wb") as err:
            self.process = subprocess.Popen(
                self._words, stdin=subprocess.PIPE, stdout=out, stderr=err, env=self._environment
            )
        self.tell(*self._description)
        return self

    def __exit__(self, *_: object) -> None:
        self.process.kill()
        self.process.wait()
        assert self.process.stdin
        self.process.stdin.close()

    def tell(self, *lines: str) -> None:
        assert self.process.stdin
        self.process.stdin.write("".join(f"{line}\n" for line in lines).encode())
        self.process.stdin.flush()

    @property
    def said(self) -> list[str]:
        """What it called and in which state it was, line by line."""
        return self._out.read_text().rpartition("\n")[0].splitlines()

    @property
    def logged(self) -> str:
        return self._err.read_text()

    def until(self, line: str, times: int = 1) -> None:
        until(lambda: self.said.count(line) >= times, f"{line!r} of a controller manager: {self.said}\n{self.logged}")

    def set(self, values: Mapping[str, float]) -> None:
        """A controller's commands from the next turn on."""
        self.tell(*(f"set {name} {value}" for name, value in values.items()))

    def values(self) -> dict[str, float]:
        """Every state interface now, and the `turns` of the loop so far."""
        before = len(self.said)
        self.tell("values")
        found: list[str] = []

        def printed() -> bool:
            found[:] = [line for line in self.said[before:] if line.startswith("values ")]
            return bool(found)

        until(printed, "the values")
        return {name: float(value) for name, _, value in (word.rpartition("=") for word in found[0].split()[1:])}

    def turn(self, turns: int) -> None:
        """Wait for so many more turns of the loop, in each of which the hardware is read and written."""
        until_turn = self.values()["turns"] + turns
        until(lambda: self.values()["turns"] >= until_turn, f"{turns} turns")

    def signal(self, number: signal.Signals) -> None:
        self.process.send_signal(number)


def settings(folder: Path, kind: str, **more: object) -> tuple[str, str]:
    """The option of a service for a board of this kind, without an obstacle sensor."""
    path = folder / "settings.toml"
    own = dict(traits_of(kind).settings) if kind else {}
    write_settings(str(path), {**own, status.LEASE: status.LEASE_WITHOUT_S, "scan.gate": "off", **more})
    return "--config", str(path)


def drive(manager: Manager, trial: Trial, radps: float = RADPS) -> None:
    """A controller takes the wheels, a person enables motion, and the wheels turn."""
    manager.until("state active")
    claimed = manager.said.count("claim")
    manager.tell("claim")
    manager.until("claim", claimed + 1)
    wheels = {f"{name}/velocity": 0.0 for name in manager.joints if "steering" not in name}
    angles = {f"{name}/position": 0.0 for name in manager.joints if "steering" in name}
    manager.set({**wheels, **angles})
    manager.turn(2)  # what commands a speed while motion is enabled is held until it has commanded zero
    trial.enable()
    manager.set(dict.fromkeys(wheels, radps))
    turns(manager, trial)


def turns(manager: Manager, trial: Trial) -> None:
    """Wait until the board's wheels turn."""
    try:
        trial.board.wait_wheels(turning=True, timeout_s=10.0)
    except TimeoutError:
        pytest.fail(f"{trial.robot.why()}\n{trial.robot.state.clients}\n{manager.said}\n{manager.logged}")


def stopped(trial: Trial, fault_ns: int) -> Stopped:
    """The board's word on a stop that followed the fault, once its wheels are at rest."""
    trial.board.wait_wheels(turning=False, timeout_s=5.0)
    return judge(trial.board.events(), fault_ns, True)


def trials(prefix: str, folder: Path, kind: str = "", **more: object) -> Iterator[Trial]:
    with Trial(f"{prefix}-{os.getpid()}", settings(folder, kind, **more), imu_hz=20.0, kind=kind) as trial:
        yield trial
