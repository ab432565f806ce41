"""Every single fault: a scenario is run, and at each call of the system the run is forked, once for each fault that may happen
there; the fork goes on with the fault and is judged.

A fork of this process is a copy of the whole simulated machine, so a run costs only what comes after its fault. Clock readings
are no places for a fault: what happens at one is seen by nobody before the next call.
"""

from __future__ import annotations

import errno
import gc
import json
import os
import signal
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from typing import Any

from failstop.lab.machine.kernel import Thread
from failstop.lab.machine.robot import MS
from failstop.lab.machine.scenarios import SCENARIOS
from failstop.lab.machine.stage import Stage

HELD_NS = 300 * MS
ASLEEP_S = 20.0
RUN_S = 30
"""A run that takes longer in real time has gone astray."""
ERRORS: dict[str, tuple[int, ...]] = {
    "write": (errno.EAGAIN,),
    "open": (errno.EMFILE,),
    "spawn": (errno.EAGAIN,),
    "eventfd": (errno.EMFILE,),
    "pidfd_open": (errno.EMFILE,),
    "dup": (errno.EMFILE,),
    "fallocate": (errno.ENOSPC,),
    "sendmsg": (errno.EAGAIN,),
}
"""What a call may be refused with by a machine that is short of something; of a port and a disk there is more."""
PORT_ERRORS = (errno.EAGAIN, errno.EIO)
DISK_ERRORS = (errno.ENOSPC, errno.EIO)


@dataclass
class Place:
    """A call of a scenario's run."""

    number: int
    process: str
    call: str
    where: str


@dataclass
class Found:
    """What a campaign has found."""

    runs: int = 0
    places: int = 0
    violations: list[dict[str, Any]] = field(default_factory=list)
    marks: dict[str, int] = field(default_factory=dict)

    def add(self, result: dict[str, Any]) -> None:
        self.runs += 1
        for name, count in result["marks"].items():
            self.marks[name] = self.marks.get(name, 0) + count
        if result["violations"]:
            self.violations.append(result)


def faults_of(
    stage: Stage, thread: Thread, call: str, about: tuple[Any, ...]
) -> Iterator[tuple[str, Callable[[], None]]]:
    """The faults that may happen at a call, with their names."""
    machine, process = stage.machine, thread.process

    def dies() -> None:
        machine.die(process, -9)

    def held() -> None:
        stage.witness.held(process, HELD_NS)
        machine.hold(process, HELD_NS)

    def sleeps() -> None:
        stage.sleep_machine(ASLEEP_S)

    def refused(number: int) -> Callable[[], None]:
        def raise_it() -> None:
            stage.witness.tell(f"{call} of {process.name} is refused: {os.strerror(number)}")
            raise OSError(number, os.strerror(number))

        return raise_it

    def short() -> None:
        stage.witness.tell(f"{call} of {process.name} is taken by half")
        machine.shortened = True

    yield "dies", dies
    yield "held", held
    if process.name != "player.py":
        yield "sleeps", sleeps
        numbers = ERRORS.get(call, ())
        if call in ("write", "read") and (opened := process.files.get(about[0])):
            kind = type(opened.node).__name__
            if kind == "Port":
                numbers = PORT_ERRORS
                if call == "write":
                    yield "short", short
            elif kind == "Regular":
                numbers = DISK_ERRORS
            elif call == "read":
                numbers = ()
        for number in numbers:
            yield errno.errorcode[number], refused(number)


