"""Asking who is on a port, with each board there while each is asked for: the one that is there is found, and no wheel
turns. On the simulated machine, whose times are exact, with the receivers as judges."""

from __future__ import annotations

import functools
import termios
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from failstop.board.asking import Heard, told_of, turns
from failstop.board.described import Described
from failstop.board.facts import USUAL_CAN_ID
from failstop.board.feetech import codec
from failstop.board.interface import HEARD_WHEELS, Board
from failstop.board.kinds import board_of, is_described, wire_of
from failstop.board.vesc.codec import BEHIND
from failstop.board.wire import Wire
from failstop.policy.layouts import BOARDS
from failstop_lab.boards.feetech import Bus
from failstop_lab.boards.hoverboard import Hoverboard
from failstop_lab.boards.live import LiveModel
from failstop_lab.machine.robot import DEVICE, Robot
from failstop_lab.sim.model import BoardModel
from tests.support.boards import own_folder

NS = 1_000_000_000
BAUDS = {getattr(termios, f"B{baud}"): baud for baud in (57_600, 115_200, 500_000, 1_000_000)}
every_board = pytest.mark.parametrize("there", BOARDS)


def boards(wanted: str) -> dict[str, Board]:
    """The wanted board first, then all others."""
    return {kind: board_of(kind, 0.08, 0.0) for kind in dict.fromkeys((wanted, *BOARDS))}


def bits(data: bytes) -> Iterator[int]:
    """The line, a bit each, idle at the end."""
    for value in data:
        yield from (0, *((value >> at) & 1 for at in range(8)), 1)
    yield from (1,) * 10


@functools.cache
def heard_at(data: bytes, sent_baud: int, baud: int) -> bytes:
    """The bytes that a receiver of another speed takes them for: it looks in the middle of what it holds to be a bit,
    and takes a byte without a stop bit too."""
    line = bytes(bits(data))
    found = bytearray()
    at = 0.0
    step = sent_baud / baud
    while (begin := line.find(0, int(at))) >= 0:
        while at < begin:
            at += step / 16
        if int(at) > begin:
            continue  # a bit that is shorter than a look was missed
        places = [int(at + (bit + 1.5) * step) for bit in range(8)]
        found.append(sum((line[place] if place < len(line) else 1) << bit for bit, place in enumerate(places)))
        at += 9.5 * step
    return bytes(found)


