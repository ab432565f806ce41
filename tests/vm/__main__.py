"""`make vm`: the image, the guests, the trials, the table. Exit code 1 when a row is missed.

python -m tests.vm [--only NAME ...] [--keep] [--json FILE]
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import functools
import json
import resource
import shutil
import signal
import sys
import tempfile
import threading
import time
import traceback
from collections.abc import Callable, Iterator
from pathlib import Path
from typing import Any

from failstop_lab.sim.client import SimBoard, SimBoardError
from failstop_lab.trial import TrialError
from tests.vm import guest, image, payload, table
from tests.vm.guest import Guest, GuestError
from tests.vm.image import ImageError
from tests.vm.outside import DO, IMU_HZ, Scene, journal
from tests.vm.table import INSIDE, OUTSIDE, Result

UNPACK_S = 200.0
INSTALLED = "installed"
"""The state of the guest with failstop installed."""
PYTHON = "/srv/venv/bin/python"


class Run:
    """One run: what it found, and who says what."""

    def __init__(self) -> None:
        self.results: list[Result] = []
        self._lock = threading.Lock()
        self._start_s = time.monotonic()
        self._phases: list[str] = []

    def say(self, line: str) -> None:
        """A line for who watches, with the time."""
        with self._lock:
            print(f"[{time.monotonic() - self._start_s:5.0f} s] {line}", flush=True)

    @contextlib.contextmanager
    def phase(self, name: str) -> Iterator[None]:
        """A part of the run, whose time is told of at the end."""
        start_s = time.monotonic()
        try:
            yield
        finally:
            self._phases.append(f"{name} {time.monotonic() - start_s:.0f}")

    def times(self) -> str:
        """Where the time went; what the processor did for it is to be seen only when every guest has ended."""
        used = resource.getrusage(resource.RUSAGE_CHILDREN)
        whole_s = time.monotonic() - self._start_s
        return f"{whole_s:.0f} s, of a processor {used.ru_utime + used.ru_stime:.0f}: {', '.join(self._phases)}"

    def take(self, line: str) -> None:
        """The lines that the trials in a guest print."""
        try:
            fields = json.loads(line)
            found = table.result(fields)
        except (ValueError, TypeError):
            self.say(line)
            return
        self.add(found)

    def add(self, found: Result) -> None:
        """A result."""
        self.results.append(found)
        ms = "" if found.ms is None else f" {found.ms:.1f} ms"
        wrong = f" WRONG: {'; '.join(found.wrong)}" if found.wrong else ""
        self.say(f"{found.trial}:{ms} missed {found.missed} after {found.after} {found.note}{wrong}")


def install(machine: Guest, run: Run) -> None:
    """The guest goes on from its saved state, gets what is to be tried and installs it, which is the first trial.
    Raises GuestError if the package is not installed then, because no other trial can pass without it."""
    with run.phase("start"):
        machine.start(guest.STATE)
        machine.must("date", "--set", f"@{int(time.time())}")
        machine.must("sh", "-c", payload.UNPACK, timeout_s=UNPACK_S)
    run.say("the guest is ready")
    with run.phase("install"):
        inside(machine, ["install"], run)
        machine.must("dpkg", "--status", "failstop")


def inside(machine: Guest, names: list[str], run: Run) -> None:
    """The trials in the guest."""
    words = ("env", "-C", "/srv/trials", PYTHON, "-u", "-m", "tests.vm.inside", *names)
    for line in machine.lines(*words, timeout_s=2400.0, wait_s=2700.0) if names else ():
        if isinstance(line, str):
            run.take(line)


def judged(name: str, do: Callable[[], Result | list[Result]]) -> list[Result]:
    """The results of one trial. One that breaks is reported by itself, whatever broke: the others are still run."""
    try:
        found = do()
    except (TrialError, SimBoardError, GuestError) as error:
        found = Result(name, wrong=[str(error)])
    except Exception as error:
        at = traceback.extract_tb(error.__traceback__)[-1]
        found = Result(name, wrong=[f"it could not be judged: {type(error).__name__} in {at.name}: {error}"])
    return found if isinstance(found, list) else [found]


def outside(machine: Guest, names: list[str], run: Run) -> None:
    """The trials from out here."""
    machine.start(INSTALLED)
    with SimBoard(machine.place / "board", usb=str(machine.board), imu_hz=IMU_HZ) as board:
        scene = Scene(machine, board)
        scene.found()
        scene.command()
        for name in names:
            for one in judged(name, functools.partial(DO[name], scene)):
                run.add(one)
                for line in journal(scene) if one.wrong and not machine.ended(0.0) else ():
                    run.say(f"  | {line}")


def main() -> int:
    """Run what is asked for."""
    arguments = _parser().parse_args()
    wanted = {"install", *(arguments.only or table.USUAL)}
    names = [name for name in table.TRIAL_BY_NAME if name in wanted]
    run = Run()
    shutil.rmtree(guest.LOGS, ignore_errors=True)
    # However it is ended, the guests end with it.
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(128 + signal.SIGTERM))
    try:
        with _place(arguments.keep) as place:
            with run.phase("preparing"):
                made = image.make()
                disk = payload.make(place / "payload.img")
                saved = guest.state(made, payload.blank(place / "blank.img"))
            _run(made, saved, place, disk, names, run)
    except (ImageError, GuestError) as error:
        print(f"make vm: {error}", file=sys.stderr)
        return 2
    rows = table.rows(run.results, names)
    print(table.markdown(rows))
    print(run.times())
    if any(row.problems for row in rows):
        print(f"what the guests said: {guest.LOGS.absolute()}")
    if arguments.json:
        Path(arguments.json).write_text(json.dumps([dataclasses.asdict(found) for found in run.results], indent=2))
    return int(any(row.problems for row in rows))


def _run(made: image.Image, saved: Path, place: Path, disk: Path, names: list[str], run: Run) -> None:
    """Install in one guest; from there on a guest for each place of the board, side by side."""
    mine = {
        where: [name for name in names if table.TRIAL_BY_NAME[name].where == where and name != "install"]
        for where in (INSIDE, OUTSIDE)
    }

    def serve_outside(state: Path) -> None:
        for number, life in enumerate(table.lives(mine[OUTSIDE])):
            try:
                with (
                    run.phase(f"{OUTSIDE} {number}"),
                    _guest(made, place, f"{OUTSIDE}{number}", disk, disk=state) as machine,
                ):
                    outside(machine, life, run)
            except (GuestError, SimBoardError, TrialError, OSError) as error:
                run.say(f"{OUTSIDE}: {error}")

    with _guest(made, place, INSIDE, disk, disk=saved, clock=guest.LEAPS) as machine:
        install(machine, run)
        thread = None
        if mine[OUTSIDE]:
            thread = threading.Thread(target=serve_outside, args=(machine.fork(INSTALLED),), daemon=True)
            thread.start()
        try:
            with run.phase(INSIDE):
                inside(machine, mine[INSIDE], run)
        except GuestError as error:
            run.say(f"{INSIDE}: {error}")
    if thread is not None:
        thread.join()


def _guest(made: image.Image, place: Path, name: str, tried: Path, **options: Any) -> Guest:
    return Guest(made, place / name, guest.LOGS / name, tried, **options)


@contextlib.contextmanager
def _place(keep: bool) -> Iterator[Path]:
    """A folder for the run's disks; kept for who wants to look at the journal in them."""
    # Sockets have short names, so not below the cache.
    place = Path(tempfile.mkdtemp(prefix="failstop-vm-"))
    try:
        yield place
    finally:
        if keep:
            print(f"kept: {place}", flush=True)
        else:
            shutil.rmtree(place)


def _parser() -> argparse.ArgumentParser:
    parser = argparse.ArgumentParser(prog="make vm", description="The service on a stock Debian with a real USB port.")
    parser.add_argument(
        "--only",
        nargs="+",
        metavar="NAME",
        choices=list(table.TRIAL_BY_NAME),
        help="only these trials, after `install`",
    )
    parser.add_argument("--keep", action="store_true", help="keep the guests' disks")
    parser.add_argument("--json", metavar="FILE", help="write the results there too")
    return parser


if __name__ == "__main__":
    sys.exit(main())
