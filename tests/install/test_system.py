"""A system as it is looked at, and its programs: what is asked of them."""

from __future__ import annotations

from pathlib import Path

import pytest

from failstop.install import InstallError, plan, system
from failstop.install.rows import EXTRAS
from failstop.install.system import System


@pytest.mark.starts
def test_every_unit_that_can_be_installed_is_looked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that runs and is not seen would be left running by an uninstall."""
    systemctl = tmp_path / "systemctl"
    systemctl.write_text('#!/bin/sh\nfor word; do echo "$word loaded active running"; done\n')
    systemctl.chmod(0o755)
    monkeypatch.setattr(system, "PATH", f"{tmp_path}:/bin")
    assert {*plan.active(System())} >= {"failstop.service", "failstop@*.service", *(extra.source for extra in EXTRAS)}
    assert plan.active(System(str(tmp_path))) == (), "where nothing runs nobody is asked"


@pytest.mark.starts
def test_a_program_that_is_not_there_and_one_that_fails_are_named() -> None:
    machine = System()
    with pytest.raises(InstallError, match="no-such-program is not on this machine"):
        machine.run(("no-such-program",))
    with pytest.raises(InstallError, match=r"^sh -c echo why >&2; exit 3: why$"):
        machine.run(("sh", "-c", "echo why >&2; exit 3"))
    machine.run(("sh", "-c", "exit 3"), accepted=(0, 3))


def test_accounts_are_read_as_they_are(tmp_path: Path) -> None:
    found = System(str(tmp_path))
    assert found.accounts("passwd") == {}
    assert "anna" not in found.members("dialout")
    (tmp_path / "etc").mkdir()
    (tmp_path / "etc/group").write_bytes(b"root:x:0:\ndialout:x:20:anna,b\xe9la\n\n+nis\n")
    assert found.accounts("group").keys() == {"root", "dialout"}
    assert "anna" in found.members("dialout")
