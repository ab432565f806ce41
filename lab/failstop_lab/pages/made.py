"""Made: every file that is made from the code, by its place in the checkout, with what renews its text."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from failstop.cli.commands import config
from failstop_lab.faults import report
from failstop_lab.pages import (
    bases,
    board,
    c_layout,
    c_reference,
    case,
    catalog,
    causes,
    commands,
    fleet,
    public,
    reference,
    rooms,
    ros2,
    ros_changes,
    settings,
    speed,
    tried,
)
from failstop_lab.pages.marked import renewed
from failstop_lab.simulate import control_runs

ROOT = Path(__file__).resolve().parents[3]


def _fleet(text: str) -> str:
    for name, lines in fleet.TABLES.items():
        text = renewed(text, name, "\n".join(lines()))
    return text


def _ros_changes(package: str) -> str:
    return ros_changes.text(package, (ROOT / "CHANGELOG.md").read_text("utf-8"))


FILES: dict[str, Callable[[str], str]] = {
    "examples/failstop.toml": lambda _: config.example(),
    "systemd/failstop.catalog": lambda _: catalog.text(),
    "docs/reference/settings.md": lambda _: settings.page(),
    "docs/reference/causes.md": lambda _: causes.page(),
    "docs/reference/python.md": lambda _: reference.page(),
    "docs/reference/board.md": lambda _: board.page(),
    "docs/reference/c.md": lambda _: c_reference.page(),
    "docs/reference/commands.md": lambda _: commands.page(),
    "docs/reference/faults.md": lambda _: report.markdown(report.last_campaign(ROOT)),
    "docs/reference/controls.md": lambda text: control_runs.page((), text),
    "docs/reference/hazards.md": lambda _: case.hazards_page(),
    "docs/safety.md": lambda text: renewed(text, "claims", case.claims_table(ROOT)),
    "docs/reference/evidence.md": lambda _: case.evidence_page(ROOT),
    "docs/reference/assumptions.md": lambda _: case.assumptions_page(),
    "docs/reference/tried.md": lambda _: tried.page(),
    "docs/logs.md": lambda text: renewed(text, "kinds", catalog.table()),
    "docs/ros2.md": lambda text: renewed(text, "contract", ros2.text()),
    "failstop/ros2/packages/failstop_msgs/CHANGELOG.rst": lambda _: _ros_changes("failstop_msgs"),
    "failstop/ros2/packages/failstop_ros2/CHANGELOG.rst": lambda _: _ros_changes("failstop_ros2"),
    "integrations/ros2_control/CHANGELOG.rst": lambda _: _ros_changes("failstop_ros2_control"),
    "docs/fleet.md": _fleet,
    "docs/does-your-robot-stop.md": lambda text: renewed(text, "bases", bases.table()),
    "README.md": lambda text: renewed(text, "speed", speed.text(ROOT)),
    public.PLACE: lambda _: public.text(),
    "clients/c/src/layout.h": lambda _: c_layout.text(),
    "docs/dev/architecture.md": lambda text: renewed(text, "rooms", rooms.picture()),
}


def differing(root: Path = ROOT) -> dict[str, str]:
    """The files below a checkout that are not as the code has them, each with its text as it should be."""
    found = {}
    for name, renew in FILES.items():
        path = root / name
        text = path.read_text("utf-8") if path.exists() else ""
        if (new := renew(text)) != text:
            found[name] = new
    return found
