"""What a release fetches is locked, by version and hash, and fits what failstop says that it needs."""

from __future__ import annotations

import re
import sys

import pytest
from packaging.requirements import Requirement

from tests.support.deb import lock, versions
from tests.support.pages import ROOT

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

TEXT = """\
# Made by `make lock`
a==1.0 \\
    --hash=sha256:aa \\
    --hash=sha256:bb
b==2.0 ; python_full_version < '3.11' \\
    --hash=sha256:cc
"""


def test_a_lock_is_read_for_one_python() -> None:
    locked = lock.read(TEXT)
    assert lock.needed(locked, "3.10") == "a==1.0 --hash=sha256:aa --hash=sha256:bb\nb==2.0 --hash=sha256:cc\n"
    assert lock.needed(locked, "3.14") == "a==1.0 --hash=sha256:aa --hash=sha256:bb\n"
    assert lock.needed(locked, "3.10", ("a",)) == "b==2.0 --hash=sha256:cc\n"


@pytest.mark.parametrize("python", versions.VERSIONS)
def test_everything_that_the_package_carries_is_locked(python: str) -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    wanted = project["dependencies"] + [line for name in lock.EXTRAS for line in project["optional-dependencies"][name]]
    lines = lock.needed(lock.read(lock.PLACE.read_text()), python).splitlines()
    found = {line.partition("==")[0]: line.partition("==")[2].partition(" ")[0] for line in lines}
    assert all(re.search(r" --hash=sha256:[0-9a-f]{64}", line) for line in lines)
    for requirement in map(Requirement, wanted):
        if requirement.marker is None or requirement.marker.evaluate({"python_version": python}):
            assert requirement.specifier.contains(found[requirement.name]), requirement
