"""Report of a stand test: as text for people, as JSON, and as a picture where matplotlib is there; dated files of
evidence."""

from __future__ import annotations

import contextlib
import dataclasses
import importlib
import itertools
import json
import os
import sys
import time
from collections.abc import Callable, Sequence
from typing import Any

from failstop import helpers
from failstop.api import distance
from failstop.cli import style
from failstop.doctor.machine import facts
from failstop.files import durable
from failstop.policy.halted import OF_CTRL_C, Halted
from failstop.policy.settings import Settings
from failstop.supervisor.status import cost
from failstop_lab.prove.held import repeat
from failstop_lab.prove.means import Means
from failstop_lab.prove.run import Result
from failstop_lab.prove.sight import ByImu, Sight
from failstop_lab.prove.table import FROZEN, Path, Turning

CAN_NOT = (
    "This result covers only what was tested here: this robot, this battery, wheels off the ground. On the ground the "
    "robot takes longer to stop. A software stop needs a board that obeys; the power switch does not."
)
INTERRUPTED = "interrupted"
VERDICT_STYLES = {"PASS": style.OK, "FAIL": style.FAIL, "INVALID": style.WARN, "SKIP": style.WARN}
NAME = 20
"""Columns for the name of a path; some rows of the fault table are longer."""
WIDE = 116
"""Columns of a whole row."""


@dataclasses.dataclass
class Evidence:
    """Everything of one run of the stand test."""

    device: str
    simulated: bool
    realtime: bool
    character: Sight | None = None
    results: list[Result] = dataclasses.field(default_factory=list)
    ended: str = ""
    """Why it ended before its end; empty: it did not."""
    spoiled: bool = False
    """The machine was starved when it ended before its end."""
    lease_s: float = 0.0
    """How long the gate or the supervisor may be silent while the wheels turn; 0: not known yet."""
    begun_unix_s: float = dataclasses.field(default_factory=time.time)
    tool: str = "prove"
    """The command."""
    means: Means | None = None
    """The proofs that the board can give. None: the report says nothing about them."""
    outcome: Halted | None = None
    """What is known of the wheels at its end; None: they are a simulated board's, or were never to turn."""
    user: Settings | None = None
    """The robot's own; None: nothing is said of distances."""
    whole: Sequence[tuple[Path, Turning]] = ()
    """Every run that the whole test of this robot has; empty: it is not known, and nothing is said of a part."""

    @property
    def blind(self) -> bool:
        """Nothing reports whether the wheels stand."""
        return self.character is not None and not self.character.by

    @property
    def exit_code(self) -> int:
        """The exit code of the command."""
        if self.ended == INTERRUPTED:
            return self.outcome.interrupted() if self.outcome else OF_CTRL_C
        return 0 if self.passed else 1

    @property
    def ending(self) -> str:
        """Why it ended before its end, and what is known of the wheels then; empty: it did not, and they are safe."""
        known = self.outcome.sentence() if self.outcome and (self.ended or not self.outcome.safe) else ""
        return "; ".join(filter(None, (self.ended, known)))

    @property
    def passed(self) -> bool:
        """Every row passed or was skipped, one passed, and it came to its end."""
        words = {result.verdict for result in self.results}
        return not self.ending and "PASS" in words and words <= {"PASS", "SKIP"}

    @property
    def verdict(self) -> str:
        """PASS, FAIL or INVALID, of all of it."""
        if self.passed:
            return "PASS"
        doubtful = self.spoiled or (not self.ending and any(r.verdict == "INVALID" for r in self.results))
        unsafe = self.outcome is not None and not self.outcome.safe
        return "INVALID" if doubtful and not (self.failed or unsafe) else "FAIL"

    @property
    def tested(self) -> set[tuple[str, str]]:
        """The names of the paths and velocities that something is known of."""
        return {(row.path.name, row.velocity.name) for row in self.results if row.verdict in ("PASS", "FAIL")}

    @property
    def untested(self) -> list[str]:
        """For people: what the whole test has and nothing is known of, the paths with the same reason together."""
        spoiled = {row.path.name: "invalid, so nothing is known" for row in self.results if row.verdict == "INVALID"}
        spoiled |= {row.path.name: f"skipped ({row.skipped})" for row in self.results if row.skipped}
        paths = {path for path, _ in self.tested}
        missing: dict[str, list[str]] = {}
        for path, velocity in self.whole:
            if (path.name, velocity.name) not in self.tested:
                missing.setdefault(path.name, []).append(velocity.words)
        reasons: dict[str, list[str]] = {}
        for name, at in missing.items():
            elsewhere = f"not tested at {' or '.join(at)}" if name in paths else "not tested here"
            reasons.setdefault(spoiled.get(name, elsewhere), []).append(name)
        return [f"{', '.join(names)}: {reason}" for reason, names in reasons.items()]

    @property
    def covers(self) -> str:
        """For people: the part of the whole test that the verdict is about, the proofs that no row has, and a board
        that is not the robot's; empty: it is not known."""
        whole, tested = {path.name for path, _ in self.whole}, {path for path, _ in self.tested}
        found = [f"{len(whole & tested)} of {len(whole)} stop paths"] if whole else []
        runs = [(path.name, velocity.name) for path, velocity in self.whole if path.name in tested]
        found += [] if self.tested.issuperset(runs) else ["not each at every speed"]
        return ", ".join([*found, *self._unseen, *(["on a SIMULATED board"] if self.simulated else [])])

    @property
    def _unseen(self) -> list[str]:
        """For people: the proofs that no row has, because the board does not give them."""
        unseen = ["NO WHEEL WAS OBSERVED"] if self.blind else []
        silent = self.means is not None and not self.means.acknowledged_by
        return [*unseen, *(["no stop was acknowledged"] if silent else [])]

    @property
    def complete(self) -> bool:
        """It was the whole test, with every proof, of a robot."""
        return bool(self.whole) and not (self.untested or self._unseen or self.simulated)

    @property
    def failed(self) -> list[Result]:
        """The rows that failed."""
        return [result for result in self.results if result.verdict == "FAIL"]

    def as_dict(self) -> dict[str, Any]:
        """For programs."""
        return {
            **facts(),
            "begun": time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(self.begun_unix_s)),
            "device": self.device,
            "simulated": self.simulated,
            "realtime": self.realtime,
            "lease_s": self.lease_s,
            "verdict": self.verdict,
            "passed": self.passed,
            "ended": self.ending,
            "character": self.character.as_dict() if self.character else None,
            "distances": ways(self),
            "covers": self.covers,
            "complete": self.complete,
            "unproved": [*(self.means.unproved(blind=self.blind) if self.means else []), *self.untested],
            "rows": [_record(result) for result in self.results],
        }


