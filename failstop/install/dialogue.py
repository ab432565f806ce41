"""What `failstop install` and `uninstall` say and ask."""

from __future__ import annotations

import json
import os
import shlex
import signal
import sys

from failstop.api.errors import Refused
from failstop.install import InstallError
from failstop.install.steps import Plan


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


def undo_when_ended() -> None:
    """Have SIGTERM and a terminal's hang-up end this as Ctrl-C does: with everything changed back."""
    for number in (signal.SIGTERM, signal.SIGHUP):
        signal.signal(number, signal.default_int_handler)
