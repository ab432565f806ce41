"""A device with the board's chip at the board's path: the stop goes to the board, and what another device takes proves
nothing. The board and its look-alike are the judges."""

from __future__ import annotations

import pytest

from failstop.api import verdict
from failstop.messages.layout import PROCESS_NAMES
from failstop_lab.machine.robot import DEVICE
from failstop_lab.machine.usb import LookAlike, Plug
from tests.support.boards import every_board
from tests.support.simulated import Simulated

FILE = "/root/failstop.toml"
HERE, BESIDE, ELSEWHERE = "1-1.2", "1-1.3", "1-1.4"
"""Sockets: the board's, its look-alike's, a free one."""
AWAY_S = 0.3
RESET_S = 3.0
"""So long a hub may take to reset, and a board to be back."""
FOUND_S = 0.1
"""A board that is there is stopped within this time: it is searched for every 10 ms, and looked for every 50 ms while a
device is open that may not be it."""


class Bench:
    """A robot that drives, with its board and a look-alike on USB."""

    def __init__(self, serial: str, others: str, kind: str = "rrc", says: bytes = b"") -> None:
        """The serial numbers of the two; empty: it has none."""
        self.serial, self.others = serial, others
        self.simulated = Simulated(usb=Plug(serial, HERE), kind=kind)
        self.look_alike = LookAlike(says)
        self.simulated.lab.plug_usb("ttyACM1", Plug(others, BESIDE), self.look_alike)
        self.simulated.wait(1.1)  # it is seen next to the board

    def drive(self) -> None:
        simulated = self.simulated
        simulated.set_off()
        simulated.drive(0.3)
        assert not verdict.doubt(simulated.robot.state)

    def reset_hub(self, away_s: float = AWAY_S) -> None:
        """Both are gone, and the wheels turn on."""
        self.simulated.lab.unplug_usb()
        self.simulated.drive(away_s)
        assert self.simulated.turning()

    def board(self, number: int, place: str = HERE, serial: str | None = None) -> None:
        self.simulated.lab.plug_usb(f"ttyACM{number}", Plug(self.serial if serial is None else serial, place))

    def other(self, number: int, place: str = BESIDE, serial: str | None = None) -> None:
        plug = Plug(self.others if serial is None else serial, place)
        self.simulated.lab.plug_usb(f"ttyACM{number}", plug, self.look_alike)

    def stopped(self) -> None:
        """The board has stopped in time, the service has heard it, and it drives again after an enable."""
        simulated = self.simulated
        late_s = FOUND_S + simulated.own_ns / 1e9
        simulated.drive(late_s)
        assert not simulated.turning()
        simulated.wait_for("the board to be heard", lambda: not verdict.doubt(simulated.robot.state))
        simulated.wait_for("a whole service", lambda: simulated.robot.state.waiting_for is None)
        assert simulated.robot.state.last_stop.believed
        heard = len(self.look_alike.heard)
        simulated.enable()
        simulated.drive(0.3)
        assert simulated.turning()
        assert len(self.look_alike.heard) == heard

    def in_doubt(self) -> None:
        """Every screen says that the wheels may turn, and nothing that was written counts as proof."""
        state = self.simulated.robot.state
        assert verdict.doubt(state)
        assert verdict.word(state) == verdict.MAY_TURN
        assert verdict.large_word(state) == verdict.WHEELS_MAY_TURN
        stop = state.last_stop
        assert stop.acknowledged_s is None
        assert stop.observed_s is None
        assert stop.written_s is None or not stop.believed


SERIALS = {"with serial numbers": ("A", "B"), "without": ("", ""), "with one for both": ("A", "A")}
every_identity = pytest.mark.parametrize("serials", SERIALS.values(), ids=SERIALS)


@pytest.mark.claim("PORT-1")
@every_identity
def test_their_numbers_are_swapped(serials: tuple[str, str]) -> None:
    bench = Bench(*serials)
    bench.drive()
    bench.reset_hub()
    bench.other(0)
    bench.board(1)
    bench.stopped()
    assert not bench.look_alike.heard


@every_identity
def test_the_look_alike_is_back_first(serials: tuple[str, str]) -> None:
    bench = Bench(*serials)
    bench.drive()
    bench.reset_hub()
    bench.other(0)
    bench.simulated.drive(RESET_S)
    bench.in_doubt()
    bench.board(1)
    bench.stopped()
    assert not bench.look_alike.heard


def test_the_look_alike_is_put_into_the_board_s_socket() -> None:
    bench = Bench("A", "B")
    bench.drive()
    bench.reset_hub()
    bench.other(0, HERE)
    bench.simulated.drive(RESET_S)
    bench.in_doubt()
    bench.board(1, BESIDE)
    bench.stopped()
    assert not bench.look_alike.heard


@pytest.mark.parametrize("serials", [("A", "B"), ("", "")], ids=["with", "without"])
def test_the_board_is_put_into_another_socket(serials: tuple[str, str]) -> None:
    bench = Bench(*serials)
    bench.drive()
    bench.reset_hub()
    bench.other(0)
    bench.board(1, ELSEWHERE)
    bench.stopped()
    assert not bench.look_alike.heard


