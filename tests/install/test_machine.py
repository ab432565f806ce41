"""The programs of the system: what is asked of them."""

from __future__ import annotations

from pathlib import Path

import pytest

from failstop.install import machine
from failstop.install.rows import EXTRAS


@pytest.mark.starts
def test_every_unit_that_can_be_installed_is_looked_for(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """One that runs and is not seen would be left running by an uninstall."""
    systemctl = tmp_path / "systemctl"
    systemctl.write_text('#!/bin/sh\nfor word; do echo "$word loaded active running"; done\n')
    systemctl.chmod(0o755)
    monkeypatch.setattr(machine, "PATH", f"{tmp_path}:/bin")
    found = set(machine.active_units())
    assert found >= {"failstop.service", "failstop@*.service", *(extra.source for extra in EXTRAS)}
