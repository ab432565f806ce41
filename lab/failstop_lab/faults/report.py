"""Report of a campaign: by row with its times, and as a page of documentation.

A percentile is one of the times that were measured, by nearest rank, so of 100 tries or fewer the p99 is the slowest. A
stop that never came counts as later than every other.
"""

from __future__ import annotations

import dataclasses
import json
import math
import os
import subprocess
import time
from collections import Counter
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

from failstop.doctor.machine import facts
from failstop.policy.layouts import BOARDS
from failstop.supervisor.status import LEASE_S, LEASE_WITHOUT_S
from failstop_lab.boards.line import BAR_NS
from failstop_lab.boards.traits import HAS_ARM, HAS_ARM_BESIDE, PARTS, Traits, traits_of
from failstop_lab.faults import arm_table, table
from failstop_lab.faults.arm_table import ArmFault
from failstop_lab.faults.fault import FAULT_CLASSES, Fault, in_words
from failstop_lab.faults.injection import Outcome
from failstop_lab.faults.table import BEYOND

USUAL, LONGER = (f"{1000 * lease_s:.0f} ms" for lease_s in (LEASE_S, LEASE_WITHOUT_S))
LEASES = (
    f"A campaign uses the lease of a service with real-time rights ({USUAL}), whatever rights it has. If your service",
    f"has no real-time rights, and you don't set `gate.lease_s`, its lease is {LONGER}, or nine tenths of the shortest",
    "command timeout, and no deadline is shorter. The bars of *its lease*, and of a port owner that hangs, are then",
    "longer too ([service.md](../service.md#without-real-time-rights)).",
)

CONDITIONS = (
    "A bar is the longest p99 that a row may have, on two processor cores that nothing else uses, with real-time",
    "rights. On a shared or busy machine, or without the rights, a bar may be missed; *held* then says no. If a row",
    "was injected 100 times or less often, its p99 is the slowest of these. A missed stop counts as later than every",
    "other. The test of a row allows 100 ms more than its bar (1 s if the stop tool has to start), because it runs on",
    "any machine: it finds a stop that does not come, while a campaign judges the bar.",
)
COLUMNS = ("n", "p50", "p99", "max", "bar", "held")
"""The columns with what was measured, at the end of each row of the page."""
LAST = Path("lab/failstop_lab/faults/campaign.json")
"""The last campaign at the first board, in a checkout. The pages that say what it found are made from it."""
UNRECORDED = "Whether the service had real-time rights, and how busy the machine was, is not recorded."
EVERY: dict[str, Fault | ArmFault] = {**table.FAULT_BY_NAME, **arm_table.ARM_FAULT_BY_NAME}
"""The rows of both tables."""


def rows_of(traits: Traits) -> dict[str, Fault | ArmFault]:
    """The rows that a board can have, with its bars."""
    arm = arm_table.ARM_FAULT_BY_NAME if HAS_ARM in traits.parts else {}
    if HAS_ARM_BESIDE in traits.parts:
        arm = {name: row.at(traits) for name, row in arm_table.BESIDE_BY_NAME.items()}
    return {name: row.at(traits) for name, row in table.FAULT_BY_NAME.items() if row.needs <= traits.parts} | arm


@dataclasses.dataclass
class Row:
    """All injections of one row of the table. Times in ms; None: there was no stop to measure."""

    name: str
    count: int = 0
    missed: int = 0
    motion_after: int = 0
    wrong: int = 0
    """Injections that were not as the row says, for whatever reason."""
    again: int = 0
    """Scenes that ended before their fault, so that a new one was begun."""
    skipped: str = ""
    times_ms: list[float] = dataclasses.field(default_factory=list)

    def add(self, outcome: Outcome) -> None:
        """Count one."""
        if outcome.skipped:
            self.skipped = outcome.skipped
            return
        self.count += outcome.struck
        self.wrong += bool(outcome.wrong)
        self.again += len(outcome.again)
        stopped = outcome.stopped
        if outcome.struck and outcome.fault.bar_ms is not None and (stopped is None or stopped.stop_ns is None):
            self.missed += 1
        elif stopped and stopped.stop_ns is not None:
            self.motion_after += stopped.motion_after
            self.times_ms.append(stopped.stop_ns / 1e6)

    def percentiles(self) -> tuple[float, float, float] | None:
        """(p50, p99, max) in ms; infinite where that is a missed stop. None: nothing was to stop, or nothing was
        injected."""
        times_ms = sorted(self.times_ms) + [math.inf] * self.missed
        if not times_ms:
            return None
        p50, p99 = (times_ms[math.ceil(share * len(times_ms)) - 1] for share in (0.5, 0.99))
        return p50, p99, times_ms[-1]

    def as_dict(self) -> dict[str, Any]:
        """Plain values."""
        found = self.percentiles()
        names = ("p50_ms", "p99_ms", "max_ms")
        numbers = {name: round(value, 3) for name, value in zip(names, found or (), strict=False) if value < math.inf}
        plain = {"count": self.count, "missed": self.missed, "motion_after": self.motion_after, "wrong": self.wrong}
        times = {"times_ms": [round(time_ms, 3) for time_ms in self.times_ms]}
        return {"name": self.name, **plain, "again": self.again, "skipped": self.skipped, **numbers, **times}


