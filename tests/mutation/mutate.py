"""mutmut's command line, for run.py, in the copy: how its mutants are made here, and how each is tried.

And one command more: `changes` takes a JSON list of mutants' names from stdin, and prints an object of their diffs.
"""

from __future__ import annotations

import json
import os
import sys
from collections.abc import Iterable
from typing import Any

# What the tests start finds the copy first.
os.environ["PYTHONPATH"] = os.pathsep.join(map(os.path.abspath, ("mutants", "mutants/lab")))

from alone import BROKEN, alone, possible  # its neighbour: this file is run by its path
from mutmut.__main__ import cli
from mutmut.mutation import file_mutation, mutators
from mutmut.mutation.diff_apply import find_mutant, get_diff_for_mutant
from mutmut.runners.harness import BadTestExecutionCommandsException, PytestRunner
from mutmut.state import state
from mutmut.workers.isolation import ForkServerRunner

# Texts are left as they are: tests/docs holds what is said, and "XX..." is no decision.
file_mutation.mutation_operators = [it for it in mutators.mutation_operators if it[1] is not mutators.operator_string]

FAILED = 1
_run_tests, _submit = PytestRunner.run_tests, ForkServerRunner.submit


def run_tests(self: PytestRunner, *, mutant_name: str | None, tests: Iterable[str]) -> int:
    """A mutant's tests run alone, none of them long; those of the code as it is (no name) as always."""
    if mutant_name is None:
        return _run_tests(self, mutant_name=mutant_name, tests=tests)
    os.environ["PYTEST_TIMEOUT"] = "45"  # the longest takes a quarter of that

    def tried() -> int:
        try:
            return _run_tests(self, mutant_name=mutant_name, tests=tests)
        except BadTestExecutionCommandsException:
            return BROKEN
        except Exception:  # pytest's, of what a test that failed has left open
            return FAILED

    return alone(tried, separate=SEPARATE)


def submit(self: ForkServerRunner, mutant_name: str, tests: list[str], *rest: Any) -> None:
    """The fast tests first: the first failure is the end."""
    _submit(self, mutant_name, sorted(tests, key=lambda test: state().duration_by_test[test]), *rest)


PytestRunner.run_tests, ForkServerRunner.submit = run_tests, submit

if __name__ == "__main__":
    SEPARATE = possible()
    if sys.argv[1] == "run" and not SEPARATE:
        print("no PID namespace for the mutants, which takes root: one may signal any process of this user", flush=True)
    if sys.argv[1:] == ["changes"]:
        names = json.load(sys.stdin)
        print(json.dumps({name: get_diff_for_mutant(name, path=find_mutant(name).path) for name in names}))
    else:
        cli()
