"""Stacks: the part of `greenlet` that the simulated machine uses, for Python in a browser.

A browser suspends a WebAssembly stack at a promise (JavaScript Promise Integration), and Pyodide keeps Python's own
state for each: a greenlet is such a stack. The page's archive has this module as `greenlet`.
"""

from __future__ import annotations

import itertools
from collections.abc import Callable

from pyodide.code import run_js
from pyodide.ffi import create_proxy, run_sync

_begin = run_js(
    "(body) => Promise.resolve().then(() => body.callPromising()).catch(console.error).finally(() => body.destroy())"
)
"""Begins a stack once the caller's is suspended: Python's frames of the two are then never linked."""
_swap = run_js("""
(() => {
  const gates = new Map();
  return (me, other) => {
    const gate = Promise.withResolvers();
    if (me) gates.set(me, gate.resolve);
    gates.get(other)?.();
    gates.delete(other);
    return gate;
  };
})()""")
"""Opens the gate of one stack, by its number; returns that of another, which is to wait. 0: none waits."""
_numbers = itertools.count(1)


class GreenletExit(BaseException):
    """The end of a greenlet, without a report."""


class greenlet:
    """A stack of its own. Its `parent` goes on at its end."""

    def __init__(self, run: Callable[[], object] | None = None, parent: greenlet | None = None) -> None:
        self._body = run
        self.parent = parent
        self._begun = self._ended = False
        self._number = next(_numbers)
        self._thrown: BaseException | None = None

    def switch(self) -> None:
        """Go on there; returns when somebody switches back. Raises what was thrown there."""
        global _current
        me, _current = _current, self
        if me is self:
            return
        gate = _swap(me._number, self._number)
        if not self._begun:
            self._begun = True
            _begin(create_proxy(self._run))
        run_sync(gate.promise)
        if me._thrown:
            thrown, me._thrown = me._thrown, None
            raise thrown

    def throw(self, kind: type[BaseException]) -> None:
        """Raise it there, where the greenlet waits; one that has not begun ends."""
        if self._begun and not self._ended:
            self._thrown = kind()
            self.switch()
        self._begun = self._ended = True

    def _run(self) -> None:
        global _current
        assert self._body
        assert self.parent
        try:
            self._body()
        except GreenletExit:
            pass
        finally:
            self._ended = True
            _current = self.parent
            _swap(0, self.parent._number)


_current = greenlet()
_current._begun = True


def getcurrent() -> greenlet:
    """The greenlet that runs."""
    return _current
