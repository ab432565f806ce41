"""`failstop config`: every setting with its value, unit and origin; checks a file; writes the example."""

from __future__ import annotations

import os
import sys
from shutil import get_terminal_size

from failstop import config
from failstop.cli import style
from failstop.policy.settings import (
    BY_KEY,
    FIRST_SOURCE,
    Setting,
    Settings,
    declaration,
)

TYPE_CHECKING = False
if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace

    from failstop.cli.style import Line

EXAMPLES = """\
failstop config                         # every value, unit and origin
failstop config --config robot.toml
failstop config --check robot.toml
failstop config --example > robot.toml
"""

# From this many columns on, a row has room for what the setting means.
WIDE = 100

GROUPS = {
    "device": "The board's port.",
    "gate": "The gate decides every motor frame.",
    "limits": "Speeds and ramps that no command passes.",
    "wheels": "What the base stands on. Layouts: mecanum; differential (wheels 1 and 2 left, 3 and 4 right).",
    "scan": "The sensor-validity interlock: software drives only while the obstacle sensor delivers.",
    "attend": "An operator without whom nothing moves: the page, `failstop attend`, or a program proves one.",
    "imu": "Inertial measurement: calibration, and the gyro's bias.",
    "odometry": "Where the robot got to, from what it was told.",
    "battery": "Charger detection and the voltage log.",
    "pad": "The gamepad at the board.",
    "link": "The proof that the board hears: a question that it answers.",
    "still": "Whether the wheels obeyed: the judgement of the IMU.",
    "stop": "The stop tool, `failstop stop`.",
    "key": "The keys on the board.",
    "buzzer": "The board's buzzer.",
    "incidents": "The black box: what is kept of each latched stop.",
    "web": "The operator's page, `failstop web`: a process of its own, which the robot runs without.",
    "restart": "What happens to a process that died.",
    "sources": "Who may command, and who goes before whom: [sources.NAME]. "
    f"{FIRST_SOURCE} is always there, with priority 0; give every other source a different one.",
    "arm": "An arm on the same board: its stream, its poses, its warnings. Without joints there is none.",
    "joints": "The arm's joints: [joints.NAME]. Positions are pulses of 0.24 degrees.",
    "interlocks": "What a client has to assert, again and again, for motion to be enabled: [interlocks.NAME].",
}

HEAD = """\
# Every setting of failstop, with its default, unit and allowed range. Generated: `failstop config --example`.
# A line that begins with # and no space is a default: take the # away to change it. What stays commented out follows
# the version that is installed. `failstop config --check FILE` reads a file as `failstop run --config FILE` will.
"""
ALWAYS_SET = ("device.path",)
"""Settings that the example sets although they have a default: no two robots need be alike in them."""

