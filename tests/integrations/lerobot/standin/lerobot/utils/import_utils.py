"""Plugins: distributions whose names begin as LeRobot's plugins do are imported."""

from __future__ import annotations

import contextlib
import importlib
import importlib.metadata

PREFIXES = ("lerobot_robot_", "lerobot_camera_", "lerobot_teleoperator_", "lerobot_policy_")


def register_third_party_plugins() -> None:
    for found in importlib.metadata.distributions():
        name = found.metadata["Name"]
        if name and name.startswith(PREFIXES):
            with contextlib.suppress(Exception):
                importlib.import_module(name)
