"""`failstop incident`: lists, shows, plots or exports the saved incidents. An incident is the record of one stop."""

from __future__ import annotations

import os
import time
from argparse import ArgumentParser, Namespace

from failstop.api import client, dates, verdict, words
from failstop.api.errors import FailstopError
from failstop.api.events import EventLog
from failstop.api.snapshot import Stop
from failstop.api.state import StateReader
from failstop.cli import standard
from failstop.cli.commands import add_name, seconds
from failstop.cli.screen import incident as screen
from failstop.cli.style import PLAIN, Line, record, show, width
from failstop.incidents import files, story
from failstop.incidents.incident import Incident
from failstop.incidents.left import left
from failstop.messages import box

EXAMPLES = """\
failstop incident list
failstop incident show                       # the last one
failstop incident show 42                    # by its number
failstop incident show 2026-01-30 02:14      # by its date and time
failstop incident show last --all            # in full
failstop incident plot                       # the last one, to ./ID.png
failstop incident export last -o stop.mcap   # for Foxglove, rosbag2
"""

WHICH = (
    "the incident: its number, its id, its date and time as the screens show them, the beginning of any of these, the "
    "path of its file, or `last` (default)"
)
SUFFIXES = {"plot": ".png", "export": ".mcap"}
SAVED_S = 0.8
"""The latest time after the copy of the rings at which an incident file is expected, in seconds. Usually it is there
after 0.2 s."""
NOT_SAVED = 'incidents.save is "off"'
UNKNOWN = "what has stopped the wheels since the last latched stop is not remembered"
TOGETHER_NS = 500_000_000
"""A stop that comes less than this time after the cause of a saved incident, in ns, belongs to the same incident, so it
has no file of its own."""


def add_arguments(parser: ArgumentParser) -> None:
    """Define the options of `failstop incident`."""
    actions = parser.add_subparsers(dest="action", required=True, metavar="list|show|plot|export")
    listing = actions.add_parser("list", help="list all saved incidents, the newest last")
    told = actions.add_parser("show", help="print what happened: first the facts, then the events in order")
    plot = actions.add_parser("plot", help="plot an incident as PNG, SVG or PDF; needs matplotlib")
    export = actions.add_parser(
        "export", help="export an incident for Foxglove, as MCAP with ROS 2 messages; needs the Python package mcap"
    )
    for action in (told, plot, export):
        action.add_argument("id", nargs="*", default=[files.LAST], help=WHICH)
    told.add_argument(
        "--all", action="store_true", help="print everything: each event, the computer, the settings and the versions"
    )
    for action in (listing, told):
        action.add_argument("--json", action="store_true", help="print everything, as JSON")
    for name, action in (("plot", plot), ("export", export)):
        where = f"the file to write (default: ID{SUFFIXES[name]} in this folder)"
        action.add_argument("-o", "--output", metavar="FILE", help=where, default="")
    plot.add_argument(
        "--seconds",
        type=seconds,
        default=5.0,
        metavar="S",
        help="how many seconds before the cause the plot begins (default: 5)",
    )
    for action in (listing, told, plot, export):
        add_name(action)


def main(arguments: Namespace) -> int:
    """Run the command. Raises FailstopError."""
    if arguments.action == "list":
        return _list(arguments)
    meant = _meant(arguments)
    with files.as_written(meant):
        lines = _lines_on(Incident.read(meant), arguments)
    show(lines)
    return 0


def _lines_on(incident: Incident, arguments: Namespace) -> list[Line]:
    """Return the lines to print about an incident. For plot and export, this also writes the file. Raises
    IncidentError."""
    if arguments.action == "show":
        if arguments.json:
            return record(story.as_dict(incident))
        return screen.text(incident, width(), time.time(), whole=arguments.all, clock=_clock(incident, arguments.name))
    path: str = arguments.output or incident.id + SUFFIXES[arguments.action]
    if arguments.action == "plot":
        from failstop.incidents import plot

        plot.save(incident, path, arguments.seconds)
        return [[(f"wrote {words.printable(path)}", PLAIN)]]
    from failstop.incidents import export

    return [[(f"wrote {words.printable(path)}: {export.save(incident, path)} messages", PLAIN)]]


def _clock(incident: Incident, name: str) -> str:
    """Return a warning if somebody has set the clock, so that the times of day in an incident may be wrong. Otherwise
    return an empty text. This compares all saved incidents."""
    found, _ = files.heads(name, files.folders(name, os.environ))
    return next((files.jumped(head) for head in found if head["id"] == incident.id), "")


