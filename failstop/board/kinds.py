"""Kinds: the boards that are described in a folder of their own, by the name of it."""

from __future__ import annotations

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.board.wire import Wire

KINDS = ("arduino", "hoverboard", "ugv")


def wire_of(kind: str) -> Wire:
    """The description of one of KINDS. Nothing of another board is imported."""
    if kind not in KINDS:
        raise ValueError(f"no board {kind!r}: it must be one of {', '.join(KINDS)}")
    wire: Wire = __import__(f"failstop.board.{kind}.wire", fromlist=["WIRE"]).WIRE
    return wire
