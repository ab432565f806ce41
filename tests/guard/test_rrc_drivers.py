"""Drivers of Hiwonder's RRC at the guard port: the vendor's Python SDK, call by call, and its demos."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator

import pytest

from bench.guard_scene import GuardScene, Process
from failstop.board.rrc.framing import BUZZER
from failstop_lab.trial import wait_for
from tests.support.amounts import amount

SDK = """
import queue, serial, struct, sys, threading, time
def crc(data):
    value = 0
    for byte in data:
        value ^= byte
        for _ in range(8):
            value = value >> 1 ^ 0x8C if value & 1 else value >> 1
    return value
class Board:
    def __init__(self, device, baudrate=1000000, timeout=5):
        self.queues = {func: queue.Queue(maxsize=1) for func in range(12)}
        self.port = serial.Serial(None, baudrate, timeout=timeout)
        self.port.rts = False
        self.port.dtr = False
        self.port.setPort(device)
        self.port.open()
        self.reads = False
        self.wrong = 0
        time.sleep(0.5)
        threading.Thread(target=self.receive, daemon=True).start()
    def receive(self):
        state, func, frame = 0, 0, b""
        while True:
            if not self.reads:
                time.sleep(0.01)
                continue
            head = self.port.read(1)
            if head != b"\\xaa" or self.port.read(1) != b"\\x55":
                self.wrong += 1
                continue
            func, length = self.port.read(2)
            data, check = self.port.read(length), self.port.read(1)
            if crc(bytes((func, length)) + data) != check[0]:
                self.wrong += 1
                continue
            try:
                self.queues[func].put_nowait(data)
            except queue.Full:
                pass
    def write(self, func, data):
        body = bytes((func, len(data))) + bytes(data)
        self.port.write(b"\\xaa\\x55" + body + bytes((crc(body),)))
    def set_motor_speed(self, speeds):
        self.write(3, b"\\x01" + bytes((len(speeds),)) + b"".join(struct.pack("<Bf", id - 1, s) for id, s in speeds))
    def set_buzzer(self, freq, on, off, repeat=1):
        self.write(2, struct.pack("<HHHH", freq, int(on * 1000), int(off * 1000), repeat))
    def bus_servo_read(self, servo, kind, form):
        self.write(5, bytes((kind, servo)))
        servo, kind, success, value = struct.unpack(form, self.queues[5].get(block=True))
        return value if success == 0 else None
board = Board(sys.argv[1])
"""
NODE = (
    SDK
    + """
speed = float(sys.argv[2])
board.write(4, bytes((7, 1, 0)))
board.set_motor_speed([[1, 0], [2, 0], [3, 0], [4, 0]])
board.reads = True
board.set_buzzer(1900, 0.1, 0.9)
print("open", board.bus_servo_read(9, 0x05, "<BBbh"), flush=True)
last = 0
while True:
    # On the left the motors are mounted the other way round.
    board.set_motor_speed([[1, -speed], [2, -speed], [3, speed], [4, speed]])
    if time.monotonic() - last > 0.05:
        last = time.monotonic()
        ax, ay, az, *_ = struct.unpack("<6f", board.queues[7].get(block=True))
        print(board.wrong, round((ax * ax + ay * ay + az * az) ** 0.5, 1), flush=True)
    time.sleep(float(sys.argv[3]))
"""
)
"""As the vendor's node: at its start servo 1's offset and a stop, then what its topics bring."""
DEMO = (
    SDK
    + """
board.set_motor_speed([[1, -0.3], [2, -0.3]])
board.set_motor_speed([[3, 0.3], [4, 0.3]])
print("open", flush=True)
time.sleep(1000)
"""
)
"""It writes each pair of motors once, reads nothing, and sleeps."""


@pytest.fixture(scope="module")
def _rrc(tmp_path_factory: pytest.TempPathFactory) -> Iterator[GuardScene]:
    with GuardScene(tmp_path_factory.mktemp("rrc"), "rrc") as scene:
        yield scene


@pytest.fixture
def rrc(_rrc: GuardScene) -> Iterator[GuardScene]:
    _rrc.trial.robot.disable()
    _rrc.rest()
    _rrc.trial.board.events()
    yield _rrc
    _rrc.end_drivers()


def drives(scene: GuardScene, source: str = NODE, *words: str) -> Process:
    """A driver whose wheels turn."""
    scene.rest()
    scene.enable()
    driver = scene.python(source, *(words or ("0.3", "0.02")))
    assert driver.line().startswith("open")
    scene.moves()
    return driver


def test_a_node_drives_and_hears_the_imu_as_at_the_bare_board(rrc: GuardScene) -> None:
    driver = drives(rrc)
    wait_for(
        "the wheels at their speed",
        lambda: [abs(rps) for rps in rrc.trial.board.wheels()] == pytest.approx([0.3] * 4, abs=0.01),
    )
    assert driver.lines[0] == "open None", "no servo was there to be read, and the node went on"
    lines = [driver.line() for _ in range(10)]
    assert all(line == "0 1.0" for line in lines), lines
    tones = [event.data for event in rrc.trial.board.events() if event.func == BUZZER]
    assert tones == [bytes.fromhex("6c07640084030100")], "1900 Hz, on for 0.1 s, off for 0.9 s, once"


@pytest.mark.claim("GUARD-1")
@pytest.mark.parametrize("source", [NODE, DEMO], ids=["node", "demo"])
def test_a_driver_that_is_killed_stops_and_nothing_drives_before_an_enable(rrc: GuardScene, source: str) -> None:
    for _ in range(amount(5, 500)):
        driver = drives(rrc, source)
        driver.kill()
        rrc.stands()
        if source is NODE:  # a demo may have fallen silent before
            wait_for("motion to be disabled", lambda: not rrc.trial.robot.state.enabled)
            name = os.path.basename(str(driver.child.args[1]))  # type: ignore[index]
            assert f"{name} (pid {driver.pid}) died after it had driven" in str(rrc.trial.robot.why())
            again = rrc.python(source, "0.3", "0.02")
            assert again.line().startswith("open")
            rrc.trial.board.events()
            [again.line() for _ in range(4)]
            assert rrc.motion() == []
            again.kill()


def test_a_suspended_driver_stops_and_goes_on_afterwards(rrc: GuardScene) -> None:
    driver = drives(rrc)
    os.kill(driver.pid, signal.SIGSTOP)
    rrc.stands()
    assert rrc.trial.robot.state.enabled
    os.kill(driver.pid, signal.SIGCONT)
    rrc.moves()


@pytest.mark.claim("GUARD-1")
@pytest.mark.parametrize("latched", [False, True], ids=["disabled", "latched"])
def test_nothing_moves_while_motion_is_disabled_or_a_stop_is_latched(rrc: GuardScene, latched: bool) -> None:
    if latched:
        rrc.trial.robot.estop("a test")
    driver = rrc.python(NODE, "3.0", "0")
    driver.line()
    for _ in range(amount(20, 1000)):
        driver.line()
    assert rrc.motion() == []
    if latched:
        wait_for("a reset to be taken", rrc.trial.reset)


def test_a_demo_that_writes_once_and_sleeps_stops(rrc: GuardScene) -> None:
    rrc.enable()
    driver = rrc.python(DEMO)
    assert driver.line() == "open"
    wait_for("the wheels to have turned", rrc.motion)
    rrc.stands()
    wait_for("why to say so", lambda: "stopped sending" in str(rrc.trial.robot.why()))