# Named tables that nobody has until they write them.
SAMPLES = (
    ("sources.teleop.priority", 10),
    ("sources.teleop.timeout_s", 0.3),
    ("joints.shoulder.servo", 2),
    ("joints.shoulder.tuck", 963),
    ("joints.shoulder.drive", 793),
    ("interlocks.arm.timeout_s", 0.5),
    ("interlocks.arm.refusal", "arm is not in the drive pose"),
    ("interlocks.ros2.timeout_s", 0.3),
    ("interlocks.ros2.refusal", "the ROS 2 bridge is away, or two nodes publish cmd_vel"),
)


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop config`."""
    parser.add_argument("--config", metavar="FILE", help="the TOML file to read over the defaults")
    parser.add_argument("--device", metavar="PATH", help="as for `failstop run`: over the setting device.path")
    parser.add_argument("--json", action="store_true", help="the same for programs")
    other = parser.add_mutually_exclusive_group()
    other.add_argument("--check", metavar="FILE", help="only say whether this file is right (exit code 0) or not (1)")
    other.add_argument(
        "--example",
        action="store_true",
        help="a TOML file with every setting and what it means, all but device.path commented out",
    )


def main(arguments: Namespace) -> int:
    """Print what is asked for; raises SettingError when the file is not right."""
    if arguments.example:
        sys.stdout.write(example())
    elif arguments.check is not None:
        sys.stdout.write(check(arguments.check) + "\n")
    else:
        found = rows(arguments.config, arguments.device)
        if arguments.json:
            sys.stdout.write(_json(found) + "\n")
        else:
            style.show(table(found, get_terminal_size((120, 24)).columns))
    return 0


def check(path: str) -> str:
    """One line on a file that is right. Raises SettingError on one that is not."""
    read = config.read(path)
    config.checked(read)
    count = sum(value != {} for value in read.values())
    return f"{path} is right; it sets {count} value{'' if count == 1 else 's'}"


def rows(path: str | None, device: str | None) -> list[tuple[str, float | str, Setting, str]]:
    """(whole key, value, declaration, origin) of every setting; the origin is "default", the file's path or
    "--device". Raises SettingError."""
    changed: dict[str, object] = {"device.path": device} if device else {}
    read = config.read(path)
    settings = config.checked({**read, **changed})
    origins = {**dict.fromkeys(read, path or ""), **dict.fromkeys(changed, "--device")}
    return [(key, value, declaration(key), origins.get(key, "default")) for key, value in settings.flat().items()]


def table(found: list[tuple[str, float | str, Setting, str]], columns: int) -> list[Line]:
    """The rows as lines, an empty one between two groups."""
    wide = columns >= WIDE
    cells = [
        [key, f" {_shown(setting, value)}", setting.unit, os.path.basename(origin), *([setting.doc] if wide else [])]
        for key, value, setting, origin in found
    ]
    indent = sum(max(len(row[column].strip()) for row in cells) + 2 for column in range(4))
    lines: list[Line] = []
    group = found[0][0].partition(".")[0]
    for row, line in zip(cells, style.table([[(cell, style.PLAIN) for cell in row] for row in cells]), strict=True):
        if row[0].partition(".")[0] != group:
            group = row[0].partition(".")[0]
            lines.append([])
        lines += style.wrap(line, columns, indent) if wide else [line]
    if not wide:
        more = f"What each of them means: from {WIDE} columns on, or `failstop config --example`."
        lines += [[], [(more, style.PLAIN)]]
    return lines


def _shown(setting: Setting, value: float | str) -> str:
    return value if isinstance(value, str) and value else literal(setting, value)


def _json(found: list[tuple[str, float | str, Setting, str]]) -> str:
    import json

    return json.dumps(
        {
            key: {"value": value, "unit": setting.unit, "origin": origin, "allowed": setting.range()}
            for key, value, setting, origin in found
        },
        indent=2,
        ensure_ascii=False,
    )


def example() -> str:
    """A complete configuration: every default, all but ALWAYS_SET commented out so that they do not outlive the version
    they are of; what is only a sample is commented out as well."""
    parts = [HEAD]
    for group, what in GROUPS.items():
        declared = [(key, setting.default) for key, setting in BY_KEY.items() if key.partition(".")[0] == group]
        parts.append(f"\n# {what}\n")
        if declared:
            parts.append(_toml(group, declared, defaults=True))
        if group == "sources":
            # Its timeout is left out: a copy of the command timeout would hide a change of that one.
            priority = f"sources.{FIRST_SOURCE}.priority"
            parts.append(_toml(f"sources.{FIRST_SOURCE}", [(priority, Settings().flat()[priority])], defaults=True))
        for name in dict.fromkeys(key.split(".")[1] for key, _ in SAMPLES if key.startswith(f"{group}.")):
            prefix = f"{group}.{name}"
            values = [(key, value) for key, value in SAMPLES if key.startswith(f"{prefix}.")]
            sample = _toml(prefix, values, defaults=False)
            parts.append(("\n" if group == "sources" else "") + "".join(f"# {line}\n" for line in sample.splitlines()))
    return "".join(parts)


def _toml(name: str, values: list[tuple[str, float | str]], *, defaults: bool) -> str:
    lines = [f"[{name}]"]
    for key, value in values:
        setting = declaration(key)
        lines.append(f"# {setting.doc[0].upper()}{setting.doc[1:]} [{_allowed(setting)}]")
        mark = "#" if defaults and key not in ALWAYS_SET else ""
        lines.append(f"{mark}{key.rpartition('.')[2]} = {literal(setting, value)}")
    return "\n".join(lines) + "\n"


def _allowed(setting: Setting) -> str:
    return setting.range() if setting.allowed or not isinstance(setting.default, str) else f"text, {setting.range()}"


def literal(setting: Setting, value: float | str) -> str:
    """As TOML. Texts here are declared ones: printable, without quotes or backslashes."""
    if isinstance(value, str):
        return f'"{value}"'
    return f"0x{value:04X}" if setting.key == "pad.mode_button" else repr(value)
