"""`failstop chaos`: random faults from the table while driving random velocities, judged by the simulated board (on a
stand, by the real board's answers and its IMU: on_stand.py)."""

from __future__ import annotations

import json
import os
import sys
import time
from argparse import ArgumentParser, Namespace
from collections.abc import Iterator
from typing import Any

from failstop.api.errors import FailstopError
from failstop.cli import style
from failstop.policy.layouts import BOARDS
from failstop.setup.ending import noted
from failstop_lab.boards.traits import traits_of
from failstop_lab.commands import check_json, matching, write_json
from failstop_lab.faults import injection, report
from failstop_lab.faults.injection import Row
from failstop_lab.faults.scene import Scene
from failstop_lab.sim.client import SimBoardError
from failstop_lab.sim.options import add_board
from failstop_lab.trial import TrialError

EXAMPLES = """\
failstop chaos                          # a minute of random faults
failstop chaos --list
failstop chaos --each 5 --only 'kill-*'
failstop chaos --count 100 --seed 7 --json chaos.json
failstop chaos --count 100 --resume chaos.json  # the next 100 faults of it
failstop chaos --board hoverboard       # on another board
failstop chaos --device /dev/ttyACM0 --on-the-stand --wheels-are-free
"""

CAMPAIGN_S = 60.0
STORIES = 5
SEEDS = 1_000_000


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop chaos`."""
    add = parser.add_argument
    length = parser.add_mutually_exclusive_group()
    length.add_argument("--seconds", type=float, metavar="S", help=f"for how many seconds (default: {CAMPAIGN_S:g})")
    length.add_argument(
        "--count", type=int, metavar="N", help="inject this many faults, instead of running for --seconds"
    )
    length.add_argument(
        "--each", type=int, metavar="N", help="inject every fault this many times, in order, instead of at random"
    )
    add("--seed", type=int, metavar="K", help="seed of the random choices; every campaign prints its seed")
    add(
        "--first",
        type=int,
        default=0,
        metavar="I",
        help="the number of the fault to begin with; if the service fails at a fault, that fault's number is printed",
    )
    add(
        "--resume",
        metavar="FILE",
        help="go on with the campaign in this file, which --json wrote, and write the whole result to it",
    )
    add("--only", metavar="NAME,...", help="inject only these faults; * matches anything; --list prints the names")
    add_board(parser)
    add("--config", metavar="FILE", help="TOML file with settings; chaos overrides those that it needs itself")
    add("--list", action="store_true", help="list the faults")
    add("--json", metavar="FILE", help="write the result to this file")
    add("--markdown", action="store_true", help="print the result as the page docs/reference/faults.md")
    add(
        "--from",
        dest="source",
        metavar="FILE",
        help="with --markdown: run nothing, but read the result from this file, which --json wrote, and print it",
    )
    add(
        "--device",
        metavar="PATH",
        help="test the real board at this port, on a stand; its answers and its IMU show whether it stopped; needs "
        "--on-the-stand and --wheels-are-free",
    )
    add(
        "--on-the-stand",
        action="store_true",
        help="your consent: the robot is on a stand, with its wheels off the ground",
    )
    add("--wheels-are-free", action="store_true", help="your consent: nobody and nothing is near the wheels")


def main(arguments: Namespace) -> int:
    """Run the campaign; exit code 1 when anything was not as the table says."""
    _check(arguments)
    if arguments.device is not None:
        from failstop_lab.commands import on_stand

        if arguments.list:
            on_stand.list_paths(arguments.only)
            return 0
        return on_stand.run(arguments, _seed(arguments), CAMPAIGN_S)
    rows = _rows(arguments.only, arguments.board)
    if arguments.list:
        for fault in rows:
            print(f"{fault.name:<50} {fault.cause}")
        return 0
    if arguments.source:
        if not arguments.markdown:
            raise FailstopError("--from goes with --markdown")
        print(report.markdown(_read(arguments.source)), end="")
        return 0
    out = arguments.json or arguments.resume
    before = _read(arguments.resume) if arguments.resume else None
    check_json(out)
    tally = _run(arguments, rows, before)
    result = tally.as_dict()
    if out:
        write_json(out, result)
    print(report.markdown(result) if arguments.markdown else f"{tally.table()}\n\n{tally.summary()}", flush=True)
    print(f"{'interrupted; ' if tally.interrupted else ''}to repeat it: --seed {tally.seed}", file=sys.stderr)
    for story in tally.stories[:STORIES]:
        print(f"\n{story}", file=sys.stderr)
    if len(tally.stories) > STORIES:
        print(f"\nand {len(tally.stories) - STORIES} more; --json has them all", file=sys.stderr)
    return 130 if tally.interrupted else 1 if tally.stories else 0


def _check(arguments: Namespace) -> None:
    """Before anything moves. Raises FailstopError."""
    for word in ("seconds", "count", "each"):
        value = getattr(arguments, word)
        if value is not None and value <= 0:
            raise FailstopError(f"--{word} {value:g}: it must be more than 0")
    if arguments.device is not None and arguments.board != BOARDS[0]:
        raise FailstopError(
            "--board goes with a simulated board; the kind of a real one (--device) is the setting board.kind"
        )
    if arguments.resume is not None and (arguments.seed is not None or arguments.first or arguments.each is not None):
        raise FailstopError(
            "--resume goes with --count and --seconds; the seed and the first fault are those of the campaign"
        )
    if arguments.each is not None and arguments.first:
        raise FailstopError("--first goes with --count and --seconds; --each injects every row from its beginning")


def _rows(only: str | None, board: str) -> tuple[Row, ...]:
    known = report.rows_of(traits_of(board))
    return tuple(matching(only, known, "no row {} in the fault table of this board; `failstop chaos --list` has them"))


def _read(path: str) -> dict[str, Any]:
    try:
        with open(path, encoding="utf-8") as file:
            found: dict[str, Any] = json.load(file)
    except (OSError, ValueError) as error:
        raise FailstopError(f"{path} is not the result of a campaign: {error}; make one with --json {path}") from None
    return found


def _seed(arguments: Namespace) -> int:
    return arguments.seed if arguments.seed is not None else time.time_ns() % SEEDS


def _run(arguments: Namespace, rows: tuple[Row, ...], before: dict[str, Any] | None) -> report.Tally:
    seed = before.get("seed", 0) if before else _seed(arguments)
    tally = report.Tally(rows, seed, arguments.board)
    if before:
        try:
            tally.resume(before)
        except (KeyError, TypeError, ValueError) as error:
            raise FailstopError(
                f"--resume {arguments.resume}: it can't be continued: {error}; --json {arguments.resume} begins again"
            ) from None
    first = tally.next if before else arguments.first
    live = style.lives(os.environ, terminal=sys.stderr.isatty())
    with noted() as interrupted:
        # Here, because anyone who has read this line may press Ctrl-C.
        print(f"seed {seed}, {len(rows)} rows", file=sys.stderr, flush=True)
        _inject(arguments, rows, tally, interrupted, first, live=live)
    if live:
        sys.stderr.write("\r\x1b[K")
    return tally


def _inject(
    arguments: Namespace, rows: tuple[Row, ...], tally: report.Tally, interrupted: list[int], first: int, *, live: bool
) -> None:
    """Inject one fault after the other, until a signal of `interrupted` has come."""
    if interrupted:
        tally.interrupted = True
        return
    try:
        with Scene(f"chaos-{os.getpid()}", arguments.config, arguments.board) as scene:
            tally.realtime = scene.realtime()
            for outcome in _outcomes(arguments, scene, rows, tally, first):
                if interrupted:
                    # The terminal's signal went to the board and the service too: this one proves nothing.
                    tally.interrupted = True
                    break
                tally.add(outcome)
                if live:
                    sys.stderr.write(f"\r\x1b[K{tally.summary()}; {outcome.fault.name}"[:200])
                    sys.stderr.flush()
    except (TrialError, SimBoardError, OSError) as error:
        if interrupted:
            tally.interrupted = True
        else:
            tally.end(str(error))


def _outcomes(
    arguments: Namespace, scene: Scene, rows: tuple[Row, ...], tally: report.Tally, first: int
) -> Iterator[injection.Outcome]:
    if arguments.each is not None:
        return (
            injection.inject_one(scene, fault, index, tally.seed) for fault in rows for index in range(arguments.each)
        )
    if arguments.count is not None:
        return injection.campaign(scene, rows, tally.seed, lambda injected: injected >= arguments.count, first)
    until_s = tally.begun_s + (arguments.seconds or CAMPAIGN_S)

    def over(injected: int) -> bool:
        """A busy machine may need all the time to start the service: one fault is injected in any case."""
        return injected > 0 and time.monotonic() >= until_s

    return injection.campaign(scene, rows, tally.seed, over, first)
