"""`python -m lerobot_robot_failstop CALIBRATION.json`: failstop's settings for LeKiwi, with the joints of LeRobot's
calibration file."""

from __future__ import annotations

import json
import sys
from pathlib import Path
from typing import Any

from lerobot_robot_failstop.config_failstop import JOINTS

WANTED = ("id", "range_min", "range_max")
HEAD = """\
board.kind = "feetech"
scan.gate = "off"   # LeKiwi has no obstacle sensor

"""


def tables(calibration: Any) -> str:
    """The joints' settings, each line with its whole name, so that it may stand anywhere in a file. Raises ValueError
    for what is no calibration of an arm."""
    rows = calibration if isinstance(calibration, dict) else {}
    found = []
    for name in JOINTS:
        row = rows.get(f"arm_{name}")
        if not isinstance(row, dict) or not all(isinstance(row.get(key), int) for key in WANTED):
            raise ValueError(f"no arm_{name} with {', '.join(WANTED)}: is it LeKiwi's calibration?")
        low, high = row["range_min"], row["range_max"]
        if low >= high:
            raise ValueError(f"arm_{name} has a range from {low} to {high}: calibrate it again")
        values = {"servo": row["id"], "zero": (low + high) // 2, "low": low, "high": high}
        offset = row.get("homing_offset")
        if type(offset) is int and offset:
            values["offset"] = offset
        found.append("".join(f"joints.{name}.{key} = {value}\n" for key, value in values.items()))
    return "\n".join(found)


def main(words: list[str]) -> int:
    """Print them, or say on stderr why not. Returns the exit code."""
    if len(words) != 1:
        sys.stderr.write("usage: python -m lerobot_robot_failstop CALIBRATION.json\n")
        return 2
    try:
        sys.stdout.write(HEAD + tables(json.loads(Path(words[0]).read_text("utf-8"))))
    except (OSError, ValueError) as error:
        sys.stderr.write(f"{words[0]}: {error}\n")
        return 1
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
