"""Boards: sends the board a stop, finds out which board is connected to a port, and shows what the board reports. No
wheel turns."""

from __future__ import annotations

import contextlib
import os
import time

from failstop.board import asking
from failstop.board.facts import USUAL_CAN_ID
from failstop.board.interface import BY_WHEELS, HEARD_BATTERY, HEARD_IMU, HEARD_WHEELS, Board
from failstop.board.kinds import board_of, facts_of, is_own
from failstop.board.port import PortError, set_speed
from failstop.board.tap import Tap
from failstop.policy.layouts import BOARDS
from failstop.setup.talk import Left, NotAnAnswer, Talk
from failstop.supervisor.port_handover import OwnPort

CAN_ID, HIGHEST_CAN_ID, NONE = "board.can_id", 253, "none"
LIVE_S = 2.0
ASK_S = 0.1


def kind_check(answer: str) -> str:
    """Check that the answer is a kind of board, or the path of a folder with your own board. Raises NotAnAnswer."""
    if answer in BOARDS or is_own(answer):
        return answer
    raise NotAnAnswer(f"type {', '.join(BOARDS)}, or the path of your own board's folder")


def can_id_check(answer: str) -> str:
    """Check the answer to the question about the CAN id of the second motor's controller. It must be a number or the
    word none. Raises NotAnAnswer."""
    text = answer.strip().lower()
    if text == NONE or (text.isdigit() and int(text) <= HIGHEST_CAN_ID):
        return text
    raise NotAnAnswer(f"type a number from 0 to {HIGHEST_CAN_ID}, or {NONE}")


def step(talk: Talk, path: str) -> tuple[str, dict[str, object]]:
    """Find out which kind of board is connected to the port `path`, as the second step of the setup. Returns the kind,
    and the board's settings that differ from the defaults (baud rate, CAN id). Raises Left."""
    talk.step(2, "The board")
    wanted = talk.given.get("board") or talk.draft.answers.get("board", "")
    if wanted:
        wanted = talk.ask("board", "Which board is it?", "", kind_check)
    talk.say("failstop sends a stop, then asks which board it is. No wheel turns.")
    kinds = dict.fromkeys([*([wanted] if wanted else []), *BOARDS])
    try:
        boards = {kind: board_of(kind, 1.0, 0.0) for kind in kinds}
        with contextlib.closing(OwnPort.open_and_stop(path, next(iter(boards.values())))) as own:
            heard = asking.seek(own.fd, boards, time.monotonic_ns(), strangers=bool(wanted) and is_own(wanted))
            first = next(iter(boards))
            known, text, remedy = asking.told_of(heard, first, boards[first])
            last = heard[-1]
            lone = bool(last.missing) and _has_can(last.kind)
            kind = last.kind if last.known or lone else first if known is None else ""
            if not kind:
                sought = text if wanted or heard[-1].missing else f"no board that failstop knows answers at {path}"
                talk.draft.forget("board", "port")
                raise Left(f"{sought}; {remedy}")
            if wanted and kind != wanted:
                talk.draft.forget("board")
                raise Left(f"{text}: give --board {kind}, or plug in the other board")
            baud = heard[-1].other_baud if heard[-1].known else 0
            found: dict[str, object] = {"board.baud": baud} if baud else {}
            if lone:
                found |= _second(talk, own.fd, kind)
            board = board_of(kind, 1.0, 0.0, baud=baud, can_id=int(str(found.get(CAN_ID, USUAL_CAN_ID))))
            talk.say(f"It is {board.name} ({kind}){f', at {baud} baud' if baud else ''}.")
            if heard[-1].firmware:
                talk.say(f"Its firmware is {heard[-1].firmware}.")
            talk.draft.keep("board", kind)
            _live(talk, own.fd, board)
    except OSError as error:
        raise Left(f"{path} has disappeared ({error.strerror}): is the board plugged in?") from None
    except (PortError, ValueError) as error:
        raise Left(
            str(error) if os.path.exists(path) else f"{path} has disappeared: is the board plugged in?"
        ) from None
    return kind, found


def _has_can(kind: str) -> bool:
    facts = facts_of(kind)
    return bool(facts and facts.can)


def _second(talk: Talk, fd: int, kind: str) -> dict[str, object]:
    """Ask a person for the CAN id of the second motor's controller, which does not answer at the usual id. Returns the
    setting, or nothing if the robot has only one motor. Raises Left, OSError."""
    talk.say(f"The controller at the port answers, but no second one answers at CAN id {USUAL_CAN_ID}.")
    question = f"What is the CAN id of the second one? (VESC Tool shows it; {NONE}: there is only one motor)"
    answer = talk.ask("can_id", question, "", can_id_check)
    if answer == NONE:
        return {}
    board = board_of(kind, 1.0, 0.0, can_id=int(answer))
    if asking.ask(Tap(fd, board), board, stop=True) is None:
        talk.draft.forget("can_id")
        raise Left(f"no controller answers at CAN id {answer}; {asking.SERVO_PLACES}")
    return {CAN_ID: int(answer)}


def _live(talk: Talk, fd: int, board: Board) -> None:
    """Watch the board for LIVE_S, then show its battery voltage and how often it reports."""
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
        talk.say("It does not report what its wheels do, so setup will ask you.")
