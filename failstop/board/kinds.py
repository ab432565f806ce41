"""Kinds: the kinds of boards that failstop knows. Each kind has a folder that describes it. The folder is
in failstop/board, or it is your own."""

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
"""The kinds of boards in failstop/board that are described by a Wire."""
ALL_KINDS = ("rrc", *KINDS)
"""All kinds of boards in failstop/board. The usual kind comes first."""
SAME_PER_RPS = 0.01
"""Two scales count as equal if they differ by less than this share, because people write them with few digits."""


def is_own(kind: str) -> bool:
    """True if `kind` is a path, which names the folder of your own board."""
    return kind.startswith("/")


def is_described(kind: str) -> bool:
    """True if this kind of board is described by a Wire."""
    return kind in KINDS or is_own(kind)


def facts_of(kind: str) -> Facts | None:
    """Return the facts about one of ALL_KINDS, or None for your own board. No other board's modules are imported."""
    if kind not in ALL_KINDS:
        return None
    facts: Facts = __import__(f"failstop.board.{kind}.facts", fromlist=["FACTS"]).FACTS
    return facts


def wire_of(kind: str, *, tried: bool = False, speeds: int = 0, can_id: int = USUAL_CAN_ID) -> Wire:
    """Return the description of one of KINDS, or of your own board. Raises ValueError.

    Set `tried` if the parent process has already tested your own board (own.py). `speeds` is how many speeds a frame
    sets, or 0 for the usual number. `can_id` is the CAN id of the second motor. `speeds` and `can_id` matter only for a
    kind with several descriptions. No other board's modules are imported."""
    if is_own(kind):
        from failstop.board import own

        return own.wire(kind, tried=tried)
    if kind not in KINDS:
        raise ValueError(f"no board {kind!r}: it must be one of {', '.join(KINDS)}")
    module = __import__(f"failstop.board.{kind}.wire", fromlist=["WIRE"])
    made: Wire = module.wire(speeds, can_id) if hasattr(module, "wire") else module.WIRE
    return made


def watchdog_of(kind: str) -> tuple[float, str]:
    """Return (seconds, action) for the board's own watchdog: how long after the last motion it acts, and ZERO, COAST or
    DISARM of wire.py. Returns (0, "") for a board without a watchdog. Your own board also gets (0, ""), because its
    folder is not loaded here."""
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
    """Make the board of the setting board.kind. Raises OwnBoardError, which is a ValueError.

    `per_rps`: how many of the board's speed units make one wheel turn per second; 0 means the usual number. `steering`:
    the servo of a steered base, or None. `confirmed_per_rps`: the `per_rps` that somebody has confirmed by turning a
    wheel, or 0. `baud`: the baud rate of the board's firmware; 0 means the usual rate. `can_id`: the CAN id of the
    second motor, if there is one. `speeds`, `tried`: as for wire_of(). No other board's modules are imported."""
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
    """True if the scale of `board` may be wrong. A scale that equals `confirmed_per_rps` is certain. The usual scale is
    also certain if the board fixes it (Motion.scale_known), or if the board's reports would reveal an error
    (Reports.own_scale). A number that is only written in the settings is not certain."""
    if isclose(board.per_rps, confirmed_per_rps, rel_tol=SAME_PER_RPS):
        return False
    usual = isclose(board.per_rps, wire.motion.per_rps(diameter_m), rel_tol=SAME_PER_RPS)
    return not (usual and (wire.motion.scale_known or board.reports.own_scale))
