"""`make vm`: the image, a guest for each place of the board, the trials, the table. Exit code 1 when a row is missed.

python -m bench.vm [--only NAME ...] [--keep] [--json FILE]
"""

from __future__ import annotations

import argparse
import contextlib
import dataclasses
import json
import shutil
import sys
import tempfile
import threading
import time
from collections.abc import Callable, Iterator
from pathlib import Path

from bench.vm import guest, image, payload, table
from bench.vm.guest import Guest, GuestError
from bench.vm.image import ImageError
from bench.vm.outside import DO, Scene, journal
from bench.vm.table import INSIDE, OUTSIDE, Result
from failstop.board.sim.client import SimBoard, SimBoardError
from failstop.trial import TrialError, wait_for

UNPACK_S = 200.0
PYTHON = "/srv/venv/bin/python"


class Run:
    """One run: what it found, and who says what."""

    def __init__(self, verbose: bool) -> None:
        self.results: list[Result] = []
        self._verbose = verbose
        self._lock = threading.Lock()
        self._start_s = time.monotonic()

    def say(self, line: str) -> None:
        """A line for who watches, with the time."""
        with self._lock:
            print(f"[{time.monotonic() - self._start_s:5.0f} s] {line}", flush=True)

    def take(self, line: str) -> None:
        """What the trials in a guest print."""
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


def prepared(machine: Guest, run: Run) -> None:
    """The guest goes on from its saved state, and has what is to be tried."""
    machine.start(guest.STATE)
    machine.must("date", "--set", f"@{int(time.time())}")
    machine.must("sh", "-c", payload.UNPACK, timeout_s=UNPACK_S)
    run.say("the guest is ready")


def inside(machine: Guest, names: list[str], run: Run) -> None:
    """The trials in the guest."""
    prepared(machine, run)
    words = ("env", "-C", "/srv/trials", PYTHON, "-u", "-m", "bench.vm.inside", *names)
    for line in machine.lines(*words, timeout_s=1500.0, wait_s=900.0):
        if isinstance(line, str):
            run.take(line)


def outside(machine: Guest, names: list[str], run: Run) -> None:
    """The trials from out here."""
    prepared(machine, run)
    with SimBoard(machine.place / "board", usb=str(machine.board)) as board:
        scene = Scene(machine, board)
        wait_for("the board in the guest", lambda: board.info()["codings"] > 0 or board.info()["connected"], 60.0)
        scene.install()
        run.say("installed in the guest of the boots")
        for name in names:
            try:
                found = DO[name](scene)
                for one in found if isinstance(found, list) else [found]:
                    run.add(one)
            except (TrialError, SimBoardError) as error:
                run.add(Result(name, wrong=[str(error)]))
                for line in journal(scene):
                    run.say(f"  | {line}")


PLACES: dict[str, Callable[[Guest, list[str], Run], None]] = {INSIDE: inside, OUTSIDE: outside}


def main() -> int:
    """Run what is asked for."""
    arguments = _parser().parse_args()
    names = arguments.only or [trial.name for trial in table.TRIALS]
    run = Run(arguments.verbose)
    try:
        made = image.make()
        with _place(arguments.keep) as place:
            disk = payload.make(place / "payload.img")
            saved = guest.state(made, payload.blank(place / "blank.img"))
            _run(made, saved, place, disk, names, run)
    except (ImageError, GuestError) as error:
        print(f"make vm: {error}", file=sys.stderr)
        return 2
    rows = table.rows(run.results, names)
    print(table.markdown(rows))
    if arguments.json:
        Path(arguments.json).write_text(json.dumps([dataclasses.asdict(found) for found in run.results], indent=2))
    return int(any(row.problems for row in rows))


def _run(made: image.Image, saved: Path, place: Path, disk: Path, names: list[str], run: Run) -> None:
    """Every place in a guest of its own, side by side."""

    def serve(where: str) -> None:
        mine = [name for name in names if table.BY_NAME[name].where == where]
        if not mine:
            return
        try:
            with Guest(made, place / where, disk, disk=saved) as machine:
                PLACES[where](machine, mine, run)
        except (GuestError, OSError) as error:
            run.say(f"{where}: {error}")

    threads = [threading.Thread(target=serve, args=(where,)) for where in PLACES]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()


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
    parser.add_argument("--only", nargs="+", metavar="NAME", choices=list(table.BY_NAME), help="only these trials")
    parser.add_argument("--keep", action="store_true", help="keep the guests' disks")
    parser.add_argument("--json", metavar="FILE", help="write the results there too")
    parser.add_argument("--verbose", action="store_true", help="all that the guests say")
    return parser


if __name__ == "__main__":
    sys.exit(main())
