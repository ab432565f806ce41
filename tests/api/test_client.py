"""A client's side of shared memory: when it wakes the gate."""

from __future__ import annotations

import pytest

from failstop.api import client as client_module
from failstop.api.client import REPEAT_NS, Client
from failstop.shm import bell
from failstop_lab.trial import Trial

MS = 1_000_000


def test_what_repeats_the_command_just_before_it_wakes_nobody(trial: Trial, monkeypatch: pytest.MonkeyPatch) -> None:
    rings: list[bytes] = []
    now_ns = 0
    client = Client(trial.name, "test")
    send = bell.send

    def noted(fd: int, hint: bytes) -> None:
        rings.append(hint)
        send(fd, hint)

    monkeypatch.setattr(bell, "send", noted)
    monkeypatch.setattr(client_module, "monotonic_ns", lambda: now_ns)

    def rung(vx_mps: float, elapsed_ns: int, *, manual: bool = False, source: str = "cmd_vel") -> bool:
        nonlocal now_ns
        now_ns += elapsed_ns
        rings.clear()
        client.command(vx_mps, 0.0, 0.0, manual=manual, source=source)
        return bool(rings)

    assert rung(0.1, 0)
    assert not rung(0.1, 20 * MS)
    assert not rung(0.1, REPEAT_NS)
    assert rung(0.1, REPEAT_NS + 1), "a pause"
    assert rung(0.2, 20 * MS)
    assert rung(0.1, 20 * MS)
    assert rung(0.1, 20 * MS, manual=True)
    assert rung(0.1, 20 * MS, source="nav")
    assert not rung(0.1, 20 * MS, source="nav")
    monkeypatch.undo()
    client.close()
