"""A barrier: a held lock's release, then its acquire."""

from __future__ import annotations

import pytest

from failstop.shm.words import Barrier


def test_a_barrier_releases_before_it_acquires(monkeypatch: pytest.MonkeyPatch) -> None:
    """The other way around orders nothing: model/arm/barrier-control-reversed.litmus."""
    done = []

    class Lock:
        def acquire(self) -> None:
            done.append("acquire")

        def release(self) -> None:
            done.append("release")

    monkeypatch.setattr("failstop.shm.words._thread.allocate_lock", Lock)
    barrier = Barrier()
    assert done == ["acquire"], "held from the start"
    barrier()
    barrier()
    assert done[1:] == ["release", "acquire"] * 2
