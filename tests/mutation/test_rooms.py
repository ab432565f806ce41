"""The rooms name files that there are."""

from __future__ import annotations

import pytest

from tests.mutation.rooms import ROOMS
from tests.mutation.run import ROOT, matches


@pytest.mark.parametrize("room", ROOMS)
def test_every_pattern_of_a_room_matches(room: str) -> None:
    assert matches(ROOT, ROOMS[room].files)
    assert matches(ROOT, ROOMS[room].tests)


def test_a_pattern_that_matches_nothing_is_named() -> None:
    with pytest.raises(LookupError, match=r"procs/gate/nowhere\.py"):
        matches(ROOT, ("procs/gate/core.py", "procs/gate/nowhere.py"))
