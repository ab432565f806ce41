"""Report of a stand test: as text for people, as JSON, and as a picture where matplotlib is there; dated files of
evidence."""

from __future__ import annotations

import dataclasses
import importlib
import json
import os
import time
from collections.abc import Callable, Sequence
from typing import Any

from failstop.cli import style
from failstop.doctor.machine import facts
from failstop.lab.prove.held import repeat
from failstop.lab.prove.run import Character, Result
from failstop.lab.prove.shake import Noise
from failstop.supervisor.status import cost

CAN_NOT = (
    "Proved is what was done here: this robot, this battery, wheels in the air, each path so many times. Wheels on the "
    "ground take longer to stop. A software stop needs a board that obeys; the power switch needs nobody."
)
INTERRUPTED = "interrupted"
VERDICT_STYLES = {"PASS": style.OK, "FAIL": style.FAIL, "INVALID": style.WARN, "SKIP": style.WARN}
NAME = 20
"""Columns for the name of a path; some rows of the fault table are longer."""


@dataclasses.dataclass
class Evidence:
    """Everything of one run of the stand test."""

    device: str
    simulated: bool
    realtime: bool
    character: Character | None = None
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

    @property
    def exit_code(self) -> int:
        """Of the command."""
        return 0 if self.passed else 130 if self.ended == INTERRUPTED else 1

    @property
    def passed(self) -> bool:
        """Every row passed or was skipped, one passed, and it came to its end."""
        words = {result.verdict for result in self.results}
        return not self.ended and "PASS" in words and words <= {"PASS", "SKIP"}

    @property
    def verdict(self) -> str:
        """PASS, FAIL or INVALID, of all of it."""
        if self.passed:
            return "PASS"
        doubtful = self.spoiled or (not self.ended and any(r.verdict == "INVALID" for r in self.results))
        return "INVALID" if doubtful and not self.failed else "FAIL"

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
            "ended": self.ended,
            "character": dataclasses.asdict(self.character) if self.character else None,
            "rows": [_record(result) for result in self.results],
        }


def print_now(text: str) -> None:
    """As it comes, into a pipe too."""
    print(text, flush=True)


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
        "rest_bar_s": result.path.rest_bar_s(result.velocity),
        "blind_s": result.blind_s,
        "board_ms": result.board_ms,
        "back_s": result.back_s,
        "latched": result.latched,
        "arm": result.arm,
        "samples": [[round(t_ns / 1e6, 2), round(x, 5), round(y, 5)] for t_ns, x, y in result.samples],
    }


def head(width: int = NAME) -> str:
    """Above the rows; `width`: of the paths' names."""
    return (
        f"{'stop path':<{width}} {'velocity':<10} {'written, ms':>18} {'acknowledged, ms':>18} {'at rest, s':>16} "
        f"{'board, ms':>10}  result"
    )


def row(result: Result, paint: Callable[[str, str], str] = _plain, width: int = NAME) -> str:
    """One line of the table, the verdict painted."""
    bar_ms = result.path.reaction_bar_ms(simulated=result.simulated)
    written = _cell(result.written_ms, ".2f", f"{bar_ms:.0f}")
    acknowledged = _cell(result.acknowledged_ms, ".0f", "")
    rest = _cell(result.rest_s, ".2f", f"{result.path.rest_bar_s(result.velocity):.2f}")
    board = _cell(result.board_ms, ".2f", "")
    why = f" {'; '.join(result.wrong) or result.skipped}" if result.wrong or result.skipped else ""
    if result.verdict == "INVALID":
        why = f" {repeat(result.starved)};{why}"
    notes = [f"blind for {result.blind_s:.2f} s"] if result.blind_s and result.rest_s is not None else []
    notes += [f"turning again {result.back_s:.1f} s after the return"] if result.back_s is not None else []
    note = f" ({'; '.join(notes)})" if notes else ""
    name = f"{result.path.name:<{width}}"
    return (
        f"{name} {result.velocity.words:<10} {written:>18} {acknowledged:>18} {rest:>16} {board:>10}"
        f"  {paint(result.verdict, VERDICT_STYLES[result.verdict])}{why}{note}"
    )


def _cell(value: float | None, form: str, bar: str) -> str:
    shown = "-" if value is None else format(value, form)
    return f"{shown} ({bar})" if bar else shown


def character_lines(character: Character) -> list[str]:
    """How this robot shakes."""
    lines = [f"IMU at rest        {_noise(character.still)}"]
    lines += [f"IMU at {name:<11} {_noise(noise)}" for name, noise in character.spinning.items()]
    if character.limit_radps == character.configured_radps:
        lines.append(f"still.std_radps = {character.configured_radps:g} lies between: it fits this robot")
    else:
        lines.append(
            f"still.std_radps = {character.configured_radps:g} does not lie between: "
            f"set it to {character.limit_radps:.4f}, which is used here"
        )
    return lines


def _noise(noise: Noise) -> str:
    return (
        f"std x {noise.std_x:.4f} y {noise.std_y:.4f} rad/s, windows {noise.least:.4f} to {noise.most:.4f}, "
        f"{noise.rate_hz:.0f} Hz"
    )


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
    if evidence.ended:
        lines.append(f"ENDED EARLY: {evidence.ended}")
    return [*lines, evidence.verdict, CAN_NOT]


def text(evidence: Evidence) -> str:
    """The whole report."""
    character = ["", *character_lines(evidence.character)] if evidence.character else []
    rows = ["", head(), *map(row, evidence.results)] if evidence.results else []
    return "\n".join([*head_lines(evidence), *character, *rows, "", *last_lines(evidence)]) + "\n"


def save(evidence: Evidence, folder: str) -> list[str]:
    """Write the files below a dated folder; returns their paths. Raises OSError."""
    stamp = time.strftime("%Y-%m-%dT%H%M%SZ", time.gmtime(evidence.begun_unix_s))
    place = os.path.join(folder, stamp)
    os.makedirs(place, exist_ok=True)
    paths = [os.path.join(place, name) for name in ("report.txt", "result.json")]
    with open(paths[0], "w", encoding="utf-8") as file:
        file.write(text(evidence))
    with open(paths[1], "w", encoding="utf-8") as file:
        json.dump(evidence.as_dict(), file, indent=1)
    picture = os.path.join(place, "gyro.png")
    return [*paths, picture] if _draw(evidence.results, picture) else paths


def _draw(results: Sequence[Result], path: str) -> bool:
    """Gyro x and y around each stop; False without matplotlib."""
    shown = [result for result in results if result.samples]
    try:
        figure_module: Any = importlib.import_module("matplotlib.figure")
    except ImportError:
        return False
    if not shown:
        return False
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
        panel.axvline(result.path.rest_bar_s(result.velocity), color="red", linestyle=":", linewidth=0.8)
        panel.set_title(f"{result.path.name} {result.velocity.words}: {result.verdict}", fontsize=8)
    for panel in panels:
        panel.set_visible(False)
    figure.supxlabel("s from the cause; green: at rest, red: the bar")
    figure.supylabel("rad/s")
    figure.savefig(path, dpi=120)
    return True
