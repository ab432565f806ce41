"""Checks that the board named in the settings can do what the settings ask of it."""

from __future__ import annotations

from math import pi

from failstop.board.interface import Board
from failstop.board.kinds import board_of, facts_of, is_described, wire_of
from failstop.policy.kinematics import max_wheel_rps
from failstop.policy.proofs import observer
from failstop.policy.setting import SettingError
from failstop.policy.settings import BY_KEY, Settings

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Collection


def checked_board(settings: Settings, path: str | None) -> Board:
    """The board that the settings name. `path`: the settings file, for error messages. Raises SettingError if the board
    can't do what the settings ask of it. Raises OwnBoardError if your own board's description has an error."""
    board, kind = board_of(*settings.board()), settings.text("board.kind")
    if 0 < (baud := int(settings["board.baud"])) < (usual := usual_baud(kind)):
        text = (
            f"board.baud = {baud}: board.kind {kind} has {usual}, and a stop would take longer than its repeats allow"
        )
        raise SettingError(f"{path or 'settings'}: {text}: set 0, or build the firmware for {usual} or more")
    if board.wheels != settings.speeds:
        layout = settings.text("wheels.layout")
        text = f"board.kind {kind} takes {board.wheels} speeds, and wheels.layout {layout} has {settings.speeds} wheels"
        raise SettingError(f"{path or 'settings'}: {text}")
    if wrong := wrong_limits(settings, board):
        raise SettingError(f"{path or 'settings'}: {wrong}")
    _check_refresh(settings, path)
    return board


def wrong_limits(settings: Settings, board: Board) -> str:
    """Why the board can't turn the wheels as the speed limits in the settings ask, and what helps. Empty if it can."""
    if (fastest := max_wheel_rps(settings)) > board.most_rps:
        text = f"the board takes {board.most_rps:.3g} turns of a wheel a second, and the limits are {fastest:.3g}"
        return f"{text}: lower [limits], or see board.per_rps"
    turn_m = pi * settings["wheels.diameter_m"]
    if fastest * turn_m < (slowest := slowest_mps(settings)):
        text = f"the board's smallest speed of a wheel is {slowest:.2g} m/s, and the limits are {fastest * turn_m:.2g}"
        return f"{text}: raise [limits], or see board.per_rps"
    return ""


def unused(settings: Settings, board: Board, given: Collection[str] = ()) -> list[tuple[str, str]]:
    """The settings that ask for a protection which this board can't give: (problem, remedy) for each. `given`: the keys
    that the user has set, if they are known. They matter for a setting that has no value for "off"."""
    kind = settings.text("board.kind")
    facts = facts_of(kind)
    found = []
    if (least_mv := settings["battery.stop_mv"]) >= 0 and facts and not facts.battery:
        text = f"battery.stop_mv = {least_mv:g} never stops the robot, because board.kind {kind} reports no battery"
        found.append((text, "remove it, and watch the battery in another way"))
    if settings.text("still.command") and not observer(board.observed_by, imu=settings.on("board.imu")):
        text = f'still.command never runs, because with board.imu = "off" nothing on board.kind {kind} shows whether'
        found.append((f"{text} the wheels turn", 'set board.imu = "on" if the robot has an IMU, or remove it'))
    # The description of your own board has no word for keys.
    if _is_set("key.stop", settings, given) and not (facts and facts.keys):
        text = f"key.stop = {settings['key.stop']:g} never stops the robot, because board.kind {kind} reports no keys"
        found.append((text, "remove it, and use an emergency stop switch"))
    if settings.on("buzzer.tones") and not board.buzzer(1000, 100, 100, 1):
        text = f'buzzer.tones = "on" warns nobody, because board.kind {kind} has no buzzer that failstop knows'
        found.append((text, "remove it"))
    return found


def _is_set(key: str, settings: Settings, given: Collection[str]) -> bool:
    return key in given or settings[key] != BY_KEY[key].default


def _check_refresh(settings: Settings, path: str | None) -> None:
    """Check that the board's own watchdog does not stop the wheels between two frames. Twice in its time a frame must
    be due, because one may be late. Raises SettingError."""
    kind, refresh_s = settings.text("board.kind"), settings["gate.refresh_s"]
    acts_ns = wire_of(kind).watchdog.acts_ns if is_described(kind) else 0
    if 0 < acts_ns < 2 * settings.ns("gate.refresh_s"):
        text = f"gate.refresh_s = {refresh_s:g} s: the board's own watchdog stops the wheels {acts_ns / 1e9:g} s after"
        most = f"set gate.refresh_s to {acts_ns / 2e9:g} or less"
        raise SettingError(f"{path or 'settings'}: {text} the last frame: {most}")


def usual_baud(kind: str) -> int:
    """The usual baud rate of a board of the kind `kind`."""
    return board_of(kind, 1.0, 0.0).port.baud


def slowest_mps(settings: Settings) -> float:
    """The slowest speed that the board can give a wheel, in m/s at the wheel's rim. The board rounds a slower speed to
    zero. Returns 0 if the board accepts any speed."""
    return board_of(*settings.board()).step_rps * pi * settings["wheels.diameter_m"]
