"""The builds of Python whose order of memory was checked, and the ones that are refused."""

from __future__ import annotations

import pytest

from failstop_lab.machine.kernel import Machine
from failstop_lab.machine.loading import Loader


def imported(abiflags: str) -> object:
    """failstop, imported by a Python with these flags of its build."""
    loader = Loader(Machine())
    loader.system["sys"].abiflags = abiflags  # type: ignore[attr-defined]
    return loader.load("failstop")


def test_a_free_threaded_python_is_refused_with_the_remedy() -> None:
    imported("")
    imported("d")  # a debug build
    for flags in ("t", "td"):
        with pytest.raises(ImportError, match=r"free-threaded .*; next: use python3\.\d+ without the t$"):
            imported(flags)
