"""Fit: whether the board that the settings name takes what they drive."""

from __future__ import annotations

from failstop.board.interface import Board
from failstop.board.kinds import board_of
from failstop.policy.kinematics import max_wheel_rps
from failstop.policy.setting import SettingError
from failstop.policy.settings import Settings


def checked_board(settings: Settings, path: str | None) -> Board:
    """The board of the settings of this file. Raises SettingError for one that does not take what they drive, and
    OwnBoardError."""
    board, kind = board_of(*settings.board()), settings.text("board.kind")
    if board.wheels != settings.speeds:
        layout = settings.text("wheels.layout")
        text = f"board.kind {kind} takes {board.wheels} speeds, and wheels.layout {layout} has {settings.speeds} wheels"
        raise SettingError(f"{path or 'settings'}: {text}")
    if (fastest := max_wheel_rps(settings)) > board.most_rps:
        text = f"the board takes {board.most_rps:.3g} turns of a wheel a second, and the limits are {fastest:.3g}"
        raise SettingError(f"{path or 'settings'}: {text}: lower [limits], or see board.per_rps")
    return board
