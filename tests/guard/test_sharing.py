"""A driver whose children and copies share its opening of the port, and one that opens it again and again."""

from __future__ import annotations

import fcntl
import os
import select
import subprocess
import sys
import termios
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from failstop import config
from failstop.api.errors import FailstopError
from failstop.guard.door import Door
from failstop.guard.dry import Nothing
from failstop.guard.guard import Guard
from failstop.guard.news import News
from failstop.guard.openers import Held, owners
from failstop.guard.pty import Pty
from tests.support.waiting import until

AS_ROOT = pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to hang up a terminal")
FOLLOWS = """
import os, select, sys
path = sys.argv[1]
for line in sys.stdin:
    exec(line)
    print("done", flush=True)
"""
OPEN = "port = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)"
DRIVE = r"os.write(port, b'm %d %d\r')"
FORK = "hold, end = os.pipe(); child = os.fork() or (os.close(end), os.read(hold, 1), os._exit(0)); os.close(hold)"
"""A child with all that its parent has, which lives until end_child."""
FORK_ON = "child = os.fork() or ((p := select.poll()).register(1, 0), p.poll(), os._exit(0))"
"""A child that outlives its parent, until nobody reads its output any more."""
END_CHILD = "os.close(end); os.waitpid(child, 0)"


class Script:
    """A driver that does what it is told, a line at a time."""

    def __init__(self, path: str, program: str = sys.executable) -> None:
        words = [program, "-c", FOLLOWS, path]
        self.child = subprocess.Popen(words, stdin=subprocess.PIPE, stdout=subprocess.PIPE)

    def begin(self, line: str) -> None:
        """Have it do this, without waiting for it."""
        assert self.child.stdin
        self.child.stdin.write(f"{line}\n".encode())
        self.child.stdin.flush()

    @property
    def says(self) -> bool:
        """It has written something that was not read yet."""
        assert self.child.stdout
        return bool(select.select([self.child.stdout], [], [], 0)[0])


class Named(Nothing):
    """A service that shows under which name it was last spoken to."""

    shown: tuple[str, int | None] = ("", None)

    def join(self, who: str, pid: int | None) -> None:
        self.shown = who, pid
        super().join(who, pid)

    def rename(self, who: str, pid: int | None) -> None:
        self.shown = who, pid
        super().rename(who, pid)


class Desk:
    """A guard without a robot, turned by the test, and the drivers at its port."""

    def __init__(self, folder: Path, **settings: object) -> None:
        self.lines: list[str] = []
        made = config.load(None, {"board.kind": "arduino", **settings})
        self.pty = Pty(str(folder / "port"))
        self.door = Door(self.pty)
        self.board = Named(made, self.lines.append)
        self.guard = Guard(self.board, self.pty, self.door, self.lines.append)
        self.scripts: list[Script] = []
        self._ended = False

    def script(self, name: str = "") -> Script:
        """Start a driver; `name`: what its program is called."""
        program = Path(self.pty.path).with_name(name) if name else Path(sys.executable)
        if name and not program.exists():
            program.symlink_to(sys.executable)
        self.scripts.append(Script(self.pty.path, str(program)))
        return self.scripts[-1]

    def do(self, script: Script, *lines: str) -> None:
        """Have a driver do this, while the guard goes on."""
        for line in lines:
            script.begin(line)
            self.until(lambda: script.says, f"{line} to be done")
            assert script.child.stdout
            assert script.child.stdout.readline() == b"done\n"

    def unseen(self, script: Script, *lines: str) -> None:
        """Have a driver do this before the guard looks."""
        for line in lines:
            script.begin(line)
            assert script.child.stdout
            assert script.child.stdout.readline() == b"done\n"

    def until(self, found: Callable[[], object], what: str) -> None:
        """Turn the guard until it is so."""

        def turned() -> bool:
            self.guard.turn()
            return bool(found())

        until(turned, what)

    def says(self, words: str) -> None:
        """Wait for a line with these words."""
        self.until(lambda: [line for line in self.lines if words in line], f"{words!r}, of {self.lines}")

    def turn(self, times: int = 5) -> None:
        """So many turns, at most a few milliseconds each."""
        for _ in range(times):
            self.guard.turn()

    def close(self) -> None:
        for script in self.scripts:
            script.child.kill()
            script.child.wait()
            for stream in (script.child.stdin, script.child.stdout):
                assert stream
                stream.close()
        self.end_guard()
        self.pty.close()

    def end_guard(self) -> None:
        if not self._ended:
            self._ended = True
            self.guard.close()