def _list(arguments: Namespace) -> int:
    found, problems = files.heads(arguments.name, files.folders(arguments.name, os.environ))
    if arguments.json:
        show(record(found))
    elif found:
        show(screen.table(found, width()))
    elif not problems:
        print(files.nothing(arguments.name, os.environ))
    for problem in problems:
        standard.say(problem)
    return 1 if problems else 0


def _meant(arguments: Namespace) -> str:
    """Return the path of the incident file that the user has asked for. If the user wants the last incident
    and a stop is still being saved, first wait for the file of this stop. Raises IncidentError."""
    # The shell splits a date and a time into two words.
    wanted = " ".join(arguments.id)
    if wanted != files.LAST:
        return files.find(wanted, arguments.name, os.environ)
    while (stop := unsaved(arguments.name)) and time.monotonic_ns() < _due_ns(arguments.name, stop):
        time.sleep(0.1)
    newer = _newer(arguments.name, stop)
    try:
        path = files.find(wanted, arguments.name, os.environ)
    except files.IncidentError:
        if newer:
            standard.say(newer)
        raise
    if newer:
        standard.say(f"{newer}; this incident is from before that")
    return path


def _due_ns(name: str, stop: Stop) -> int:
    """Return the latest time at which the file of this stop is expected (CLOCK_MONOTONIC). 0 if no file will come."""
    try:
        after_s = float(StateReader(name).settings()["still.after_s"])
    except FailstopError:
        return 0
    return 0 if failed(name, stop) else stop.noticed_ns + box.copy_ns(round(after_s * 1e9)) + round(SAVED_S * 1e9)


def _newer(name: str, stop: Stop | None) -> str:
    """Describe a stop that is newer than the last saved incident, and say why it is not saved. Empty if no such stop is
    known. `stop`: the result of unsaved()."""
    if stop:
        why = failed(name, stop)
        return f"the last stop ({stop.reason}) {f'was not saved: {why}' if why else 'is not saved yet'}"
    if gone := left(name):
        return f"the last run died: {'; '.join(gone[0].also)}"
    return before(name) or unlatched(name)


def before(name: str) -> str:
    """Describe the end of the run before this one if its incident was not saved and this run has had no stop yet. Empty
    otherwise."""
    try:
        stop, told = StateReader(name).read().last_stop, verdict.before_event(EventLog(name).read())
    except FailstopError:
        return ""
    if stop or told is None or "id" in told.fields:
        return ""
    return f"the run before this one: {verdict.before([told])}"


def unlatched(name: str) -> str:
    """Describe the last stop of the wheels if it was not latched, for example if motion was disabled. The text has the
    stop's time and reason, and says that the stop has no incident. Empty if the last stop was latched, or if a stop is
    latched now. If the service does not remember that, the text says so."""
    try:
        at = dates.now()
        state, events = dates.dated(StateReader(name).read(), EventLog(name).read(), at)
    except FailstopError:
        return ""
    if (last := verdict.unlatched(state, events)) is None:
        return "" if verdict.remembered(state, events) else UNKNOWN
    what = last.what.replace("motion disabled", "motion was disabled", 1)
    return f"at {words.clock(last.t, at.unix_s)} {what}; that is not a latched stop, so it has no incident"


def unsaved(name: str) -> Stop | None:
    """Return the service's last stop if no incident file has it, else None."""
    try:
        state, run = StateReader(name).read(), client.run(name)[0].rpartition(".")[2]
    except FailstopError:
        return None
    stop = state.last_stop
    # If another cause comes while a stop is latched, it is saved with the latched stop.
    if not stop or state.cause not in (None, stop.cause):
        return None
    heads, _ = files.heads(name, files.folders(name, os.environ))
    # Compare the run and its monotonic time, because somebody may have set the wall clock since.
    saved_ns = (head["cause_ns"] for head in heads if head.get("run") == run)
    return None if any(ns > stop.noticed_ns - TOGETHER_NS for ns in saved_ns) else stop


def failed(name: str, stop: Stop) -> str:
    """Return the reason why the service did not save the incident of its last stop. Empty if no reason is known."""
    try:
        if StateReader(name).settings()["incidents.save"] == "off":
            return NOT_SAVED
        told = [event for event in EventLog(name).read() if event.kind == "incident" and event.ns > stop.noticed_ns]
        told = [event for event in told if event.fields.get("run") != "before"]
    except FailstopError:
        return ""
    return told[-1].what.removeprefix("incident not saved: ") if told and told[-1].level == "warning" else ""
