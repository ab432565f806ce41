"""A plugin of pytest for mutmut's copy: mutants of modules that are loaded on a simulated machine are tried as well.

A mutated function asks mutmut at each call which mutant is meant, also in a copy of its module that a machine has
loaded: there mutmut is the real one, which asks the real machine, and the code under test sees nothing of it. A mutant
is named after its module, and all copies have the same name: whichever a test calls is noted, and mutated.

A source with its mutants beside it is not patched, since each piece of it is there many times: a test that does so is
left out.
"""

from __future__ import annotations

from types import CodeType

import pytest

from failstop_lab.machine import loading


def pytest_configure() -> None:
    loading.HARMLESS.add("mutmut")
    compiled = loading._compiled

    def or_left_out(name: str, patches: loading.Patches = ()) -> tuple[CodeType, bool]:
        try:
            return compiled(name, patches)
        except ValueError as error:
            pytest.skip(f"it patches: {error}")

    loading._compiled = or_left_out
