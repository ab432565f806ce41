"""`failstop stop`: the stop tool. Needs nothing running."""

from __future__ import annotations

import os
import sys
import time
from argparse import ArgumentParser, Namespace

from failstop.fold import PREFIX, fitted
from failstop.procs.stopper import rest, tool
from failstop.supervisor import config
from failstop.supervisor.settings import BY_KEY, SettingError

DEVICE = "device.path"
WAIT = "stop.wait_s"
DEFAULTS = {key: BY_KEY[key].default for key in (DEVICE, WAIT)}

END_SERVICE_S = 12.0
"""With --end-service everything is through by then: below the unit's TimeoutStopSec, at which systemd would kill this
program and leave what it has not killed yet alive."""
REST_S = 1.0
"""How long killed processes may take to end: a write to a port that hangs can hold one up."""

EXAMPLES = """\
failstop stop                            # /dev/ttyACM0
failstop stop --device /dev/ttyACM1 --wait 60
failstop stop --config /etc/failstop/failstop.toml
"""


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop stop`."""
    device, wait_s = DEFAULTS[DEVICE], DEFAULTS[WAIT]
    parser.add_argument("--config", metavar="FILE", help=f"TOML file, of which {DEVICE} and {WAIT} are used")
    parser.add_argument("--device", metavar="PATH", help=f"the board's port (default: {DEVICE}, else {device})")
    parser.add_argument("--wait", metavar="S", type=float, help=f"how long to try (default: {WAIT}, else {wait_s:g} s)")
    parser.add_argument(
        "--end-service",
        action="store_true",
        help="first SIGKILL what is left of the service; for ExecStopPost in the systemd unit alone",
    )


def main(arguments: Namespace) -> int:
    """Write the stop burst. Exit code 1, though it is written, if the file does not say where to and no option does,
    and for --end-service where it is not allowed; raises PortError when the port can't be had in time, SettingError for
    an option that is not allowed."""
    start_s = time.monotonic()
    misused = arguments.end_service and not _end_service()
    options = {DEVICE: ("--device", arguments.device), WAIT: ("--wait", arguments.wait)}
    given = {key: BY_KEY[key].check(value, name) for key, (name, value) in options.items() if value is not None}
    found, problems = _of_file(arguments.config) if arguments.config else ({}, {})
    values = {**DEFAULTS, **found, **given}
    for problem in dict.fromkeys(problems.values()):
        _say(f"{problem}; going on without it")
    wait_s = float(values[WAIT])
    if arguments.end_service:
        wait_s = min(wait_s, END_SERVICE_S - (time.monotonic() - start_s))
    after_s = tool.stop(str(values[DEVICE]), wait_s, _say)
    print(f"stop frame sent (after {after_s:.1f} s)")
    if DEVICE in problems and DEVICE not in given:
        _say(f"it went to {values[DEVICE]}, the default: is this the board? Name it with --device")
        return 1
    return int(misused)


def _end_service() -> bool:
    """SIGKILL the rest of the control group. False, with nothing killed, where that is not the service's: no reason not
    to stop."""
    if "SERVICE_RESULT" not in os.environ or not _in_a_service():
        _say(
            "nothing killed: --end-service kills the rest of the control group, and is for ExecStopPost in the systemd "
            "unit; by hand use `failstop stop` without it"
        )
        return False
    try:
        killed, left = rest.kill(REST_S)
    except OSError as error:
        _say(f"cannot kill what is left of the service: {error}")
        return True
    if killed:
        _say(f"killed what was left of the service: {killed} processes")
    if left:
        _say(f"{left} of them have not ended within {REST_S:g} s")
    return True


def _in_a_service() -> bool:
    """Of a control group that can't be read nothing can be killed: no reason not to stop."""
    try:
        return rest.of_a_service()
    except OSError:
        return True


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
    print(fitted(PREFIX + text, 2), file=sys.stderr)