class Tally:
    """The rows of a campaign, in the table's order, and the stories of what went wrong."""

    def __init__(self, rows: tuple[Fault | ArmFault, ...], seed: int, board: str = BOARDS[0]) -> None:
        """`board`: its kind."""
        self.seed, self.board = seed, board
        self._faults = {fault.name: fault for fault in rows}
        self.rows = {fault.name: Row(fault.name) for fault in rows}
        self.stories: list[str] = []
        self.again: Counter[str] = Counter()
        """How many scenes ended before their fault, by what was wrong."""
        self.ended = ""
        """Why the campaign could not go on."""
        self.realtime: bool | None = None
        """Whether the service has real-time rights, as it says itself; None: it was not asked."""
        self.interrupted = False
        self.next = 0
        """The number of the first fault that was not drawn yet."""
        self._parts: list[dict[str, Any]] = []
        self._counted = 0
        self._loads: list[float] = []
        # Of the beginning: somebody may commit while a campaign runs.
        self._facts = {**facts(), "commit": commit()}
        self.begun_s = time.monotonic()
        self._begun_ticks = processor_ticks()

    def resume(self, before: dict[str, Any]) -> None:
        """Add what an earlier part of this campaign has measured, from its as_dict(). Raises ValueError if that was
        another campaign."""
        rows = {row["name"]: row for row in before["rows"]}
        if before["board"] != self.board or rows.keys() != self.rows.keys():
            raise ValueError("it was of another board or of other rows")
        if before["seed"] != self.seed or not all("times_ms" in row for row in rows.values()):
            raise ValueError("it has another seed, or not the time of each fault")
        for name, row in self.rows.items():
            known = rows[name]
            row.count, row.missed, row.motion_after = known["count"], known["missed"], known["motion_after"]
            row.wrong, row.skipped, row.times_ms = known["wrong"], known["skipped"], list(known["times_ms"])
            row.again = known["again"]
        self.stories, self.again = list(before["stories"]), Counter(before["again"])
        self.next, self._parts = before["next"], list(before["machine"]["parts"])
        self._counted = self.count

    def add(self, outcome: Outcome) -> None:
        """Count one."""
        self.rows[outcome.fault.name].add(outcome)
        self.again.update(outcome.again)
        self._loads.append(os.getloadavg()[0])
        if not outcome.skipped:
            self.next = max(self.next, outcome.index + 1)
        if outcome.wrong:
            self.stories.append(outcome.story(self.seed))

    @property
    def count(self) -> int:
        """Faults injected."""
        return sum(row.count for row in self.rows.values())

    def total(self, field: str) -> int:
        """The sum of a count over all rows."""
        return sum(getattr(row, field) for row in self.rows.values())

    def end(self, why: str) -> None:
        """The campaign can't go on."""
        self.ended = why
        self.stories.append(f"the campaign could not go on: {why}")

    def summary(self) -> str:
        """One line."""
        ended = f"; it could not go on: {self.ended}" if self.ended else ""
        begun = f"; {_begun_again(self.again)}" if self.again else ""
        return (
            f"{self.count} faults in {time.monotonic() - self.begun_s:.0f} s: {self.total('missed')} stops missed, "
            f"{self.total('motion_after')} motion frames after a stop, {self.total('wrong')} not as the table says; "
            f"{kept(self._faults, {name: row.as_dict() for name, row in self.rows.items()})}{begun}{ended}"
        )

    def table(self) -> str:
        """For people."""
        head = f"{'fault':<50} {'count':>6} {'missed':>7} {'moved':>6} {'p50':>9} {'p99':>9} {'max':>9}  bar"
        lines = [head]
        for row in self.rows.values():
            if row.count:
                fault = self._faults[row.name]
                times = _times(row.as_dict())
                bar = _bar(fault) + (" ms" if fault.bar_ms is not None else "")
                late = ", MISSED" if bar_held(fault, row.as_dict()) is False else ""
                lines.append(
                    f"{row.name:<50} {row.count:>6} {row.missed:>7} {row.motion_after:>6}"
                    f" {times[0]:>9} {times[1]:>9} {times[2]:>9}  {bar}{late}"
                )
        lines += [f"{row.name:<50} not here: {row.skipped}" for row in self.rows.values() if row.skipped]
        lines.append(
            "\nTimes in ms, from the fault (or what the table counts from) to the arrival of the first stop frame"
        )
        lines.append(
            "that the board executes; moved: motion frames after it and before the next enable. Of the arm's: to"
        )
        lines.append("the last joint at rest; moved: moves of its servos after its stop.")
        return "\n".join(lines)

    def as_dict(self) -> dict[str, Any]:
        """Plain values, as in `--json`."""
        loads = self._loads or [os.getloadavg()[0]]
        part = {**self._facts, "count": self.count - self._counted, "realtime": self.realtime}
        part |= {"took_s": round(time.monotonic() - self.begun_s), "load": round(sum(loads) / len(loads), 1)}
        part["steal"] = stolen_share(self._begun_ticks)
        parts = [*self._parts, part]
        took_s = sum(one["took_s"] for one in parts)
        machine = {**_common(parts), "took_s": took_s, "conditions": conditions(parts), "parts": parts}
        totals = {field: self.total(field) for field in ("count", "missed", "motion_after", "wrong")}
        rows = [row.as_dict() for row in self.rows.values()]
        told = {"machine": machine, "board": self.board, "seed": self.seed, "next": self.next}
        return {**told, **totals, "again": dict(self.again), "rows": rows, "stories": self.stories}