class There:
    """A simulated machine with one board at its port; it has the speed of its own, or any."""

    def __init__(self, kind: str, *, own_speed: bool, deaf_ns: int = 0, says: bytes = b"") -> None:
        """`deaf_ns`: as long it hears nothing. `says`: it is no board, and says this again and again."""
        self.robot = Robot(imu_hz=20.0)
        self.machine, attached = self.robot.machine, self.robot.board
        now_ns = self.machine.now_ns
        self.model = LiveModel(kind, now_ns) if is_described(kind) else BoardModel(now_ns, imu_hz=20.0)
        attached.model = self.model
        self.model.deaf = deaf_ns > 0 or bool(says)
        self.baud = board_of(kind, 0.08, 0.0).port.baud
        if own_speed:
            self._at_its_own_speed()
        if deaf_ns:
            self.machine.at(now_ns + deaf_ns, self._hear)
        if says:
            self._says = says
            self._say()
        attached.plan()
        self.robot.join("test")

    def _at_its_own_speed(self) -> None:
        attached = self.robot.board
        port: Any = attached.port
        receive, send = attached.receive, port.send

        def speed() -> int:
            return BAUDS[port.settings[4]]

        attached.receive = lambda data: receive(heard_at(data, speed(), self.baud))  # type: ignore[method-assign]
        port.send = lambda data: send(heard_at(data, self.baud, speed()))

    def _hear(self) -> None:
        self.model.deaf = False

    def _say(self) -> None:
        port: Any = self.robot.board.port
        port.send(self._says)
        self.machine.at(self.machine.now_ns + NS // 50, self._say)

    def asked(self, wanted: str, known: dict[str, Board] | None = None, *, strangers: bool = False) -> list[Any]:
        """Everything that was heard, behind the stop that goes out when the port is opened."""
        load = self.robot.loader.load
        handover, asking = load("failstop.supervisor.port_handover"), load("failstop.board.asking")
        chosen = known or boards(wanted)
        own = handover.OwnPort.open_and_stop(DEVICE, chosen[wanted])
        assert own.stopped
        found: list[Any] = asking.seek(own.fd, chosen, self.machine.now_ns, strangers=strangers)
        return found

    def turned(self) -> bool:
        """A wheel was told to turn."""
        return any(any(frame.speeds) for frame in self.model.executed(0))


@pytest.mark.parametrize("own_speed", [True, False], ids=["at its speed", "at any speed"])
@pytest.mark.parametrize("wanted", BOARDS)
@every_board
def test_the_board_that_is_there_is_found_and_stands_still(there: str, wanted: str, own_speed: bool) -> None:
    on = There(there, own_speed=own_speed)
    heard = on.asked(wanted)
    assert (heard[-1].kind, heard[-1].known) == (there, True)
    assert not any(each.known for each in heard[:-1])
    assert (heard[-1].answered_ms is None) == (not boards(there)[there].pings)
    assert not on.turned()


def test_the_hoverboard_fork_with_22_bytes_of_feedback_is_known_and_named() -> None:
    on = There("hoverboard", own_speed=True)
    assert isinstance(on.model, LiveModel)
    assert isinstance(on.model.receiver, Hoverboard)
    on.model.receiver.counters = (8_999, 3)
    heard = on.asked("hoverboard")
    assert (heard[-1].kind, heard[-1].known) == ("hoverboard", True)
    known, text, _ = told_of(heard, "hoverboard", boards("hoverboard")["hoverboard"])
    assert known
    assert "its firmware is the fork for hoverboard-robotics' ROS driver, by its feedback of 22 bytes" in text
    assert There("hoverboard", own_speed=True).asked("hoverboard")[-1].firmware == ""


@pytest.mark.parametrize("wanted", BOARDS)
def test_a_board_whose_firmware_has_another_baud_rate_is_found_at_it(wanted: str) -> None:
    on = There("arduino", own_speed=True)
    on.baud = 115_200
    heard = on.asked(wanted)
    assert (heard[-1].kind, heard[-1].known, heard[-1].other_baud) == ("arduino", True, 115_200)
    known, text, remedy = told_of(heard, wanted, boards(wanted)[wanted])
    assert not known
    if wanted == "arduino":
        assert text == "it answers as arduino does, but at 115200 baud, and the settings say 57600"
        assert remedy == "set board.baud = 115200"
    else:
        assert remedy.startswith('set board.kind = "arduino" and board.baud = 115200')
    assert not on.turned()


def test_a_board_at_the_rate_of_its_settings_is_known_and_at_the_usual_one_found() -> None:
    at_115200 = {**boards("arduino"), "arduino": board_of("arduino", 0.08, 0.0, baud=115_200)}
    for baud, known, advice in ((115_200, True, ""), (57_600, False, "set board.baud = 57600")):
        on = There("arduino", own_speed=True)
        on.baud = baud
        found = told_of(on.asked("arduino", at_115200), "arduino", at_115200["arduino"])
        assert (found[0], found[2]) == (known, advice)


@pytest.mark.parametrize("wanted", ["feetech", "rrc"])
@pytest.mark.parametrize("missing", codec.WHEELS)
def test_a_bus_on_which_one_wheel_does_not_answer_is_known_and_the_servo_named(missing: int, wanted: str) -> None:
    on = There("feetech", own_speed=True)
    assert isinstance(on.model, LiveModel)
    assert isinstance(on.model.receiver, Bus)
    on.model.receiver.silent.add(missing)
    known, text, remedy = told_of(on.asked(wanted), wanted, boards(wanted)[wanted])
    it = "it is feetech" if wanted == "feetech" else "it is feetech, but board.kind is rrc"
    assert (known, text) == (False, f"{it}; servo {missing} does not answer while others do")
    assert remedy == "check its plug on the bus, its power and its id"
    assert not on.turned()


@every_board
def test_a_board_that_its_opening_has_reset_is_waited_for(there: str) -> None:
    deaf_ns = boards(there)[there].port.deaf_ns
    heard = There(there, own_speed=True, deaf_ns=deaf_ns).asked(there)
    assert (heard[-1].kind, heard[-1].known) == (there, True)
    assert heard[-1].after_ns >= deaf_ns
    assert {each.kind for each in heard} == {there}, "nobody else is asked meanwhile"


def test_a_board_that_reports_and_does_not_hear_is_not_taken_for_known() -> None:
    heard = There("ugv", own_speed=True, deaf_ns=60 * NS).asked("ugv")
    assert not any(each.known for each in heard)
    assert all(HEARD_WHEELS in each.reports for each in heard if each.kind == "ugv")


@pytest.mark.parametrize("says", [b"NMEA $GPGGA,1,2\r\n", b"\xaa\x55\x00", b"0 0\r\nOK\r\n"])
def test_what_is_no_board_is_not_taken_for_one(says: bytes) -> None:
    heard = There("arduino", own_speed=False, says=says).asked("ugv")
    assert not any(each.known for each in heard)
    assert all(each.size for each in heard)


@every_board
def test_a_line_that_sends_everything_back_is_no_board(there: str) -> None:
    board = boards(there)[there]
    for sent in (board.burst, *board.pings):
        assert board.hearing().feed(sent) == []


@pytest.mark.parametrize("there", ["arduino", "ugv"])
@pytest.mark.parametrize("wanted", BOARDS)
def test_half_a_motion_line_is_ended_by_the_stop_before_the_question(there: str, wanted: str) -> None:
    """Without it the question would be the end of that line, which would then be run."""
    on, board = There(there, own_speed=False), boards(there)[there]
    on.robot.board.receive(board.motor_speeds((0.05,) * board.wheels, 0.1)[:-1])
    assert on.asked(wanted)[-1].kind == there
    assert not any(on.model.wheels)


def test_the_order_in_which_boards_are_asked() -> None:
    """The wanted one first, again when it must have started; then those that are listened to; late ones last."""
    order = [(0, "ugv"), (5 * NS, "ugv"), (0, "hoverboard"), (0, "rrc"), (0, "arduino"), (0, "damiao"), (0, "feetech")]
    order += [(0, "vesc"), (2 * NS, "arduino")]
    assert list(turns(boards("ugv"), resets=True)) == order
    assert list(turns(boards("ugv"), resets=False)) == [turn for turn in order if not turn[0]]


@pytest.mark.parametrize("there", ["hoverboard", "ugv", "rrc"])
@pytest.mark.starts
def test_no_stranger_is_written_to_where_the_board_is_the_users_own(there: str, tmp_path: Path) -> None:
    """It is listened to: who speaks unasked is found."""
    folder = own_folder(tmp_path / "tank")
    known = {folder: board_of(folder, 0.08, 0.0), **boards("rrc")}
    on = There(there, own_speed=False)
    wrote: list[bytes] = []
    on.robot.board.on_bytes = wrote.append
    heard = on.asked(folder, known, strangers=True)
    assert (heard[-1].kind, heard[-1].known) == (there, True)
    assert set(wrote) <= {*known[folder].pings, known[folder].burst}


def heard(kind: str, *, answered_ms: float | None = None, reports: int = 0, size: int = 0, after_s: float = 0) -> Heard:
    known = answered_ms is not None or (kind == "hoverboard" and reports > 0)
    return Heard(kind, known, answered_ms, frozenset([HEARD_WHEELS][:reports]), size, int(after_s * 1e9))


SILENT = [heard(each) for each in ("ugv", "hoverboard", "arduino", "rrc")]


@pytest.mark.parametrize(
    ("name", "answers", "known", "text", "advice"),
    [
        (
            "ugv",
            [heard("ugv", answered_ms=3.1)],
            True,
            "it answers as ugv does, and opening the port did not reset it",
            "",
        ),
        ("rrc", [heard("rrc", answered_ms=3.1)], True, "it answers as rrc does", ""),
        ("hoverboard", [heard("hoverboard", reports=1)], True, "it reports as hoverboard does", ""),
        (
            "arduino",
            [heard("arduino"), heard("arduino", answered_ms=3.1, after_s=2.01)],
            True,
            "it answers as arduino does; opening the port reset it, so it heard nothing for 2 s",
            "",
        ),
        (
            "rrc",
            [heard("rrc", size=90), heard("hoverboard", reports=1, size=90)],
            False,
            "the board that answers is hoverboard, but board.kind is rrc",
            'set board.kind = "hoverboard"',
        ),
        (
            "ugv",
            [heard("ugv", reports=1, size=9), *SILENT],
            False,
            "it reports as ugv does, but answers no question, so it may hear nothing",
            "TX and RX",
        ),
        (
            "ugv",
            [heard("ugv", size=77), *SILENT],
            False,
            "77 bytes came, but from no board that failstop knows, so this is not ugv",
            "baud rate",
        ),
        ("ugv", SILENT, False, "nothing answers as ugv, or as another board that failstop knows", "power"),
    ],
)
def test_the_verdict_on_a_board(name: str, answers: list[Heard], known: bool, text: str, advice: str) -> None:
    found = told_of(answers, name, board_of(name, 0.08, 0.0))
    assert found[:2] == (known, text)
    assert advice in found[2]


def test_of_a_board_without_a_question_nobody_knows_whether_it_is_there() -> None:
    silent = Described(Wire(**{**vars(wire_of("arduino")), "questions": ()}), 1.0, 0.1)
    known, text, remedy = told_of([heard("/etc/tank"), *SILENT], "/etc/tank", silent)
    assert known is None
    assert text.startswith("/etc/tank can't be asked anything")
    assert "questions" in remedy


@pytest.mark.parametrize("wanted", ["vesc", "rrc"])
def test_a_vesc_at_the_port_that_has_the_second_one_s_usual_id_is_known(wanted: str) -> None:
    """So that setup asks for the id of the second one."""
    on = There("vesc", own_speed=True)
    model: Any = on.model
    model.receiver.motors[0].can_id, model.receiver.motors[1].can_id = USUAL_CAN_ID, 5
    heard = on.asked(wanted)
    assert (heard[-1].kind, heard[-1].known, heard[-1].missing) == ("vesc", False, (BEHIND,))


@pytest.mark.parametrize("wanted", ["vesc", "rrc"])
def test_a_second_vesc_that_does_not_answer_is_named_where_it_is_looked_for(wanted: str) -> None:
    on = There("vesc", own_speed=True)
    model: Any = on.model
    model.receiver.can_dead = True
    heard = on.asked(wanted)
    known, text, remedy = told_of(heard, wanted, boards(wanted)[wanted])
    it = "it is vesc" if wanted == "vesc" else "it is vesc, but board.kind is rrc"
    assert (heard[-1].kind, known) == ("vesc", False)
    assert text == f"{it}; motor 2 (the VESC on its CAN) does not answer while others do"
    assert remedy == "check its plug on the bus, its power and its id"
