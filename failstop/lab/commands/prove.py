"""`failstop prove`: the stand test. Every stop path is timed on the robot, and kept as evidence."""

from __future__ import annotations

import json
import os
import random
import sys
import tempfile
from argparse import ArgumentParser, Namespace

from failstop import config
from failstop.api.errors import FailstopError, Refused
from failstop.cli import style
from failstop.cli.commands import add_name
from failstop.files.root import state_directory
from failstop.lab.prove import report, table
from failstop.lab.prove.report import Evidence
from failstop.lab.prove.session import check_free, interruptible, session
from failstop.lab.prove.stand import Stand
from failstop.lab.prove.swing import REACH_RAD
from failstop.lab.prove.table import BY_ARM_PATH, BY_PATH, BY_TURNING, Path, Turning
from failstop.lab.sim.client import SimBoard

EXAMPLES = """\
failstop prove --sim --quick            # on a simulated board, half a minute
sudo systemctl stop failstop && sudo failstop prove
failstop prove --only timeout,stop-request --at 0.2 --out /tmp/evidence
"""

WORD = "spin"
PROVE_FOLDER = "prove"
RUN_S = 3.5
KNOWN = (*BY_PATH, *BY_ARM_PATH)
ARM_WARNING = """\
  5. THE ARM MOVES: to its drive pose, and its base joint swings by {reach:g} rad. Nobody and nothing is in its reach.

"""
SAFETY = """\
THIS TURNS THE WHEELS, at {fastest}, and kills the programs that stop them: {count} runs, {minutes:.0f} min.

  1. The robot stands on a stand: every wheel is OFF THE GROUND and free to turn.
  2. No person, hair, clothing, cable or tool is near the wheels, and nobody will come near.
  3. The POWER SWITCH is at hand, and you will use it when the wheels turn on.
  4. This is a latched protective stop by software, no emergency stop in the sense of ISO 13850.

{arm}Ctrl-C stops everything at any time. Type "{word}" to begin, anything else to leave it: """


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop prove`."""
    add = parser.add_argument
    add("--sim", action="store_true", help="on a simulated board of its own, without questions")
    add("--quick", action="store_true", help="the main paths, each at one velocity in turn")
    add("--only", metavar="PATH,...", help=f"these stop paths alone: {', '.join(KNOWN)}")
    add("--at", metavar="V,...", help=f"these velocities alone: {', '.join(BY_TURNING)}")
    add("--pad", action="store_true", help="ask a person to press a button of the gamepad")
    add("--device", metavar="PATH", help="the board's port (default: the setting device.path)")
    add("--config", metavar="FILE", help="the service's settings (default: the installed file, if there is one)")
    add("--out", metavar="DIR", help="where evidence is kept (default: prove/ in the state directory; --sim: nowhere)")
    add("--json", action="store_true", help="print the result for programs instead")
    add_name(parser)


def main(arguments: Namespace) -> int:
    """Run the stand test; exit code 1 when anything failed or was left out, 2 without consent."""
    only, at = _words(arguments)
    say = (lambda _: None) if arguments.json else report.print_now

    def taken(device: str, user: dict[str, object], board: SimBoard | None) -> Evidence:
        ask = report.print_now if arguments.pad else None
        stand = Stand(device, user, folder, board)
        has_arm = bool(stand.settings.servos())
        plan = table.plan(quick=arguments.quick, only=only, at=at, has_arm=has_arm)
        if not plan:
            raise FailstopError(
                "nothing to do: the settings name no joints, and only the arm's stop paths are asked for"
            )
        if not board:
            _ask_consent(device, plan, has_arm=has_arm)
        velocities = list(dict.fromkeys(velocity for path, velocity in plan if not path.arm))
        runs = ((path, velocity, random.Random()) for path, velocity in plan)
        return session(runs, velocities, stand, quick=arguments.quick, say=say, ask=ask)

    with interruptible(), tempfile.TemporaryDirectory(prefix="failstop-prove-", ignore_cleanup_errors=True) as folder:
        if arguments.sim:
            link = os.path.join(folder, "board")
            with SimBoard(link) as board:
                evidence = taken(link, config.read(arguments.config), board)
        else:
            path = config.chosen(arguments.name, arguments.config)
            device = arguments.device or config.load(path).text("device.path")
            check_free(device, arguments.name)
            evidence = taken(device, config.read(path), None)
    _show(arguments, evidence)
    return evidence.exit_code


def _words(arguments: Namespace) -> tuple[tuple[str, ...], tuple[str, ...]]:
    """The names that --only and --at give. Raises FailstopError for one that is in no table."""
    chosen = []
    for given, known, what in (
        (arguments.only, KNOWN, "stop path"),
        (arguments.at, tuple(BY_TURNING), "velocity"),
    ):
        names = tuple(given.split(",")) if given else ()
        for name in names:
            if name not in known:
                raise FailstopError(f"no {what} {name!r}: there is {', '.join(known)}")
        chosen.append(names)
    return chosen[0], chosen[1]


def _ask_consent(device: str, plan: list[tuple[Path, Turning]], *, has_arm: bool) -> None:
    fastest = " and ".join(dict.fromkeys(velocity.words for _, velocity in plan))
    arm = ARM_WARNING.format(reach=REACH_RAD) if has_arm else ""
    print(f"{device}:", file=sys.stderr)
    minutes = max(1.0, len(plan) * RUN_S / 60)
    sys.stderr.write(SAFETY.format(fastest=fastest, count=len(plan), minutes=minutes, word=WORD, arm=arm))
    sys.stderr.flush()
    if sys.stdin.readline().strip() != WORD:
        raise Refused("no consent: nothing was moved")


def _show(arguments: Namespace, evidence: Evidence) -> None:
    if arguments.json:
        print(json.dumps(evidence.as_dict()))
    else:
        verdict = style.paint(evidence.verdict, report.VERDICT_STYLES[evidence.verdict])
        lines = [verdict if line == evidence.verdict else line for line in report.last_lines(evidence)]
        print("\n" + "\n".join(lines))
    if evidence.simulated and not arguments.out:
        return
    folder = arguments.out or os.path.join(state_directory(arguments.name, os.environ), PROVE_FOLDER)
    for path in report.save(evidence, folder):
        print(f"evidence: {path}", file=sys.stderr)
