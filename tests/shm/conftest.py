"""Fixtures of the shared memory tests: names that no other run on this machine uses, and their removal."""

from __future__ import annotations

import itertools
import os
from collections.abc import Iterator
from types import SimpleNamespace

import pytest

from failstop.messages import segments
from failstop.shm.segment import Segment

from . import simulated
from .dying import RUN, lifelines

_numbers = itertools.count()


@pytest.fixture
def name() -> Iterator[str]:
    """An instance name of this test alone; its segments are gone afterwards."""
    unique = f"t{os.getpid()}x{next(_numbers)}"
    yield unique
    segments.unlink_all(unique)


@pytest.fixture
def lines(name: str) -> Segment:
    """The lines of every block, as one of the service's processes sees them."""
    segments.create(name, "lifelines", RUN).close()
    return lifelines(name)


@pytest.fixture
def on() -> SimpleNamespace:
    """A simulated machine, with failstop's modules as the test's process has them."""
    return simulated.machine()


@pytest.fixture
def bases(on: SimpleNamespace) -> list[str]:
    """The three candidate directories of a user, who is the test; none is made yet, and each can be."""
    on.os.chmod("/run", 0o1777)
    on.os.makedirs(f"/run/user/{simulated.USER}")
    on.os.chown(f"/run/user/{simulated.USER}", simulated.USER, simulated.USER)
    on.own.uid = on.own.gid = simulated.USER
    found: list[str] = on.instance.bases()
    return found


@pytest.fixture
def fds() -> Iterator[list[int]]:
    opened: list[int] = []
    yield opened
    for fd in opened:
        os.close(fd)
