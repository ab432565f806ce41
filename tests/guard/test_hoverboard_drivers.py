"""Drivers of a hoverboard at the guard port: what the ROS drivers call, and a script with pyserial."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator

import pytest

from bench.guard_scene import GuardScene, Process
from failstop_lab.trial import wait_for
from tests.support.amounts import amount

NODE = """
import os, struct, sys, termios, time
port = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY | os.O_NDELAY)
settings = termios.tcgetattr(port)
settings[0] = settings[1] = settings[3] = 0
settings[2] = termios.B115200 | termios.CRTSCTS | termios.CLOCAL | termios.CREAD | termios.CS8
settings[6][termios.VMIN] = settings[6][termios.VTIME] = 0
termios.tcsetattr(port, termios.TCSANOW, settings)
left, right, hertz = int(sys.argv[2]), int(sys.argv[3]), float(sys.argv[4])
print("open", flush=True)
kept, heard, last = b"", 0, 0.0
while True:
    try:
        kept += os.read(port, 1024)
    except BlockingIOError:
        pass
    while (at := kept.find(b"\\xcd\\xab")) >= 0 and len(kept) >= at + 18:
        words = struct.unpack("<HhhhhhhHH", kept[at : at + 18])
        check = 0
        for word in words:
            check ^= word & 0xFFFF
        kept = kept[at + 18 :]
        heard += 1
        if time.monotonic() - last > 0.05:
            last = time.monotonic()
            print("bad check" if check else "%d %d %d %d" % (heard, words[4], -words[3], words[5]), flush=True)
    steer, speed = left - right, (left + right) // 2
    frame = struct.pack("<Hhh", 0xABCD, steer, speed)
    try:
        os.write(port, frame + struct.pack("<H", 0xABCD ^ steer & 0xFFFF ^ speed & 0xFFFF))
    except BlockingIOError:  # the port's buffer is full: they say so, and write the next one
        pass
    time.sleep(1 / hertz)
"""
"""As hoverboard-robotics' ROS drivers: nothing at opening, non-blocking reads, a frame each period."""
SCRIPT = """
import serial, struct, sys, time
port = serial.Serial(sys.argv[1], 115200, timeout=0.1)
def send(steer, speed):
    port.write(struct.pack("<HhhH", 0xABCD, steer, speed, 0xABCD ^ (steer & 0xFFFF) ^ (speed & 0xFFFF)))
print("open", flush=True)
for _ in range(int(sys.argv[2])):
    send(0, 30)
    port.read(18)
    time.sleep(0.05)
if len(sys.argv) > 3:
    send(0, 0)
else:
    time.sleep(1000)
"""
NEVER_READS = """
import serial, sys, time
port = serial.Serial(sys.argv[1], 115200)
print("open", flush=True)
while True:
    port.write(bytes.fromhex("cdab00001e00d3ab"))
    time.sleep(0.01)
"""


@pytest.fixture(scope="module")
def _hoverboard(tmp_path_factory: pytest.TempPathFactory) -> Iterator[GuardScene]:
    with GuardScene(tmp_path_factory.mktemp("hoverboard"), "hoverboard") as scene:
        yield scene


@pytest.fixture
def hoverboard(_hoverboard: GuardScene) -> Iterator[GuardScene]:
    _hoverboard.trial.robot.disable()
    _hoverboard.rest()
    _hoverboard.trial.board.events()
    yield _hoverboard
    _hoverboard.end_drivers()


def drives(scene: GuardScene, source: str = NODE, *words: str) -> Process:
    """A driver whose wheels turn."""
    scene.rest()
    scene.enable()
    driver = scene.python(source, *(words or ("30", "30", "100")))
    assert driver.line() == "open"
    scene.moves()
    return driver


def test_a_driver_drives_and_hears_its_feedback_as_at_the_bare_board(hoverboard: GuardScene) -> None:
    driver = drives(hoverboard)
    wait_for(
        "the wheels at their speed", lambda: all(29 <= rps * 60 <= 30.1 for rps in hoverboard.trial.board.wheels())
    )

    def measured() -> bool:
        _, left, right, centivolts = map(int, driver.newest().split())
        return abs(left - 30) <= 2 and abs(right - 30) <= 2 and centivolts == 3650

    wait_for("the feedback to say so", measured)


def test_feedback_comes_unasked_and_whole_while_motion_is_disabled(hoverboard: GuardScene) -> None:
    driver = hoverboard.python(NODE, "30", "30", "50")
    driver.line()
    lines = [driver.line() for _ in range(20)]
    assert "bad check" not in lines
    assert all(line.split()[1:3] == ["0", "0"] for line in lines), "it sees a board at rest"
    first, last = (int(lines[at].split()[0]) for at in (0, -1))
    assert last - first >= 19


@pytest.mark.claim("GUARD-1")
@pytest.mark.parametrize("source", [NODE, NEVER_READS], ids=["node", "never reads"])
def test_a_driver_that_is_killed_stops_and_nothing_drives_before_an_enable(hoverboard: GuardScene, source: str) -> None:
    for _ in range(amount(10, 500)):
        driver = drives(hoverboard, source)
        driver.kill()
        hoverboard.stands()
        wait_for("motion to be disabled", lambda: not hoverboard.trial.robot.state.enabled)
        name = os.path.basename(str(driver.child.args[1]))  # type: ignore[index]
        assert f"{name} (pid {driver.pid}) died after it had driven" in str(hoverboard.trial.robot.why())
        again = hoverboard.python(source, "30", "30", "100")
        assert again.line() == "open"
        pid = again.pid
        wait_for("the guard to know it", lambda pid=pid: pid in hoverboard.clients().values())  # type: ignore[misc]
        hoverboard.trial.board.events()
        if source is NODE:
            [again.line() for _ in range(4)]
        assert hoverboard.motion() == []
        again.kill()


def test_a_suspended_driver_stops_and_goes_on_afterwards(hoverboard: GuardScene) -> None:
    driver = drives(hoverboard)
    os.kill(driver.pid, signal.SIGSTOP)
    hoverboard.stands()
    assert hoverboard.trial.robot.state.enabled
    os.kill(driver.pid, signal.SIGCONT)
    hoverboard.moves()


@pytest.mark.claim("GUARD-1")
@pytest.mark.parametrize("latched", [False, True], ids=["disabled", "latched"])
def test_nothing_moves_while_motion_is_disabled_or_a_stop_is_latched(hoverboard: GuardScene, latched: bool) -> None:
    if latched:
        hoverboard.trial.robot.estop("a test")
    driver = hoverboard.python(NODE, "1000", "-1000", "2000")
    driver.line()
    for _ in range(amount(20, 1000)):
        assert driver.line().split()[1:3] == ["0", "0"]
    assert hoverboard.motion() == []
    if latched:
        wait_for("a reset to be taken", hoverboard.trial.reset)


def test_a_script_that_ends_after_a_zero_leaves_motion_enabled(hoverboard: GuardScene) -> None:
    driver = drives(hoverboard, SCRIPT, "20", "stop")
    driver.child.wait()
    hoverboard.rest()
    assert hoverboard.trial.robot.state.enabled


def test_a_script_that_writes_once_stops(hoverboard: GuardScene) -> None:
    hoverboard.enable()
    driver = hoverboard.python(SCRIPT, "1")
    assert driver.line() == "open"
    wait_for("the wheels to have turned", hoverboard.motion)
    hoverboard.stands()
    wait_for("why to say so", lambda: "stopped sending" in str(hoverboard.trial.robot.why()))
