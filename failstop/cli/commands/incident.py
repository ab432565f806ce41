"""`failstop incident`: what the black box kept of each stop - list, show, plot, export."""

from __future__ import annotations

import json
import os
import shlex
import sys
import time
from argparse import ArgumentParser, Namespace
from contextlib import closing
from typing import Any

import msgpack

from failstop.api.client import attach, last_run
from failstop.api.errors import FailstopError
from failstop.cli import standard
from failstop.cli.commands import add_name
from failstop.cli.screen.follow import left
from failstop.cli.style import show, width
from failstop.incidents import files, report
from failstop.incidents.files import IncidentError
from failstop.incidents.incident import Incident
from failstop.policy import causes
from failstop.shm import layout
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
RECENT_S = 20.0
"""A stop that is older was saved, or never will be; a lost port is waited for less long (saver.py)."""
PATIENCE_S = 4.0
"""A stop's file is there 2.4 s after it."""
LOOK_S = 0.1


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop incident`."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="list|show|plot|export")
    listing = actions.add_parser("list", help="every incident that is kept, the newest last")
    listing.add_argument("--json", action="store_true", help="for programs")
    told = actions.add_parser("show", help="what happened: the facts, and the story in order")
    plot = actions.add_parser("plot", help="a picture of one, as PNG, SVG or PDF; needs failstop[plots]")
    export = actions.add_parser("export", help="one as MCAP with ROS 2 messages, for Foxglove; needs failstop[export]")
    for action in (told, plot, export):
        action.add_argument("id", nargs="?", default=files.LAST, help=WHICH)
    told.add_argument("--all", action="store_true", help="every line of the story, processes, machine, settings")
    told.add_argument("--seconds", type=float, default=10.0, metavar="S", help="tell from S before it (default: 10)")
    told.add_argument("--json", action="store_true", help="for programs; the whole story, and every setting")
    for name, action in (("plot", plot), ("export", export)):
        where = f"the file to write, or a folder (default: ID{SUFFIXES[name]} in this folder)"
        action.add_argument("-o", "--output", metavar="FILE", help=where, default="")
        action.add_argument("-f", "--force", action="store_true", help="write over a file that is there already")
    plot.add_argument("--seconds", type=float, default=5.0, metavar="S", help="from S before the cause (default: 5)")
    for action in (listing, told, plot, export):
        add_name(action)


def main(arguments: Namespace) -> int:
    """Carry out one action. Raises FailstopError."""
    return {"list": _list, "show": _show}.get(arguments.action, _write)(arguments)


def _list(arguments: Namespace) -> int:
    found, problems = files.heads(arguments.name, files.folders(arguments.name, os.environ))
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
    incident = Incident.read(_meant(arguments))
    since_ns = incident.cause_ns - round(arguments.seconds * 1e9)
    if arguments.json:
        print(json.dumps(report.as_dict(incident), indent=2))
    elif arguments.all:
        show(report.text(incident, width(), since_ns, time.time()))
    else:
        same = "" if arguments.id == files.LAST else f" {shlex.quote(arguments.id)}"
        again = same + option(arguments.name)
        show(report.summary(incident, width(), since_ns, time.time(), again))
    return 0


def _write(arguments: Namespace) -> int:
    """A picture or an export; nothing is written over what is there."""
    incident = Incident.read(_meant(arguments))
    path: str = arguments.output
    if not path or os.path.isdir(path):
        path = os.path.join(path, incident.id + SUFFIXES[arguments.action])
    if os.path.exists(path) and not arguments.force:
        raise IncidentError(f"{path} is there already: -f writes over it, -o FILE another")
    if arguments.action == "plot":
        from failstop.incidents import plot

        plot.save(incident, path, arguments.seconds)
        print(f"wrote {path}")
    else:
        from failstop.incidents import export

        print(f"wrote {path}: {export.save(incident, path)} messages")
    return 0


def _meant(arguments: Namespace) -> str:
    """The incident's path; the last one is waited for, if it is of a moment ago. Raises IncidentError."""
    until_s = time.monotonic() + PATIENCE_S
    while arguments.id == files.LAST:
        heads, _ = files.heads(arguments.name, files.folders(arguments.name, os.environ))
        if not (reason := unsaved(arguments.name, heads, time.time())):
            break
        if time.monotonic() > until_s:
            raise IncidentError(f"the stop ({reason}) is not saved yet: again in a few seconds")
        time.sleep(LOOK_S)
    if arguments.id == files.LAST and left(arguments.name):
        standard.say("how the last run ended is saved when the service is started again: this is from before it")
    return files.find(arguments.id, arguments.name, os.environ)


def unsaved(name: str, heads: list[dict[str, Any]], now_s: float) -> str:
    """The reason of the service's last stop, when it is recent and in none of the incidents; else empty."""
    try:
        with closing(attach(name, layout.SUPERVISOR, last_run(name))) as supervisor:
            entry, run = supervisor.latest_reader("stop").read(), f"{supervisor.incarnation:016x}"
        stop = msgpack.unpackb(entry[2]) if entry else {}
        # What comes while a stop is latched belongs to that one's file.
        if not stop or stop["latched"] != stop["cause"] or not 0 <= now_s - stop["t"] < RECENT_S:
            return ""
        saved = any(head.get("run") == run and head["epoch"] >= stop["epoch"] for head in heads)
        return "" if saved else str(causes.read(stop["cause"]))
    except (FailstopError, ValueError, KeyError, TypeError, msgpack.UnpackException):
        return ""
