"""Finds the final states of a litmus test that AArch64 allows, by trying every order. It needs no herd7.

A step waits for an earlier step of its thread that gives it a value, accesses the same location, or is ordered before
it by an acquire or a release. All other steps may come in any order. All threads see a store at once, as on AArch64. A
test must have no branches, write each register once, and use constant addresses.

check compares every set of final states with herd7's.
"""

from __future__ import annotations

import hashlib
import re
from pathlib import Path

FOLDER = Path(__file__).resolve().parent
CHECKED = FOLDER / "checked.txt"
VERDICTS = {True: "sometimes", False: "never"}
LOADS = {"LDR": "", "LDAR": "A", "LDXR": "", "LDAXR": "A"}
STORES = {"STR": "", "STLR": "L", "STXR": "", "STLXR": "L"}
SWAPS = {"CASA": "A", "CASL": "L"}
ZERO = "ZR"

State = tuple[int, ...]


class Step:
    """One instruction. `order`: A if it acquires, L if it releases, otherwise empty."""

    def __init__(self, text: str, addresses: dict[str, str]) -> None:
        self.op, *rest = re.split(r"[ ,]+", text)
        self.args = [re.sub(r"^[WX](?=\w)", "", arg) for arg in rest]
        self.order = {**LOADS, **STORES, **SWAPS, "MOV": ""}[self.op]
        self.at = addresses[rest[-1].strip("[]")] if rest[-1].startswith("[") else ""
        self.writes = set(self.args[:1]) - ({self.args[0]} if self.op in ("STR", "STLR") else set())
        reads = self.args[:-1] if self.op in ("STR", "STLR", *SWAPS) else self.args[1:-1]
        self.reads = set(reads) - {ZERO}

    def waits_for(self, earlier: Step) -> bool:
        """Return True if this step must not be performed before `earlier`, a step of the same thread."""
        if earlier.writes & self.reads:
            return True
        if not (self.at and earlier.at):
            return False
        released = "L" in earlier.order and "A" in self.order
        return self.at == earlier.at or "A" in earlier.order or "L" in self.order or released

    def perform(self, registers: dict[str, int], memory: dict[str, int]) -> None:
        """Perform the step. All threads see its store at once. An exclusive store always succeeds, so a test may use it
        only on a lock that no other thread uses."""

        def value(name: str) -> int:
            return 0 if name == ZERO else registers[name]

        if self.op == "MOV":
            registers[self.args[0]] = int(self.args[1].strip("#"))
        elif self.op in LOADS:
            registers[self.args[0]] = memory[self.at]
        elif self.op in SWAPS:
            found = memory[self.at]
            if found == registers[self.args[0]]:
                memory[self.at] = value(self.args[1])
            registers[self.args[0]] = found
        else:
            memory[self.at] = value(self.args[-2])
            if len(self.args) == 3:
                registers[self.args[0]] = 0


class Test:
    """A litmus test of this folder."""

    def __init__(self, path: Path) -> None:
        text = path.read_text(encoding="utf-8")
        start, _, rest = text.partition("}")
        program = re.split(r"\n(?:filter|exists)", rest)[0].strip()
        rows = [[cell.strip() for cell in row.strip(" ;").split("|")] for row in program.splitlines()]
        columns = list(zip(*rows, strict=True))
        values = re.findall(r"([\w:]+)=(\w+);", start)
        self.threads = [
            [Step(cell, {name[2:]: to for name, to in values if name[:2] == f"{i}:"}) for cell in column[1:] if cell]
            for i, column in enumerate(columns)
        ]
        self.memory = {step.at: 0 for steps in self.threads for step in steps if step.at}
        self.memory |= {name: int(value) for name, value in values if ":" not in name}
        self.asked = {
            (int(thread), register): int(value)
            for thread, register, value in re.findall(r"(\d):X(\d+)=(\d)", text[text.index("\nexists") :])
        }

    def bad(self, states: set[State]) -> bool:
        """Return True if the state that the test asks for is in `states`."""
        return tuple(self.asked[key] for key in sorted(self.asked)) in states

    def states(self) -> set[State]:
        """Return every final state: the values of the registers in `asked`, in sorted order."""
        found = set()
        seen = set()
        todo = [(tuple(0 for _ in self.threads), tuple({} for _ in self.threads), self.memory)]
        while todo:
            done, registers, memory = todo.pop()
            key = (done, repr(registers), repr(memory))
            if key in seen:
                continue
            seen.add(key)
            ended = True
            for i, steps in enumerate(self.threads):
                for j, step in enumerate(steps):
                    if done[i] >> j & 1:
                        continue
                    ended = False
                    if any(not done[i] >> k & 1 and step.waits_for(steps[k]) for k in range(j)):
                        continue
                    own, changed = dict(registers[i]), dict(memory)
                    step.perform(own, changed)
                    of_all = (*registers[:i], dict(sorted(own.items())), *registers[i + 1 :])
                    todo.append(((*done[:i], done[i] | 1 << j, *done[i + 1 :]), of_all, changed))
            if ended:
                found.add(tuple(registers[thread][register] for thread, register in sorted(self.asked)))
        return found


def litmus_tests() -> list[Path]:
    """Return the paths of all litmus tests, sorted."""
    return sorted(FOLDER.glob("*.litmus"))


def digest() -> str:
    """Return the SHA-256 of all litmus tests, which CHECKED names first."""
    return hashlib.sha256(b"".join(path.name.encode() + path.read_bytes() for path in litmus_tests())).hexdigest()


def written(states: set[State]) -> str:
    """Return the states as text, in the format of CHECKED."""
    return " | ".join(" ".join(map(str, state)) for state in sorted(states))
