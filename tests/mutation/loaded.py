"""A plugin of pytest for mutmut's copy: mutants of modules that are loaded on a simulated machine are tried as well.

A mutated function asks mutmut at each call which mutant is meant. mutmut is the real one there too: it asks the real
machine, of which the code under test sees nothing. A mutant's name is that of its module, which is the same for each copy
that is loaded, so whatever copy of a function a test calls, it is noted and mutated.
"""

from __future__ import annotations

from failstop.lab.machine import loading


def pytest_configure() -> None:
    loading.HARMLESS.add("mutmut")
