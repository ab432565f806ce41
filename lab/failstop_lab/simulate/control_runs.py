"""Control runs: whether what is taken out of the protocol is missed, and the page about it
(docs/reference/controls.md)."""

from __future__ import annotations

import multiprocessing
from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, replace
from pathlib import Path

from failstop_lab.case.claims import CLAIMS
from failstop_lab.machine.loading import HOME
from failstop_lab.simulate.controls import CONTROLS, NOT_EXPRESSED, Mutant
from failstop_lab.simulate.seeds import ROUNDS, commit, seeds, stays_down, used_s
from failstop_lab.simulate.single_faults import Plan, explore, of_board
from failstop_lab.simulate.tested_controls import TESTED, ByTest, Noticed
from failstop_lab.simulate.weak_controls import WEAK_CONTROLS

BOTH = (*CONTROLS, *WEAK_CONTROLS)
SHORT = 1
"""So many scenarios a run where memory alone is odd: each begins on the service as it was started."""
ENOUGH = 6
"""A run that needs more deviations is looked for again, while there is time."""
COLUMNS = ("taken out", "scenario", "found by", "s", "deviations", "what is wrong then", "commit")
OF_TESTS = ("taken out", "found by", "s", "what the test says", "commit")
OF_CLAIMS = ("claim", "taken out", "in", "found by", "s")
SEARCH_S = 60.0
"""How long a control is looked for."""
NOT_FOUND = "NOT FOUND"
UNSOUGHT = "not looked for"


def head(columns: tuple[str, ...]) -> str:
    """The first two lines of a table."""
    return "| " + " | ".join(columns) + " |\n|" + "---|" * len(columns)


TABLE_HEAD = head(COLUMNS)

PAGE = """\
# Controls: what the tests find when a part is taken out

This page shows that the campaigns on the [simulated machine](../how-it-is-tested.md#the-simulated-machine) can fail.
`make controls` takes one part of the stop protocol out of the code at a time, and the campaign must find out that
something goes wrong. Only then does it mean something that it finds nothing wrong with the whole code.

For each part, seeds of one scenario are played, seed 0 first, for at most {seconds} s of one core. *s* is the processor
time until the first run that went wrong, including the start of the service. Then draws are left out of that run, as
long as it still goes wrong. The draws that are left are its *deviations*; 0 means that the scenario goes wrong by
itself. The last column is the commit at which that row was tried.

`failstop simulate --controls 'no epoch*'` tries a single part, and tells the story of the run that goes wrong. With
`--page FILE` it renews the rows that it has tried.

## Claims

Each claim of [safety.md](../safety.md#what-is-claimed) rests on rules of the code. For each claim at least one of them
is taken out, and something must notice. Where several rules carry a claim, all of them are taken out together.

{claims}

## Failing rows of the model

These are the rows of [the model](../how-it-is-tested.md#the-stop-protocol-in-a-model-checker) that must fail, and parts
that the model does not have.

{model}

## What a test finds

The simulation's judge looks at wheels and at the bytes on the wire. If a missing part shows on neither, a test must
notice it. That test runs in a copy of the checkout without that part.

{tested}

## Barriers

Each barrier of [memory order](../how-it-is-tested.md#memory-order-on-arm) is taken out on one side of its pair. In
these runs only the memory behaves in an unusual way. For *moving: supervisor* an entry of the black box is taken out
too, because its own barrier is between the two. *ring: any writer* and *reply: gate* take out the same barrier.

{memory}

## What can't be taken out by a change of the source

| row | why |
|---|---|
{others}
"""


@dataclass(frozen=True)
class Found:
    """How a control was found: by which campaign, after how many of its runs and how much of a processor's time; with
    how many faults or draws it happens again, and what was wrong. Not found: `wrong` is empty."""

    control: Mutant
    by: str
    runs: int
    took_s: float
    draws: int = 0
    wrong: str = ""
    story: str = ""
    commit: str = ""
    """That it was looked for at."""

    def text(self) -> str:
        """One line of the table."""
        where = f"`{self.control.scenario}{of_board(self.control.board)}`"
        by = self.by.replace("seeds", "seed", 1) if self.runs == 1 and self.by.startswith("seeds") else self.by
        by = by.replace("faults", "fault", 1) if self.runs == 1 else by
        told = f"{self.runs} {by}" if self.wrong else f"{NOT_FOUND} by {self.runs} {by}"
        last = f"{self.draws if self.wrong else ''} | {self.wrong} | {self.commit}"
        return f"| {self.control.row} | {where} | {told} | {self.took_s:.1f} | {last} |"


