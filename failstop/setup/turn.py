"""Turn: finds out the scale, which says how many of the board's speed units make one wheel turn per second. Some boards
know it. For all others, this needs a person.

Many boards use the same scale for commanded and for reported speeds. Comparing these speeds shows nothing, because they
agree even if the scale is wrong. So a person turns a wheel by hand, and the board's counts show the true scale. If that
is not possible, failstop drives a wheel slowly, and the person counts its turns.
"""

from __future__ import annotations

import contextlib
import os
import time
from collections.abc import Mapping

from failstop.board.interface import HEARD_WHEELS, Board
from failstop.board.kinds import board_of
from failstop.board.port import PortError, set_speed
from failstop.board.tap import Tap
from failstop.policy.scale import CAPS, PER_RPS, PER_RPS_CONFIRMED
from failstop.policy.settings import BY_KEY, Settings
from failstop.setup.halt import Halt
from failstop.setup.rig import Rig, alone, rim_mps
from failstop.setup.talk import NO, Left, NotAnAnswer, Talk, number
from failstop.supervisor.port_handover import OwnPort

KEY = "per_rps"
UNKNOWN = "unknown"
SLOWEST_MPS = min(CAPS["limits.vx_mps"], CAPS["limits.vy_mps"])
"""How fast the rim of a wheel moves while a person counts the wheel's turns, m/s. It is the highest speed that is
allowed before a person has confirmed the scale."""
SECONDS = 10.0
ASK_S = 0.1
REPORTS_S = 3.0
LEAST_COUNTS = 4.0
"""A wheel has turned if its position has changed by at least this many counts. A smaller change is play or noise."""
OTHERS = 0.2
"""While a person turns one wheel, each other wheel may move this share of that wheel's counts. If another wheel has
moved further, the person has turned two wheels."""
MOST_TURNS = 100.0


def asked(
    talk: Talk, device: str, values: Mapping[str, object], halt: Halt, speeds: int, *, single: bool = True
) -> dict[str, object]:
    """Ask a person for the scale. Returns the setting board.per_rps and, if a wheel was turned to find it, the setting
    that confirms it. Returns no settings if the board knows its scale, or if the person does not know it.

    `speeds` is the number of wheel speeds in a frame of the board. `single`: True if setup can turn a single wheel of
    this board. Raises Left.
    """
    settings = Settings(dict(values))
    board = board_of(*settings.board())
    if not board.scale_assumed:
        return {}
    talk.say("How far a wheel turns depends on its motor and its encoder, and the board does not know it.")
    before = talk.draft.answers.get(KEY)
    if KEY in talk.given:
        answer = talk.ask(KEY, "", "", _check, keep=False)
    elif before:
        answer = talk.ask(KEY, "", "", _check)
    else:
        if talk.silent:
            raise Left(f"there is no terminal to ask you at: give --per-rps, a number or {UNKNOWN}")
        found = by_hand(talk, device, board) if board.reports.position_per_turn else None
        if not (found or single):
            raise Left(f"setup can't turn a single wheel of your board: give --per-rps, a number or {UNKNOWN}")
        answer = before = found or driven(talk, device, settings, halt, speeds, board)
        talk.draft.keep(KEY, answer)
    if answer == UNKNOWN:
        talk.warn(f"Speeds stay capped at {SLOWEST_MPS:g} m/s until it is known.", "run setup again and turn a wheel")
        return {}
    if answer != before:
        talk.warn(
            f"No wheel was turned to confirm this number, so speeds stay capped at {SLOWEST_MPS:g} m/s.",
            "run setup without --per-rps and turn a wheel",
        )
        return {PER_RPS: float(answer)}
    return {PER_RPS: float(answer), PER_RPS_CONFIRMED: float(answer)}


def _check(answer: str) -> str:
    """Check that the answer is an allowed value of board.per_rps, or UNKNOWN. Raises NotAnAnswer."""
    if answer == UNKNOWN:
        return answer
    declared = BY_KEY[PER_RPS]
    assert declared.high is not None
    with contextlib.suppress(ValueError):
        if 0 < float(answer) <= declared.high:
            return f"{float(answer):g}"
    raise NotAnAnswer(f"type a number above 0, up to {declared.high:g}, or {UNKNOWN}")


def _turns(answer: str) -> str:
    return answer if answer in (NO, UNKNOWN) else number(0.05, MOST_TURNS, "")(answer)


