"""A controller manager of the stand-in that drives a robot of the simulated board through the plugin."""

from __future__ import annotations

import os
import xml.etree.ElementTree as ElementTree
from collections.abc import Iterator, Mapping
from pathlib import Path

import pytest

from failstop.supervisor import status
from failstop_lab.boards.traits import traits_of
from failstop_lab.controller_manager import PLUGIN, Manager, uncompilable
from failstop_lab.trial import Stopped, Trial, judge, write_settings

URDFS = PLUGIN / "urdf"
RADPS = 3.0


def needs_compiler() -> pytest.MarkDecorator:
    return pytest.mark.skipif(bool(uncompilable()), reason=uncompilable())


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


def managed(release: str, text: str, folder: Path, *, old: bool = False) -> Manager:
    """A controller manager with the hardware of a URDF's text. `old`: Ctrl-C calls nothing, as before 2025."""
    return Manager(release, described(text), folder, old=old)


def settings(folder: Path, kind: str, **more: object) -> tuple[str, str]:
    """The option of a service for a board of this kind, without an obstacle sensor."""
    path = folder / "settings.toml"
    own = dict(traits_of(kind).settings) if kind else {}
    write_settings(str(path), {**own, status.LEASE: status.LEASE_WITHOUT_S, "scan.gate": "off", **more})
    return "--config", str(path)


def drive(manager: Manager, trial: Trial, radps: float = RADPS) -> None:
    """A controller takes the wheels, a person enables motion, and the wheels turn."""
    manager.until("state active")
    manager.claim()
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
