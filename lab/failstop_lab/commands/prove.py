"""`failstop prove`: the stand test. Every stop path is timed on the robot, and kept as evidence."""

from __future__ import annotations

import dataclasses
import hashlib
import json
import os
import random
import sys
import tempfile
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator, Sequence
from typing import Any

from failstop import config
from failstop.api.errors import FailstopError, Refused
from failstop.board.kinds import board_of
from failstop.cli import style
from failstop.cli.commands import add_name
from failstop.files.root import state_directory
from failstop.setup.ending import interruptible
from failstop_lab.boards.traits import traits_of
from failstop_lab.prove import pack, report, saving, table
from failstop_lab.prove.means import means_of
from failstop_lab.prove.report import Evidence
from failstop_lab.prove.saving import Save
from failstop_lab.prove.session import check_free, session
from failstop_lab.prove.stand import ProveStand, driven, settings_for
from failstop_lab.prove.swing import REACH_RAD
from failstop_lab.prove.table import BY_ARM_PATH, BY_PATH, BY_TURNING, SWINGING, Path, Turning
from failstop_lab.sim.client import SimBoard
from failstop_lab.sim.options import IMU_HZ, add_board

EXAMPLES = """\
failstop prove --sim --quick            # on a simulated board, half a minute
failstop prove --sim --board hoverboard # on another kind of board
sudo systemctl stop failstop && sudo failstop prove
failstop prove --sim --quick --pack evidence.html
failstop prove --check evidence.html    # is it unchanged, and who signed it?
failstop prove --only timeout,stop-request --at 0.2 --out /tmp/evidence
"""

Plan = list[tuple[Path, Turning]]

