"""Changes of each ROS package: its CHANGELOG.rst, which bloom reads, made of what CHANGELOG.md says of ROS."""

from __future__ import annotations

import re
from collections.abc import Iterator

PACKAGES = {
    "failstop_msgs": re.compile(r"failstop_msgs|`~/status`"),
    "failstop_ros2": re.compile(r"\bROS\b|\bbridge\b|`~/"),
    "failstop_ros2_control": re.compile(r"\bros2_control\b"),
}
"""Each package, with how a change that is one of its is known."""
FOLDERS = {
    "failstop_msgs": "failstop/ros2/packages/failstop_msgs",
    "failstop_ros2": "failstop/ros2/packages/failstop_ros2",
    "failstop_ros2_control": "integrations/ros2_control",
}
"""Where each package is."""
PART = re.compile(r"^## (?P<version>\S+)(?: \((?P<date>\S+)\))?$", re.MULTILINE)
COMING = "Forthcoming"
"""Bloom's word for what no release has."""


def text(package: str, changes: str) -> str:
    """The file of a package, of the text of CHANGELOG.md."""
    title = f"Changelog for package {package}"
    lines = ["^" * len(title), title, "^" * len(title), "", "The whole of failstop's changes: CHANGELOG.md."]
    parts = list(PART.finditer(changes))
    ends = [part.start() for part in parts[1:]] + [len(changes)]
    for part, end in zip(parts, ends, strict=True):
        heading = f"{part['version']} ({part['date']})" if part["date"] else COMING
        found = [item for item in _items(changes[part.end() : end]) if PACKAGES[package].search(item)]
        lines += [
            "",
            heading,
            "-" * len(heading),
            *(f"* {_rst(item)}" for item in found or ["No change of this package."]),
        ]
    return "\n".join(lines) + "\n"


def _items(part: str) -> Iterator[str]:
    """Its changes, each as one line."""
    for item in re.findall(r"^- ((?:.+\n)(?:  .+\n)*)", part, re.MULTILINE):
        yield " ".join(item.split())


def _rst(item: str) -> str:
    return re.sub(r"\[([^]]+)\]\([^)]+\)", r"\1", item).replace("`", "``")
