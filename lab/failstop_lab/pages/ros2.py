"""The tables of docs/ros2.md: the contract of the bridge as people read it."""

from __future__ import annotations

from collections.abc import Iterable, Iterator

from failstop.policy.settings import Settings
from failstop.ros2 import contract, mirrors
from failstop.ros2.contract import (
    ARM_ACTION,
    ARM_BUSY,
    ARM_GOAL,
    ARM_SERVICES,
    INWARD,
    OUTWARD,
    SERVICES,
    SETTINGS,
    STATE_KEYS,
    TF,
)


def _table(head: str, rows: Iterable[Iterable[str]]) -> Iterator[str]:
    columns = head.split(" | ")
    yield f"| {head} |"
    yield "|" + "---|" * len(columns)
    for row in rows:
        yield f"| {' | '.join(row)} |"


def _shown(value: object) -> str:
    if value == [""]:
        return "[]"
    return "true" if value is True else "false" if value is False else str(value)


def text() -> str:
    """The tables."""
    topics = [("reads", topic, "") for topic in (*INWARD, ARM_GOAL)]
    topics += [("publishes", topic, f"{topic.hz} Hz") for topic in (*OUTWARD, TF, ARM_BUSY)]
    shown = mirrors.values(Settings().flat())
    lines = [
        f"The node is called `{contract.NODE}` unless you rename it. A name without a leading `/` is relative to the "
        "node's namespace, and `~` stands for the node's name.",
        "",
        *_table(
            "the bridge | topic | type | QoS | rate | what",
            (
                (way, f"`{topic.name}`", f"`{topic.type}`", topic.qos.words(), hz, topic.text)
                for way, topic, hz in topics
            ),
        ),
    ]
    lines += [
        "",
        *_table("service | type | what", ((f"`{s.name}`", f"`{s.type}`", s.text) for s in (*SERVICES, *ARM_SERVICES))),
    ]
    action = (f"`{ARM_ACTION.name}`", f"`{ARM_ACTION.type}`", ARM_ACTION.text)
    lines += ["", *_table("action | type | what", [action])]
    lines += ["", "Parameters of the bridge itself, read at its start:", ""]
    own = ((f"`{s.name}`", f"`{_shown(s.default)}`", _words(s)) for s in SETTINGS)
    lines += _table("parameter | default | what", own)
    shows = "These parameters show failstop's settings. `ros2 param set` is refused: change the setting instead."
    lines += ["", shows, ""]
    rows = (
        (f"`{m.name}`", f"`{_shown(shown[m.name])}`", ", ".join(f"`{key}`" for key in m.keys) or "can't be changed")
        for m in mirrors.TABLE
    )
    lines += _table("parameter | default | setting", rows)
    lines += ["", "The keys of `~/state`:", "", *_table("key | value", ((f"`{k}`", v) for k, v in STATE_KEYS.items()))]
    return "\n".join(lines)


def _words(setting: contract.Parameter) -> str:
    return f"{setting.text}: {', '.join(setting.allowed)}" if setting.allowed else setting.text
