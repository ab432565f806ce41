"""What `failstop install` and `uninstall` say and ask."""

from __future__ import annotations

import json
import os
import shlex
import signal
import sys
from collections.abc import Callable

from failstop.api.errors import Refused
from failstop.install import InstallError
from failstop.install.do import Doer
from failstop.install.steps import Plan

TYPE_CHECKING = False
if TYPE_CHECKING:
    from argparse import Namespace


def as_json(plan: Plan) -> str:
    """A plan for programs."""
    steps = [{"verb": step.verb, "subject": step.subject, "remark": step.remark} for step in plan.steps if step.verb]
    return json.dumps({"steps": steps, "notes": plan.notes, "restarts": plan.restarts}, indent=2)


def as_text(plan: Plan) -> str:
    """A plan as lines."""
    shown = [step for step in plan.steps if step.verb]
    verbs = max((len(step.verb) for step in shown), default=0)
    lines = [f"{step.verb:<{verbs}}  {step.subject}{f': {step.remark}' if step.remark else ''}" for step in shown]
    return "\n".join([*lines, *(f"{'note':<{verbs}}  {note}" for note in plan.notes)])


def changes(arguments: Namespace) -> bool:
    """Whether more is wanted than to be shown what would be done. Raises InstallError where it can't be done."""
    if arguments.root is not None and not os.path.isdir(arguments.root):
        raise InstallError(f"--root {arguments.root}: no such directory")
    if arguments.dry_run or arguments.json:
        return False
    need_root()
    if arguments.root is None:
        need_systemd()
    return True


def carry_out(made: Plan, heading: str, arguments: Namespace, ask: Callable[[], None], doer: Doer) -> bool:
    """Show a plan, ask, and do it; False when it was only to be shown. Raises InstallError, Refused."""
    if arguments.json:
        print(as_json(made))
        return False
    print(f"{heading}:\n\n{as_text(made)}\n")
    if arguments.dry_run:
        return False
    ask()
    # SIGTERM and a terminal's hang-up end this as Ctrl-C does: with everything changed back.
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.default_int_handler)
    for what in doer.do(made.steps):
        print(f"failstop: {what}: remove it by hand", file=sys.stderr)
    return True


def need_root() -> None:
    """Raise InstallError with the command to type unless this is root."""
    if os.geteuid():
        words = [os.path.abspath(sys.argv[0]), *sys.argv[1:]]
        raise InstallError(f"this changes the system, which needs root: sudo {shlex.join(words)}")


def need_systemd() -> None:
    """Raise InstallError unless systemd runs this machine."""
    if not os.path.isdir("/run/systemd/system"):
        raise InstallError(
            "systemd does not run this machine: `failstop run` is the service in the foreground, "
            "`--root DIR` installs into the files of another system"
        )


def consent(question: str, yes: bool) -> None:
    """Ask on the terminal unless the answer was given. Raises Refused."""
    if yes:
        return
    if not sys.stdin.isatty():
        raise Refused("nobody to ask: say --yes, or look first with --dry-run")
    try:
        answer = input(f"{question} [y/N] ")
    except EOFError:
        answer = ""
    if answer.strip().lower() not in ("y", "yes"):
        raise Refused("not wanted; nothing was changed")
