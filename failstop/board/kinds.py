"""Kinds: the boards that failstop knows. Each is described by a folder, which is in failstop/board or is your own."""

from __future__ import annotations

from math import isclose

from failstop.board.facts import USUAL_CAN_ID

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.board.described import Described
    from failstop.board.facts import Facts, SteeringServo
    from failstop.board.interface import Board
    from failstop.board.wire import Wire

KINDS = ("arduino", "damiao", "feetech", "hoverboard", "ugv", "vesc")
"""The boards in failstop/board that a Wire describes."""
ALL_KINDS = ("rrc", *KINDS)
"""All boards in failstop/board, the usual one first."""
SAME_PER_RPS = 0.01
"""Two scales that differ by less than this share count as equal, because they are written with few digits."""


def is_own(kind: str) -> bool:
    """True for a path, which names the folder of your own board."""
    return kind.startswith("/")


def is_described(kind: str) -> bool:
    """True if a Wire describes this kind of board."""
    return kind in KINDS or is_own(kind)


def facts_of(kind: str) -> Facts | None:
    """What the settings need to know about one of ALL_KINDS; None for a board in your own folder. Imports the facts of
    that board only."""
    if kind not in ALL_KINDS:
        return None
    facts: Facts = __import__(f"failstop.board.{kind}.facts", fromlist=["FACTS"]).FACTS
    return facts


def wire_of(kind: str, *, tried: bool = False, speeds: int = 0, can_id: int = USUAL_CAN_ID) -> Wire:
    """The description of one of KINDS, or of your own board. `tried`: it was loaded before this process was started, so
    no child process has to try it first (own.py); `speeds`: how many speeds a frame sets (0: as usual), `can_id`: the
    second motor's, for a board with several descriptions. Imports nothing of other boards. Raises ValueError."""
    if is_own(kind):
        from failstop.board import own

        return own.wire(kind, tried=tried)
    if kind not in KINDS:
        raise ValueError(f"no board {kind!r}: it must be one of {', '.join(KINDS)}")
    module = __import__(f"failstop.board.{kind}.wire", fromlist=["WIRE"])
    made: Wire = module.wire(speeds, can_id) if hasattr(module, "wire") else module.WIRE
    return made


def watchdog_of(kind: str) -> tuple[float, str]:
    """The board's own watchdog: after how many seconds it acts (0: it has none), and what it does, as one of wire.py's
    words. For your own board this is not looked up."""
    if kind not in KINDS:
        return 0.0, ""
    watchdog = wire_of(kind).watchdog
    return watchdog.acts_ns / 1e9, watchdog.does if watchdog.acts_ns else ""


def board_of(
    kind: str,
    diameter_m: float,
    per_rps: float,
    steering: SteeringServo | None = None,
    confirmed_per_rps: float = 0.0,
    baud: int = 0,
    can_id: int = USUAL_CAN_ID,
    speeds: int = 0,
    *,
    tried: bool = False,
) -> Board:
    """The board of the setting board.kind. `per_rps`: one turn of a wheel per second in the board's unit; 0: as usual
    for such boards. `steering`: the servo of a steered base; None if there is none. `confirmed_per_rps`: the `per_rps`
    that somebody has confirmed by turning a wheel; 0: none. `baud`: the baud rate with which its firmware was built; 0:
    as usual. `can_id`: the id of the second motor, if it is connected by CAN. `speeds`, `tried`: as for wire_of().
    Nothing of another board is imported. Raises OwnBoardError, a ValueError."""
    if is_described(kind):
        from failstop.board.described import Described, SteeredBoard

        wire = wire_of(kind, tried=tried, speeds=speeds, can_id=can_id)
        made = Described(wire, per_rps or wire.motion.per_rps(diameter_m), diameter_m, baud)
        if steering and wire.steering:
            made = SteeredBoard(wire, made.per_rps, diameter_m, baud, wire.steering(steering))
        made.scale_assumed = _assumed(wire, made, diameter_m, confirmed_per_rps)
        return made
    board: Board = __import__(f"failstop.board.{kind}.board", fromlist=["board"]).board(diameter_m, per_rps, steering)
    return board


def _assumed(wire: Wire, board: Described, diameter_m: float, confirmed_per_rps: float) -> bool:
    """True if nobody knows that the scale of `board` is right. A number that a person wrote into the settings was not
    tried, and a confirmed number does not count for another one."""
    if isclose(board.per_rps, confirmed_per_rps, rel_tol=SAME_PER_RPS):
        return False
    usual = isclose(board.per_rps, wire.motion.per_rps(diameter_m), rel_tol=SAME_PER_RPS)
    return not (usual and (wire.motion.scale_known or board.reports.own_scale))
