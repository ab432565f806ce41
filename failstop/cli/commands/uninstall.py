"""`failstop uninstall`: takes away what `failstop install` put there."""

from __future__ import annotations

import os
from functools import partial

from failstop.install import dialogue, plan
from failstop.install.do import Doer
from failstop.install.found import Request
from failstop.install.looking import look
from failstop.install.machine import Machine
from failstop.shm import instance

TYPE_CHECKING = False
if TYPE_CHECKING:
    from argparse import ArgumentParser, Namespace

EXAMPLES = """\
failstop uninstall --dry-run            # only show what would be removed
sudo failstop uninstall                 # settings and logs stay
sudo failstop uninstall --purge --yes   # these too
sudo failstop uninstall --name front    # only this robot's instance
"""


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop uninstall`."""
    parser.add_argument("--dry-run", action="store_true", help="show what would be done and change nothing")
    parser.add_argument("--yes", action="store_true", help="do not ask")
    parser.add_argument("--purge", action="store_true", help="configuration, logs, incidents and the user too")
    parser.add_argument("--name", help="only this instance (default: everything)")
    parser.add_argument("--root", metavar="DIR", help="in this directory, the root of another system")
    parser.add_argument("--json", action="store_true", help="what would be done, for programs; implies --dry-run")


def main(arguments: Namespace) -> int:
    """Uninstall. Raises InstallError or Refused; then nothing is changed."""
    dialogue.changes(arguments)
    live = arguments.root is None
    name = instance.check_name(arguments.name) if arguments.name else Request.name
    request = Request(name, "", os.path.abspath(arguments.root or "/"), live)
    make = plan.uninstall_instance if arguments.name else plan.uninstall
    made = make(request, look(request), arguments.purge)
    ask = partial(dialogue.consent, "The wheels stop. Go ahead?" if made.restarts else "Go ahead?", arguments.yes)
    heading = f"to be removed{'' if live else f' from {request.root}'}"
    if dialogue.carry_out(made, heading, arguments, ask, Doer(request.root, Machine())):
        print("done")
    return 0
