"""Driving: what `Robot.drive` answers - it drives, another one does, or the wheels are held.

match robot.drive(0.2, 0.0, 0.0):
    case Preempted(by=who): print(who, "drives")
    case Blocked(block=Block.NO_SCAN): look_at_the_sensor()
"""

from __future__ import annotations

import dataclasses

from failstop.api.snapshot import Block, Velocity


@dataclasses.dataclass(frozen=True)
class Driving:
    """This command moves the wheels."""

    velocity: Velocity
    """What the gate commands now: it gets to what was asked for along the ramp, within the limits."""

    def __bool__(self) -> bool:
        return True


@dataclasses.dataclass(frozen=True)
class Preempted:
    """A source of higher priority drives; this command waits."""

    by: str
    """Who drives: name and pid."""
    source: str
    """As which source."""

    def __bool__(self) -> bool:
        return False


@dataclasses.dataclass(frozen=True)
class Blocked:
    """Nothing moves."""

    block: Block
    """What holds the wheels. NO_COMMAND: the gate has not taken the command in time."""
    why: str
    """The same in words, with the stop's cause."""

    def __bool__(self) -> bool:
        return False


Answer = Driving | Preempted | Blocked
"""True in a condition only if this command moves the wheels."""


def judge(decided: dict[str, object], rows: list[dict[str, str]], source: str, cause: str) -> Answer | None:
    """The answer of a gate that has decided so: `rows` of its sources, highest first. None: it may not have seen the
    command yet. Pure."""
    block = Block.LATCHED if cause else Block.of(decided["blocked"])  # type: ignore[arg-type]
    if block in (Block.LATCHED, Block.DISABLED):
        return Blocked(block, cause or block.value)
    if not any(row["source"] == source for row in rows):
        return None
    driver = next(row for row in rows if row["state"] == "drives")
    if driver["source"] != source:
        return Preempted(driver["who"], driver["source"])
    if block:
        return Blocked(block, block.value)
    return Driving(Velocity(*decided["body_vel"]))  # type: ignore[misc]


def settled(answer: Answer) -> bool:
    """False for what a command that the gate has not seen yet may change: the one of before may have been too old, or
    the sensor silent."""
    return bool(answer) or (isinstance(answer, Blocked) and answer.block in (Block.LATCHED, Block.DISABLED))
