"""Tested controls: what is taken out of the code and shows on no wheel and no wire of the simulated machine, and the
test that must notice it. The test runs in a copy of the checkout, in which that part is missing."""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

from failstop.api.errors import FailstopError
from failstop_lab.machine.loading import Patches, patched
from failstop_lab.simulate.controls import STOP_PORT_MODULE, SUPERVISOR_MODULE
from failstop_lab.simulate.seeds import commit, used_s

ROOT = Path(__file__).resolve().parents[3]
LATCH_MODULE, PROOF_MODULE = "failstop.supervisor.latch", "failstop.supervisor.proof"
LAYOUT_MODULE, RUN_MODULE = "failstop.messages.layout", "failstop.supervisor.run"
DISTANCE_MODULE = "failstop.api.distance"
NOTICED, PASSED = 1, 0
"""The exit codes of pytest for a test that fails, and for one that passes."""
FAILURES, TOLD_BY = "= FAILURES =", "E   "
"""How pytest begins its part about tests that failed, and a line of what is wrong. A test that can't begin or end, such
as one without its fixture, is an error of another part, and notices nothing."""
MOST_SAID = 160
TEST_S = 300


@dataclass(frozen=True)
class ByTest:
    """`row`: what is taken out; `claims`: the claims (lab/case/claims.py) that rest on it."""

    row: str
    test: str
    patches: Patches
    claims: tuple[str, ...]


TESTED = (
    ByTest(
        "the stop tool writes no stop",
        "tests/procs/test_stop_tool.py::test_the_tool_writes_the_burst_and_takes_nobody_s_port",
        (
            (
                "failstop.stop_tool",
                "        stop_port.burst()\n        stop_port.repeat(board.repeats_ns[SUPERVISOR_ROW])\n",
                "",
            ),
        ),
        ("SEVERAL-1",),
    ),
    ByTest(
        "the service ends without a stop",
        "tests/supervisor/test_ending.py"
        "::test_the_end_is_a_stop_that_is_heard_then_every_process_ended_then_another_stop",
        (
            (SUPERVISOR_MODULE, "        self._raise_epoch([stop])\n        while", "        while"),
            (SUPERVISOR_MODULE, "written = self._burst() > 0", "written = True"),
        ),
        ("END-1",),
    ),
    ByTest(
        "a stop does not stop the arm",
        "tests/procs/test_port_owner_arm.py::test_every_stop_has_the_arm_s_behind_it",
        ((STOP_PORT_MODULE, ' + (board.arm.stops(servos) if board.arm else b"")', ""),),
        ("ARM-1",),
    ),
    ByTest(
        "a later cause replaces the first one",
        "tests/supervisor/test_stops.py::test_the_first_noticed_of_those_that_came_first_is_latched",
        (
            (
                LATCH_MODULE,
                "        if self.stop is None:\n            self.stop, self.since",
                "        if True:\n            self.stop, self.since",
            ),
        ),
        ("CAUSE-1",),
    ),
    ByTest(
        "the answer to a ping from before the stop acknowledges the stop",
        "tests/supervisor/test_proof.py::test_a_ping_from_before_the_stop_proves_nothing",
        ((PROOF_MODULE, "sent_ns < self.stop.written_ns or not self.stop.written_ns:", "not self.stop.written_ns:"),),
        ("PROOF-1",),
    ),
    ByTest(
        "every user may write into a client's memory",
        "tests/safety/test_table.py::test_row",
        (
            (LAYOUT_MODULE, "CLIENTS_WRITE = 0o660", "CLIENTS_WRITE = 0o666"),
            (RUN_MODULE, "create=True, mode=0o660", "create=True, mode=0o666"),
        ),
        ("ACCESS-1",),
    ),
    ByTest(
        "the stopping distance leaves out the braking",
        "tests/lab/case/test_distance.py::test_every_screen_tells_the_way_that_the_wheels_make",
        ((DISTANCE_MODULE, "speed_mps * seconds + speed_mps**2 / (2 * braking_mps2)", "speed_mps * seconds"),),
        ("DISTANCE-1",),
    ),
)


@dataclass(frozen=True)
class Noticed:
    """How the test of a control ended: `wrong` is what it said; empty if it noticed nothing."""

    control: ByTest
    took_s: float
    wrong: str
    story: str
    commit: str

    def text(self) -> str:
        """One line of the table."""
        told = f"`{self.control.test}`" if self.wrong else f"NOT FOUND by `{self.control.test}`"
        return f"| {self.control.row} | {told} | {self.took_s:.1f} | {self.wrong} | {self.commit} |"


def copied(to: Path, patches: Patches) -> None:
    """Copy what git knows of the checkout, and change it. Raises FailstopError: this is no checkout, or there is no
    git; ValueError for a patch of what is not there."""
    try:
        words = ("git", "-C", str(ROOT), "ls-files", "-z", "--cached", "--others", "--exclude-standard")
        listed = subprocess.run(words, capture_output=True, check=True).stdout
    except (OSError, subprocess.CalledProcessError):
        raise FailstopError(f"the tests are in a checkout, and {ROOT} is none: clone the repository") from None
    for name in filter(None, map(os.fsdecode, listed.split(b"\0"))):
        if (ROOT / name).is_file() or (ROOT / name).is_symlink():
            (to / name).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy2(ROOT / name, to / name, follow_symlinks=False)
    for module in dict.fromkeys(module for module, _, _ in patches):
        path = to.joinpath(*module.split(".")).with_suffix(".py")
        path.write_text(patched(module, path.read_text("utf-8"), patches), "utf-8")


def search(control: ByTest) -> Noticed:
    """Run its test on the changed code. Raises FailstopError if the test can't be run."""
    begun_s = used_s()
    with tempfile.TemporaryDirectory(prefix="failstop-control-") as folder:
        copied(Path(folder), control.patches)
        words = (sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", "-p", "no:xdist", control.test)
        done = subprocess.run(words, cwd=folder, capture_output=True, text=True, check=False, timeout=TEST_S)
    _, failed, told = done.stdout.partition(FAILURES)
    if done.returncode != (NOTICED if failed else PASSED):
        raise FailstopError(f"{control.test} can't be run: {done.stdout[-MOST_SAID:] or done.stderr[-MOST_SAID:]}")
    said = [line.removeprefix(TOLD_BY).strip() for line in told.splitlines() if line.startswith(TOLD_BY)]
    wrong = " ".join(said[:1]).removeprefix("AssertionError: ")[:MOST_SAID].replace("|", "\\|") or "it fails"
    return Noticed(control, used_s() - begun_s, wrong if failed else "", done.stdout, commit())


def searched(wanted: Callable[[ByTest], bool]) -> Iterator[Noticed]:
    """All that are wanted, one after the other."""
    yield from (search(control) for control in TESTED if wanted(control))
