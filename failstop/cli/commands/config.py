"""`failstop config`: shows every setting with its value, unit and origin, checks a settings file, or prints an
example."""

from __future__ import annotations

import json
import os
import sys
from argparse import ArgumentParser, Namespace
from textwrap import indent

from failstop import config
from failstop.api import distance
from failstop.cli import style
from failstop.files import way
from failstop.policy.setting import Setting, SettingError
from failstop.policy.settings import BY_KEY, FIRST_SOURCE, UNATTENDED_DRIVE, Settings, declaration
from failstop.supervisor.fit import checked_board, slowest_mps, unused

EXAMPLES = """\
failstop config                         # every value, unit and origin
failstop config --config robot.toml
failstop config --check robot.toml      # is this file right?
failstop config --example > robot.toml  # a file to start from
failstop config --within 0.1            # how fast, to stop within 0.1 m
"""

GROUPS = {
    "device": "The motor board's port.",
    "board": "The board, by its kind, and the unit of its speeds where that is not the usual one.",
    "gate": "The gate, which decides what the wheels do, and when commands stop counting.",
    "limits": "How fast the robot may go and speed up, whatever a program commands. With LeKiwi's servos the speeds' "
    "defaults are 0.1, 0.1 and 0.5.",
    "wheels": "The base and its sizes. Four wheels are numbered front left, rear left, front right, rear right; two "
    "are left, right; three are left, rear, right. Defaults of omni3: LeKiwi's, 0.1 m; of ackermann: ROSOrin's, "
    "0.085 m, ids 1 and 3.",
    "steering": "The servo that steers a base of the layout ackermann; a stop leaves it as it is.",
    "scan": "The obstacle sensor: programs can drive only while it delivers scans.",
    "attend": "An operator who must be present for the robot to move.",
    "imu": "The IMU: correcting its acceleration and its gyro's bias.",
    "odometry": "Where the robot is, computed from how its wheels turned or, if the board doesn't report that, from "
    "the commands.",
    "battery": "The battery: stopping when it is low, detecting the charger, logging the voltage.",
    "pad": "The gamepad whose receiver is plugged into the board.",
    "link": "Pings to the board, whose answers prove that it hears.",
    "still": "Whether the wheels came to rest after a stop, judged by what the board reports, or else by the IMU.",
    "stop": "The command `failstop stop`.",
    "key": "The keys on the board.",
    "buzzer": "The board's buzzer.",
    "incidents": "The black box: what is kept on disk after each latched stop.",
    "guard": "The guard port, `failstop guard`: your driver opens it instead of the board, and works unchanged.",
    "web": "The operator's page, `failstop web`. It is a separate process, so the robot also runs without it.",
    "restart": "How often a failstop process that died is restarted.",
    "sources": "Who may drive, and whose commands win: [sources.NAME]. "
    f"{FIRST_SOURCE} always exists, with priority 0; give every other source a different priority.",
    "arm": "An arm on the same board. These settings do nothing until the arm has joints ([joints.NAME]).",
    "joints": "The arm's joints, [joints.NAME]. Positions are in pulses, the servo's own unit. With LeKiwi's servos "
    "zero is 2048 and high 4095 by default.",
    "interlocks": "Conditions that a program of yours must keep asserting for the robot to move: [interlocks.NAME].",
}

HEAD = """\
# Every setting of failstop, with its default, unit and allowed range. Generated: `failstop config --example`.
# A line that begins with # and no space is a default (## if only another layout has this setting). To change a setting,
# remove its #, or add the line at the end of this file: each line has the setting's whole name, so its place does not
# matter. Settings that stay commented out keep the defaults of the installed version. Check your file with
# `failstop config --check FILE`.
"""

SAMPLES: dict[str, dict[str, dict[str, float | str]]] = {
    "sources": {"teleop": {"priority": 10, "timeout_s": 0.3}},
    "joints": {"shoulder": {"servo": 2, "tuck": 963, "drive": 793}},
    "interlocks": {
        "arm": {"timeout_s": 0.5, "refusal": "arm is not in the drive pose"},
        "ros2": {"timeout_s": 0.3, "refusal": "the ROS 2 bridge is away, or two nodes publish cmd_vel"},
    },
}
"""Sample tables for the example file. The user chooses the names of such tables, for example `shoulder` for a joint.
None of these tables exists by default."""


def add_arguments(parser: ArgumentParser) -> None:
    """Define the options of `failstop config`."""
    parser.add_argument(
        "--config", metavar="FILE", help="TOML file with settings (without it, every setting has its default)"
    )
    parser.add_argument("--json", action="store_true", help="print JSON instead of text")
    parser.add_argument(
        "--within",
        metavar="M",
        type=float,
        help="print only how fast the robot may drive if it must stop within M metres",
    )
    other = parser.add_mutually_exclusive_group()
    other.add_argument(
        "--check",
        metavar="FILE",
        help="only check this file, and that nobody else may write it; exit code 0: the file is right, 1: it is not",
    )
    whole = "print a TOML file with every setting and its meaning, all commented out"
    other.add_argument("--example", action="store_true", help=whole)