def last_campaign(root: Path) -> dict[str, Any]:
    """The last campaign at the first board, as Tally.as_dict() has it. `root`: the checkout's folder. Raises OSError,
    ValueError."""
    found: dict[str, Any] = json.loads((root / LAST).read_text("utf-8"))
    return found


def processor_ticks() -> tuple[int, int]:
    """(all, taken by the host) of the processors' time so far, in ticks; zeros where the kernel does not say."""
    try:
        with open("/proc/stat", encoding="ascii") as file:
            ticks = [int(word) for word in file.readline().split()[1:9]]
    except (OSError, ValueError):
        return 0, 0
    return sum(ticks), ticks[7] if len(ticks) > 7 else 0


def stolen_share(begun: tuple[int, int]) -> float:
    """The share of the processors' time that the host took away since then. `begun`: processor_ticks() at that time."""
    (all_before, stolen_before), (now, stolen) = begun, processor_ticks()
    return (stolen - stolen_before) / max(1, now - all_before)


def _common(parts: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    """The facts() of all parts of a campaign, each "A and B" where they differ."""
    return {
        name: values[0] if len(values) == 1 else " and ".join(map(str, values))
        for name in facts()
        for values in [list(dict.fromkeys(part[name] for part in parts))]
    }


def conditions(parts: Sequence[Mapping[str, Any]]) -> str:
    """What decides how late a stop is, of all parts of a campaign, in words: rights, mean load, steal."""
    granted = sum(bool(part["realtime"]) for part in parts)
    found = "with real-time rights" if granted else "without real-time rights"
    if 0 < granted < len(parts):
        found = f"with real-time rights in {granted} of {len(parts)} parts"
    elif any(part["realtime"] is None for part in parts):
        found = "with rights that are not known"
    load = _span([f"{part['load']:.1f}" for part in sorted(parts, key=lambda part: float(part["load"]))])
    steal = _span([f"{part['steal']:.1%}" for part in sorted(parts, key=lambda part: float(part["steal"]))])
    return f"{found}, at a load of {load} and a steal of {steal} (processor time that the host took away)"


def _span(values: Sequence[str]) -> str:
    return values[0] if values[0] == values[-1] else f"{values[0]} to {values[-1]}"


def commit() -> str:
    """The commit of the checkout that this is, with a + if a file differs from it, except the last campaign's. Empty
    outside of a checkout."""
    root = Path(__file__).resolve().parents[3]
    if not (root / ".git").exists():
        return ""
    try:
        said = [
            subprocess.run(["git", "-C", root, *words], capture_output=True, text=True, check=True).stdout
            for words in (("rev-parse", "HEAD"), ("diff", "--name-only", "HEAD", "--", ".", f":(exclude){LAST}"))
        ]
    except (OSError, subprocess.CalledProcessError):
        return ""
    return said[0][:8] + "+" * bool(said[1])


def bar_held(fault: Fault | ArmFault, row: dict[str, Any]) -> bool | None:
    """Whether the p99 of a row kept its bar, and no stop was missed; None: it has no bar, or nothing was injected."""
    p99_ms = row.get("p99_ms")
    if fault.bar_ms is not None and row.get("missed"):
        return False
    return None if fault.bar_ms is None or p99_ms is None else bool(p99_ms <= fault.bar_ms)


def kept(faults: dict[str, Fault | ArmFault], measured: dict[str, dict[str, Any]]) -> str:
    """In how many rows the p99 was within the bar, and in which it was not, as a clause."""
    judged = {name: bar_held(fault, measured.get(name, {})) for name, fault in faults.items()}
    late = [name for name, verdict in judged.items() if verdict is False]
    count = sum(verdict is not None for verdict in judged.values())
    named = f", but not for {', '.join(late)}" if late else ""
    return f"the p99 was within its bar for {count - len(late)} of {count} kinds of fault{named}"


def _bar(fault: Fault | ArmFault) -> str:
    if fault.bar_ms is None:
        return "refused" if isinstance(fault, ArmFault) else "no stop"
    return f"{fault.bar_ms:g}"


def _times(row: dict[str, Any]) -> tuple[str, str, str]:
    found = [row.get(name) for name in ("p50_ms", "p99_ms", "max_ms")]
    none = "missed" if row.get("missed") else "-"
    a, b, c = (none if value is None else f"{value:.2f}" for value in found)
    return a, b, c


def markdown(result: dict[str, Any]) -> str:
    """docs/reference/faults.md: the table, with what a campaign measured beside each row; of another board its rows."""
    board = result.get("board", BOARDS[0])
    of, known = "" if board == BOARDS[0] else f", board {board}", rows_of(traits_of(board)).values()
    measured = {row["name"]: row for row in result["rows"]}
    machine = result["machine"]
    within = kept(rows_of(traits_of(board)), measured)
    lines = [
        "# Faults",
        "",
        "For everything that can go wrong, this page shows which process stops the wheels first, how soon, what is",
        "latched and what clears it. Each row is a test (`tests/lab/faults/test_table.py`; some rows that kill several",
        "processes at once run only in `make campaigns`), and the random campaign of `failstop chaos` draws from them.",
        "The simulated board judges, on its side of the wire. A row passes if the board executes a stop frame after",
        "the fault, and no motion frame from then until the next enable, while the client goes on sending commands.",
        "Generated by `make docs` from table.py and campaign.json of `lab/failstop_lab/faults`: do not edit.",
        "`make chaos` writes campaign.json.",
        "",
        f"Measured {machine['date']}{of}: {machine['cores']}-core {machine['machine']}, kernel {machine['kernel']}, "
        f"Python {machine['python']}, failstop {machine['version']}; {result['count']} faults in "
        f"{machine['took_s']} s, seed {result['seed']}: **{result['missed']} stops missed, "
        f"{result['motion_after']} motion frames after a stop, {result['wrong']} not as the table says**.",
        *_parts(machine.get("parts", ())),
        "",
        f"**{within[0].upper()}{within[1:]}.** {_conditions(machine)}",
        *_wrong(result),
        "",
        *CONDITIONS,
        "",
        "Times are in ms, from the fault, or from the moment that the row names, until the last byte of that stop",
        "frame has arrived. *Latched* is a row of [causes.md](causes.md) with its first arguments, which is also in",
        "the journal; *said* is what else is reported. If nothing is latched after a new start, motion is disabled.",
        "Clearing moves no wheel, except if it happens *by itself*. A fault that is *not here* could not be caused on",
        "that machine: `make vm` puts a machine to sleep and steps its clock",
        "([how](../how-it-is-tested.md#usb-sleep-and-boot)). Where several processes are hit within 5 ms, the last of",
        "them may stop the wheels before the process that *first to stop* names.",
        "",
        *LEASES,
    ]
    for event in FAULT_CLASSES:
        rows = [fault for fault in known if isinstance(fault, Fault) and fault.event == event]
        if not rows:
            continue  # this board can have none of them
        lines += ["", f"## {event[0].upper()}{event[1:]}", ""]
        lines += _head("row", "cause", "first to stop", "latched", "cleared", "said", *COLUMNS)
        lines += [_line(fault, measured.get(fault.name, {})) for fault in rows]
    lines += [
        *("", "## The arm moves", ""),
        "Times are from the fault to the last moment at which a joint turns, as the servos report it. *refused*:",
        "motion is not enabled, and no wheel turns. The rows are from `lab/failstop_lab/faults/arm_table.py`, and each",
        "is a test in `tests/lab/faults/test_arm_rows.py`.",
    ]
    lines += ["", *_head("row", "cause", "first to stop", "latched", "cleared", *COLUMNS)]
    for fault in known:
        if isinstance(fault, ArmFault):
            row = measured.get(fault.name, {})
            cells = (str(row.get("count", 0)), *_times(row), _bar(fault), _held(fault, row))
            lines.append(f"{fault.described()} {' | '.join(cells)} |")
    lines += other_boards() if board == BOARDS[0] else []
    lines += ["", "## Beyond this side of the wire", "", "| what | what helps |", "|---|---|"]
    lines += [f"| {what} | {helps} |" for what, helps in BEYOND]
    return "\n".join(lines) + "\n"


def _parts(parts: Sequence[Mapping[str, Any]]) -> list[str]:
    """How many faults of a campaign were injected on which day, at which commit, and on what if the machines differ."""
    if not parts:
        return []
    said = [f" ({part['cores']} cores, kernel {part['kernel']}, Python {part['python']})" for part in parts]
    if len(set(said)) == 1:
        said = [""] * len(said)
    faults: Counter[tuple[str, str]] = Counter()
    for part, machine in zip(parts, said, strict=True):
        faults[f"{part['date']} at {part['commit'] or 'no commit'}", machine] += part["count"]
    each = (f"{when}: {count} faults{machine}" for (when, machine), count in faults.items())
    return [f"Run on {'; '.join(each)}."]


def _wrong(result: Mapping[str, Any]) -> list[str]:
    """What went wrong in a campaign: the first line of each story, and the scenes that were begun again."""
    stories = [story.partition("\n")[0] for story in result["stories"]]
    lines = ["", "What was not as the table says:", "", *(f"- {line}" for line in stories)] if stories else []
    if again := result.get("again"):
        lines += ["", f"{_begun_again(again)}."]
    return lines


def _begun_again(again: Mapping[str, int]) -> str:
    """The scenes that ended before their fault, in words."""
    each = "; ".join(f"{count} times: {why}" for why, count in sorted(again.items()))
    return f"scenes that ended before their fault, so that a new one was begun: {sum(again.values())} ({each})"


def other_boards() -> list[str]:
    """The part of the page on rows and bars of another board."""
    by_need: dict[str, list[str]] = {}
    for fault in table.TABLE:
        for part in fault.needs:
            by_need.setdefault(part, []).append(f"`{fault.name}`")
    by_need[HAS_ARM] = ["all of *The arm moves*"]
    beside = ", ".join(f"`{name}`" for name in arm_table.BESIDE_BY_NAME)
    by_need[HAS_ARM_BESIDE] = [f"{beside}, while the wheels turn too: judged are both, and that no servo lets go"]
    return [
        *("", "## Another board", ""),
        "`failstop chaos --board NAME`, or the path of an own board's folder, injects the same rows at that board,",
        f"judged by its receiver. Each bar is {BAR_NS / 1e6:g} ms later, for the board's own line and loop (`BAR_NS`",
        "of `lab/failstop_lab/boards/line.py`, to which `tests/board` holds each receiver). A row is absent where a",
        "board has not what the row needs; `lab/failstop_lab/boards/traits.py` tells that by its description. A few",
        "rows of each board are in `make test` (`tests/lab/faults/test_every_board.py`), all in `make campaigns`;",
        "`make chaos BOARD=NAME` draws them.",
        *("", "| needs | rows |", "|---|---|"),
        *(f"| {part} | {', '.join(by_need[part])} |" for part in PARTS if part in by_need),
    ]


def described(fault: Fault) -> str:
    """The part of a row that nothing is measured for."""
    latched, logged = _code(in_words(fault.latched)), _code(fault.logged)
    return f"| `{fault.name}` | {fault.cause} | {fault.first} | {latched} | {fault.cleared} | {logged} |"


def _line(fault: Fault, row: dict[str, Any]) -> str:
    counted = "" if fault.counted_from == "the fault" else f" (from {fault.counted_from})"
    count = row.get("count") or ("not here" if row.get("skipped") else 0)
    return f"{described(fault)} {' | '.join((str(count), *_times(row), _bar(fault) + counted, _held(fault, row)))} |"


def _head(*columns: str) -> list[str]:
    return [f"| {' | '.join(columns)} |", "|---" * len(columns) + "|"]


def _held(fault: Fault | ArmFault, row: dict[str, Any]) -> str:
    return {True: "yes", False: "**no**", None: "-"}[bar_held(fault, row)]


def _conditions(machine: dict[str, Any]) -> str:
    return f"The service ran {machine['conditions']}." if "conditions" in machine else UNRECORDED


def _code(text: str) -> str:
    return f"`{text}`" if text else "nothing"
