"""Boards: which one answers at a port, and what it says of itself. Questions that move no wheel, behind a stop."""

from __future__ import annotations

import contextlib
import os
import time

from failstop.board import asking
from failstop.board.interface import BY_WHEELS, HEARD_BATTERY, HEARD_IMU, HEARD_WHEELS, Board
from failstop.board.kinds import board_of, is_own
from failstop.board.port import PortError, set_speed
from failstop.board.tap import Tap
from failstop.policy.layouts import BOARDS
from failstop.setup.talk import Left, NotAnAnswer, Talk
from failstop.supervisor.port_handover import OwnPort

LIVE_S = 2.0
ASK_S = 0.1


def kind_check(answer: str) -> str:
    """A kind of board. Raises NotAnAnswer."""
    if answer in BOARDS or is_own(answer):
        return answer
    raise NotAnAnswer(f"type {', '.join(BOARDS)}, or the path of a folder of your own")


def step(talk: Talk, path: str) -> tuple[str, int]:
    """The second step: the board's kind, and its baud rate, if that is not the usual one (0: it is). Raises Left."""
    talk.step(2, "The board")
    wanted = talk.given.get("board") or talk.draft.answers.get("board", "")
    if wanted:
        wanted = talk.ask("board", "Which board is it?", "", kind_check)
    talk.say("Each kind of board is asked what it is. No wheel turns by that; a stop goes first.")
    kinds = dict.fromkeys([*([wanted] if wanted else []), *BOARDS])
    try:
        boards = {kind: board_of(kind, 1.0, 0.0) for kind in kinds}
        with contextlib.closing(OwnPort.open_and_stop(path, next(iter(boards.values())))) as own:
            heard = asking.seek(own.fd, boards, time.monotonic_ns(), strangers=bool(wanted) and is_own(wanted))
            first = next(iter(boards))
            known, text, remedy = asking.told_of(heard, first, boards[first])
            kind = heard[-1].kind if heard[-1].known else first if known is None else ""
            if not kind:
                sought = text if wanted or heard[-1].missing else f"no board that failstop knows answers at {path}"
                talk.draft.forget("board", "port")
                raise Left(f"{sought}; look at {remedy}")
            if wanted and kind != wanted:
                talk.draft.forget("board")
                raise Left(f"{text}: give --board {kind}, or plug the other board in")
            baud = heard[-1].other_baud if heard[-1].known else 0
            board = board_of(kind, 1.0, 0.0, baud=baud)
            talk.say(f"It is {board.name} ({kind}){f', at {baud} baud' if baud else ''}.")
            if heard[-1].firmware:
                talk.say(f"Its firmware is {heard[-1].firmware}.")
            talk.draft.keep("board", kind)
            _live(talk, own.fd, board)
    except OSError as error:
        raise Left(f"{path} went away ({error.strerror}): is the plug in?") from None
    except (PortError, ValueError) as error:
        raise Left(str(error) if os.path.exists(path) else f"{path} went away: is the plug in?") from None
    return kind, baud


def _live(talk: Talk, fd: int, board: Board) -> None:
    """Show its reports, for a moment."""
    set_speed(fd, board.port)
    tap = Tap(fd, board)
    counts = {HEARD_IMU: 0, HEARD_WHEELS: 0, HEARD_BATTERY: 0}
    volts = None
    until_s = time.monotonic() + LIVE_S
    while time.monotonic() < until_s:
        if board.pings:
            with contextlib.suppress(BlockingIOError):
                tap.ping()
        time.sleep(ASK_S)
        for _, kind, said in tap.read():
            if kind in counts:
                counts[kind] += 1
            if kind == HEARD_BATTERY:
                volts = said[0] / 1000
    if volts is not None:
        talk.say(f"battery   {volts:.1f} V")
    for kind, what in ((HEARD_IMU, "IMU"), (HEARD_WHEELS, "wheels")):
        if counts[kind]:
            talk.say(f"{what:<9} {counts[kind] / LIVE_S:.0f} reports a second")
    if board.observed_by != BY_WHEELS:
        talk.say("It does not report its wheels: you will be asked what they do.")
