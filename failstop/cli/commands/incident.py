"""`failstop incident`: what the black box kept of each stop - list, show, plot, export."""

from __future__ import annotations

import json
import os
import shlex
import sys
from argparse import ArgumentParser, Namespace

from failstop.cli.commands import add_name
from failstop.incidents import pending, store
from failstop.incidents.file import IncidentError
from failstop.incidents.incident import Incident
from failstop.shm.instance import option

EXAMPLES = """\
failstop incident list
failstop incident show                       # the last one, what matters
failstop incident show 20260130-0214 --all --seconds 60
failstop incident plot                       # the last one, as ./ID.png
failstop incident export last -o stop.mcap   # for Foxglove, rosbag2
"""

WHICH = "the incident's id, the beginning of one, a file's path, or `last` (default)"
SUFFIXES = {"plot": ".png", "export": ".mcap"}


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop incident`."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="list|show|plot|export")
    listing = actions.add_parser("list", help="every incident that is kept, the newest last")
    listing.add_argument("--json", action="store_true", help="for programs")
    show = actions.add_parser("show", help="what happened: the facts, and the story in order")
    plot = actions.add_parser("plot", help="a picture of one, as PNG, SVG or PDF; needs failstop[plots]")
    export = actions.add_parser("export", help="one as MCAP with ROS 2 messages, for Foxglove; needs failstop[export]")
    for action in (show, plot, export):
        action.add_argument("id", nargs="?", default=store.LAST, help=WHICH)
    show.add_argument("--all", action="store_true", help="every line of the story, processes, machine, settings")
    show.add_argument("--seconds", type=float, default=10.0, metavar="S", help="tell from S before it (default: 10)")
    show.add_argument("--json", action="store_true", help="for programs; the whole story, and every setting")
    for name, action in (("plot", plot), ("export", export)):
        where = f"the file to write, or a folder (default: ID{SUFFIXES[name]} in this folder)"
        action.add_argument("-o", "--output", metavar="FILE", help=where)
        action.add_argument("-f", "--force", action="store_true", help="write over a file that is there already")
    plot.add_argument("--seconds", type=float, default=5.0, metavar="S", help="from S before the cause (default: 5)")
    for action in (listing, show, plot, export):
        add_name(action)


def main(arguments: Namespace) -> int:
    """Carry out one action. Raises FailstopError."""
    return {"list": _list, "show": _show, "plot": _plot, "export": _export}[arguments.action](arguments)


def _list(arguments: Namespace) -> int:
    from failstop.cli.style import show, width
    from failstop.incidents import report

    found, problems = store.heads(arguments.name, os.environ)
    if arguments.json:
        print(json.dumps(found, indent=2))
    elif found:
        show(report.table(found, width()))
    elif not problems:
        print(f"no incidents of {arguments.name!r}: nothing was latched yet")
    for problem in problems:
        sys.stderr.write(f"failstop: {problem}\n")
    return 1 if problems else 0


def _show(arguments: Namespace) -> int:
    import time

    from failstop.cli.style import show, width
    from failstop.incidents import report

    incident = _meant(arguments)
    if arguments.json:
        print(json.dumps(report.as_dict(incident), indent=2))
    else:
        since_ns = incident.cause_ns - round(arguments.seconds * 1e9)
        if arguments.all:
            lines = report.text(incident, width(), since_ns, time.time())
        else:
            lines = report.summary(incident, width(), since_ns, time.time(), _same(arguments))
        show(lines)
    return 0


def _meant(arguments: Namespace) -> Incident:
    """The incident; the last one is waited for, if it is of a moment ago. Raises IncidentError."""
    unsaved = pending.wait(arguments.name, os.environ) if arguments.id == store.LAST else None
    try:
        incident = store.load(arguments.id, arguments.name, os.environ)
    except IncidentError:
        if unsaved:
            raise IncidentError(f"the stop ({unsaved['reason']}) is not saved yet: again in a few seconds") from None
        raise
    if unsaved:
        sys.stderr.write(f"failstop: the newest stop ({unsaved['reason']}) is not saved yet: this is one before it\n")
    return incident


def _same(arguments: Namespace) -> str:
    """The words that mean the same incident again."""
    identity = "" if arguments.id == store.LAST else f" {shlex.quote(arguments.id)}"
    return identity + option(arguments.name)


def _output(arguments: Namespace, identity: str) -> str:
    """Where to write. Raises IncidentError rather than write over what is there."""
    path: str = arguments.output or identity + SUFFIXES[arguments.action]
    if os.path.isdir(path):
        path = os.path.join(path, identity + SUFFIXES[arguments.action])
    if os.path.exists(path) and not arguments.force:
        raise IncidentError(f"{path} is there already: -f writes over it, -o FILE another")
    return path


def _plot(arguments: Namespace) -> int:
    incident = _meant(arguments)
    path = _output(arguments, incident.id)
    from failstop.incidents import plot

    plot.save(incident, path, arguments.seconds)
    print(f"wrote {path}")
    return 0


def _export(arguments: Namespace) -> int:
    incident = _meant(arguments)
    path = _output(arguments, incident.id)
    from failstop.incidents import export

    messages = export.save(incident, path)
    print(f"wrote {path}: {messages} messages")
    return 0
