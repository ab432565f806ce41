"""A barrier: a held lock's release, then its acquire."""

from __future__ import annotations

from types import SimpleNamespace


def test_a_barrier_releases_before_it_acquires(on: SimpleNamespace) -> None:
    """The other way around orders nothing: model/aarch64/barrier-control-reversed.litmus."""
    done = []

    class Lock:
        def acquire(self) -> None:
            done.append("acquire")

        def release(self) -> None:
            done.append("release")

    on.system["_thread"].allocate_lock = Lock
    barrier = on.load("failstop.shm.words").Barrier()
    assert done == ["acquire"], "held from the start"
    barrier()
    barrier()
    assert done[1:] == ["release", "acquire"] * 2

    class View:
        def __getitem__(self, where: slice) -> bytes:
            return bytes(where.stop - where.start)

        def __setitem__(self, where: slice, data: bytes) -> None:
            done.append("store")

    writer = on.load("failstop.shm.cell").RingWriter(View(), 0, 8, 2, 1)
    done.clear()
    writer.put(b"x")
    assert done == ["release", "acquire", "store"], "before what its entry's reader sees"
