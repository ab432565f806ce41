"""`failstop install` and `failstop uninstall`: failstop as a service of this machine, whole or not at all."""

from __future__ import annotations

import json
import os
import shlex
import signal
import sys
from argparse import ArgumentParser, Namespace

from failstop.api.errors import Refused
from failstop.install import InstallError, plan, rows, tree
from failstop.install.do import Doer
from failstop.install.plan import Plan, Request
from failstop.install.rows import EXTRAS, OPERATE, VIEW, YES
from failstop.install.system import PREFIX, READY_S, System
from failstop.instances import unit_of
from failstop.policy.settings import BY_KEY
from failstop.shm import instance
from failstop.shm.instance import DEFAULT_NAME, option
from failstop.version import VERSION

EXAMPLES = {
    "install": """\
failstop install --dry-run           # only show what would be done
sudo failstop install                # show it, ask, do it, wait until ready
sudo failstop install --device /dev/ttyUSB0 --yes
sudo failstop install --name front --device /dev/ttyACM1   # one more robot
sudo failstop install --ros2-user robot   # and the bridge to ROS 2
sudo failstop install --web           # and the operator's page
sudo failstop install --root /mnt/image --yes   # of a system not running
""",
    "uninstall": """\
failstop uninstall --dry-run            # only show what would be removed
sudo failstop uninstall                 # settings and logs stay
sudo failstop uninstall --purge --yes   # these too
sudo failstop uninstall --name front    # only this robot's instance
""",
}


def add_arguments(parser: ArgumentParser) -> None:
    """Options of the two."""
    install = not parser.prog.endswith("uninstall")
    add = parser.add_argument
    add("--dry-run", action="store_true", help="show what would be done and change nothing")
    add("--yes", action="store_true", help="do not ask")
    if not install:
        add("--purge", action="store_true", help="configuration, logs, incidents and the user too")
        add("--name", help="only this instance (default: everything)")
        add("--root", metavar="DIR", help="in this directory, the root of another system")
    else:
        add("--restart", action="store_true", help="with --yes: a service that runs may be restarted too")
        add("--device", metavar="PATH", help="the board's port, for a new configuration")
        name = f"the robot's name, if there are several (default: {DEFAULT_NAME})"
        add("--name", default=DEFAULT_NAME, help=name)
        add("--ros2-user", metavar="NAME", default="", help="the bridge to ROS 2 too, as this user")
        fleet = "publish it to its fleet's broker too, and obey its stop"
        add("--fleet", action="store_const", const=YES, default="", help=fleet)
        page = "the operator's page too; operate: its paired devices may reset and enable"
        add("--web", nargs="?", choices=(VIEW, OPERATE), const=VIEW, default="", help=page)
        add("--root", metavar="DIR", help="install into this directory, the root of another system")
        add("--no-start", action="store_true", help="start it at the next boot, not now")
        wait = "how long it has to become ready (default: %(default)g)"
        add("--wait", metavar="S", type=float, default=READY_S, help=wait)
        running = f"have the service run in the environment that this command is in; else it is copied to {PREFIX}"
        add("--use-running-venv", action="store_true", help=running)
    add("--json", action="store_true", help="what would be done, for programs; implies --dry-run")


def main(arguments: Namespace) -> int:
    """Do it. Raises InstallError, Refused, SettingError; then nothing is changed."""
    if arguments.root is not None and not os.path.isdir(arguments.root):
        raise InstallError(f"--root {arguments.root}: no such directory")
    if not (arguments.dry_run or arguments.json):
        if os.geteuid():
            words = [os.path.abspath(sys.argv[0]), *sys.argv[1:]]
            raise InstallError(f"this changes the system, which needs root: sudo {shlex.join(words)}")
        if arguments.root is None and not os.path.isdir("/run/systemd/system"):
            raise InstallError(
                "systemd does not run this machine: `failstop run` is the service in the foreground, "
                "`--root DIR` installs into the files of another system"
            )
    return _install(arguments) if arguments.command == "install" else _uninstall(arguments)