def by_hand(talk: Talk, device: str, board: Board) -> str | None:
    """Let a person turn a wheel by hand, and return the value of board.per_rps. Returns UNKNOWN if the person skips
    this, or None if no wheel can be turned by hand. Raises Left."""
    try:
        with contextlib.closing(OwnPort.open_and_stop(device, board)) as own:
            set_speed(own.fd, board.port)
            tap = Tap(own.fd, board)
            while True:
                before = _positions(tap, board)
                talk.say("Mark one wheel, and turn it by hand one or more whole turns. Leave the other wheels alone.")
                how = f"How many turns did it make? ({NO}: it can't be turned by hand; {UNKNOWN}: skip this)"
                answer = talk.ask("turned", how, "1", _turns, keep=False)
                if answer == NO:
                    return None
                if answer == UNKNOWN:
                    return answer
                if not (problem := _wrong(counts := _moved(before, _positions(tap, board), board.reports.wraps))):
                    return _found(
                        talk, board, max(counts) / board.reports.position_per_turn, float(answer), max(counts)
                    )
                talk.warn(problem, "turn one wheel again")
    except (PortError, OSError, ValueError) as error:
        text = str(error) if os.path.exists(device) else f"{device} has disappeared: is the board plugged in?"
        raise Left(text) from None


def _positions(tap: Tap, board: Board) -> tuple[float, ...]:
    """Return the newest wheel positions that the board reports. Raises Left."""
    with contextlib.suppress(BlockingIOError):
        tap.read()  # discard old reports
    until_s = time.monotonic() + REPORTS_S + board.port.deaf_ns / 1e9
    while time.monotonic() < until_s:
        if board.pings:
            with contextlib.suppress(BlockingIOError):
                tap.ping()
        time.sleep(ASK_S)
        found = [said[1] for _, kind, said in tap.read() if kind == HEARD_WHEELS and said[1]]
        if found:
            return tuple(found[-1])
    raise Left("the board does not report the positions of its wheels: are the encoders plugged in?")


def _moved(before: tuple[float, ...], after: tuple[float, ...], wraps: float) -> list[float]:
    """Return how far each position has changed, without a sign."""
    steps = [now - then for then, now in zip(before, after, strict=True)]
    if wraps:
        steps = [(step + wraps / 2) % wraps - wraps / 2 for step in steps]
    return [abs(step) for step in steps]


def _wrong(counts: list[float]) -> str:
    """Return a text about the problem if no wheel or several wheels have moved, or "" if exactly one wheel has moved.
    `counts`: how far each wheel has moved."""
    *others, most = sorted(counts)
    if most < LEAST_COUNTS:
        return "The board counted nothing: is that wheel's encoder plugged in?"
    if others and others[-1] > OTHERS * most:
        return "More than one wheel turned."
    return ""


def driven(talk: Talk, device: str, settings: Settings, halt: Halt, speeds: int, board: Board) -> str:
    """Turn a wheel slowly while a person counts its turns, and return the value of board.per_rps. Returns UNKNOWN if
    the person skips this. Raises Left."""
    kind, diameter_m = settings.text("board.kind"), settings["wheels.diameter_m"]
    rps = SLOWEST_MPS / rim_mps(1.0, diameter_m)
    values, velocity = alone(kind, speeds, 0, SLOWEST_MPS, diameter_m)
    values |= {key: value for key, value in settings.flat().items() if key in ("board.baud", "board.can_id")}
    while True:
        talk.say(f"Mark the wheels. Id 0 turns its wheel for {SECONDS:g} s: count the turns, quarters too (2.25).")
        with Rig(device, values, halt) as rig:
            rig.drive(velocity, SECONDS)
        answer = talk.ask(
            "counted", f"How many turns did it make? (again; {UNKNOWN}: skip this)", "", _counted, keep=False
        )
        if answer == UNKNOWN:
            return answer
        if answer != "again":
            per_turn = board.reports.position_per_turn
            told = rig.moved[0] / per_turn if per_turn and rig.moved.get(0) else rps * SECONDS
            return _found(talk, board, told, float(answer), rig.moved.get(0, 0.0))


def _counted(answer: str) -> str:
    return answer if answer in ("again", UNKNOWN) else number(0.05, MOST_TURNS, "")(answer)


def _found(talk: Talk, board: Board, told: float, turns: float, counts: float) -> str:
    """Print and return the corrected value of board.per_rps. `told`: how many turns the wheel has made if the present
    value is right. `turns`: the turns that the person has counted. `counts`: the board's counts, or 0 if there are
    none."""
    per_rps = board.per_rps * told / turns
    counted = f"{counts / turns:.0f} counts a turn: " if counts else ""
    talk.say(f"{counted}{PER_RPS} is {per_rps:.4g} (such boards usually have {board.per_rps:.4g}).")
    return f"{per_rps:.6g}"
