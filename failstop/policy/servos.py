"""Servos on a bus: finds the part that each servo turns, and makes texts about loads, temperatures and faults. Pure."""

from __future__ import annotations

from failstop.board.kinds import facts_of
from failstop.board.wire import (
    SERVO_CURRENT,
    SERVO_HEAT,
    SERVO_LOAD,
    SERVO_MISSING,
    SERVO_OTHER,
    SERVO_SENSOR,
    SERVO_VOLTAGE,
)
from failstop.policy.layouts import WHEEL_NAMES
from failstop.policy.settings import Settings

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterable, Mapping

    Health = Mapping[str, tuple[float, int]]


def by_part(rows: Iterable[tuple[int, float, int, int]], settings: Settings) -> dict[str, tuple[float, int]]:
    """The load and temperature of each servo that answers and turns a wheel or a joint. The key is a name such as `rear
    wheel (servo 8)`. `rows`: the values of each servo, as in records.HEALTH."""
    parts = _parts(settings)
    answer = ((servo, load, at_c) for servo, load, at_c, bits in rows if not bits & SERVO_MISSING)
    return {parts[servo]: (load, at_c) for servo, load, at_c in answer if servo in parts}


def _wheels(settings: Settings) -> tuple[int, ...]:
    """The ids of what turns the wheels: the motor controllers if they report their own load and temperature, otherwise
    the bus servos. Empty if the wheels are turned by neither."""
    facts = facts_of(settings.text("board.kind"))
    if facts and facts.motors:
        return tuple(facts.motors)[: settings.speeds]
    return facts.arm.wheels if facts and facts.arm else ()


def turn_wheels(settings: Settings) -> bool:
    """True if the wheels are turned by bus servos, or by motor controllers that report their own load and
    temperature."""
    return bool(_wheels(settings))


def _parts(settings: Settings) -> dict[int, str]:
    """The part that each servo turns, in words, by the servo's id."""
    wheels = _wheels(settings)
    facts = facts_of(settings.text("board.kind"))
    if facts and facts.motors:
        return {motor: facts.motors[motor] for motor in wheels}
    parts = {servo: f"{name} wheel" for servo, name in zip(wheels, WHEEL_NAMES.get(len(wheels), ()), strict=False)}
    parts |= {int(table["servo"]): f"joint {name}" for name, table in settings.named["joints"].items()}
    return {servo: f"{part} (servo {servo})" for servo, part in parts.items()}


SILENT_SERVO = "it does not answer"
WRONG = {
    SERVO_VOLTAGE: "its supply voltage is out of range",
    SERVO_SENSOR: "its position sensor fails",
    SERVO_HEAT: "it is too hot",
    SERVO_CURRENT: "it takes too much current",
    SERVO_LOAD: "it is overloaded",
    SERVO_OTHER: "it reports another fault, which its maker's tool can show",
    SERVO_MISSING: SILENT_SERVO,
}
"""What is wrong with a servo, in words, for each error bit in board/wire.py."""


def servo_faults(rows: Iterable[tuple[int, float, int, int]], settings: Settings) -> dict[str, str]:
    """What is wrong with each servo that reports an error or does not answer. The key is the name of the part that the
    servo turns."""
    parts = _parts(settings)
    found = {parts.get(servo, f"servo {servo}"): bits for servo, _, _, bits in rows if bits}
    return {part: _words(bits) for part, bits in found.items()}


def _words(bits: int) -> str:
    """Say what is wrong. Feetech servos may also set bits that have no name."""
    return " and ".join(text for bit, text in WRONG.items() if bits & bit) or WRONG[SERVO_OTHER]


def missing_wheel(rows: Iterable[tuple[int, float, int, int]], settings: Settings) -> str:
    """The first wheel whose servo is reported as missing (SERVO_MISSING), for example `rear wheel (servo 8)`. Empty if
    no wheel's servo is missing."""
    wheels = _wheels(settings)
    return next((_parts(settings)[servo] for servo, _, _, bits in rows if bits & SERVO_MISSING and servo in wheels), "")


def waited_for(rows: Iterable[tuple[int, float, int, int]], settings: Settings) -> str:
    """A text that names the wheel whose servo is missing, because motion waits for it. Empty if missing_wheel() finds
    no such wheel."""
    wheel = missing_wheel(rows, settings)
    return f"the {wheel}, which does not answer" if wheel else ""


def summary(servos: Health) -> str:
    """A text for people about the hottest servo and the servo with the highest load."""
    hottest = max(servos, key=lambda name: servos[name][1])
    loaded = max(servos, key=lambda name: abs(servos[name][0]))
    load = abs(servos[loaded][0])
    bears = f", {loaded} bears the most, {load:.0%}" if load else ""
    return f"{hottest} at {servos[hottest][1]} C is the hottest{bears}"


def hot(servos: Health, settings: Settings) -> list[str]:
    """A text for each servo that is at least as hot as the setting arm.hot_c."""
    return [f"{name} is at {at_c} C" for name, (_, at_c) in servos.items() if at_c >= settings["arm.hot_c"]]
