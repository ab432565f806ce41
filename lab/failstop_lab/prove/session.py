"""A session on the stand, with the board to itself: it measures the robot's character, makes every run, and ends with
the wheels at rest."""

from __future__ import annotations

import contextlib
import os
import random
import sys
from collections.abc import Callable, Iterable, Iterator, Sequence
from functools import partial

from failstop.api.errors import FailstopError, NoService, Refused
from failstop.api.robot import Robot
from failstop.cli import style
from failstop.doctor.system import System
from failstop.instances import unit_of
from failstop.supervisor.status import LEASE
from failstop_lab.prove import report
from failstop_lab.prove.arm_run import ArmRun
from failstop_lab.prove.character import Restless, Unfit, WrongScale, characterize
from failstop_lab.prove.frozen import FrozenRun
from failstop_lab.prove.held import repeat
from failstop_lab.prove.others import StoppedByOthers
from failstop_lab.prove.report import Evidence
from failstop_lab.prove.run import PathRun, Result
from failstop_lab.prove.sight import Sight
from failstop_lab.prove.stand import ProveStand
from failstop_lab.prove.strike import Ask
from failstop_lab.prove.table import FROZEN, Path, Turning
from failstop_lab.sim.client import SimBoardError
from failstop_lab.trial import TrialError

TAKES = 3
"""How often a row is run at most, if the machine spoils it."""
COMES_TO_REST_S = 1.5
"""Time to come to rest before the robot is characterized again."""
NOT_SEEN_AT_REST = "the wheels were not seen to come to rest: if they turn, use the POWER SWITCH"

Runs = Iterable[tuple[Path, Turning, random.Random]]
"""The plan, with the random numbers for each run."""


def session(
    runs: Runs,
    velocities: Sequence[Turning],
    stand: ProveStand,
    *,
    quick: bool = False,
    say: Callable[[str], None],
    ask: Ask | None = None,
    watcher: Ask | None = None,
    tool: str = "prove",
    keep_all: bool = True,
    width: int = report.NAME,
) -> Evidence:
    """Characterize the robot at `velocities`, if there are any, and make the runs, reporting rows as they come. It ends
    at the first wheel that does not stop. `stand` is entered here; `ask`: tells a person to press a button; `watcher`:
    asks the person who watches the wheels; `tool`: which command this is; `keep_all`: keep the samples of passed runs
    too; `width`: of the paths' names."""

    def show(result: Result) -> None:
        say(report.row(result, style.paint, width))

    begun = stand.held.mark()
    evidence = Evidence(stand.device, stand.board is not None, False, tool=tool, means=stand.means, user=stand.user)
    try:
        with stand:
            with Robot(stand.name) as robot:
                evidence.realtime = all(process.realtime for process in robot.state.processes.values())
                evidence.lease_s = robot.state.lease_s
            say("\n".join(report.head_lines(evidence)) + "\n")
            if velocities:
                evidence.character = _characterize(stand, velocities, quick=quick, say=say)
            say("\n".join([*report.character_lines(evidence), "", report.head(width)]))
            for result in _results(stand, evidence, runs, ask, watcher, show):
                if result.verdict == "PASS" and not keep_all:
                    result.samples = []
                evidence.results.append(result)
                show(result)
    except KeyboardInterrupt:
        evidence.ended = report.INTERRUPTED
    except (TrialError, SimBoardError, FailstopError, OSError) as error:
        starved = stand.held.starved(begun)
        evidence.spoiled = bool(starved) and not isinstance(error, (Restless, WrongScale))
        evidence.ended = f"{repeat(starved)}; {error}" if evidence.spoiled else str(error)
    if not stand.board:
        evidence.outcome = stand.outcome
    return evidence


def _results(
    stand: ProveStand,
    evidence: Evidence,
    runs: Runs,
    ask: Ask | None,
    watcher: Ask | None,
    spoiled: Callable[[Result], None],
) -> Iterator[Result]:
    """The result of each run, up to the first one that ends the session. `spoiled`: reports a spoiled result."""
    # The lease comes from the settings or from the service's rights, so every bar is for the lease in use.
    lease_s = evidence.lease_s if evidence.lease_s != stand.settings[LEASE] else 0.0
    for path, velocity, chance in runs:
        asks = watcher if path.kind == FROZEN else ask
        wanted = path.under(stand.settings).leased(lease_s)
        take = partial(_perform, stand, evidence.character, wanted, velocity, asks, chance)
        result = until_valid(take, spoiled)
        yield result
        if result.runaway:
            evidence.ended = NOT_SEEN_AT_REST
            _alarm(NOT_SEEN_AT_REST)
            return
        if result.over:
            evidence.ended = result.over
            return


def until_valid(take: Callable[[], Result], spoiled: Callable[[Result], None]) -> Result:
    """The result of a row, which is run again if the machine spoils it. `spoiled`: reports a spoiled result."""
    again: list[str] = []
    while (result := take()).verdict == "INVALID" and not result.over and len(again) + 1 < TAKES:
        spoiled(result)
        again.append(result.starved)
    result.again = again
    return result


def _perform(
    stand: ProveStand, sight: Sight | None, path: Path, velocity: Turning, ask: Ask | None, chance: random.Random
) -> Result:
    if path.arm:
        result = ArmRun(stand, path, velocity, sight).perform()
    else:
        assert sight
        run = FrozenRun if path.kind == FROZEN else PathRun
        result = run(stand, sight, path, velocity, ask, chance).perform()
    try:
        stand.others.check()
    except StoppedByOthers as error:
        result.over = str(error)
    return result


def _characterize(
    stand: ProveStand, velocities: Sequence[Turning], *, quick: bool, say: Callable[[str], None]
) -> Sight:
    """The robot's character, measured again if the machine spoils it."""
    for left in reversed(range(TAKES)):
        begun = stand.held.mark()
        try:
            return characterize(stand, velocities, quick=quick)
        except Restless as error:
            _alarm(str(error))
            raise
        except Unfit as error:
            if not (left and (starved := stand.held.starved(begun))):
                raise
            say(f"{error}; {repeat(starved)}: it is measured again")
            stand.driver.robot.disable()
            stand.run(COMES_TO_REST_S)
    raise AssertionError("unreachable")


def check_free(device: str, *names: str, system: System | None = None) -> None:
    """Check that no other program drives this board, above all no service with one of these names. Raises Refused with
    the command that ends it."""
    system = system or System()
    node = system.node(device)
    for name in names:
        with contextlib.suppress(NoService):
            served = Robot(name).state.device.path
            # Nobody else uses a simulated board. On a robot, the service may be between two openings of this port.
            if not (node and node.pseudo and served and os.path.realpath(served) != node.resolved):
                running = system.service(name)
                end = running.end() if running else f"sudo systemctl stop {unit_of(name)}"
                raise Refused(
                    f"the service {name!r} is running, and this test kills a service's processes; end it first: {end}"
                )
    if node is None:
        return  # the run reports it, with the devices that exist
    holders, _ = system.holders(node.resolved)
    for holder in holders:
        raise Refused(f"{holder} has {device} open; end it first: {holder.end()}")


def _alarm(text: str) -> None:
    """Warn at once, before anything is shut down."""
    print(style.paint(f"\a{text}", style.FAIL), file=sys.stderr, flush=True)
