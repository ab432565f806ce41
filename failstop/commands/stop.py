"""`failstop stop`: the stop tool. Needs nothing running."""

from __future__ import annotations

import sys
from argparse import ArgumentParser, Namespace

from failstop.procs.stopper import tool
from failstop.supervisor import config
from failstop.supervisor.settings import BY_KEY, SettingError

DEVICE = "device.path"
WAIT = "stop.wait_s"
DEFAULTS = {key: BY_KEY[key].default for key in (DEVICE, WAIT)}


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop stop`."""
    device, wait_s = DEFAULTS[DEVICE], DEFAULTS[WAIT]
    parser.add_argument("--config", metavar="FILE", help=f"TOML file, of which {DEVICE} and {WAIT} are used")
    parser.add_argument("--device", metavar="PATH", help=f"the board's port (default: {DEVICE}, else {device})")
    parser.add_argument("--wait", metavar="S", type=float, help=f"how long to try (default: {WAIT}, else {wait_s:g} s)")


def main(arguments: Namespace) -> int:
    """Write the stop burst. Exit code 1, though it is written, if the file does not say where to and no option does;
    raises PortError when the port can't be had in time, SettingError for an option that is not allowed."""
    options = {DEVICE: ("--device", arguments.device), WAIT: ("--wait", arguments.wait)}
    given = {key: BY_KEY[key].check(value, name) for key, (name, value) in options.items() if value is not None}
    found, problems = _of_file(arguments.config) if arguments.config else ({}, {})
    values = {**DEFAULTS, **found, **given}
    for problem in dict.fromkeys(problems.values()):
        _say(f"{problem}; going on without it")
    after_s = tool.stop(str(values[DEVICE]), float(values[WAIT]), _say)
    print(f"stop frame sent (after {after_s:.1f} s)")
    if DEVICE in problems and DEVICE not in given:
        _say(f"it went to {values[DEVICE]}, the default: is this the board? Name it with --device")
        return 1
    return 0


def _of_file(path: str) -> tuple[dict[str, float | str], dict[str, str]]:
    """The two values as far as the file has them, and what is wrong with them. Nothing else in it is looked at: a
    mistake elsewhere must not keep the wheels turning."""
    found: dict[str, float | str] = {}
    try:
        read = config.read(path)
    except SettingError as error:
        return found, dict.fromkeys(DEFAULTS, str(error))
    problems: dict[str, str] = {}
    for key in DEFAULTS:
        if key in read:
            try:
                found[key] = BY_KEY[key].check(read[key])
            except SettingError as error:
                problems[key] = str(error)
    return found, problems


def _say(text: str) -> None:
    print(f"failstop: {text}", file=sys.stderr)
