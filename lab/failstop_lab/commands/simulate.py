"""`failstop simulate`: every single fault at every call of a few scenarios, on a simulated machine."""

from __future__ import annotations

import json
import os
import time
from argparse import ArgumentParser, ArgumentTypeError, Namespace
from fnmatch import fnmatch
from itertools import chain

from failstop.api.errors import FailstopError
from failstop.policy.layouts import BOARDS
from failstop_lab.commands import matching
from failstop_lab.sim.options import add_board

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop_lab.simulate.single_faults import Result

EXAMPLES = """\
failstop simulate                 # every fault, once for each line of code
failstop simulate --part 3/16     # one sixteenth of that
failstop simulate --own           # only faults of the process that calls
failstop simulate --whole         # every fault at every call
failstop simulate --board ugv     # on another board
failstop simulate --scenario replug --call 1041 --fault dies
failstop simulate --seeds 60      # random faults and orders, for a minute
failstop simulate --seed 537      # repeat one random run
failstop simulate --decisions FILE  # repeat a failure from its printout
failstop simulate --controls      # without a part, do the runs fail?
"""
EVERY = "*"
SEEDS_A_DAY = 1_000_000
STORIES = 3


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop simulate`."""
    add = parser.add_argument
    add("--scenario", metavar="NAME,...", help="run only these scenarios; * matches anything; --list prints the names")
    add_board(parser)
    add(
        "--whole",
        action="store_true",
        help="inject at every call to the system (default: at one call for each line of code)",
    )
    add("--own", action="store_true", help="inject only faults of the process that makes the call")
    add(
        "--jobs",
        type=int,
        default=os.cpu_count() or 1,
        metavar="N",
        help="how many processes to use (default: one per core)",
    )
    add("--part", type=_part, default=(0, 1), metavar="K/N", help="run only the K-th of N parts")
    add(
        "--call",
        type=int,
        metavar="N",
        help="with --scenario and --fault: run once, with the fault at the call of this number",
    )
    add("--fault", metavar="NAME", help="with --call: the name of the fault")
    add(
        "--seeds", type=float, metavar="SECONDS", help="make random runs instead, for so many seconds on each processor"
    )
    add(
        "--seed",
        type=int,
        metavar="N",
        help="make only this random run, and print each event; with --seeds: begin with this run",
    )
    add(
        "--decisions",
        metavar="FILE",
        help="repeat a failed run from the decisions that it printed, given as a file or as text",
    )
    add("--day", action="store_true", help="with --seeds: begin with a run whose number comes from today's date")
    add(
        "--controls",
        nargs="?",
        const=EVERY,
        metavar="ROW",
        help=(
            "remove the parts of the stop protocol one by one, and check that the runs fail without each of them; with "
            "ROW: remove only this part, and print each event"
        ),
    )
    add("--page", metavar="FILE", help="with --controls: test every kind of board, and update this page of results")
    add("--list", action="store_true", help="list the scenarios")
    add(
        "--marks",
        action="store_true",
        help="print how often the runs reached each cause of a stop, each decision about a motion frame, and each "
        "change of a process's state",
    )


def main(arguments: Namespace) -> int:
    """Run the campaign; exit code 1 when anything was wrong, or a mark was not reached by all scenarios together."""
    try:
        from failstop_lab.boards.traits import traits_of
        from failstop_lab.simulate import coverage, single_faults
        from failstop_lab.simulate.for_seeds import for_seeds_of, play_of
        from failstop_lab.simulate.scenarios import scenarios_of
    except ModuleNotFoundError as error:
        raise FailstopError(f"this needs the Python package {error.name}; next: `pip install {error.name}`") from None

    board, traits = arguments.board, traits_of(arguments.board)
    known = scenarios_of(traits)
    there = known if not (arguments.scenario or arguments.list) else [*known, *for_seeds_of(traits)]
    names = matching(
        arguments.scenario, {name: name for name in there}, "no scenario {}; `failstop simulate --list` has them"
    )
    if arguments.list:
        for name in names:
            print(f"{name:<24} {play_of(name).__doc__ or ''}")
        return 0
    if arguments.call is not None:
        if len(names) != 1 or not arguments.fault:
            raise FailstopError("--call needs one --scenario and a --fault")
        run = single_faults.one(single_faults.Plan(names[0], only=(arguments.call, arguments.fault), board=board))
        if not run.fault:
            raise FailstopError(
                f"no fault {arguments.fault!r} can happen at call {arguments.call} of {names[0]}; "
                "copy both from the last line of a failed run"
            )
        print(run.text())
        return int(bool(run.violations))
    if arguments.controls:
        return _controls(board, arguments.jobs, arguments.controls, arguments.page)
    chosen = names if arguments.scenario else None
    if arguments.decisions is not None:
        return _decided(arguments.decisions, chosen, board)
    if arguments.seeds is not None:
        today = int(time.strftime("%Y%m%d")) * SEEDS_A_DAY if arguments.day else 0
        return _seeds(arguments.seed or today, arguments.seeds, arguments.jobs, chosen, board)
    if arguments.seed is not None:
        return _seed(arguments.seed, chosen, board)
    whole = len(names) == len(known) and arguments.part[1] == 1
    total, begun_s = single_faults.Result(), time.monotonic()
    todo = single_faults.plans(names, 0 if arguments.whole else 1, board, own=arguments.own)
    todo = todo[arguments.part[0] :: arguments.part[1]]
    for done, (plan, result) in enumerate(single_faults.results(todo, arguments.jobs), 1):
        total.merge(result)
        took_s = time.monotonic() - begun_s
        told = f"{plan.scenario} {plan.share[0] + 1}/{plan.share[1]}"
        counts = f"{total.runs:>6} runs  {len(total.wrong):>3} wrong"
        print(f"{done:>3}/{len(todo)}  {counts}  {took_s:6.1f} s  {told}", flush=True)
    return _report(
        total,
        time.monotonic() - begun_s,
        coverage.unreached(total.marks, traits) if whole else [],
        told_marks=arguments.marks,
    )


def _part(text: str) -> tuple[int, int]:
    number, _, parts = text.partition("/")
    if not (number.isdecimal() and parts.isdecimal() and 1 <= int(number) <= int(parts)):
        raise ArgumentTypeError(f"{text} is not a part: write 3/16 for the third of sixteen")
    return int(number) - 1, int(parts)


def _controls(board: str, jobs: int, wanted: str, file: str) -> int:
    from failstop_lab.simulate import control_runs, controls, tested_controls

    def asked(row: str) -> bool:
        return fnmatch(row, wanted)

    tested = [each.row for each in tested_controls.TESTED]
    known = [*(each.row for each in control_runs.BOTH), *tested, *controls.NOT_EXPRESSED]
    if not any(map(asked, known)):
        raise FailstopError(f"no control {wanted}; choose from: {'; '.join(known)}")
    boards = BOARDS if file else (board,)
    print(control_runs.TABLE_HEAD, flush=True)
    every: list[control_runs.Found | tested_controls.Noticed] = []
    runs: chain[control_runs.Found | tested_controls.Noticed] = chain(
        control_runs.searched(control_runs.SEARCH_S, jobs, lambda each: asked(each.row) and each.board in boards),
        tested_controls.searched(lambda each: asked(each.row) and BOARDS[0] in boards),
    )
    for found in runs:
        every.append(found)
        print(found.text(), flush=True)
        if wanted != EVERY:
            print(found.story)
    for row, why in controls.NOT_EXPRESSED.items():
        if asked(row):
            print(f"not in the code: {row}: {why}")
    if file:
        before = ""
        if os.path.exists(file):
            with open(file, encoding="utf-8") as page:
                before = page.read()
        with open(file, "w", encoding="utf-8") as page:
            page.write(control_runs.page(every, before))
    print(f"{sum(bool(found.wrong) for found in every)} of {len(every)} controls found")
    return int(not all(found.wrong for found in every))


def _seeds(first: int, seconds: float, jobs: int, names: list[str] | None, board: str) -> int:
    from failstop_lab.simulate import seeds

    total = seeds.Seeds()
    for part in seeds.many(first, seconds, jobs, names, board):
        total.merge(part)
    for run in total.wrong[:STORIES]:
        print(f"{run.text()}\n")
    rate = total.events / max(total.took_s, 1e-9)
    kinds = ", ".join(f"{count} {group}" for group, count in total.groups.most_common())
    print(f"from seed {first}: {kinds}; {total.twice} runs were repeated and gave the same bytes")
    told = f"{total.runs} seeds, {total.rounds} rounds, {total.events} faults ({rate:.0f} a second of a core)"
    print(f"{told}: {len(total.wrong)} wrong: {[run.seed for run in total.wrong]}")
    return int(bool(total.wrong))


def _seed(number: int, names: list[str] | None, board: str) -> int:
    from failstop_lab.simulate.seeds import Nursery

    nursery = Nursery(names, board=board)
    run = nursery.run(number)
    print((nursery.shrunk(run) if run.violations else run).text())
    return int(bool(run.violations))


def _decided(told: str, names: list[str] | None, board: str) -> int:
    from failstop_lab.simulate.seeds import Nursery, commit

    if not told.lstrip().startswith("{"):
        try:
            with open(told, encoding="utf-8", errors="replace") as file:
                told = file.read()
        except OSError as error:
            raise FailstopError(
                f"{told} can't be read: {error.strerror}; give the decisions that were printed, or a file with them"
            ) from None
    try:
        decisions = json.loads(told)
        draws = {str(label): int(value) for label, value in decisions["draws"].items()}
    except (ValueError, TypeError, KeyError, AttributeError, RecursionError, OverflowError):
        raise FailstopError(
            "this is not a list of decisions: copy everything between the quotes that `failstop simulate` printed"
        ) from None
    run = Nursery(names, board=board).run(0, draws)
    print(run.text())
    if decisions.get("commit") != commit():
        print(f"the decisions are from commit {decisions.get('commit')}, but this is {commit()}, so they may not fit")
    return int(bool(run.violations))


def _report(total: Result, took_s: float, missing: list[str], *, told_marks: bool) -> int:
    kinds: dict[str, list[int]] = {}
    for index, run in enumerate(total.wrong):
        kinds.setdefault(f"{run.fault}: {run.violations[0]}", []).append(index)
    for text, indices in sorted(kinds.items(), key=lambda kind: -len(kind[1])):
        print(f"\n{len(indices)} times  {text}")
    for indices in list(kinds.values())[:STORIES]:
        print(f"\n{total.wrong[indices[0]].text()}")
    if told_marks:
        for name, count in sorted(total.marks.items()):
            print(f"{count:>9}  {name}")
    for name in missing:
        print(f"not reached: {name}")
    rate = total.runs / max(total.used_s, 1e-9)
    counts = f"{total.runs} runs at {total.calls} calls; {total.equivalent} more would be the same as one of these"
    times = f"{took_s:.0f} s, {total.used_s:.0f} s of a processor ({rate:.0f} a second of it)"
    print(f"\n{counts}: {len(total.wrong)} wrong, in {times}")
    return int(bool(total.wrong or missing))