def ways(evidence: Evidence) -> list[str]:
    """The stopping distances, in words: by the settings, and by what was written last here."""
    if evidence.user is None:
        return []
    lines = distance.sentences(evidence.user)
    written = [result for result in evidence.results if result.written_ms is not None and result.path.kind != FROZEN]
    if written:
        slowest = max(written, key=lambda result: result.written_ms or 0.0)
        seconds = (slowest.written_ms or 0.0) / 1000
        way = distance.distance_m(distance.fastest_mps(evidence.user), seconds, evidence.user[distance.BRAKING])
        lines.append(
            f"In these runs the slowest stop, {slowest.path.name}, was written after {1000 * seconds:.1f} ms: "
            f"{way:.2f} m."
        )
    return lines


def print_now(text: str) -> None:
    """As it comes, into a pipe too; on a terminal what has no colours is broken at its words."""
    columns = style.width() if sys.stdout.isatty() else 0
    for line in text.split("\n"):
        rows = (
            style.wrap([(line, style.PLAIN)], columns, 2) if columns and "\x1b" not in line else [[(line, style.PLAIN)]]
        )
        print("\n".join(map(style.plain, rows)), flush=True)


def narrow() -> bool:
    """Whether the rows have to fit a terminal of 80 columns."""
    return sys.stdout.isatty() and style.width() < WIDE


def _plain(text: str, _role: str) -> str:
    return text


