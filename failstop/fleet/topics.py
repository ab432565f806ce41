"""The topics on which a robot, and the program that stops the fleet, publish on the broker.

failstop/v1/FLEET/stop                      to all robots: stop
failstop/v1/FLEET/stop/ROBOT                to one robot: stop
failstop/v1/FLEET/answer/STOP_ID/ROBOT      the robot's answer to this stop
failstop/v1/FLEET/robot/ROBOT/connection    the robot's connection (retained)
failstop/v1/FLEET/robot/ROBOT/state         the robot's state (retained)
failstop/v1/FLEET/robot/ROBOT/event         the robot's last event (retained)
"""

from __future__ import annotations

ROOT = "failstop/v1"
ANY = "+"
CONNECTION = "connection"
STATE = "state"
EVENT = "event"


def of_robot(fleet: str, robot: str, last: str) -> str:
    """Return a robot's topic that ends with `last`. With ANY as `robot`, it is a pattern for all robots."""
    return f"{ROOT}/{fleet}/robot/{robot}/{last}"


def robot_of(topic: str) -> tuple[str, str]:
    """Split a robot's topic into the robot's name and the last part."""
    parts = topic.split("/")
    return (parts[-2], parts[-1]) if len(parts) > 1 else ("", topic)


def stop(fleet: str, robot: str = "") -> str:
    """Return the topic for stops to all robots, or to one robot."""
    return f"{ROOT}/{fleet}/stop{'/' if robot else ''}{robot}"


def answer(fleet: str, stop_id: str, robot: str) -> str:
    """Return the topic for a robot's answer to this stop. With ANY as `robot`, it is a pattern for all robots."""
    return f"{ROOT}/{fleet}/answer/{stop_id}/{robot}"