def search(control: Mutant, seconds: float) -> Found:
    """Look for a control by seeds of its scenario for so long, where seeds may play it, and else by its single
    faults."""
    rounds = SHORT if control.groups else ROUNDS
    drawn_s = 0.0 if stays_down(control.scenario) else seconds
    runs, took_s, best = 0, 0.0, None
    while took_s < drawn_s and not (best and best.draws <= ENOUGH):
        found = seeds(
            runs, 1, drawn_s - took_s, control.patches, [control.scenario], control.board, control.groups, rounds
        )
        runs, took_s = runs + found.runs, took_s + (found.found_s or found.took_s)
        if found.wrong and (best is None or len(found.wrong[0].draws) < best.draws):
            seed, first = found.wrong[0], best or Found(control, "seeds", runs, took_s)
            wrong, story = seed.violations[0], seed.text()
            best = Found(control, "seeds", first.runs, first.took_s, len(seed.draws), wrong, story)
    if best:
        return replace(best, commit=commit())
    if control.groups:
        return Found(control, "seeds", runs, took_s, commit=commit())
    begun_s = used_s()
    plan = Plan(control.scenario, most=1, patches=control.patches, fault=control.fault, first=True, board=control.board)
    single = explore(plan)
    by = f"single faults, and not by {runs} seeds" if runs else "single faults"
    if not single.wrong:
        return Found(control, by, single.runs, used_s() - begun_s, commit=commit())
    run = single.wrong[0]
    took_s, faults = used_s() - begun_s, int(bool(run.fault))
    return Found(control, by, single.runs, took_s, faults, run.violations[0], run.text(), commit())


def searched(seconds: float, jobs: int, wanted: Callable[[Mutant], bool]) -> Iterator[Found]:
    """All controls that are wanted, in the order of their tables, in so many processes."""
    with multiprocessing.get_context("fork").Pool(jobs, maxtasksperchild=1) as pool:
        yield from pool.imap(_searched, [(control, seconds) for control in BOTH if wanted(control)])


def _searched(todo: tuple[Mutant, float]) -> Found:
    return search(*todo)


def rows(page: str) -> dict[str, list[str]]:
    """The cells of each control on the page, by the first one."""
    lines = (line.removeprefix("| ").removesuffix("|").split(" | ") for line in page.splitlines())
    return {
        cells[0]: [cell.strip() for cell in cells] for cells in lines if len(cells) in (len(COLUMNS), len(OF_TESTS))
    }


def found_by(control: Mutant | ByTest, page: str) -> tuple[str, str]:
    """What has found a control on the page, and in how many seconds. Empty: nothing has."""
    cells = rows(page).get(control.row, [])
    columns = COLUMNS if isinstance(control, Mutant) else OF_TESTS
    if len(cells) != len(columns):
        return "", ""
    by, seconds = (cells[columns.index(name)] for name in ("found by", "s"))
    return ("", "") if not seconds or by.startswith(NOT_FOUND) else (by, seconds)


def controls_of(claim: str) -> list[Mutant | ByTest]:
    """The controls of a claim, in the order of their tables."""
    return [control for control in (*CONTROLS, *TESTED) if claim in control.claims]


def page(found: Iterable[Found | Noticed], before: str) -> str:
    """The page about these, and about all others what it said `before`."""
    lines = {line.split(" | ")[0].removeprefix("| "): line for line in before.splitlines() if line.startswith("| ")}
    lines |= {each.control.row: each.text() for each in found}

    def table(columns: tuple[str, ...], controls: Iterable[Mutant | ByTest]) -> str:
        def line(control: Mutant | ByTest) -> str:
            where = f"`{control.scenario}` | " if isinstance(control, Mutant) else ""
            empty = " |" * (len(columns) - 2 - bool(where))
            return lines.get(control.row) or f"| {control.row} | {where}{UNSOUGHT} |{empty}"

        return "\n".join([head(columns), *map(line, controls)])

    model, memory, tested = table(COLUMNS, CONTROLS), table(COLUMNS, WEAK_CONTROLS), table(OF_TESTS, TESTED)
    claims = "\n".join([head(OF_CLAIMS), *_of_claims("\n".join((model, tested)))])
    others = "\n".join(f"| {row} | {why} |" for row, why in NOT_EXPRESSED.items())
    return PAGE.format(seconds=f"{SEARCH_S:g}", claims=claims, model=model, tested=tested, memory=memory, others=others)


def _of_claims(tables: str) -> Iterator[str]:
    for claim in CLAIMS:
        for control in controls_of(claim.name):
            by, seconds = found_by(control, tables)
            files = dict.fromkeys(file_of(module) for module, _, _ in control.patches)
            link, places = f"[{claim.name}](evidence.md#{claim.name.lower()})", ", ".join(f"`{each}`" for each in files)
            yield f"| {link} | {control.row} | {places} | {by or UNSOUGHT} | {seconds} |"


def file_of(module: str) -> str:
    """The file of a module, as a reader finds it: the core's folders lie at the top."""
    path = Path(HOME, *module.split(".")[1:]).with_suffix(".py")
    return str(path.resolve().relative_to(Path(HOME).resolve().parent))
