"""The subcommands of `failstop`: each module has add_arguments(parser) and main(arguments) -> exit code."""

from __future__ import annotations

from argparse import ArgumentParser, ArgumentTypeError
from math import inf
from typing import TYPE_CHECKING

from failstop.policy.setting import SettingError

if TYPE_CHECKING:
    from failstop.board.interface import Board
    from failstop.policy.settings import Settings


def add_name(parser: ArgumentParser) -> None:
    """The option that chooses the instance."""
    parser.add_argument("--name", default="failstop", help="the service's name (default: failstop)")


def board_for(settings: Settings, path: str | None) -> Board:
    """The board of the settings of this file. Raises SettingError for one that does not take what they drive, and
    OwnBoardError."""
    from failstop.board.kinds import board_of
    from failstop.policy.kinematics import max_wheel_rps  # `failstop run` has written the first stop by now

    board, kind = board_of(*settings.board()), settings.text("board.kind")
    if board.wheels != settings.speeds:
        layout = settings.text("wheels.layout")
        text = f"board.kind {kind} takes {board.wheels} speeds, and wheels.layout {layout} has {settings.speeds} wheels"
        raise SettingError(f"{path or 'settings'}: {text}")
    if (fastest := max_wheel_rps(settings)) > board.most_rps:
        text = f"the board takes {board.most_rps:.3g} turns of a wheel a second, and the limits are {fastest:.3g}"
        raise SettingError(f"{path or 'settings'}: {text}: lower [limits], or see board.per_rps")
    return board


def seconds(text: str) -> float:
    """How long something is to last, as an option says it."""
    try:
        found = float(text)
    except ValueError:
        found = inf
    if not 0 < found < inf:
        raise ArgumentTypeError(f"{text} is no time in seconds: give a number above 0, such as 2")
    return found
