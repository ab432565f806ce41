"""`failstop incident`: what the black box kept of each stop - list, show, plot, export."""

from __future__ import annotations

import json
import os
from argparse import ArgumentParser, Namespace

from failstop.commands import add_name
from failstop.incidents import store

EXAMPLES = """\
failstop incident list
failstop incident show                       # the last one
failstop incident show 20260130-0214 --seconds 60
failstop incident plot last -o stop.png
failstop incident export last -o stop.mcap   # for Foxglove, PlotJuggler, rosbag2
"""

WHICH = "the incident's id, the beginning of one, a file's path, or `last`"


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop incident`."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="list|show|plot|export")
    listing = actions.add_parser("list", help="every incident that is kept, the newest last")
    listing.add_argument("--json", action="store_true", help="for programs")
    show = actions.add_parser("show", help="the story of one, in order")
    show.add_argument("id", nargs="?", default=store.LAST, help=f"{WHICH} (default)")
    show.add_argument("--seconds", type=float, default=10.0, metavar="S", help="tell from S before it (default: 10)")
    show.add_argument("--json", action="store_true", help="for programs; the whole story, and every setting")
    plot = actions.add_parser("plot", help="a picture of one, as PNG, SVG or PDF; needs failstop[plots]")
    export = actions.add_parser("export", help="one as MCAP with ROS 2 messages, for Foxglove; needs failstop[export]")
    for action in (plot, export):
        action.add_argument("id", help=WHICH)
        action.add_argument("-o", "--output", required=True, metavar="FILE", help="the file to write")
    plot.add_argument("--seconds", type=float, default=5.0, metavar="S", help="from S before the cause (default: 5)")
    for action in (listing, show, plot, export):
        add_name(action)


def main(arguments: Namespace) -> int:
    """Carry out one action. Raises FailstopError."""
    return {"list": _list, "show": _show, "plot": _plot, "export": _export}[arguments.action](arguments)


def _list(arguments: Namespace) -> int:
    import sys

    from failstop.incidents import report
    from failstop.style import width

    found, problems = store.heads(arguments.name, os.environ)
    if arguments.json:
        print(json.dumps(found, indent=2))
    elif found:
        print("\n".join(report.table(found, width())))
    elif not problems:
        print(f"no incidents of {arguments.name!r}: nothing was latched yet")
    for problem in problems:
        sys.stderr.write(f"failstop: {problem}\n")
    return 1 if problems else 0


def _show(arguments: Namespace) -> int:
    from failstop.incidents import report
    from failstop.style import width

    incident = store.load(arguments.id, arguments.name, os.environ)
    if arguments.json:
        print(json.dumps(report.as_dict(incident), indent=2))
    else:
        since_ns = incident.cause_ns - round(arguments.seconds * 1e9)
        print("\n".join(report.text(incident, width(), since_ns)))
    return 0


def _plot(arguments: Namespace) -> int:
    incident = store.load(arguments.id, arguments.name, os.environ)
    from failstop.incidents import plot

    plot.save(incident, arguments.output, arguments.seconds)
    print(f"wrote {arguments.output}")
    return 0


def _export(arguments: Namespace) -> int:
    incident = store.load(arguments.id, arguments.name, os.environ)
    from failstop.incidents import export

    messages = export.save(incident, arguments.output)
    print(f"wrote {arguments.output}: {messages} messages")
    return 0
