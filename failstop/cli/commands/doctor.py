"""`failstop doctor`: shows problems of this computer that make failstop less reliable, each with a command that
helps."""

from __future__ import annotations

import dataclasses
import json
import os
import sys
from argparse import ArgumentParser, Namespace
from importlib.metadata import distributions
from typing import Any

from failstop.api.errors import FailstopError
from failstop.cli import style
from failstop.cli.commands import add_name
from failstop.cli.style import PLAIN
from failstop.doctor import table
from failstop.doctor.look import FAIL, OK, SKIP, WARN, Finding, Look
from failstop.doctor.machine import facts
from failstop.files.instance import check_name
from failstop.incidents import files, story
from failstop.incidents.incident import Incident

EXAMPLES = """\
failstop doctor             # takes 5 s, or 10 s if no board answers
failstop doctor --quick
failstop doctor --report report.json    # send it with your question
failstop doctor --json | jq '.findings[] | select(.level != "ok")'
"""

LEVEL_COLUMNS = 6
GAP = 2
ARROW = "-> "
SHOWN = {
    FAIL: (style.FAIL, "failed"),
    WARN: (style.WARN, "warned"),
    SKIP: (style.DIM, "not known"),
    OK: (style.OK, "fine"),
}
"""For each level, the colour of its findings, and the word for them in the summary, for example in "2 failed"."""
WITHHELD = ("still.command", "web.hosts", "web.origin")
"""Settings that the report leaves out, because their values may contain a password or show where the robot is."""
UNBROKEN = 1 << 16
"""A width in columns that no line reaches, so no line is wrapped."""


def add_arguments(parser: ArgumentParser) -> None:
    """Define the options of `failstop doctor`."""
    add = parser.add_argument
    add("--config", metavar="FILE", help="the service's settings (default: the installed file, if there is one)")
    add(
        "--device",
        metavar="PATH",
        help="the board's port (default: that of the running service, else the setting device.path)",
    )
    add("--quick", action="store_true", help="skip the timing test, which takes 5 s")
    add("--json", action="store_true", help="print JSON instead of text")
    add(
        "--report",
        metavar="FILE",
        help="write a report that you can send along with a question. It has versions, settings and the last incident, "
        "but no secrets",
    )
    add_name(parser)


def main(arguments: Namespace) -> int:
    """Run the command. The exit code is 1 if at least one finding is a failure."""
    look = Look(check_name(arguments.name), arguments.config, arguments.device, arguments.quick)
    found = table.examine(look)
    worst = found[0][1].level
    records = [{"check": check, **dataclasses.asdict(finding)} for check, finding in found]
    told = {"worst": worst, **facts(), "findings": records}
    if arguments.report:
        files.write_as(arguments.report, report(look, told).encode())
        print(
            f"wrote {arguments.report}; read it before you send it, because it quotes the reasons that people "
            "gave for stops"
        )
    else:
        lines = screen(found, style.width() if sys.stdout.isatty() else UNBROKEN)
        style.show(style.record(told) if arguments.json else lines)
    return 1 if worst == FAIL else 0


def report(look: Look, told: dict[str, Any]) -> str:
    """Return a report to send to others, with the findings, versions, settings and the last incident. It leaves out the
    values of the settings in WITHHELD, and the name of this computer."""
    try:
        with files.as_written(meant := files.find(files.LAST, look.name, os.environ)):
            incident = json.loads(json.dumps(story.as_dict(Incident.read(meant))))
    except FailstopError as error:
        incident = {"none": str(error)}
    settings, packages = (
        look.active_settings.flat(),
        {str(one.metadata["Name"]): one.version for one in distributions()},
    )
    private = {str(each.get(key, "")) for each in (settings, incident.get("settings", {})) for key in WITHHELD}
    # The longest text first, because a shorter one may be part of it.
    words = sorted({*private, str(incident.get("host", ""))} - {""}, key=len, reverse=True)
    told = {**told, "packages": packages, "settings": settings, "incident": incident}
    return json.dumps(_without(words, told), indent=2) + "\n"


def _without(words: list[str], told: Any) -> Any:
    if isinstance(told, dict):
        return {key: _without(words, value) for key, value in told.items()}
    if isinstance(told, list):
        return [_without(words, value) for value in told]
    for word in words if isinstance(told, str) else ():
        told = told.replace(word, "(left out)")
    return told


def screen(found: list[tuple[str, Finding]], columns: int = UNBROKEN) -> list[style.Line]:
    """Return the findings as lines for people, wrapped to this many columns. Commands are not wrapped, so that they can
    be copied."""
    width = max(len(name) for name, _ in found)
    indent = LEVEL_COLUMNS + width + GAP
    lines: list[style.Line] = []
    for name, finding in found:
        head = [(f"{finding.level:<{LEVEL_COLUMNS}}", SHOWN[finding.level][0]), (f"{name:<{width + GAP}}", PLAIN)]
        lines += style.wrap([*head, (finding.text, PLAIN)], columns, indent)
        if finding.fix:
            left = indent if indent + len(ARROW + finding.fix) <= columns else LEVEL_COLUMNS
            lines.append([(" " * left + ARROW, PLAIN), (finding.fix, style.STRONG)])
        if finding.advice:
            lines += style.wrap([(" " * indent, PLAIN), (finding.advice, style.DIM)], columns, indent)
    counts = [(sum(finding.level == level for _, finding in found), words) for level, (_, words) in SHOWN.items()]
    return [*lines, [], [(", ".join(f"{count} {words}" for count, words in counts if count), PLAIN)]]
