"""Asking: finds out which board is on an open port. It asks questions that move no wheel.

failstop tries one kind of board after another, until a question is answered. A kind without questions is recognised by
its reports. Before each question, failstop writes the stop of the same kind, because a stop ends any frame that was cut
short. The stops and the questions of one kind never move a board of another kind that failstop describes, at any baud
rate (tests/board/test_asking.py). failstop can't promise this for a board that you have described yourself. So if
board.kind names your own board, failstop writes only your board's stop and questions, and just listens for other kinds.
"""

from __future__ import annotations

import time

from failstop.board import port
from failstop.board.interface import Board
from failstop.board.kinds import facts_of
from failstop.board.stop_port import StopPort
from failstop.board.tap import Tap
from failstop.data import Data

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Iterator, Mapping

ANSWER_S = 0.25
"""How long to wait for an answer or a report, in s. Every board that failstop describes answers sooner than this, and
reports more often than this."""
QUESTIONS = 2
"""How many times each kind of board is asked, because a single question may be lost on the line."""
MORE_QUESTIONS = 2
"""How many more times a board is asked if it sends bytes, but none of them is an answer. For example, one of two motors
may answer while the other one is silent."""

WIRES = "check the board's power, its cable (TX and RX must cross), device.path, and the baud rate of its firmware"
"""What people should check if no bytes come from the board."""

SERVO_PLACES = "check its plug on the bus, its power and its id"
"""What people should check if a servo or a motor's controller does not answer."""

ADAPTERS = {
    "0403:6001": "FT232",
    "0403:6015": "FT231X",
    "067b:2303": "PL2303",
    "10c4:ea60": "CP210x",
    "1a86:55d3": "CH343",
    "1a86:55d4": "CH9102",
    "1a86:7523": "CH340",
}
"""Chips between USB and a serial line, by vendor:product. Many kinds of devices have such a chip, so the chip does not
show which board is behind it."""
DRIVERS = {"FT": "ftdi_sio", "PL": "pl2303", "CP": "cp210x", "CH340": "ch341"}
"""The kernel module for each chip, by the beginning of the chip's name in ADAPTERS. All other chips use cdc_acm."""


class Unknown(Board):
    """Stands in for your own board if this program's user can't use the board's folder. Nothing is known about the
    board then, so nothing is written to it."""

    __slots__ = ("why",)

    pings = ()
    echo_ns = fades_ns = 0
    usb = ()
    usb_alone = False
    commanders = ()
    scale_assumed = False
    observed_by = ""

    def __init__(self, why: str) -> None:
        """`why` is one line for people that says why the board's folder can't be used, and what to do."""
        self.why = why


class Heard(Data):
    """The result of looking for one kind of board on a port."""

    kind: str
    known: bool
    """True if the device on the port is a board of this kind."""
    answered_ms: float | None
    reports: frozenset[int]
    """The kinds of reports that came from the device, as the HEARD_ numbers of interface.py."""
    size: int
    """How many bytes came from the device, even if they make no sense."""
    after_ns: int
    """The time between the opening of the port and the first question, in ns."""
    firmware: str = ""
    """The name of the board's firmware, if the board reports that it is not the usual one."""
    other_baud: int = 0
    """The baud rate that was used for the questions, if it is not the rate in the settings. Else 0."""
    missing: tuple[int, ...] = ()
    """The servos that do not answer, although other servos of the same board do."""


def turns(boards: Mapping[str, Board], resets: bool) -> Iterator[tuple[int, str]]:
    """Yield the attempts to find the board, in order, as (time, kind). `time`: when to try, in ns after the port was
    opened. The first of `boards` comes first, because the user wants it. Boards without questions come next, because
    failstop writes nothing to them. `resets`: True if opening the port may have reset the board. Some kinds of boards
    hear nothing for a while after a reset. If `resets` is True, each such kind gets a second attempt after that
    time."""
    wanted, *others = boards
    others.sort(key=lambda kind: len(boards[kind].pings) > 0)
    for group in ([wanted], others):
        yield from ((0, kind) for kind in group)
        late = sorted((boards[kind].port.deaf_ns, kind) for kind in group) if resets else []
        yield from ((deaf_ns, kind) for deaf_ns, kind in late if deaf_ns)


