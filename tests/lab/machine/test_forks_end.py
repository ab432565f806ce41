"""A fork of a campaign ends as one: whatever is raised in it, or in the process that waits for it."""

from __future__ import annotations

import subprocess
import sys

PROGRAM = """\
import os
from failstop_lab.simulate import single_faults
from failstop_lab.simulate.single_faults import Explorer, Plan

me = os.getpid()


class Raises(Explorer):
    def {where}(self, *arguments):
        if {when}:
            raise {what}
        return super().{where}(*arguments)


try:
    result = Raises(Plan("drive_and_stop", most=1, fault="EIO", first=True)).explore()
    print("result", result.wrong[0].violations)
except KeyboardInterrupt:
    print("raised")
assert os.getpid() == me, "a fork went on as the program"
print("end of", os.getpid() == me)
"""


def program(where: str, when: str, what: str) -> list[str]:
    text = PROGRAM.format(where=where, when=when, what=what)
    done = subprocess.run([sys.executable, "-c", text], capture_output=True, text=True, timeout=120, check=True)
    return done.stdout.splitlines()


def test_a_fork_in_which_something_is_raised_is_a_run_that_is_wrong() -> None:
    assert program("_judged", "os.getpid() != me", "KeyboardInterrupt") == [
        "result ['the simulation itself ended with 1']",
        "end of True",
    ]


def test_an_interrupt_while_it_waits_for_a_fork_makes_no_other_fork() -> None:
    assert program("_collect", "os.getpid() == me", "KeyboardInterrupt") == ["raised", "end of True"]
