"""`failstop doctor`: what on this machine keeps failstop from its promises, with the command that helps."""

from __future__ import annotations

import json
from argparse import ArgumentParser, Namespace

from failstop import style
from failstop.commands import add_name
from failstop.doctor import gather, table
from failstop.doctor.finding import FAIL, LEVELS, WARN, Finding, worst
from failstop.doctor.system import System
from failstop.machine import facts as machine_facts

EXAMPLES = """\
failstop doctor                         # everything; the timing self-test takes 5 s
failstop doctor --quick
sudo failstop doctor --stop-test        # a running service stops, latches, and is reset
failstop doctor --json | jq '.findings[] | select(.level != "ok")'
"""


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop doctor`."""
    add = parser.add_argument
    add("--config", metavar="FILE", help="the service's settings (default: the installed file, if there is one)")
    add("--device", metavar="PATH", help="the board's port (default: the running service's, else device.path)")
    add("--quick", action="store_true", help="without the timing self-test, which takes 5 s")
    add("--stop-test", action="store_true", help="consent: a running service may be stopped once and reset")
    add("--json", action="store_true", help="for programs")
    add_name(parser)


def main(arguments: Namespace) -> int:
    """Print the findings; exit code 1 when one is a failure."""
    gathered = gather.gather(
        arguments.name,
        arguments.config,
        arguments.device,
        quick=arguments.quick,
        stop_test_wanted=arguments.stop_test,
        system=System(),
    )
    found = table.examine(gathered)
    level = worst(finding.level for _, finding in found)
    if arguments.json:
        print(json.dumps({"worst": level, **machine_facts(), "findings": table.as_records(found)}, indent=2))
    else:
        print("\n".join(screen(found)))
    return 1 if level == FAIL else 0


def screen(found: list[tuple[str, Finding]]) -> list[str]:
    """For people."""
    width = max(len(name) for name, _ in found)
    lines = []
    shown = ""
    for name, finding in found:
        title = name if name != shown else ""
        lines.append(f"{style.paint(f'{finding.level:<4}', finding.level)}  {title:<{width}}  {finding.text}")
        if finding.fix:
            lines.append(f"{'':<{width + 8}}-> {finding.fix}")
        shown = name
    counts = {level: sum(finding.level == level for _, finding in found) for level in LEVELS}
    lines.append("")
    lines.append(f"{counts[FAIL]} failed, {counts[WARN]} warnings, {counts['ok']} fine")
    return lines