def main(arguments: Namespace) -> int:
    """Run the command. Raises SettingError if the settings file is wrong."""
    if arguments.example:
        sys.stdout.write(example())
    elif arguments.check is not None:
        read = config.read(arguments.check)
        board = checked_board(settings := config.checked(read, arguments.check), arguments.check)
        if settings.on("web.drive") and not settings.on("attend.required"):
            raise SettingError(
                f"{arguments.check}: {UNATTENDED_DRIVE}: the page shows no stick without it. Set it, or remove "
                "web.drive"
            )
        if where := way.exposed(arguments.check):
            raise SettingError(": ".join(config.exposed(arguments.check, where)))
        count, slowest = sum(value != {} for value in read.values()), slowest_mps(settings)
        rest = f"; a wheel that should go slower than {slowest:.2g} m/s does not turn" if slowest else ""
        print(f"{arguments.check} is right; it sets {count} value{'' if count == 1 else 's'}{rest}")
        for problem, remedy in unused(settings, board, read):
            print(f"but {problem}: {remedy}")
    elif arguments.within is not None:
        print(_fastest(config.load(arguments.config), arguments.within))
    else:
        found = rows(arguments.config)
        if arguments.json:
            print(json.dumps(found, indent=2, ensure_ascii=False))
        else:
            style.show(table(found))
            ways = distance.sentences(config.load(arguments.config))
            style.show([[], *(line for way in ways for line in style.wrap([(way, style.PLAIN)], style.width(), 0))])
    return 0


def _fastest(settings: Settings, metres: float) -> str:
    """Describe how fast the robot may drive if it must stop within `metres`. Raises SettingError unless `metres` is
    above 0."""
    if not metres > 0:
        raise SettingError(f"--within {metres:g}: it must be a distance above 0, in m")
    _, latest = distance.furthest(settings)
    fastest = distance.speed_mps(metres, latest[0], settings[distance.BRAKING])
    return (
        f"To stop {distance.WITHIN.format(metres)}, the robot may go at most {fastest:.3f} m/s. It reacts most slowly, "
        f"after {latest[0]:.2f} s, when {latest[1]}, and brakes with {settings[distance.BRAKING]:g} m/s2."
    )


def rows(path: str | None) -> dict[str, dict[str, float | str]]:
    """Return the value, unit, origin and allowed values of each setting, by its whole key such as `board.kind`. The
    origin is "default" or the path of the settings file. Raises SettingError."""
    read = config.read(path)
    return {
        key: {
            "value": value,
            "unit": (setting := declaration(key)).unit,
            "origin": path if path and key in read else "default",
            "allowed": setting.range(),
        }
        for key, value in config.checked(read, path).flat().items()
    }


def table(found: dict[str, dict[str, float | str]]) -> list[style.Line]:
    """Return the settings from rows() as a table for the terminal, with an empty line between two groups."""
    cells = []
    for key, row in found.items():
        setting = declaration(key)
        value = row["value"] if row["value"] and isinstance(row["value"], str) else literal(setting, row["value"])
        cells.append([key, f" {value}", setting.unit, os.path.basename(str(row["origin"]))])
    lines: list[style.Line] = []
    group = ""
    for key, line in zip(found, style.table([[(cell, style.PLAIN) for cell in row] for row in cells]), strict=True):
        if lines and key.partition(".")[0] != group:
            lines.append([])
        group = key.partition(".")[0]
        lines.append(line)
    return [*lines, [], [("What each of them means, and what is allowed: `failstop config --example`.", style.PLAIN)]]


def example() -> str:
    """Return an example settings file, with every default and some sample tables. Every line is a comment, so that a
    copy of the file does not keep old defaults after an update of failstop. There are no [table] lines, because a
    setting at the end of the file would then belong to the last table."""
    parts = [HEAD]
    for group, what in GROUPS.items():
        declared = {
            key.partition(".")[2]: setting.default for key, setting in BY_KEY.items() if key.startswith(f"{group}.")
        }
        parts.append(f"\n# {what}\n")
        if declared:
            parts.append(_toml(group, declared, "#"))
        if group == "sources":
            # The timeout is left out. A copy of the command timeout here would stay the same if somebody changed that
            # setting.
            first = f"sources.{FIRST_SOURCE}"
            parts.append(_toml(first, {"priority": Settings().flat()[f"{first}.priority"]}, "#") + "\n")
        samples = SAMPLES.get(group, {}).items()
        parts.append("\n".join(indent(_toml(f"{group}.{name}", values, ""), "# ") for name, values in samples))
    return "".join(parts)


def _toml(name: str, values: dict[str, float | str], mark: str) -> str:
    marks = {key: mark + "#" * (mark == "#" and f"{name}.{key}" not in Settings().flat()) for key in values}
    lines = []
    for key, value in values.items():
        setting = declaration(f"{name}.{key}")
        what = "" if setting.allowed or not isinstance(setting.default, str) else "text, "
        lines.append(f"# {setting.doc[0].upper()}{setting.doc[1:]} [{what}{setting.range()}]")
        lines.append(f"{marks[key]}{name}.{key} = {literal(setting, value)}")
    return "\n".join(lines) + "\n"


def literal(setting: Setting, value: float | str) -> str:
    """Return a setting's value in TOML. A text must be printable, without quotes and backslashes."""
    if isinstance(value, str):
        return f'"{value}"'
    return f"0x{value:04X}" if setting.key == "pad.mode_button" else repr(value)
