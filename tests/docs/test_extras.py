"""Nobody is told to install a package of a name that no index has."""

from __future__ import annotations

import re
import subprocess
import sys

import pytest

from failstop import extras
from tests.support.pages import ROOT

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

SHOWN = (".py", ".md", ".js", ".html", ".service", ".toml")
AN_INDEX_S = re.compile(r"pip install (?:-\S+ )*['\"]?failstop\b")


def test_nobody_is_told_to_install_failstop_from_an_index() -> None:
    listed = subprocess.run(["git", "-C", str(ROOT), "ls-files"], capture_output=True, text=True, check=True).stdout
    paths = [ROOT / name for name in listed.splitlines() if name.endswith(SHOWN)]
    assert len(paths) > 300
    told = [
        f"{path.relative_to(ROOT)}: {line.strip()}"
        for path in paths
        if path.is_file() and not path.is_relative_to(ROOT / "tests")
        for line in path.read_text().splitlines()
        if AN_INDEX_S.search(line)
    ]
    assert told == []


@pytest.mark.parametrize("extra", sorted(extras.PACKAGES))
def test_the_packages_of_an_extra_are_those_of_the_build(extra: str) -> None:
    declared = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]["optional-dependencies"][extra]
    assert sorted(re.split(r"[<>=\[ ]", row)[0] for row in declared) == sorted(extras.PACKAGES[extra])


def test_what_is_missing_is_told_for_an_environment_without_pip() -> None:
    told = extras.missing("a plot needs matplotlib", "plots", pip=False)
    assert f"there is no pip in {sys.prefix}: do it on a machine" in told


def test_what_is_missing_is_told_for_this_environment() -> None:
    told = extras.missing("the page needs tornado", "web", pip=True)
    assert told == f"the page needs tornado: {sys.executable} -m pip install segno tornado"
    assert extras.missing("the page needs tornado", "web").startswith("the page needs tornado")
