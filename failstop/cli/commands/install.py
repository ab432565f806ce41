"""`failstop install`: failstop as a service of this machine, whole or not at all."""

from __future__ import annotations

import dataclasses
import os
import sys
from functools import partial

from failstop.api.errors import Refused
from failstop.discovery import LINK
from failstop.install import InstallError, dialogue, layout, looking, plan, rows, tree
from failstop.install.do import Doer
from failstop.install.found import Request
from failstop.install.layout import PREFIX, unit_of
from failstop.install.machine import READY_S, Machine
from failstop.install.rows import EXTRAS, OPERATE, VIEW
from failstop.install.steps import Plan
from failstop.policy.settings import BY_KEY
from failstop.shm import instance
from failstop.shm.instance import DEFAULT_NAME, option
from failstop.version import VERSION

TYPE_CHECKING = False
if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace

EXAMPLES = """\
failstop install --dry-run           # only show what would be done
sudo failstop install                # show it, ask, do it, wait until ready
sudo failstop install --device /dev/ttyUSB0 --yes
sudo failstop install --name front --device /dev/ttyACM1   # one more robot
sudo failstop install --ros2-user robot   # and the bridge to ROS 2
sudo failstop install --web           # and the operator's page
sudo failstop install --root /mnt/image --yes   # of a system not running
"""


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop install`."""
    parser.add_argument("--dry-run", action="store_true", help="show what would be done and change nothing")
    parser.add_argument("--yes", action="store_true", help="do not ask")
    parser.add_argument("--restart", action="store_true", help="with --yes: a service that runs may be restarted too")
    parser.add_argument("--device", metavar="PATH", help="the board's port, for a new configuration")
    parser.add_argument(
        "--name", default=DEFAULT_NAME, help=f"the robot's name, if there are several (default: {DEFAULT_NAME})"
    )
    parser.add_argument("--ros2-user", metavar="NAME", default="", help="the bridge to ROS 2 too, as this user")
    parser.add_argument("--fleet", action="store_true", help="publish it to its fleet's broker too, and obey its stop")
    parser.add_argument(
        "--web",
        nargs="?",
        choices=(VIEW, OPERATE),
        const=VIEW,
        default="",
        help="the operator's page too; operate: its paired devices may reset and enable",
    )
    parser.add_argument("--root", metavar="DIR", help="install into this directory, the root of another system")
    parser.add_argument("--no-start", action="store_true", help="start it at the next boot, not now")
    parser.add_argument(
        "--wait",
        metavar="S",
        type=float,
        default=READY_S,
        help="how long it has to become ready (default: %(default)g)",
    )
    parser.add_argument(
        "--use-running-venv",
        action="store_true",
        help=f"have the service run in the environment that this command is in; else it is copied to {PREFIX}",
    )
    parser.add_argument("--json", action="store_true", help="what would be done, for programs; implies --dry-run")


def main(arguments: Namespace) -> int:
    """Install. Raises InstallError, Refused, SettingError; then nothing is changed."""
    request = _request(arguments)
    dry = not dialogue.changes(arguments)
    texts = rows.texts()
    there = dataclasses.replace(looking.look(request), configured_device=looking.configured_device(request))
    # Of what is there already too: a new environment takes the place of the one that it runs in.
    wanted = tuple(extra.needs for extra in EXTRAS if extra.needs and extra.choice(request, there))
    tree.needed(wanted)
    environment = None if arguments.use_running_venv else tree.running(PREFIX, tree.interpreter(), wanted)
    device = plan.device_of(texts, request, there)
    # What would be done can be shown without a board.
    there = dataclasses.replace(there, device_there=dry or device == LINK or os.path.exists(device))
    made = plan.install(texts, request, environment.digest() if environment else "", there)
    if not (made.steps or arguments.json):
        runs = " and runs" if request.live and request.start else ""
        print(f"nothing to do: failstop {VERSION} is installed{runs}")
        return 0
    heading = f"failstop {VERSION}, to be installed {'here' if request.live else f'in {request.root}'}"
    doer = Doer(request.root, Machine(arguments.wait), environment)
    if dialogue.carry_out(made, heading, arguments, partial(_consent, made, arguments), doer):
        print(_done(request, environment))
    return 0


def _request(arguments: Namespace) -> Request:
    instance.check_name(arguments.name)
    if arguments.device is not None:
        BY_KEY["device.path"].check(arguments.device, "--device")
        if '"' in arguments.device or "\\" in arguments.device:
            raise InstallError(f"--device {arguments.device}: no path of a port has quotes or backslashes")
    return Request(
        arguments.name,
        arguments.device or "",
        os.path.abspath(arguments.root or "/"),
        arguments.root is None,
        not arguments.no_start,
        _running_command() if arguments.use_running_venv else layout.UNIT_COMMAND,
        arguments.ros2_user,
        arguments.fleet,
        arguments.web,
    )


def _running_command() -> str:
    """The command of the running environment. Raises InstallError when the service could not run it."""
    command = os.path.join(sys.prefix, "bin", "failstop")
    for path in (command, os.path.realpath(sys.executable)):
        if problem := tree.unreachable(path):
            raise InstallError(
                f"the service could not run {path}: {problem}. Leave --use-running-venv out: it is copied then"
            )
    return command


def _consent(made: Plan, arguments: Namespace) -> None:
    units = ", ".join(made.restarts)
    if units and arguments.yes and not arguments.restart:
        raise Refused(
            f"{units} runs and would be restarted, which stops the wheels: say --restart too, "
            f"or stop it first (systemctl stop {' '.join(made.restarts)})"
        )
    warning = f"{units} is restarted: THE WHEELS STOP. " if units else ""
    dialogue.consent(f"{warning}Go ahead?", arguments.yes)


def _done(request: Request, environment: tree.Environment | None) -> str:
    if not request.live:
        needs = environment.interpreter if environment else request.command
        missing = not os.path.exists(os.path.join(request.root, needs.lstrip("/")))
        return f"done{f'; {needs} is still to come there' if missing else ''}"
    user = os.environ.get("SUDO_USER", "USER")
    started = (
        f"{unit_of(request.name)} runs" if request.start else f"done; systemctl start {unit_of(request.name)} starts it"
    )
    return (
        f"{started}. Next: failstop status{option(request.name)}\n"
        f"Who is to drive has to be in the group failstop: sudo usermod -aG failstop {user} (and a new login)"
    )