def _record(result: Result) -> dict[str, Any]:
    return {
        "path": result.path.name,
        "velocity": result.velocity.name,
        "verdict": result.verdict,
        "wrong": result.wrong,
        "starved": result.starved,
        "skipped": result.skipped,
        "written_ms": result.written_ms,
        "written_by": result.written_by,
        "written_bar_ms": result.path.reaction_bar_ms(simulated=result.simulated),
        "acknowledged_ms": result.acknowledged_ms,
        "rest_s": result.rest_s,
        "rest_bar_s": result.rest_bar_s,
        "blind_s": result.blind_s,
        "board_ms": result.board_ms,
        "back_s": result.back_s,
        "latched": result.latched,
        "arm": result.arm,
        "taken_again": result.again,
        "samples": [[round(t_ns / 1e6, 2), *(_rounded(part) for part in parts)] for t_ns, *parts in result.samples],
    }


def _rounded(part: float | Sequence[float]) -> float | list[float]:
    """A value of the gyro, or those of the wheels."""
    return [round(value, 5) for value in part] if isinstance(part, Sequence) else round(part, 5)


def head(width: int = NAME) -> str:
    """Above the rows; `width`: of the paths' names."""
    if narrow():
        return f"{'stop path':<{width}} {'velocity':<9} {'written, ms':>13} {'heard, ms':>9} {'rest, s':>11}  result"
    return (
        f"{'stop path':<{width}} {'velocity':<10} {'written, ms':>18} {'acknowledged, ms':>18} {'at rest, s':>16} "
        f"{'board, ms':>10}  result"
    )


def row(result: Result, paint: Callable[[str, str], str] = _plain, width: int = NAME) -> str:
    """One line of the table, the verdict painted."""
    frozen = result.path.kind == FROZEN  # nobody writes
    bar_ms = result.path.reaction_bar_ms(simulated=result.simulated)
    written = _cell(result.written_ms, ".2f", "" if frozen else f"{bar_ms:.0f}")
    acknowledged = _cell(result.acknowledged_ms, ".0f", "")
    rest = _cell(result.rest_s, ".2f", f"{result.rest_bar_s:.2f}" if result.rest_bar_s else "")
    board = _cell(result.board_ms, ".2f", "")
    why = f" {'; '.join(result.wrong) or result.skipped}" if result.wrong or result.skipped else ""
    if result.verdict == "INVALID":
        why = f" {repeat(result.starved)};{why}"
    notes = [f"no reading for {result.blind_s:.2f} s"] if result.blind_s and result.rest_s is not None else []
    notes += [f"turning again {result.back_s:.1f} s after the sensor was back"] if result.back_s is not None else []
    notes += [f"measured {len(result.again) + 1} times"] if result.again else []
    note = f" ({'; '.join(notes)})" if notes else ""
    name = f"{result.path.name:<{width}}"
    if narrow():
        return (
            f"{name} {result.velocity.words:<9} {written:>13} {acknowledged:>9} {rest:>11}"
            f"  {paint(result.verdict, VERDICT_STYLES[result.verdict])}" + (f"\n   {why}{note}" if why or note else "")
        )
    return (
        f"{name} {result.velocity.words:<10} {written:>18} {acknowledged:>18} {rest:>16} {board:>10}"
        f"  {paint(result.verdict, VERDICT_STYLES[result.verdict])}{why}{note}"
    )


def _cell(value: float | None, form: str, bar: str) -> str:
    shown = "-" if value is None else format(value, form)
    return f"{shown} ({bar})" if bar else shown


def character_lines(evidence: Evidence) -> list[str]:
    """How this robot shows rest, and what can't be proved on it."""
    lines = evidence.character.lines() if evidence.character else []
    if evidence.means:
        lines += evidence.means.lines(blind=evidence.blind)
        lines += [f"NOT PROVED HERE: {reason}" for reason in evidence.means.unproved(blind=evidence.blind)]
    return lines


def head_lines(evidence: Evidence) -> list[str]:
    """Where and when."""
    machine = facts()
    when = time.strftime("%Y-%m-%d %H:%M:%S UTC", time.gmtime(evidence.begun_unix_s))
    what = "SIMULATED board" if evidence.simulated else "board"
    rights = "real-time priority" if evidence.realtime else f"WITHOUT real-time priority: {cost(evidence.lease_s)}"
    return [
        f"failstop {evidence.tool} {machine['version']}, {when}: {what} at {evidence.device}",
        f"{machine['machine']}, {machine['cores']} cores, kernel {machine['kernel']}, Python {machine['python']}",
        rights,
    ]


