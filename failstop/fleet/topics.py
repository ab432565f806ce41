"""Topics: where what is said on the broker. Those of the state are VDA 5050's, those of the fleet stop are our own."""

from __future__ import annotations

from failstop.fleet import vda5050

ANY = "+"
CONNECTION = "connection"
STATE = "state"
EVENT = "event"
"""Ours, beside the interface's: the last event, retained."""


def of_robot(manufacturer: str, robot: str, last: str) -> str:
    """Of one robot, or of ANY."""
    return vda5050.topic(manufacturer, robot, last)


def robot_of(topic: str) -> tuple[str, str]:
    """The robot of such a topic, and its last part."""
    parts = topic.split("/")
    return (parts[-2], parts[-1]) if len(parts) > 1 else ("", topic)


def stop(manufacturer: str, robot: str = "") -> str:
    """To all robots, or to one: stop."""
    return f"failstop/v1/{manufacturer}/stop{'/' if robot else ''}{robot}"


def answer(manufacturer: str, stop_id: str, robot: str) -> str:
    """The topic of one robot's answer, or of ANY."""
    return f"failstop/v1/{manufacturer}/answer/{stop_id}/{robot}"
