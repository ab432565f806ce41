"""Asking: finds out which board is on an open port, by questions that move no wheel.

A board is known by its answer to one of its questions, or, if it has no questions, by its reports. Before each question
the stop of that board is written, because it ends any frame that was cut. No other board of failstop takes such a stop
or question for motion, at any baud rate (tests/board/test_asking.py). Nobody knows how an unknown device takes them. So
if your own board may be on the port, failstop writes nothing for the other boards and only listens.
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
"""How long to wait for an answer or a report, s: longer than any of these boards takes to answer, and longer than the
time between two of its reports."""
QUESTIONS = 2
"""How often each board is asked, because a question may be lost on the line."""
MORE_QUESTIONS = 2
"""How often it is asked again if bytes come that answer nothing, because they may be from a part of the board."""

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
"""Chips between USB and a serial line, by vendor:product. They are in devices of every kind."""
DRIVERS = {"FT": "ftdi_sio", "PL": "pl2303", "CP": "cp210x", "CH34": "ch341"}
"""The kernel's module for chips whose names begin like this; for all others it is cdc_acm."""


class Unknown(Board):
    """A board whose folder this user can't use. Nothing is known about it, and nothing is written to it."""

    __slots__ = ("why",)

    pings = ()
    echo_ns = fades_ns = 0
    usb = ()
    usb_alone = False
    commanders = ()
    scale_assumed = False
    observed_by = ""

    def __init__(self, why: str) -> None:
        """`why`: one line for people that says why the board's folder can't be used, and what to do."""
        self.why = why


class Heard(Data):
    """The result of asking at a port as one kind of board."""

    kind: str
    known: bool
    """True if the device at the port is a board of this kind."""
    answered_ms: float | None
    reports: frozenset[int]
    """The kinds of its reports, by the numbers in interface.py."""
    size: int
    """How many bytes were received, of whatever kind."""
    after_ns: int
    """When the board was asked, counted from the opening of the port, ns."""
    firmware: str = ""
    """Its firmware, if that is not the usual one."""
    other_baud: int = 0
    """The baud rate at which it was asked, if that is not the one in the settings; else 0."""
    missing: tuple[int, ...] = ()
    """The servos that do not answer although others of this board do."""


def turns(boards: Mapping[str, Board], resets: bool) -> Iterator[tuple[int, str]]:
    """Which board to ask when: (how long after the opening of the port, ns, and the board), for each turn. The board
    that the user wants comes first, then boards without questions, because for them failstop only listens. `resets`:
    opening the port may have reset the board, which then hears nothing for a while."""
    wanted, *others = boards
    others.sort(key=lambda kind: len(boards[kind].pings) > 0)
    for group in ([wanted], others):
        yield from ((0, kind) for kind in group)
        late = sorted((boards[kind].port.deaf_ns, kind) for kind in group) if resets else []
        yield from ((deaf_ns, kind) for deaf_ns, kind in late if deaf_ns)


def seek(fd: int, boards: Mapping[str, Board], opened_ns: int, *, strangers: bool) -> list[Heard]:
    """Ask as one board after the other until one is found, which is then the last in the list. The stop of the first
    board was written before. At the end, ask at the other baud rates that a board may have. `strangers`: write nothing
    for the boards other than the first. Raises OSError if the device is gone."""
    found: list[Heard] = []
    usual = [(due_ns, kind, boards[kind].port.baud) for due_ns, kind in turns(boards, port.has_lines(fd))]
    # Of a board that a Wire describes; others have one rate.
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
    """Ask a board twice, and again if bytes come that answer nothing. Returns after how many ms it answered, or None.
    `stop`: write its stop first. Raises OSError if the device is gone.

    Before each further question the stop is written again. Its bytes complete a packet, if the receiver has taken the
    bytes of another board for the beginning of one."""
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
    """The time in ms until the board answered a question. For a board without questions: until it reported that it
    obeys zero speed. None if it did neither."""
    return tap.answered_ms(ANSWER_S) if board.pings else tap.zeros_ms(ANSWER_S)


def told_of(heard: list[Heard], kind: str, board: Board) -> tuple[bool | None, str, str]:
    """The result of looking for a board of this `kind`: True if it is present, False if not, None if that can't be
    known; the same in words; and the remedy."""
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