def last_lines(evidence: Evidence) -> list[str]:
    """The sum."""
    count = {word: sum(result.verdict == word for result in evidence.results) for word in VERDICT_STYLES}
    invalid = f", {count['INVALID']} invalid" if count["INVALID"] else ""
    lines = [f"{count['PASS']} passed, {count['FAIL']} failed, {count['SKIP']} skipped{invalid}"]
    lines += [f"tested: {evidence.covers}"] if evidence.covers else []
    lines += [f"NOT PROVED HERE: {reason}" for reason in evidence.untested]
    if evidence.ending:
        lines.append(f"ENDED EARLY: {evidence.ending}")
    return [*lines, evidence.verdict, CAN_NOT, *ways(evidence)]


def text(evidence: Evidence) -> str:
    """The whole report."""
    character = ["", *character_lines(evidence)]
    rows = ["", head(), *map(row, evidence.results)] if evidence.results else []
    return "\n".join([*head_lines(evidence), *character, *rows, "", *last_lines(evidence)]) + "\n"


def save(evidence: Evidence, folder: str) -> list[str]:
    """Write the files into a new dated folder below this one; returns their paths. The result comes first, and never
    as half a file, because `failstop setup` reads it. Raises OSError."""
    stamp = time.strftime("%Y-%m-%dT%H%M%SZ", time.gmtime(evidence.begun_unix_s))
    place = _new_folder(os.path.join(folder, stamp))
    paths = [os.path.join(place, name) for name in ("report.txt", "result.json")]
    durable.replace(paths[1], json.dumps(evidence.as_dict(), indent=1).encode())
    durable.replace(paths[0], text(evidence).encode())
    shaken = isinstance(evidence.character, ByImu)
    picture = os.path.join(place, "gyro.png")
    return [*paths, picture] if shaken and _draw(evidence.results, picture) else paths


def _new_folder(path: str) -> str:
    """Make a folder, under this path with a number where an earlier run has it: the clock may have been set back."""
    os.makedirs(os.path.dirname(path), exist_ok=True)
    for number in itertools.count(1):
        place = f"{path}-{number}" if number > 1 else path
        with contextlib.suppress(FileExistsError):
            os.mkdir(place)
            break
    return place


def _draw(results: Sequence[Result], path: str) -> bool:
    """Gyro x and y around each stop; False without matplotlib."""
    shown = [result for result in results if result.samples]
    try:
        helpers.import_elsewhere("matplotlib")
        styles: Any = importlib.import_module("matplotlib.style")
    except ImportError:
        return False
    if not shown:
        return False
    # after_reset: without the settings of a matplotlibrc, which may run LaTeX.
    with styles.context([], after_reset=True):
        _draw_panels(shown, path)
    return True


def _draw_panels(shown: Sequence[Result], path: str) -> None:
    figure_module: Any = importlib.import_module("matplotlib.figure")
    columns = min(3, len(shown))
    rows = -(-len(shown) // columns)
    # Without pyplot: no window system is asked for.
    figure = figure_module.Figure(figsize=(5 * columns, 1.8 * rows), layout="constrained")
    panels = figure.subplots(rows, columns, squeeze=False, sharex=True).flat
    for result, panel in zip(shown, panels, strict=False):
        times = [t_ns / 1e9 for t_ns, _, _ in result.samples]
        for axis, name in ((1, "x"), (2, "y")):
            panel.plot(times, [sample[axis] for sample in result.samples], linewidth=0.5, label=f"gyro {name}")
        panel.axvline(0.0, color="black", linewidth=0.8)
        if result.rest_s is not None:
            panel.axvline(result.rest_s, color="green", linewidth=0.8)
        panel.axvline(result.rest_bar_s, color="red", linestyle=":", linewidth=0.8)
        panel.set_title(f"{result.path.name} {result.velocity.words}: {result.verdict}", fontsize=8)
    for panel in panels:
        panel.set_visible(False)
    figure.supxlabel("s from the cause; green: at rest, red: the bar")
    figure.supylabel("rad/s")
    figure.savefig(path, dpi=120)
