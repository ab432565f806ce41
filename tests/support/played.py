"""A World of which a test plays parts: what the machine says of its processes and ports, at any time of the test."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import Any

from failstop.procs.world import World


class PlayedWorld(World):
    """Real, but for what is played. Who keeps a function of it asks anew at each call all the same."""

    def __init__(self, **given: Any) -> None:
        super().__init__(**given)
        self._parts: dict[str, Callable[..., Any]] = dict(vars(self))
        for name in self._parts:
            setattr(self, name, partial(self._ask, name))

    def _ask(self, name: str, *arguments: Any) -> Any:
        return self._parts[name](*arguments)

    def play(self, name: str, part: Callable[..., Any]) -> Callable[..., Any]:
        """From now on this is what that field of a World does; returns what did it before."""
        before, self._parts[name] = self._parts[name], part
        return before
