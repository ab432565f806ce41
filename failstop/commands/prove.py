"""`failstop prove`: the stand test. Every stop path is timed on the robot, and kept as evidence."""

from __future__ import annotations

import contextlib
import json
import os
import signal
import sys
import tempfile
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from types import FrameType

from failstop import style
from failstop.board.sim.client import SimBoard, SimBoardError
from failstop.commands import add_name
from failstop.doctor import port_facts
from failstop.doctor.gather import settings_of
from failstop.doctor.system import System
from failstop.errors import FailstopError, NoService, Refused
from failstop.install.layout import unit_of
from failstop.procs.telemetry.state_files import state_directory
from failstop.prove import report, table
from failstop.prove.character import Unfit, characterize
from failstop.prove.report import Evidence
from failstop.prove.run import Character, Run
from failstop.prove.stand import Stand
from failstop.prove.strike import Ask
from failstop.prove.table import BY_PATH, BY_VELOCITY, Path, Velocity
from failstop.robot import Robot
from failstop.supervisor import config
from failstop.trial import TrialError

EXAMPLES = """\
failstop prove --sim --quick            # on a simulated board, half a minute
sudo systemctl stop failstop && sudo failstop prove
failstop prove --only deadman,stop-request --at 0.2 --out /tmp/evidence
"""

