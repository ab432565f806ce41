"""`make wheels` asks for what pyproject.toml needs, for each Python that it allows; only there the index is asked."""

from __future__ import annotations

import re
from pathlib import Path
from types import ModuleType
from typing import Any

import pytest

from tests.support.commands import script

ROOT = Path(__file__).resolve().parent.parent


@pytest.fixture(scope="module")
def wheels() -> ModuleType:
    return script(ROOT / "packaging" / "wheels.py")


def test_every_python_that_is_allowed_is_asked_for(wheels: Any) -> None:
    project = (ROOT / "pyproject.toml").read_text()
    named = re.findall(r"Programming Language :: Python :: (3\.\d+)", project)
    assert list(wheels.PYTHONS) == named
    assert f'requires-python = ">={named[0]},<3.{int(named[-1][2:]) + 1}"' in project


def test_a_condition_is_of_the_python_that_is_asked_for(wheels: Any) -> None:
    dependencies = ["numpy>=1.24", "tomli>=2.0; python_version < '3.11'"]
    assert wheels.needed(dependencies, "3.10") == ["numpy>=1.24", "tomli>=2.0"]
    assert wheels.needed(dependencies, "3.11") == ["numpy>=1.24"]


def test_what_has_no_wheel_is_named(wheels: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    class Done:
        def __init__(self, command: list[str]) -> None:
            assert "--only-binary=:all:" in command
            assert "manylinux_2_28_aarch64" in command
            self.returncode = int(command[-1].startswith("numpy"))

    monkeypatch.setattr(wheels.subprocess, "run", lambda command, **_: Done(command))
    assert wheels.missing(["numpy>=1.24", "msgpack>=1.1"], "3.12", "aarch64", "/tmp") == ["numpy>=1.24"]