def seek(fd: int, boards: Mapping[str, Board], opened_ns: int, *, strangers: bool) -> list[Heard]:
    """Try one kind of board after another, until a board of that kind is found on the port. The search also ends if
    only some servos of a board answer (Heard.missing). Returns the result of each attempt, the last attempt last. The
    caller must already have written the stop of the first board. If no board is found at the usual baud rates, the
    other baud rates of each board are tried too. `strangers`: True to write only the bytes of the first board, and just
    listen for all others. Raises OSError if the device is gone."""
    found: list[Heard] = []
    usual = [(due_ns, kind, boards[kind].port.baud) for due_ns, kind in turns(boards, port.has_lines(fd))]
    # Only boards that a Wire describes have other baud rates.
    others = [(0, kind, baud) for kind, board in boards.items() for baud in getattr(board, "other_bauds", ())]
    for due_ns, kind, baud in usual + others:
        time.sleep(max(0, opened_ns + due_ns - time.monotonic_ns()) / 1e9)
        board, first = boards[kind], not found
        port.set_speed(fd, board.port.at(baud))
        silent = not board.pings or (strangers and kind != next(iter(boards)))
        after_ns = time.monotonic_ns() - opened_ns
        tap = Tap(fd, board)
        answered_ms = None if silent else ask(tap, board, stop=not first)
        if silent:
            tap.listen(ANSWER_S)
        known = bool(tap.reports) if silent else answered_ms is not None
        parts = frozenset(tap.reports), tap.size, after_ns, tap.firmware, baud * (baud != board.port.baud), tap.missing
        found.append(Heard(kind, known, answered_ms, *parts))
        if known or tap.missing:
            break
    return found


def ask(tap: Tap, board: Board, *, stop: bool) -> float | None:
    """Ask a board until it answers, at most QUESTIONS times. If it has sent bytes but no answer, ask it at most
    MORE_QUESTIONS more times. These end early if the bytes show that a servo is missing (Tap.missing). Returns how long
    the answer took, in ms, or None if no answer came. Raises OSError if the device is gone.

    The stop is written before each question, because the board may have read bytes for another kind of board as the
    beginning of a packet. The stop completes that packet, so the board can read the question. `stop`: False to leave
    out the stop before the first question.
    """
    stops = StopPort(tap.fd, board)
    for turn in range(QUESTIONS + MORE_QUESTIONS):
        if turn >= QUESTIONS and (tap.missing or not tap.size):
            break
        if stop or turn:
            stops.burst()
        time.sleep((len(board.burst) * board.port.byte_ns + board.idle_ns) / 1e9)
        if (answered_ms := heard_ms(tap, board)) is not None:
            return answered_ms
    return None


def heard_ms(tap: Tap, board: Board) -> float | None:
    """Ask the board one question, and return how long it took to answer, in ms. A board without questions is not asked:
    the time is then until it reports that it obeys zero speed. None if no answer or report came."""
    return tap.answered_ms(ANSWER_S) if board.pings else tap.zeros_ms(ANSWER_S)


def told_of(heard: list[Heard], kind: str, board: Board) -> tuple[bool | None, str, str]:
    """Return (found, text, remedy) for one kind of board. `found`: True if this kind is on the port, False if not, None
    if it can't be asked. `text`: the result in words for people. `remedy`: what to do."""
    last, deaf_ns = heard[-1], board.port.deaf_ns
    if last.missing:
        facts = facts_of(last.kind)
        motors = facts.motors if facts else {}
        which = " and ".join(motors.get(servo, f"servo {servo}") for servo in last.missing)
        it = f"it is {last.kind}" if last.kind == kind else f"it is {last.kind}, but board.kind is {kind}"
        return False, f"{it}; {which} does not answer while others do", SERVO_PLACES
    if last.known and last.kind != kind:
        rate = f" and board.baud = {last.other_baud}" if last.other_baud else ""
        remedy = f'set board.kind = "{last.kind}"{rate}, or plug in the other board'
        return False, f"the board that answers is {last.kind}, but board.kind is {kind}", remedy
    if last.known and last.other_baud:
        text = f"it answers as {kind} does, but at {last.other_baud} baud, and the settings say {board.port.baud}"
        return False, text, f"set board.baud = {last.other_baud}"
    if last.known:
        reset = f"; opening the port reset it, so it heard nothing for {deaf_ns / 1e9:g} s"
        opened = reset if last.after_ns >= deaf_ns else ", and opening the port did not reset it"
        which = f"; its firmware is {last.firmware}" if last.firmware else ""
        return (
            True,
            f"it {'answers' if board.pings else 'reports'} as {kind} does{opened if deaf_ns else ''}{which}",
            "",
        )
    if any(each.reports for each in heard if each.kind == kind):
        return False, f"it reports as {kind} does, but answers no question, so it may hear nothing", WIRES
    if came := max(each.size for each in heard):
        return False, f"{came} bytes came, but from no board that failstop knows, so this is not {kind}", WIRES
    if not (board.pings or board.echo_ns):
        return (
            None,
            f"{kind} can't be asked anything, so nobody knows whether it is there",
            "add questions to its wire.py",
        )
    return False, f"nothing answers as {kind}, or as another board that failstop knows", WIRES