WORD = "spin"
SIGNALS = (signal.SIGINT, signal.SIGTERM, signal.SIGHUP)
PROVE_FOLDER = "prove"
RUN_S = 3.5
RUNAWAY = "the wheels were not seen to come to rest: if they turn, use the POWER SWITCH"
SAFETY = """\
THIS TURNS THE WHEELS, at {fastest}, and kills the programs that stop them: {count} runs, {minutes:.0f} min.

  1. The robot stands on a stand: every wheel is OFF THE GROUND and free to turn.
  2. No person, hair, clothing, cable or tool is near the wheels, and nobody will come near.
  3. The POWER SWITCH is at hand, and you will use it when the wheels turn on.
  4. This is a latched protective stop by software, no emergency stop in the sense of ISO 13850.

Ctrl-C stops the wheels at any time. Type "{word}" to begin, anything else to leave it: """


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop prove`."""
    add = parser.add_argument
    add("--sim", action="store_true", help="on a simulated board of its own, without questions")
    add("--quick", action="store_true", help="the main paths, each at one velocity in turn")
    add("--only", metavar="PATH,...", help=f"these stop paths alone: {', '.join(BY_PATH)}")
    add("--at", metavar="V,...", help=f"these velocities alone: {', '.join(BY_VELOCITY)}")
    add("--pad", action="store_true", help="ask a person to press a button of the gamepad")
    add("--device", metavar="PATH", help="the board's port (default: the setting device.path)")
    add("--config", metavar="FILE", help="the service's settings (default: the installed file, if there is one)")
    add("--out", metavar="DIR", help="where evidence is kept (default: prove/ in the state directory; --sim: nowhere)")
    add("--json", action="store_true", help="print the result for programs instead")
    add_name(parser)


def main(arguments: Namespace) -> int:
    """Run the stand test; exit code 1 when anything failed or was left out, 2 without consent."""
    plan = _plan(arguments)
    with _interruptible(), tempfile.TemporaryDirectory(prefix="failstop-prove-") as folder:
        if arguments.sim:
            link = os.path.join(folder, "board")
            with SimBoard(link) as board:
                evidence = prove(arguments, plan, link, config.read(arguments.config), folder, board)
        else:
            path, settings = settings_of(arguments.name, arguments.config, System())
            device = arguments.device or settings.text("device.path")
            _check_free(arguments.name, device)
            _ask_consent(device, plan)
            evidence = prove(arguments, plan, device, config.read(path), folder, None)
    _show(arguments, evidence)
    return 0 if evidence.passed else 130 if evidence.ended == "interrupted" else 1


def prove(
    arguments: Namespace,
    plan: list[tuple[Path, Velocity]],
    device: str,
    user: dict[str, object],
    folder: str,
    board: SimBoard | None,
) -> Evidence:
    """Characterize the robot and run the plan, printing rows as they come. Ends at the first wheel that turns on."""
    say = (lambda _: None) if arguments.json else _print
    evidence = Evidence(device, board is not None, False)
    ask: Ask | None = _print if arguments.pad else None
    stand = Stand(device, user, folder, board)
    try:
        with stand:
            with Robot(stand.name) as robot:
                evidence.realtime = all(process.realtime for process in robot.state.processes.values())
            say("\n".join(report.head_lines(evidence)) + "\n")
            evidence.character = _characterize(stand, plan, quick=arguments.quick)
            say("\n".join([*report.character_lines(evidence.character), "", report.HEAD]))
            for path, velocity in plan:
                result = Run(stand, evidence.character, path, velocity, ask).take()
                evidence.results.append(result)
                say(report.row(result, style.paint))
                if result.runaway:
                    evidence.ended = RUNAWAY
                    _alarm(RUNAWAY)
                    break
    except KeyboardInterrupt:
        evidence.ended = "interrupted"
    except (TrialError, SimBoardError, FailstopError) as error:
        evidence.ended = str(error)
    if stand.unsafe and not board:
        evidence.ended = f"{evidence.ended}; {stand.unsafe}: use the POWER SWITCH".lstrip("; ")
    return evidence


def _characterize(stand: Stand, plan: list[tuple[Path, Velocity]], *, quick: bool) -> Character:
    velocities = list(dict.fromkeys(velocity for _, velocity in plan))
    try:
        return characterize(stand, velocities, quick=quick)
    except Unfit as error:
        _alarm(str(error))
        raise


def _plan(arguments: Namespace) -> list[tuple[Path, Velocity]]:
    chosen = []
    for given, known, what in (
        (arguments.only, BY_PATH, "stop path"),
        (arguments.at, BY_VELOCITY, "velocity"),
    ):
        names = tuple(given.split(",")) if given else ()
        for name in names:
            if name not in known:
                raise FailstopError(f"no {what} {name!r}: there is {', '.join(known)}")
        chosen.append(names)
    return table.plan(quick=arguments.quick, only=chosen[0], at=chosen[1])


def _check_free(name: str, device: str) -> None:
    """Nobody else drives this board. Raises Refused with the command that ends whoever does."""
    node = port_facts.node(device, System())
    with contextlib.suppress(NoService):
        served = Robot(name).state.device["path"]
        # A simulated board is nobody else's. On a robot the service may be between two openings of this very port.
        if not (node and node.pseudo and served and os.path.realpath(served) != node.resolved):
            end = f"sudo systemctl stop {unit_of(name)}"
            raise Refused(f"the service {name!r} runs, and this test kills what it runs: {end}")
    if node is None:
        return  # the run says it, with the devices that are there
    holders, _ = port_facts.holders(node.resolved, set(), System())
    for holder in holders:
        end = f"sudo systemctl stop {holder.unit}" if holder.unit else f"kill {holder.pid}"
        raise Refused(f"{holder.name} (pid {holder.pid}) has {device} open: {end}")


def _ask_consent(device: str, plan: list[tuple[Path, Velocity]]) -> None:
    fastest = " and ".join(dict.fromkeys(velocity.words for _, velocity in plan))
    print(f"{device}:", file=sys.stderr)
    minutes = max(1.0, len(plan) * RUN_S / 60)
    sys.stderr.write(SAFETY.format(fastest=fastest, count=len(plan), minutes=minutes, word=WORD))
    sys.stderr.flush()
    if sys.stdin.readline().strip() != WORD:
        raise Refused("no consent: nothing was moved")


@contextlib.contextmanager
def _interruptible() -> Iterator[None]:
    """A lost terminal and a kill end it as Ctrl-C does: by way of wheels at rest."""

    def interrupt(_number: int, _frame: FrameType | None) -> None:
        raise KeyboardInterrupt

    before = {number: signal.signal(number, interrupt) for number in SIGNALS}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)


def _alarm(text: str) -> None:
    """At once, before anything is wound up."""
    print(style.paint(f"\a{text}", style.FAIL), file=sys.stderr, flush=True)


def _print(text: str) -> None:
    print(text, flush=True)


def _show(arguments: Namespace, evidence: Evidence) -> None:
    if arguments.json:
        print(json.dumps(evidence.as_dict()))
    else:
        verdict = style.paint(evidence.verdict, report.ROLES[evidence.verdict])
        lines = [verdict if line == evidence.verdict else line for line in report.last_lines(evidence)]
        print("\n" + "\n".join(lines))
    if evidence.simulated and not arguments.out:
        return
    folder = arguments.out or os.path.join(state_directory(arguments.name, os.environ), PROVE_FOLDER)
    for path in report.save(evidence, folder):
        print(f"evidence: {path}", file=sys.stderr)
