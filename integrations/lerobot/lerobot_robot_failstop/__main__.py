"""`python -m lerobot_robot_failstop CALIBRATION.json`: prints failstop's settings for a LeKiwi. The joints come from
LeRobot's calibration file."""

from __future__ import annotations

import json
import sys
import tempfile
from pathlib import Path
from typing import Any

from failstop import config
from lerobot_robot_failstop.config_failstop import JOINTS

WANTED = ("id", "range_min", "range_max")
HEAD = """\
board.kind = "feetech"
scan.gate = "off"   # LeKiwi has no obstacle sensor

"""


HIGHEST = 4095
"""The highest position of a servo. One turn has the positions 0 to 4095."""
FULL_TURN = "wrist_roll"
"""The joint that LeRobot allows to make a whole turn."""
WIDEST, NARROWEST = 3500, 100
"""The widest and the narrowest range of any other joint of LeKiwi's arm, in positions of its servo. At the widest range
the arm's links touch each other. A range below the narrowest means that the joint was not moved from end to end while
its range was recorded."""


def tables(calibration: Any) -> str:
    """Return the joints' settings as text, with whole keys that need no [table]. Raises ValueError if this is not the
    calibration of an arm, or if a value can't be right."""
    rows = calibration if isinstance(calibration, dict) else {}
    found = []
    for name in JOINTS:
        row = rows.get(f"arm_{name}")
        if not isinstance(row, dict) or not all(type(row.get(key)) is int for key in WANTED):
            raise ValueError(f"no arm_{name} with {', '.join(WANTED)}: is it LeKiwi's calibration?")
        low, high = row["range_min"], row["range_max"]
        if wrong := _wrong(name, low, high):
            raise ValueError(f"arm_{name} has a range from {low} to {high}: {wrong}")
        values = {"servo": row["id"], "zero": (low + high) // 2, "low": low, "high": high}
        offset = row.get("homing_offset")
        if type(offset) is int and offset:
            values["offset"] = offset
        found.append("".join(f"joints.{name}.{key} = {value}\n" for key, value in values.items()))
    return "\n".join(found)


def _wrong(name: str, low: int, high: int) -> str:
    """Why a joint's range can't be right, and what to do. Empty if it can."""
    if low >= high:
        return "calibrate it again"
    if low < 0 or high > HIGHEST:
        return f"a servo has the steps 0 to {HIGHEST}: calibrate it again"
    if high - low < NARROWEST:
        return f"{high - low} steps are no joint's range: calibrate it again, and move every joint from end to end"
    if high - low > WIDEST and name != FULL_TURN:
        return (
            f"{high - low} of {HIGHEST + 1} steps are more than this joint can turn, so its servo's zero lies within "
            "its range: calibrate it again, with the arm in the middle of its ranges when LeRobot asks for that"
        )
    return ""


def _read(path: str) -> Any:
    """Return the content of the JSON file. Raises ValueError with the reason if it can't be read."""
    try:
        return json.loads(Path(path).read_text("utf-8"))
    except OSError as error:
        raise ValueError(f"{error.strerror}: check the path") from None
    except RecursionError:  # each Python version has another text for this error
        raise ValueError("its lists are nested too deeply: is it LeKiwi's calibration?") from None
    except ValueError as error:
        raise ValueError(f"it is no JSON ({error}): is it LeKiwi's calibration?") from None


def _check(made: str) -> None:
    """Let failstop check the settings, before anybody adds them to a file. Raises ValueError."""
    with tempfile.NamedTemporaryFile("w", suffix=".toml", encoding="utf-8") as file:
        file.write(made)
        file.flush()
        try:
            config.load(file.name)
        except ValueError as error:
            raise ValueError(str(error).removeprefix(f"{file.name}: ")) from None


def main(words: list[str]) -> int:
    """Print the settings, or print to stderr why that is not possible. Returns the exit code."""
    if len(words) != 1:
        sys.stderr.write("usage: python -m lerobot_robot_failstop CALIBRATION.json\n")
        return 2
    try:
        made = HEAD + tables(_read(words[0]))
        _check(made)
        sys.stdout.write(made)
    except (OSError, ValueError) as error:
        sys.stderr.write(f"{words[0]}: {error}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
