"""Answers that set a robot up from its cable to a proved file, and the options that give them."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

from failstop.setup.talk import option

KIND = "ugv"
GIVEN = {
    "port": "PORT",
    "board": KIND,
    "robot": "ugv-rover",
    "stand": "yes",
    "wheel_0": "left+",
    "wheel_1": "right-",
    "forward": "yes",
    "turn": "yes",
    "diameter_m": "0.08",
    "track_m": "0.172",
    "vx_mps": "0.2",
    "wz_radps": "1",
    "prove": "no",
    "file": "made.toml",
}
"""Right answers to all questions, in their order, which turn no wheel."""


def words(place: Path, answers: Mapping[str, str]) -> list[str]:
    """The options of these answers."""
    return [word for key, value in answers.items() for word in (option(key), value.replace("PORT", str(place / "b")))]