WORD = "spin"
PROVE_FOLDER = "prove"
RUN_S = 3.5
KNOWN = (*BY_PATH, *BY_ARM_PATH)
SPEEDS = ", ".join(f"{turning.name} ({turning.words})" for turning in BY_TURNING.values())
ARM_WARNING = """\
  5. THE ARM MOVES: to its drive pose, and its base joint swings by {reach:g} rad. \
Nobody and nothing is in its reach.

"""
INTERLOCKS_WARNING = """\
THE TEST ITSELF ASSERTS YOUR INTERLOCKS: {names}. Make sure that they hold, because nothing else checks them.

"""
SAFETY = """\
THIS TURNS THE WHEELS, at {fastest}, \
and kills the programs that stop them: {count} runs, about {minutes:.0f} min.
The board is at {device}.

  1. The robot is on a stand: every wheel is OFF THE GROUND and free to turn.
  2. No person, hair, clothing, cable or tool is near the wheels, and nobody will come near.
  3. The POWER SWITCH is at hand, and you will use it if the wheels keep turning.
  4. You know that failstop is a protective stop by software, not an emergency \
stop in the sense of ISO 13850.

{arm}{interlocks}Ctrl-C stops everything at any time.
Type "{word}" to begin, or anything else to quit:"""


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop prove`."""
    add = parser.add_argument
    add("--sim", action="store_true", help="use a simulated board, and ask nothing")
    add_board(parser, None, "with --sim: the kind of board: {} (default: the setting board.kind)")
    add("--quick", action="store_true", help="test only the main stop paths, each at one speed")
    add("--only", metavar="PATH,...", help=f"test only these stop paths: {', '.join(KNOWN)}")
    add("--at", metavar="V,...", help=f"test only at these speeds, or at your limits if they are lower: {SPEEDS}")
    add("--pad", action="store_true", help="also test the gamepad: you are asked to press one of its buttons")
    add("--device", metavar="PATH", help="the board's port (default: the setting device.path)")
    add("--config", metavar="FILE", help="the service's settings (default: the installed file, if there is one)")
    add(
        "--out",
        metavar="DIR",
        help="where to keep the evidence (default: prove/ in the state directory; with --sim: nowhere)",
    )
    add("--pack", metavar="FILE", help="write the evidence as one page (FILE.html) that opens without a network")
    add("--key", metavar="FILE", help="with --pack: sign that page with this OpenSSH key")
    add("--check", metavar="FILE", help="test nothing; check whether this --pack page is unchanged, and who signed it")
    add("--json", action="store_true", help="print the result as JSON")
    add_name(parser)


def main(arguments: Namespace) -> int:
    """Run the stand test; exit code 1 when anything failed or the evidence could not be saved, 2 without consent."""
    if arguments.check:
        print(pack.verified(arguments.check))
        return 0
    if arguments.pack and not arguments.pack.endswith(".html"):
        raise FailstopError(f"--pack {arguments.pack}: the name must end in .html")
    if arguments.key and not arguments.pack:
        raise FailstopError("--key goes with --pack")
    only, at = _words(arguments)
    _check_places(arguments)
    if arguments.board and not arguments.sim:
        raise FailstopError("--board goes with --sim; the kind of a real board is the setting board.kind")
    say = (lambda _: None) if arguments.json else report.print_now

    def run_session(device: str, user: dict[str, object], plans: Plans, board: SimBoard | None = None) -> Evidence:
        plan = plans.chosen
        velocities = list(dict.fromkeys(velocity for _, velocity in plan if velocity != SWINGING))
        runs = ((path, velocity, random.Random()) for path, velocity in plan)
        ask, watcher = (report.print_now if asks else None for asks in (arguments.pad, not arguments.json))
        stand = ProveStand(device, user, folder, board)
        found = session(runs, velocities, stand, quick=arguments.quick, say=say, ask=ask, watcher=watcher)
        return dataclasses.replace(found, whole=plans.whole)

    with interruptible(), tempfile.TemporaryDirectory(prefix="failstop-prove-", ignore_cleanup_errors=True) as folder:
        if arguments.sim:
            link = os.path.join(folder, "board")
            user = config.read(arguments.config)
            if arguments.board:
                user = {**traits_of(arguments.board).settings, **user, "board.kind": arguments.board}
            plans = _plans(arguments, user, only, at)
            imu_hz = 0.0 if user.get("board.imu") == "off" else IMU_HZ
            with SimBoard(link, imu_hz=imu_hz, board=str(user.get("board.kind", ""))) as board:
                evidence = run_session(link, user, plans, board)
        else:
            path = config.chosen(arguments.name, arguments.config)
            device = arguments.device or config.load(path).text("device.path")
            check_free(device, arguments.name)
            user = config.read(path)
            plans = _plans(arguments, user, only, at)
            _ask_consent(device, plans, tuple(driven(user).interlocks()))
            evidence = run_session(device, user, plans)
    # Before the result is printed, because standard output may be full or closed.
    paths, failed = saving.save_each(_saves(arguments, evidence))
    try:
        _show(arguments, evidence)
    finally:
        for line in (*(f"evidence: {path}" for path in paths), *(style.paint(why, style.FAIL) for why in failed)):
            print(line, file=sys.stderr)
    return evidence.exit_code or int(bool(failed))


@dataclasses.dataclass(frozen=True)
class Plans:
    """The runs that this robot can have, in order."""

    chosen: Plan
    whole: Plan
    """All of them, also those that the options leave out."""
    has_arm: bool
    """Its arm moves."""


def _plans(arguments: Namespace, user: dict[str, object], only: tuple[str, ...], at: tuple[str, ...]) -> Plans:
    """Raises FailstopError where there are no runs, SettingError."""
    settings = driven(settings_for(user))
    has_arm, board = bool(settings.servos()), board_of(*settings.board())
    means = means_of(settings.text("board.kind"), board, imu=settings.on("board.imu"))
    beside = bool(board.arm and board.arm.beside_wheels)
    plan = table.plan(quick=arguments.quick, only=only, at=at, has_arm=has_arm, beside=beside, settings=settings)
    everything = table.plan(quick=False, has_arm=has_arm, beside=beside, settings=settings)
    fitted, whole = (
        [(means.fitted(path), velocity) for path, velocity in runs if not means.lacks(path)]
        for runs in (plan, everything)
    )
    if not fitted:
        why = {means.lacks(path) for path, _ in plan} or {"it needs an arm, and the settings have no joints"}
        raise FailstopError(f"nothing to test of {', '.join(only)}: {'; '.join(sorted(why))}")
    return Plans(fitted, whole, has_arm)


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
                raise FailstopError(f"no {what} {name!r}: choose from {', '.join(known)}")
        chosen.append(names)
    return chosen[0], chosen[1]


def _ask_consent(device: str, plans: Plans, interlocks: Sequence[str]) -> None:
    plan = plans.chosen
    fastest = " and ".join(dict.fromkeys(velocity.words for _, velocity in plan))
    arm = ARM_WARNING.format(reach=REACH_RAD) if plans.has_arm else ""
    minutes = max(1.0, len(plan) * RUN_S / 60)
    asserts = INTERLOCKS_WARNING.format(names=", ".join(interlocks)) if interlocks else ""
    words = {"device": device, "word": WORD, "arm": arm, "interlocks": asserts}
    text = SAFETY.format(fastest=fastest, count=len(plan), minutes=minutes, **words)
    style.warn(text, end=" ")
    if sys.stdin.readline().strip() != WORD:
        raise Refused("no consent: nothing was moved")


def _show(arguments: Namespace, evidence: Evidence) -> None:
    if arguments.json:
        print(json.dumps(evidence.as_dict()))
    else:
        verdict = style.paint(evidence.verdict, report.VERDICT_STYLES[evidence.verdict])
        lines = [verdict if line == evidence.verdict else line for line in report.last_lines(evidence)]
        report.print_now("\n" + "\n".join(lines))


def _folder(arguments: Namespace) -> str:
    """Below it every test has a folder of its own. Empty: the files of a simulated run are not kept."""
    if arguments.sim or arguments.out:
        return arguments.out or ""
    return os.path.join(state_directory(arguments.name, os.environ), PROVE_FOLDER)


def _check_places(arguments: Namespace) -> None:
    """Before anything moves: the evidence can be saved when the test ends. Raises FailstopError."""
    if (folder := _folder(arguments)) and (why := saving.unwritable(folder)):
        raise FailstopError(f"the evidence can't be saved in {folder}: {why}; choose another folder with --out")
    if arguments.pack:
        pack.check_place(arguments.pack, arguments.key)


def _saves(arguments: Namespace, evidence: Evidence) -> Iterator[Save]:
    """The dated folder first, because it has the samples too, and its files need no key."""
    if folder := _folder(arguments):
        yield folder, lambda: report.save(evidence, folder)
    if arguments.pack:
        yield arguments.pack, lambda: pack.save(record_of(evidence), arguments.pack, arguments.key)


def record_of(evidence: Evidence) -> dict[str, Any]:
    """All that a pack holds; `samples` stay in the dated folder."""
    assert evidence.user is not None  # that of a stand
    settings, told = evidence.user.flat(), evidence.as_dict()
    return {
        **told,
        "rows": [{**row, "samples": []} for row in told["rows"]],
        "board": settings["board.kind"],
        "settings": settings,
        "settings_sha256": hashlib.sha256(evidence.user.lines().encode()).hexdigest(),
        "code_sha256": pack.code_digest(),
        "can_not": report.CAN_NOT,
    }
