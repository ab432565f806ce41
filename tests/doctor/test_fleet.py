"""Whether doctor sees that a robot of a fleet obeys no stop of the fleet."""

from __future__ import annotations

import pytest

from failstop.doctor.look import OK, WARN
from failstop.fleet.check import UNIT, check

from .parts import look

INSTALLED = {"LoadState": "loaded", "ActiveState": "inactive", "UnitFileState": "disabled", "StatusErrno": "0"}
RUNS = {**INSTALLED, "ActiveState": "active", "UnitFileState": "enabled"}
DOWN = f"{UNIT} is enabled and failed: the robot obeys no stop of the fleet"
DEAF = {**RUNS, "StatusText": "obeys no fleet stop: no key", "StatusErrno": "107"}


@pytest.mark.parametrize(
    ("unit", "level", "text", "fix"),
    [
        (None, OK, "the robot is in no fleet", ""),
        ({"LoadState": "not-found"}, OK, "the robot is in no fleet", ""),
        (INSTALLED, OK, "the robot is in no fleet", ""),
        ({**RUNS, "StatusText": "obeys a fleet stop"}, OK, "the robot obeys a fleet stop", ""),
        (DEAF, WARN, "the robot obeys no fleet stop: no key", f"journalctl -u {UNIT}"),
        ({**RUNS, "ActiveState": "failed"}, WARN, DOWN, f"journalctl -xeu {UNIT}"),
    ],
)
def test_what_the_publisher_says_of_itself(unit: dict[str, str] | None, level: str, text: str, fix: str) -> None:
    said = None if unit is None else "".join(f"{key}={value}\n" for key, value in unit.items())
    [found] = check(look(says={"systemctl": said}))
    assert (found.level, found.text, found.fix) == (level, text, fix)