def _install(arguments: Namespace) -> int:
    system, request, texts = System(arguments.root, arguments.wait), _request(arguments), rows.texts()
    # Of the extras that are there already too: a new environment takes the place of the one that they run in.
    there = plan.chosen(request, system)
    needs = tuple(extra.needs for extra in EXTRAS if extra.needs and extra in there)
    tree.needed(needs)
    environment = None if arguments.use_running_venv else tree.running(PREFIX, tree.interpreter(), needs)
    made = plan.install(texts, request, environment, system)
    # What would be done can be shown without a board.
    if not (arguments.dry_run or arguments.json):
        plan.refuse_absent(request, system)
    if not (made.steps or arguments.json):
        print(f"nothing to do: failstop {VERSION} is installed{' and runs' if system.live and request.start else ''}")
        return 0
    heading = f"failstop {VERSION}, to be installed {'here' if system.live else f'in {system.root}'}"
    question, units = "Go ahead?", ", ".join(made.restarts)
    if units:
        question = f"{units} is restarted: THE WHEELS STOP. Go ahead?"
    if _carry_out(made, heading, question, arguments, system):
        print(_done(request, system, environment.interpreter if environment else request.command))
    return 0


def _uninstall(arguments: Namespace) -> int:
    system = System(arguments.root)
    if arguments.name:
        made = plan.uninstall_instance(instance.check_name(arguments.name), system, arguments.purge)
    else:
        made = plan.uninstall(system, arguments.purge)
    question = "The wheels stop. Go ahead?" if made.restarts else "Go ahead?"
    if _carry_out(made, f"to be removed{'' if system.live else f' from {system.root}'}", question, arguments, system):
        print("done")
    return 0


def _request(arguments: Namespace) -> Request:
    instance.check_name(arguments.name)
    if arguments.device is not None:
        BY_KEY["device.path"].check(arguments.device, "--device")
    return Request(
        arguments.name,
        arguments.device or "",
        not arguments.no_start,
        _running_command() if arguments.use_running_venv else rows.UNIT_COMMAND,
        {"--ros2-user": arguments.ros2_user, "--fleet": arguments.fleet, "--web": arguments.web},
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


def _done(request: Request, system: System, runs: str) -> str:
    if not system.live:
        missing = not os.path.exists(system.at(runs))
        return f"done{f'; {runs} is still to come there' if missing else ''}"
    unit, user = unit_of(request.name), os.environ.get("SUDO_USER", "USER")
    started = f"{unit} runs" if request.start else f"done; systemctl start {unit} starts it"
    return (
        f"{started}. Next: failstop status{option(request.name)}\n"
        f"Who is to drive has to be in the group failstop: sudo usermod -aG failstop {user} (and a new login)"
    )


def _carry_out(made: Plan, heading: str, question: str, arguments: Namespace, system: System) -> bool:
    """Show a plan, ask, and do it; False when it was only to be shown. Raises InstallError, Refused."""
    shown = [step for step in made.steps if step.verb]
    if arguments.json:
        steps = [{"verb": step.verb, "subject": step.subject, "remark": step.remark} for step in shown]
        print(json.dumps({"steps": steps, "notes": made.notes, "restarts": made.restarts}, indent=2))
        return False
    width = max((len(step.verb) for step in shown), default=0)
    lines = [f"{step.verb:<{width}}  {step.subject}{f': {step.remark}' if step.remark else ''}" for step in shown]
    print(f"{heading}:\n", *lines, *(f"{'note':<{width}}  {note}" for note in made.notes), "", sep="\n")
    if arguments.dry_run:
        return False
    if not arguments.yes:
        _consent(question)
    elif made.restarts and not getattr(arguments, "restart", True):
        raise Refused(
            f"{', '.join(made.restarts)} runs and would be restarted, which stops the wheels: say --restart too, "
            f"or stop it first (systemctl stop {' '.join(made.restarts)})"
        )
    # SIGTERM and a terminal's hang-up end this as Ctrl-C does: with everything changed back.
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.default_int_handler)
    for what in Doer(system).do(made.steps):
        print(f"failstop: {what}: remove it by hand", file=sys.stderr)
    return True


def _consent(question: str) -> None:
    if not sys.stdin.isatty():
        raise Refused("nobody to ask: say --yes, or look first with --dry-run")
    try:
        answer = input(f"{question} [y/N] ")
    except EOFError:
        answer = ""
    if answer.strip().lower() not in ("y", "yes"):
        raise Refused("not wanted; nothing was changed")
