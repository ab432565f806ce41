"""Servos of a bus: their loads and temperatures by the parts that they turn, and the texts about them. Pure."""

from __future__ import annotations

from failstop.board.kinds import facts_of
from failstop.policy.layouts import WHEEL_NAMES
from failstop.policy.settings import Settings

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    Health = Mapping[str, tuple[float, int]]


def by_part(rows: Iterable[tuple[int, float, int]], settings: Settings) -> dict[str, tuple[float, int]]:
    """Load and temperature of each servo that turns a wheel or a joint, by a name such as `rear wheel (servo 8)`.
    `rows`: each id with both values (records.HEALTH)."""
    facts = facts_of(settings.text("board.kind"))
    wheels = facts.arm.wheels if facts and facts.arm else ()
    parts = {servo: f"{name} wheel" for servo, name in zip(wheels, WHEEL_NAMES.get(len(wheels), ()), strict=False)}
    parts |= {int(table["servo"]): f"joint {name}" for name, table in settings.named["joints"].items()}
    return {f"{parts[servo]} (servo {servo})": (load, at_c) for servo, load, at_c in rows if servo in parts}


def summary(servos: Health) -> str:
    """A text about the hottest servo and the one with the highest load."""
    hottest = max(servos, key=lambda name: servos[name][1])
    loaded = max(servos, key=lambda name: abs(servos[name][0]))
    load = abs(servos[loaded][0])
    bears = f", {loaded} bears the most, {load:.0%}" if load else ""
    return f"{hottest} at {servos[hottest][1]} C is the hottest{bears}"


def hot(servos: Health, settings: Settings) -> list[str]:
    """A text for each servo that is as hot as the setting arm.hot_c."""
    return [f"{name} is at {at_c} C" for name, (_, at_c) in servos.items() if at_c >= settings["arm.hot_c"]]
