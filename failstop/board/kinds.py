"""Kinds: the boards that failstop knows, each by the folder of this room that describes it."""

from __future__ import annotations

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.board.interface import Board
    from failstop.board.wire import Wire

KINDS = ("arduino", "hoverboard", "ugv")
"""Those that a Wire describes."""


def wire_of(kind: str) -> Wire:
    """The description of one of KINDS. Nothing of another board is imported."""
    if kind not in KINDS:
        raise ValueError(f"no board {kind!r}: it must be one of {', '.join(KINDS)}")
    wire: Wire = __import__(f"failstop.board.{kind}.wire", fromlist=["WIRE"]).WIRE
    return wire


def board_of(kind: str, diameter_m: float, per_rps: float) -> Board:
    """The board of the setting board.kind. `per_rps`: a wheel's speed of one turn a second in its own unit; 0: as such
    boards usually have it. Nothing of another board is imported."""
    if kind in KINDS:
        from failstop.board.described import Described

        wire = wire_of(kind)
        return Described(wire, per_rps or wire.motion.per_rps(diameter_m))
    board: Board = __import__(f"failstop.board.{kind}.board", fromlist=["board"]).board(diameter_m, per_rps)
    return board