def test_a_spare_is_believed_once_it_answers() -> None:
    bench = Bench("A", "B")
    bench.drive()
    bench.reset_hub()
    bench.other(1)
    bench.board(0, serial="C")
    bench.stopped()
    assert not bench.look_alike.heard


def test_a_spare_that_has_answered_stays_the_board_when_the_old_one_is_plugged_in() -> None:
    bench = Bench("A", "B")
    bench.drive()
    bench.reset_hub()
    bench.board(0, serial="C")
    bench.stopped()
    bench.other(2, ELSEWHERE, serial="A")
    bench.simulated.drive(RESET_S)
    assert bench.simulated.turning()
    assert not bench.look_alike.heard


@pytest.mark.parametrize("says", [b"", b"\x54\x2c" * 40], ids=["silent", "with data of its own"])
def test_a_device_in_the_board_s_place_is_left_for_the_board(says: bytes) -> None:
    """It is taken for a spare: the bytes that it gets prove nothing, and the board is stopped once it is anywhere."""
    bench = Bench("A", "B", says=says)
    bench.drive()
    bench.reset_hub()
    bench.other(0, HERE, serial="C")
    bench.simulated.drive(RESET_S)
    assert bench.look_alike.heard
    bench.in_doubt()
    bench.board(1, ELSEWHERE)
    bench.stopped()


def test_one_without_a_serial_number_that_nobody_has_seen_before() -> None:
    bench = Bench("", "")
    bench.drive()
    bench.reset_hub()
    bench.other(0, ELSEWHERE)
    bench.simulated.drive(RESET_S)
    bench.in_doubt()
    bench.board(1)
    bench.stopped()


@every_board
def test_every_board_that_was_heard_and_is_not_any_more(simulated: Simulated) -> None:
    """Where a board can be heard, one that is back and is not heard may turn its wheels."""
    simulated.set_off()
    simulated.drive(0.3)
    if simulated.robot.state.device.link == "unasked":
        simulated.drive(0.3, (0.0, 0.0, 0.0))
    simulated.board.unplug()
    simulated.wait_for("the loss", lambda: simulated.robot.state.device.state == "lost")
    simulated.board.deaf(True)
    look_alike = LookAlike()
    simulated.lab.plug().board = look_alike
    simulated.lab.board.port = None
    simulated.drive(RESET_S)
    assert look_alike.heard
    state = simulated.robot.state
    assert verdict.large_word(state) == verdict.WHEELS_MAY_TURN
    assert state.last_stop.acknowledged_s is None
    assert not state.last_stop.believed


def test_the_first_device_of_a_run_is_believed_once_it_answers() -> None:
    simulated = Simulated(deaf=True)
    simulated.robot.estop("try")
    simulated.wait_for("the stop", lambda: simulated.robot.state.last_stop)
    assert not simulated.robot.state.last_stop.believed
    assert "has not answered as the board does" in simulated.printed("why")
    simulated.board.deaf(False)
    simulated.wait_for("an answer", lambda: simulated.robot.state.last_stop.believed)
    assert "has not answered as the board does" not in simulated.printed("why")


def test_failstop_stop_is_no_success_where_the_board_is_not_heard() -> None:
    bench = Bench("A", "B")
    assert bench.simulated.command("stop")[0] == 0
    bench.simulated.lab.unplug_usb()
    bench.simulated.wait(0.3)
    bench.other(0, HERE, serial="C")
    bench.simulated.wait(1.0)
    code, out, err = bench.simulated.command("stop")
    assert (code, "stop latched" in out) == (1, True)
    assert "has not answered since it came back" in err
    assert "THE WHEELS MAY TURN" in bench.simulated.command("why")[1]
    assert "MAY TURN" in bench.simulated.command("status")[1]


def killed(bench: Bench) -> None:
    """Every process of the service dies while the robot drives."""
    simulated = bench.simulated
    simulated.enable()
    simulated.drive(0.3)
    assert simulated.turning()
    for name in PROCESS_NAMES:
        simulated.lab.kill(name)
    bench.look_alike.heard.clear()


def stopped_by_systemd(bench: Bench) -> bool:
    """systemd runs the stop tool with the service's file, which names the first port."""
    lab = bench.simulated.lab
    lab.write(FILE, f'device.path = "{DEVICE}"\n')
    lab.write("/proc/self/cgroup", "0::/system.slice/failstop.service\n")
    code, _, _ = lab.command(("stop", "--end-service", "--config", FILE), environ={"SERVICE_RESULT": "signal"})
    return code == 0 and not bench.look_alike.heard


def test_the_last_stop_goes_where_the_board_was_found_again() -> None:
    bench = Bench("A", "B")
    bench.drive()
    bench.reset_hub()
    bench.other(0)
    bench.board(1, ELSEWHERE)
    bench.stopped()
    killed(bench)
    assert stopped_by_systemd(bench)
    assert not bench.simulated.turning()


def test_the_last_stop_goes_to_no_look_alike_at_the_last_port() -> None:
    """The board is back under the name in the file, and its look-alike has the name that the board had."""
    bench = Bench("A", "B")
    bench.drive()
    bench.reset_hub()
    bench.other(0)
    bench.board(1)
    bench.stopped()
    killed(bench)
    bench.simulated.lab.unplug_usb()
    bench.board(0)
    bench.other(1)
    assert stopped_by_systemd(bench)
    assert not bench.simulated.turning()
