"""The one command that grants the rights, where the service runs."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from failstop.shm.heartbeat import EARLY_NEWS, REALTIME
from failstop.supervisor import grant


@pytest.mark.parametrize(
    ("unit", "container", "told"),
    [
        ("", False, "`sudo prlimit --pid $$ --rtprio=40 --memlock=unlimited`"),
        ("", True, "`--cap-add SYS_NICE --cap-add IPC_LOCK --ulimit rtprio=40 --ulimit memlock=-1`"),
        ("failstop.service", False, "`sudo systemctl edit failstop.service`, with LimitRTPRIO=40 and LimitMEMLOCK="),
        ("failstop@left.service", True, "`sudo systemctl edit failstop@left.service`"),
    ],
)
def test_the_command_fits_the_case(unit: str, container: bool, told: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(grant, "own_unit", lambda: unit)
    monkeypatch.setattr(grant, "in_container", lambda: container)
    assert told in grant.advice(realtime=False, managed=bool(unit))
    assert "give it" not in grant.advice(realtime=True, managed=bool(unit))


def test_each_is_one_line() -> None:
    assert "\n" not in "".join((grant.UNIT, grant.CONTAINER, grant.SHELL, grant.GRANTED))


@pytest.mark.parametrize("sign", ["/.dockerenv", "/run/.containerenv", "variable", ""])
def test_a_container_is_known_by_its_signs(sign: str, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os.path, "exists", lambda path: path == sign)
    monkeypatch.delenv(grant.CONTAINER_VARIABLE, raising=False)
    if sign == "variable":
        monkeypatch.setenv(grant.CONTAINER_VARIABLE, "podman")
    assert grant.in_container() is bool(sign)


@pytest.mark.parametrize(
    ("groups", "unit"),
    [
        ("0::/system.slice/failstop.service\n", "failstop.service"),
        ("1:cpu:/\n0::/user.slice/user-1000.slice/user@1000.service/app.slice/robot.service\n", "robot.service"),
        ("0::/\n", "UNIT"),
    ],
)
def test_the_unit_is_that_of_the_control_group(
    groups: str, unit: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "cgroup").write_text(groups)
    monkeypatch.setattr(grant, "CONTROL_GROUP", str(tmp_path / "cgroup"))
    assert grant.own_unit() == unit
    monkeypatch.setattr(grant, "CONTROL_GROUP", str(tmp_path / "absent"))
    assert grant.own_unit() == "UNIT"


def test_what_is_lacking_is_told_of() -> None:
    realtime = ("SCHED_FIFO", f"{grant.NO_REALTIME}; give it rights")
    early_news = ("robust futexes", grant.NO_EARLY_NEWS)
    assert grant.lacking(0, "give it rights") == [realtime, early_news]
    assert grant.lacking(REALTIME, "give it rights") == [early_news]
    assert grant.lacking(EARLY_NEWS, "give it rights") == [realtime]
    assert grant.lacking(REALTIME | EARLY_NEWS, "give it rights") == []
