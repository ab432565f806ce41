"""The arm in words: one line for status, a table for `failstop arm`. Pure."""

from __future__ import annotations

from failstop.api import words

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.api.snapshot import ArmState


def headline(arm: ArmState) -> str:
    """What it does, in a line."""
    if arm.mode:
        phase = f", {arm.phase}" if arm.phase else ""
        return f"{arm.mode} for {arm.by}{phase}"
    if arm.released:
        return "released: its torque is off"
    found = "holding" + (f", in the {arm.pose} pose" if arm.pose else "")
    if arm.auto_tuck_s is not None:
        found += f", tucks itself in {arm.auto_tuck_s} s"
    return found


def wrong(arm: ArmState) -> list[str]:
    """What is wrong with it, and what was refused last."""
    return [*arm.wrong, *([f"the last goal was refused: {arm.refused}"] if arm.refused else [])]


def lines(arm: ArmState) -> list[str]:
    """All of it."""
    found = [f"arm       {headline(arm)}"]
    found += [f"closed    {arm.closed}"] if arm.closed else []
    found += [f"wrong     {text}" for text in wrong(arm)]
    found.append(f"{'joint':<12}{'servo':>5}{'angle':>9}{'pulses':>8}{'commanded':>11}{'read':>10}  torque")
    for name, joint in arm.joints.items():
        measured = "-" if joint.pulses is None else f"{joint.pulses}"
        angle = "-" if joint.angle_rad is None else f"{joint.angle_rad:+.3f}"
        commanded = "-" if joint.commanded_pulses is None else f"{joint.commanded_pulses:.1f}"
        age = "never" if joint.age_s is None else f"{words.span(joint.age_s)} ago"
        torque = "on" if joint.torque else "off"
        heat = f", {joint.temperature_c} C" if joint.temperature_c else ""
        found.append(f"{name:<12}{joint.servo:>5}{angle:>9}{measured:>8}{commanded:>11}{age:>10}  {torque}{heat}")
    return found
