"""Each stand-in has the public names of the module that it stands in for, and calls take what they take there."""

from __future__ import annotations

import ast
import importlib
import inspect
from types import ModuleType
from typing import Any

import pytest

from failstop_lab.machine.calls import Calls
from failstop_lab.machine.kernel import Machine
from failstop_lab.machine.stand_ins import stand_ins

STAND_INS = stand_ins(Calls(Machine()))
LEFT_OUT = {
    "failstop.shm.futex": {"NO_DUMP", "leave_no_dump"},
    "failstop.procs.rights": {"STACK_BYTES"},
    "failstop.procs.starved": {"starved"},
    "failstop.shm.thread_state": set[str](),
    "failstop.board.own": {"LIMIT_S", "SAYS"},
    "failstop.helpers": {"import_elsewhere", "python", "search_path"},
}
"""Names of these modules that the service uses nowhere but in themselves."""


def own(module: ModuleType) -> dict[str, Any]:
    """The public names that a module defines itself."""
    found: set[str] = set()
    for node in ast.parse(inspect.getsource(module)).body:
        if isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            found.add(node.name)
        elif isinstance(node, ast.Assign):
            found |= {target.id for target in node.targets if isinstance(target, ast.Name)}
    return {name: getattr(module, name) for name in found if not name.startswith("_") and name != "TYPE_CHECKING"}


@pytest.mark.parametrize("name", STAND_INS)
def test_a_stand_in_has_each_public_name_of_its_module(name: str) -> None:
    real = own(importlib.import_module(name))
    assert real
    missing = {each for each in real if not hasattr(STAND_INS[name], each)}
    assert missing == LEFT_OUT[name]


@pytest.mark.parametrize("name", STAND_INS)
def test_a_stand_in_has_each_number_of_its_module(name: str) -> None:
    numbers = {each: value for each, value in own(importlib.import_module(name)).items() if isinstance(value, int)}
    there = {each: getattr(STAND_INS[name], each) for each in numbers if hasattr(STAND_INS[name], each)}
    assert bool(there) == bool(numbers)
    assert all(numbers[each] == value for each, value in there.items())


def test_the_futex_has_each_method_of_the_real_one() -> None:
    real, other = (
        module.Futex for module in (importlib.import_module("failstop.shm.futex"), STAND_INS["failstop.shm.futex"])
    )
    for name, method in vars(real).items():
        if name.startswith("_") or not callable(method):
            continue
        assert list(inspect.signature(method).parameters) == list(inspect.signature(getattr(other, name)).parameters)


@pytest.mark.parametrize("name", STAND_INS)
def test_a_function_takes_as_many_arguments_as_the_real_one(name: str) -> None:
    for each, real in own(importlib.import_module(name)).items():
        other = getattr(STAND_INS[name], each, None)
        if not inspect.isfunction(inspect.unwrap(real)) or other is None or not inspect.isfunction(other):
            continue
        least = [
            parameter
            for parameter in inspect.signature(real).parameters.values()
            if parameter.default is parameter.empty
        ]
        inspect.signature(other).bind(*(None for _ in least))
