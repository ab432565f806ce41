"""Interlocks: named conditions that a client asserts and must keep asserting, such as an arm in its drive pose. Pure.

Enabling motion needs all of them, and losing one disables.
"""

from __future__ import annotations

from failstop.procs.gate.stamps import believed_ns


class Interlocks:
    """When each condition was asserted last."""

    __slots__ = ("_asserted_ns", "_declared")

    def __init__(self, declared: dict[str, tuple[int, str]]) -> None:
        """`declared`: name -> (timeout in ns, the refusal's text)."""
        self._declared = declared
        self._asserted_ns: dict[str, int] = {}

    def hold(self, names: list[str], t_ns: int, now_ns: int) -> None:
        """A client says that these conditions hold; names that no setting declares mean nothing, nor does a
        stamp from the future."""
        for name in names:
            if name in self._declared:
                self._asserted_ns[name] = max(self._asserted_ns.get(name, 0), believed_ns(t_ns, now_ns))

    def unmet(self, now_ns: int) -> str:
        """The refusal's text of the first condition that does not hold; empty when all do."""
        for name, (timeout_ns, refusal) in self._declared.items():
            asserted_ns = self._asserted_ns.get(name)
            if asserted_ns is None or now_ns - asserted_ns > timeout_ns:
                return refusal
        return ""