@pytest.fixture
def desk(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[Desk]:
    desk = Desk(tmp_path, **getattr(request, "param", {}))
    yield desk
    desk.close()


def test_a_descriptor_that_was_copied_is_no_second_program(desk: Desk) -> None:
    driver = desk.script()
    desk.unseen(driver, OPEN, "copy = os.dup(port)")
    desk.says("has the port open")
    assert (desk.door.count, desk.door.crowded) == (1, False)
    desk.do(driver, DRIVE % (7, 7))
    desk.says("motion: wheels 7 7")


def driving_with_a_child(desk: Desk, fork: str, begins: str) -> Script:
    """A driver whose motion has come, and whose child has the port open too. The child `begins` before the guard has
    looked who opened the port, or after."""
    driver = desk.script()
    if begins == "before":
        desk.unseen(driver, OPEN, fork)
        desk.says("has the port open")
    else:
        desk.do(driver, OPEN, fork)
    desk.do(driver, DRIVE % (7, 7))
    desk.says("motion: wheels 7 7")
    return driver


@pytest.mark.parametrize("begins", ["before", "after"])
def test_a_child_that_ends_leaves_its_parent_the_port(desk: Desk, begins: str) -> None:
    """As with system() and popen() in C, which inherit every descriptor."""
    driver = driving_with_a_child(desk, FORK, begins)
    assert not desk.door.crowded
    desk.do(driver, END_CHILD)
    desk.turn()
    assert not [line for line in desk.lines if "ended" in line or "hung up" in line], desk.lines
    desk.do(driver, DRIVE % (8, 8))
    desk.says("motion: wheels 8 8")


def test_a_program_that_runs_another_one_again_and_again_goes_on_driving(desk: Desk) -> None:
    driver = desk.script()
    desk.do(driver, OPEN, "os.set_inheritable(port, True)")
    for speed in range(1, 6):
        desk.do(driver, "os.system('sleep 0.02')", DRIVE % (speed, speed))
        desk.says(f"motion: wheels {speed} {speed}")
    assert not [line for line in desk.lines if "ended" in line], desk.lines


@pytest.mark.parametrize("begins", ["before", "after"])
def test_a_driver_that_dies_while_its_child_has_the_port_is_named_with_the_remedy(desk: Desk, begins: str) -> None:
    driver = driving_with_a_child(desk, FORK_ON, begins)
    driver.child.kill()
    desk.says("has ended or died, and the last speed that it wrote was not zero")
    desk.says("but a child of it still had it open, so the guard hung up: open the port with O_CLOEXEC")
    assert desk.door.count == 0


def test_a_driver_that_closes_the_port_and_leaves_it_open_with_a_child_is_noticed(desk: Desk) -> None:
    """The kernel reports no close, and the next driver would be refused."""
    driver = desk.script()
    desk.do(driver, OPEN, FORK_ON, DRIVE % (7, 7))
    desk.says("motion: wheels 7 7")
    desk.do(driver, "os.close(port)")
    desk.says("but a child of it still had it open, so the guard hung up")
    again = desk.script()
    desk.do(again, OPEN, DRIVE % (8, 8))
    desk.says("motion: wheels 8 8")


@pytest.mark.parametrize("desk", [{"guard.openers": 2}], indirect=True)
def test_of_two_programs_each_has_its_own_death_and_no_child_s(desk: Desk) -> None:
    first, second = desk.script(), desk.script()
    desk.unseen(first, OPEN, FORK)
    desk.says(f"(pid {first.child.pid}) has the port open")
    desk.do(second, OPEN)
    desk.until(lambda: set(desk.door.seen) == {first.child.pid, second.child.pid}, "both to be seen")
    assert (desk.door.count, desk.door.crowded) == (2, False)
    desk.do(first, END_CHILD, DRIVE % (7, 7))
    desk.says("motion: wheels 7 7")
    assert not [line for line in desk.lines if "ended" in line]
    second.child.kill()
    both = f"(pid {first.child.pid}) and ", f"(pid {second.child.pid}) has ended or died, and the last speed"
    desk.says(both[1])
    assert next(line for line in desk.lines if both[1] in line).startswith("one of ")
    assert any(both[0] in line for line in desk.lines), "the guard can't see which of the two has written"
    assert set(desk.door.seen) == {first.child.pid}


@pytest.mark.parametrize("desk", [{"guard.openers": 3}], indirect=True)
@pytest.mark.parametrize("drives", ["before", "after"])
def test_of_several_programs_none_is_named_alone(desk: Desk, drives: str) -> None:
    """Nobody can see which of them drives, and one that lives must not be named as the one that has died."""
    reader, driver, third = (desk.script(name) for name in ("reader", "driver", "third"))
    one, other = reader.child.pid, driver.child.pid
    desk.do(reader, OPEN)
    desk.says(f"reader (pid {one}) has the port open")
    assert desk.board.shown == ("reader", one)
    if drives == "before":
        desk.do(reader, DRIVE % (7, 7))
        desk.says("motion: wheels 7 7")
    desk.do(driver, OPEN)
    desk.until(lambda: desk.board.shown == ("reader or driver", None), "both to be named")
    assert not [line for line in desk.lines if "with failstop" in line], "it drives on"
    desk.do(driver, DRIVE % (8, 8), r"os.write(port, b'o 1 1\r')")
    desk.says(f"reader (pid {one}) or driver (pid {other}): refused raw PWM (o)")
    desk.do(third, OPEN)
    desk.until(lambda: desk.board.shown == ("reader or driver or third", None), "all to be named")
    driver.child.kill()
    desk.says(f"reader (pid {one}) and third (pid {third.child.pid}) have the port open")
    assert desk.board.shown == ("reader or third", None)
    reader.child.kill()
    desk.says(f"third (pid {third.child.pid}) has the port open")
    assert desk.board.shown == ("third", third.child.pid)


@pytest.mark.parametrize("desk", [{"guard.openers": 2}], indirect=True)
def test_a_program_that_dies_during_the_search_is_not_ended_under_the_name_of_the_next_one(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The search leaves out who is dying, and the kernel reports the close only afterwards."""
    first, second = desk.script("first"), desk.script("second")
    desk.do(first, OPEN, DRIVE % (7, 7))
    desk.says("motion: wheels 7 7")
    search, searching = desk.door.recount, []

    def recount(meanwhile: Callable[[], None]) -> None:
        searching.append(True)
        search(meanwhile)
        searching.clear()

    monkeypatch.setattr(desk.door, "recount", recount)
    monkeypatch.setattr("failstop.guard.door.dying", lambda pid: bool(searching) and pid == first.child.pid)
    desk.do(second, OPEN)
    desk.until(lambda: set(desk.door.seen) == {second.child.pid}, "only the second one to be seen")
    assert desk.board.shown == ("first or second", None)
    monkeypatch.undo()
    first.child.kill()
    desk.says(f"first (pid {first.child.pid}) or second (pid {second.child.pid}) has ended or died, and the last speed")
    desk.until(lambda: desk.board.shown == ("second", second.child.pid), "the second one to have the port to itself")


@pytest.mark.parametrize("desk", [{"guard.openers": 2}], indirect=True)
def test_two_programs_with_long_names_are_both_named(desk: Desk) -> None:
    first, second = desk.script("a" * 60), desk.script("b" * 60)
    desk.do(first, OPEN)
    desk.do(second, OPEN)
    desk.until(lambda: desk.board.shown[1] is None, "both to be named")
    assert desk.board.shown[0] == f"{'a' * 28} or {'b' * 28}"


@AS_ROOT
def test_a_program_that_opens_it_twice_is_told_what_to_do(desk: Desk) -> None:
    driver = desk.script()
    desk.do(driver, OPEN, OPEN.replace("port =", "other ="))
    desk.says(
        f"(pid {driver.child.pid}) has opened the port 2 times, and guard.openers allows 1: nothing that it writes "
        "moves the robot. Open it once, or set guard.openers = 2"
    )


def test_a_guard_whose_port_was_opened_too_often_still_sleeps(desk: Desk, monkeypatch: pytest.MonkeyPatch) -> None:
    """Nothing is sent to the service then, so the motion that waits to be sent must not wake the guard."""
    driver = desk.script()
    desk.unseen(driver, OPEN, OPEN.replace("port =", "other ="), DRIVE % (7, 7), "os.write(port, b'e' + bytes([13]))")
    desk.says("has opened the port 2 times")
    desk.turn()
    waits, wait = [], desk.door.wait
    monkeypatch.setattr(desk.door, "wait", lambda seconds: waits.append(seconds) or wait(seconds))
    desk.turn()
    assert min(waits) > 0.004, waits


@AS_ROOT
@pytest.mark.parametrize("ends", ["dies", "loses its terminal", "outlives the guard"])
def test_a_driver_that_ends_while_root_has_the_port_too_may_have_driven_whatever_root_wrote(
    desk: Desk, ends: str
) -> None:
    driver, root = desk.script(), desk.script()
    desk.do(driver, OPEN, DRIVE % (7, 7))
    desk.says("motion: wheels 7 7")
    desk.do(root, OPEN, DRIVE % (0, 0))
    desk.says("nothing that they write moves the robot until one closes it")
    desk.turn()
    if ends == "dies":
        driver.child.kill()
        desk.says("has ended or died while too many programs had the port open")
    elif ends == "loses its terminal":
        desk.do(root, "import fcntl", "fcntl.ioctl(port, 0x5437)")
        desk.says("root hung up the port")
    else:
        desk.end_guard()
    assert [line for line in desk.lines if "with failstop: the wheels stop" in line], desk.lines


@AS_ROOT
def test_a_driver_that_has_the_port_to_itself_again_ends_cleanly(desk: Desk) -> None:
    driver, root = desk.script(), desk.script()
    desk.do(driver, OPEN, DRIVE % (0, 0))
    desk.do(root, OPEN)
    desk.says("nothing that they write moves the robot until one closes it")
    desk.do(root, "os.close(port)")
    desk.until(lambda: not desk.door.crowded, "root to be gone")
    desk.do(driver, DRIVE % (0, 0))
    desk.lines.clear()
    driver.child.kill()
    desk.says(f"(pid {driver.child.pid}) has ended")
    assert not [line for line in desk.lines if "or died" in line or "with failstop" in line], desk.lines


@pytest.mark.parametrize(
    ("held", "shares", "opened", "expected"),
    [
        pytest.param([(5, 3, 90), (5, 4, 90)], [{(5, 3), (5, 4)}], 1, {5: 1}, id="a copy"),
        pytest.param([(5, 3, 90), (5, 4, 90)], [], 2, {5: 2}, id="opened twice"),
        pytest.param([(4, 3, 95), (5, 3, 90)], [{(4, 3), (5, 3)}], 1, {5: 1}, id="the parent is older, by pid or not"),
        pytest.param([(5, 3, 90), (6, 3, 90)], [{(5, 3), (6, 3)}], 1, {5: 1}, id="both began in one tick"),
        pytest.param([(7, 3, 99), (5, 3, 90)], [{(7, 3), (5, 3)}], 1, {7: 1}, id="the known one stays the owner"),
        pytest.param(
            [(7, 3, 99), (8, 3, 99), (5, 3, 90)], [{(7, 3), (8, 3)}], 2, {7: 1, 5: 1}, id="two programs and a child"
        ),
    ],
)
def test_whose_an_opening_is(
    held: list[tuple[int, int, int]], shares: list[set[tuple[int, int]]], opened: int, expected: dict[int, int]
) -> None:
    def same(one: Held, other: Held) -> bool:
        return any({(one.pid, one.fd), (other.pid, other.fd)} <= share for share in shares)

    assert owners([Held(*each) for each in held], {7}, opened, same) == expected


@pytest.mark.parametrize(("opened", "expected"), [(1, {5: 1}), (2, {5: 1, 6: 1}), (3, {5: 1, 6: 1, 8: 1})])
def test_where_the_kernel_does_not_say_what_is_shared_its_events_count(opened: int, expected: dict[int, int]) -> None:
    held = [Held(8, 3, 99), Held(5, 3, 90), Held(6, 3, 91)]
    assert owners(held, {}, opened, lambda _one, _other: None) == expected


def test_a_driver_that_asks_for_too_much_is_named_once_for_each_limit(desk: Desk) -> None:
    driver = desk.script()
    desk.do(driver, OPEN)
    for speed in range(900, 905):
        for motion in (DRIVE % (speed, speed), DRIVE % (speed, -speed)):
            desk.do(driver, motion)
            desk.turn()
    desk.says("motion: wheels 904 -904")
    asks = [line.partition(" asks for ")[2] for line in desk.lines if " asks for " in line]
    assert ["forward or backward" in asks[0], "turning" in asks[1], len(asks)] == [True, True, 2], asks


# How old a driver's first motion is, and one that opens the port for each motion.


def test_the_first_motion_of_a_driver_is_as_old_as_its_opening(desk: Desk) -> None:
    """However long nobody had the port open before."""
    since_s = time.monotonic()
    desk.until(lambda: time.monotonic() - since_s > 1.0, "a second without a driver")
    desk.unseen(desk.script(), OPEN, DRIVE % (7, 7))
    desk.says("it has written no speed for")
    assert "motion: wheels 7 7" in next(line for line in desk.lines if "motion" in line)


@pytest.mark.parametrize("stays_s", [0, 0.1])
def test_a_program_that_closes_the_port_after_each_motion_is_told_to_keep_it_open(desk: Desk, stays_s: float) -> None:
    """As `echo "m 10 10" > PORT` does."""
    script = desk.script()
    close = f"__import__('time').sleep({stays_s}); os.close(port)"
    desk.do(script, f"{OPEN}; {DRIVE % (7, 7)}; {close}")
    desk.says("closed the port right after it wrote a motion, and a motion ends when the port is closed: keep it open")
    assert "write the motion again within 0.3 s" in desk.lines[-1]


def test_one_that_asks_or_stops_and_closes_the_port_is_told_nothing(desk: Desk) -> None:
    script = desk.script()
    for line in (r"b'e\r'", r"b'm 0 0\r'", r"b'm 7 7\rm 0 0\r'"):
        desk.do(script, f"{OPEN}; os.write(port, {line}); os.close(port)")
        desk.turn()
    assert not [line for line in desk.lines if "right after" in line]


@pytest.mark.parametrize("desk", [{"board.kind": "feetech"}], indirect=True)
def test_a_host_that_ends_after_a_late_answer_is_named_with_the_reason(desk: Desk) -> None:
    host = desk.script()
    desk.do(host, OPEN)
    desk.unseen(host, r"os.write(port, b'\xff\xff\x07\x02\x01\xf5')")
    time.sleep(0.1)  # the guard is held up for longer than a host waits
    desk.turn()
    host.child.kill()
    desk.says("ms late, and this driver waits 34 ms: the computer is busy")


UNANSWERED = "no board answers in a dry run: a driver that waits for the answer goes no further"


@pytest.mark.parametrize(
    ("desk", "asks", "moves_on"),
    [
        ({"board.kind": "vesc"}, "020100000003", "020104408403"),
        ({"board.kind": "damiao"}, b"t7FF80100330A00000000\r".hex(), b"t7FF80100330B00000000\r".hex()),
    ],
    indirect=["desk"],
    ids=["vesc", "damiao"],
)
def test_a_dry_run_says_that_nobody_answers_a_question(desk: Desk, asks: str, moves_on: str) -> None:
    driver = desk.script()
    desk.do(driver, OPEN)
    for question in (asks, moves_on, asks):
        desk.do(driver, f"os.write(port, bytes.fromhex('{question}'))")
        time.sleep(0.02)  # a guard passes on one frame in this time
        desk.turn()
    desk.until(lambda: len([line for line in desk.lines if "passed on to the board" in line]) == 2, "both questions")
    assert desk.lines.count(f"  {UNANSWERED}") == 1, desk.lines


@pytest.mark.parametrize(
    ("desk", "written"),
    [({"board.kind": "arduino"}, rb"e\r"), ({"board.kind": "ugv"}, rb'{"T":132,"IO4":1,"IO5":1}\n')],
    indirect=["desk"],
    ids=["failstop answers itself", "a light"],
)
def test_a_dry_run_says_nothing_of_answers_that_no_driver_waits_for(desk: Desk, written: bytes) -> None:
    driver = desk.script()
    desk.do(driver, OPEN, f"os.write(port, b'{written.decode()}')")
    desk.says("passed on to the board")
    assert not [line for line in desk.lines if UNANSWERED in line]


# A program that closes the port and opens it again at once, and one that closes it while another one has it open.

TWO: dict[str, object] = {"guard.openers": 2}
CLOSE = "os.close(port)"
ASK = r"os.write(port, b'e\r')"
ANSWERED = r"select.select([port], [], [], 5); assert os.read(port, 100) == b'0 0\r\n'"
HALF_A_SECOND = (
    "import termios; found = termios.tcgetattr(port); found[6][termios.VMIN] = 0; found[6][termios.VTIME] = 5; "
    "termios.tcsetattr(port, termios.TCSANOW, found)"
)


def reads(desk: Desk) -> list[int]:
    """After how many bytes, and after which time, a read from the terminal returns."""
    characters = termios.tcgetattr(desk.pty.slave)[6]
    return [characters[termios.VMIN], characters[termios.VTIME]]


@pytest.mark.parametrize("desk", [TWO], indirect=True)
@pytest.mark.parametrize(
    "last", ["pass", r"os.write(port, b'b\r')", r"os.write(port, b'm 0 0\r')"], ids=["waits", "asks", "stops"]
)
def test_the_first_question_after_the_port_was_closed_and_opened_is_answered(desk: Desk, last: str) -> None:
    """Also if the program had written before, whatever the guard has not read of that."""
    driver = desk.script()
    desk.do(driver, OPEN, ASK, ANSWERED)
    desk.unseen(driver, last, CLOSE, OPEN, ASK)
    desk.do(driver, ANSWERED)
    desk.do(driver, ASK, ANSWERED)


@pytest.mark.parametrize("desk", [TWO], indirect=True)
def test_a_program_keeps_the_settings_that_it_made_right_after_it_opened_the_port_again(desk: Desk) -> None:
    """Otherwise a read that should return after half a second would never return."""
    driver = desk.script()
    desk.do(driver, OPEN)
    desk.unseen(driver, CLOSE, OPEN, HALF_A_SECOND)
    assert reads(desk) == [0, 5]
    desk.says("has ended")
    desk.turn()
    assert reads(desk) == [0, 5]
    desk.do(driver, CLOSE)
    desk.until(lambda: reads(desk) == [1, 0], "the next program to find it as the first did")


@pytest.mark.parametrize("desk", [TWO], indirect=True)
def test_a_program_may_open_the_port_again_while_the_guard_handles_that_it_was_closed(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    driver, look = desk.script(), desk.door.look
    desk.do(driver, OPEN, ASK, ANSWERED)

    def then_opened(ready: dict[int, int]) -> News:
        news = look(ready)
        if news.ended:
            monkeypatch.undo()
            desk.unseen(driver, OPEN, HALF_A_SECOND, ASK)
        return news

    monkeypatch.setattr(desk.door, "look", then_opened)
    desk.unseen(driver, CLOSE)
    desk.says("has ended")
    desk.do(driver, ANSWERED)
    assert reads(desk) == [0, 5]


@pytest.mark.parametrize("desk", [TWO], indirect=True)
def test_a_program_keeps_its_settings_when_another_one_closes_the_port(desk: Desk) -> None:
    driver, other = desk.script(), desk.script()
    desk.do(driver, OPEN, HALF_A_SECOND)
    desk.do(other, OPEN)
    desk.until(lambda: len(desk.door.seen) == 2, "both to be seen")
    desk.do(other, CLOSE)
    desk.until(lambda: len(desk.door.seen) == 1, "one to be seen")
    assert reads(desk) == [0, 5]


@pytest.mark.parametrize("desk", [{"board.kind": "damiao", **TWO}], indirect=True)
def test_what_a_program_has_set_up_stays_when_another_one_closes_the_port(desk: Desk) -> None:
    driver, other = desk.script(), desk.script()
    disables, turns = r"os.write(port, b't0018FFFFFFFFFFFFFFFD\r')", r"os.write(port, b't20140000A040\r')"
    desk.do(driver, OPEN, turns)
    desk.says("motion: wheels 5 0")
    desk.do(driver, disables)
    desk.do(other, OPEN)
    desk.until(lambda: len(desk.door.seen) == 2, "both to be seen")
    desk.do(other, CLOSE)
    desk.until(lambda: len(desk.door.seen) == 1, "one to be seen")
    desk.lines.clear()
    desk.do(driver, turns)
    desk.says("refused a speed for motor 1, which the driver has disabled")
    assert not [line for line in desk.lines if "motion" in line]


def _excludes(desk: Desk) -> bool:
    """True if the kernel refuses an ordinary user's program."""
    return fcntl.ioctl(desk.pty.slave, 0x80045440, bytes(4)) != bytes(4)


@AS_ROOT
@pytest.mark.parametrize(
    ("desk", "refuses"), [({"guard.openers": 1}, True), (TWO, False)], indirect=["desk"], ids=["one", "two"]
)
def test_one_more_program_is_let_in_as_soon_as_there_is_room_and_not_before(
    desk: Desk, refuses: bool, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also while the guard finds out which programs have the port open. That takes long on a busy computer."""
    driver, other = desk.script(), desk.script()
    desk.do(driver, OPEN)
    desk.do(other, OPEN)
    desk.until(lambda: desk.door.count == 2 and _excludes(desk), "both to be seen")
    search, found = desk.door.recount, []
    monkeypatch.setattr(desk.door, "recount", lambda meanwhile: (found.append(_excludes(desk)), search(meanwhile)))
    desk.do(other, CLOSE)
    desk.until(lambda: found, "a search")
    assert found == [refuses]


# A link that is lost.


def test_a_link_that_cannot_be_made_again_ends_no_guard_whose_port_is_open(
    desk: Desk, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The driver has the terminal itself, and needs the link no more. Without a driver, systemd makes the folder again
    when it starts the guard again."""
    monkeypatch.setattr("failstop.guard.guard.LOOK_NS", 0)
    driver = desk.script()
    desk.do(driver, OPEN, DRIVE % (7, 7))
    desk.says("motion: wheels 7 7")
    path, aside = Path(desk.pty.path), Path(desk.pty.path).with_name("aside")
    for kept in ("", "again: "):
        path.rename(aside)
        path.write_text("in its place")
        desk.turn()
        reason = f"{path} exists already and is not a link: remove it, or choose another --path"
        assert [line for line in desk.lines if reason in line] == [
            f"{reason}; the driver that has the port open keeps it"
        ], kept
        path.unlink()
        desk.turn()
        assert os.readlink(path) == desk.pty.name
        aside.unlink()
        desk.lines.clear()
    path.unlink()
    path.write_text("in its place")
    desk.do(driver, DRIVE % (8, 8))
    desk.says("motion: wheels 8 8")
    driver.begin("os.close(port)")
    with pytest.raises(FailstopError, match="exists already and is not a link"):
        desk.until(lambda: False, "the guard to end without a driver")


# A terminal that root hangs up.


@AS_ROOT
@pytest.mark.parametrize("driven", [True, False], ids=["driven", "alone"])
def test_a_terminal_that_root_hangs_up_is_replaced(desk: Desk, driven: bool) -> None:
    driver, root = desk.script(), desk.script()
    if driven:
        desk.do(driver, OPEN, DRIVE % (7, 7))
        desk.says("motion: wheels 7 7")
    desk.do(root, "import fcntl, termios", OPEN, "fcntl.ioctl(port, 0x5437)", "os.close(port)")
    name = Path(f"/proc/{driver.child.pid}/comm").read_text().strip()
    desk.says("root hung up the port (vhangup)")
    said = next(line for line in desk.lines if "root hung up" in line)
    # Root's own program may have been seen too.
    assert (f", so {name} (pid {driver.child.pid})" in said and "lost it: start" in said) == driven, said
    assert desk.pty.name == os.readlink(desk.pty.path)
    again = desk.script()
    desk.do(again, OPEN, DRIVE % (8, 8))
    desk.says("motion: wheels 8 8")
