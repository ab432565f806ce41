"""The unit of the robot in its fleet."""

from __future__ import annotations

import re
from pathlib import Path

import pytest

from failstop.install.rows import FLEET
from tests.systemd.units import OLDEST, SINCE, SYSTEMD, analyze, needs_analyze, settings

UNIT = FLEET.source

LATER = {"Type": 240, "After": 1, "Description": 1, "DynamicUser": 235, "LoadCredential": 247, "StateDirectory": 235}
LATER |= {"PrivateDevices": 209, "RestrictAddressFamilies": 211, "RestrictRealtime": 231}


@needs_analyze
def test_verify_finds_nothing(tmp_path: Path) -> None:
    text = (SYSTEMD / UNIT).read_text()
    (tmp_path / UNIT).write_text(text.replace("/opt/failstop/bin/failstop", "/bin/true"))
    done = analyze("verify", "--man=no", str(tmp_path / UNIT))
    assert (done.returncode, done.stdout + done.stderr) == (0, "")


@needs_analyze
def test_exposure(tmp_path: Path) -> None:
    text = (SYSTEMD / UNIT).read_text()
    (tmp_path / UNIT).write_text(text.replace("/opt/failstop/bin/failstop", "/bin/true"))
    done = analyze("security", "--offline=true", "--no-pager", "--threshold=100", str(tmp_path / UNIT))
    if "offline" in done.stderr:
        pytest.skip("this systemd-analyze judges no files (--offline)")
    found = re.search(r"exposure level for \S+: ([\d.]+)", done.stdout)
    assert found, done
    assert float(found[1]) <= 2.0


def test_it_can_not_drive_and_the_service_does_not_need_it() -> None:
    found = settings(UNIT)
    given = dict(found)
    assert not {"PartOf", "Requires", "BindsTo", "Wants", "SupplementaryGroups", "Group", "User"} & set(given)
    assert (given["DynamicUser"], given["Restart"]) == ("yes", "always")
    assert [key for key, _ in found if {**SINCE, **LATER}.get(key, 999) > OLDEST] == []
