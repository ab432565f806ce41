"""`failstop enable`, `disable` and `reset`: one request, its answer."""

from __future__ import annotations

from argparse import ArgumentParser, Namespace

from failstop.api.errors import Refused
from failstop.api.robot import Robot
from failstop.api.verdict import next_step
from failstop.cli.commands import add_name
from failstop.supervisor.fold import fitted

EXAMPLES = {
    "enable": """\
failstop enable
failstop enable --name left  # of the service that runs with this name
""",
    "disable": """\
failstop disable             # zero at once, no ramp; nothing is latched
failstop disable --name left
""",
    "reset": """\
failstop reset               # moves nothing
failstop reset && failstop enable
""",
}


def add_arguments(parser: ArgumentParser) -> None:
    """Options of the three."""
    add_name(parser)


def _say(text: str) -> None:
    """How far it is: with an arm, enabling takes its time."""
    print(text, flush=True)


def main(arguments: Namespace) -> int:
    """Ask; a refusal is raised as Refused, with what to do first."""
    with Robot(arguments.name, client="failstop " + arguments.command, disable_on_exit=False) as robot:
        verbs = {"enable": lambda: robot.enable(_say), "disable": robot.disable, "reset": robot.reset}
        try:
            print(fitted(verbs[arguments.command](), 1, 2))
        except Refused as refused:
            state = robot.state
            if state.estop or state.waiting_for:
                raise Refused(f"{refused.args[0]}; next: {next_step(state)}") from None
            raise
    return 0