class Campaign:
    """Every fault at every call of one scenario, or those of one share of the calls; `most`: of one line of code in one
    process, no more calls than that (0: all)."""

    def __init__(self, name: str, *, share: tuple[int, int] = (0, 1), most: int = 0, seed: int = 0) -> None:
        self.name = name
        self._share, self._most, self._seed = share, most, seed
        self._seen: dict[tuple[str, str, str], int] = {}
        self._count = 0
        self._fork: int | None = None
        self.found = Found()
        self.fault = ""
        self._place: Place | None = None
        self.progress: Callable[[Found], None] = lambda found: None
        self.only: tuple[int, str] | None = None
        """One call, by its number, and one fault: without a fork."""

    def run(self) -> Found:
        Stage(SCENARIOS[self.name], self._seed).run()  # every module is compiled before the first fork
        stage = self._stage = Stage(SCENARIOS[self.name], self._seed)
        stage.machine.at_seam = self._at_seam
        gc.collect()
        gc.freeze()
        gc.disable()
        stage.run()
        if self._fork is not None:
            self._report()
        self.found.add(self._result())
        return self.found

    def _at_seam(self, thread: Thread, call: str, about: tuple[Any, ...]) -> None:
        self._count += 1
        if self.only:
            self._only(thread, call, about)
            return
        if self._count % self._share[1] != self._share[0] or thread.process.name == "last.py":
            return
        where = _where()
        key = thread.process.name, call, where
        self._seen[key] = self._seen.get(key, 0) + 1
        if self._most and self._seen[key] > self._most:
            return
        self.found.places += 1
        for fault, inject in faults_of(self._stage, thread, call, about):
            reader, writer = os.pipe()
            child = os.fork()
            if not child:
                os.close(reader)
                signal.alarm(RUN_S)
                self._fork = writer
                self.fault = fault
                self._place = Place(self._count, thread.process.name, call, where)
                self._stage.machine.at_seam = None
                self._stage.witness.tell(f"FAULT: {thread.process.name} {fault} at {call} ({where})")
                inject()
                return
            os.close(writer)
            self._take(child, reader, fault, Place(self._count, thread.process.name, call, where))

    def _only(self, thread: Thread, call: str, about: tuple[Any, ...]) -> None:
        assert self.only
        if self._count == self.only[0]:
            self._stage.machine.at_seam = None
            for fault, inject in faults_of(self._stage, thread, call, about):
                if fault == self.only[1]:
                    self.fault = fault
                    self._place = Place(self._count, thread.process.name, call, _where())
                    self._stage.witness.tell(f"FAULT: {thread.process.name} {fault} at {call} ({_where()})")
                    inject()

    def _take(self, child: int, reader: int, fault: str, place: Place) -> None:
        data = b""
        while piece := os.read(reader, 1 << 16):
            data += piece
        os.close(reader)
        _, status = os.waitpid(child, 0)
        if data:
            self.found.add(json.loads(data))
        else:
            text = f"the run itself ended with {os.waitstatus_to_exitcode(status)}"
            self.found.add(
                {
                    "violations": [text],
                    "marks": {},
                    "place": vars(place),
                    "fault": fault,
                    "scenario": self.name,
                    "story": [],
                }
            )
        self.progress(self.found)

    def _result(self) -> dict[str, Any]:
        witness = self._stage.witness
        return {
            "scenario": self.name,
            "fault": self.fault,
            "place": vars(self._place) if self._place else None,
            "violations": witness.violations,
            "causes": witness.causes,
            "marks": self._stage.marks.counts,
            "story": witness.story if witness.violations else [],
        }

    def _report(self) -> None:
        assert self._fork is not None
        data = json.dumps(self._result()).encode()
        while data:
            data = data[os.write(self._fork, data) :]
        os._exit(0)


def _where() -> str:
    """The line of the service's code that makes the call."""
    frame = sys._getframe(2)
    while frame and "/lab/" in frame.f_code.co_filename:
        frame = frame.f_back  # type: ignore[assignment]
    if not frame:
        return "?"
    path = frame.f_code.co_filename.partition("/failstop/")[2].rpartition("/failstop/")
    return f"{path[2] or path[0]}:{frame.f_lineno}"


def story(result: dict[str, Any]) -> str:
    """A run as people read it."""
    begin_ns = result["story"][0][0] if result["story"] else 0
    lines = [f"{(t_ns - begin_ns) / MS:10.3f} ms  {text}" for t_ns, text in result["story"]]
    place = result["place"]
    head = (
        f"{result['scenario']}: {place['process']} {result['fault']} at call {place['number']}, {place['call']} ({place['where']})"
        if place
        else result["scenario"]
    )
    return "\n".join([head, *(f"  {text}" for text in result["violations"]), *lines])


def main(argv: list[str]) -> int:
    """Try it by hand: scenario, share, most."""
    begun_s = time.perf_counter()
    names = list(SCENARIOS) if argv[0] == "all" else argv[0].split(",")
    total = Found()
    for name in names:
        campaign = Campaign(name, share=(int(argv[1]), int(argv[2])), most=int(argv[3]))
        if len(argv) > 4:
            campaign.only = int(argv[4]), argv[5]
        found = campaign.run()
        total.runs += found.runs
        total.places += found.places
        total.violations += found.violations
        for mark, count in found.marks.items():
            total.marks[mark] = total.marks.get(mark, 0) + count
        print(
            name,
            found.places,
            "places",
            found.runs,
            "runs",
            len(found.violations),
            "wrong",
            f"{time.perf_counter() - begun_s:.1f} s",
            flush=True,
        )
    kinds: dict[str, list[dict[str, Any]]] = {}
    for result in total.violations:
        place = result["place"] or {"process": "-", "call": "-", "where": "-"}
        kinds.setdefault(f"{result['fault']} {place['process']} {result['violations'][0]}", []).append(result)
    for kind, results in sorted(kinds.items(), key=lambda item: -len(item[1])):
        print(len(results), kind, "| e.g.", results[0]["scenario"], results[0]["place"])
    for results in list(kinds.values())[:6]:
        print(story(results[0]))
    return 0


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
