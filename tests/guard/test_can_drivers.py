"""Drivers of motors on a CAN at the guard port: what damiao-motor writes through python-can's slcan, and what a driver
of two VESCs writes."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator

import pytest

from bench.guard_scene import GuardScene, Process
from failstop_lab.trial import wait_for
from tests.support.amounts import amount

HEAD = """
import binascii, os, select, struct, sys, termios, time
port = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)
settings = termios.tcgetattr(port)
settings[0] = settings[1] = settings[3] = 0
settings[2] = termios.B115200 | termios.CLOCAL | termios.CREAD | termios.CS8
settings[6][termios.VMIN] = settings[6][termios.VTIME] = 0
termios.tcsetattr(port, termios.TCSANOW, settings)
speed, left = float(sys.argv[2]), int(sys.argv[3])
kept = b""
def read(wait_s):
    global kept
    if select.select([port], [], [], wait_s)[0]:
        kept += os.read(port, 4096)
print("open", flush=True)
"""
SLCAN = (
    HEAD
    + """
def line(can_id, data):
    os.write(port, b"t%03X8%s\\r" % (can_id, data.hex().upper().encode()))
def answer(what, wait_s=1.0):
    global kept
    until = time.monotonic() + wait_s
    while time.monotonic() < until:
        read(0.01)
        *lines, kept = kept.split(b"\\r")
        for text in lines:
            data = bytes.fromhex(text[5:21].decode())
            if what(data):
                return data
for text in (b"C\\r", b"S8\\r", b"\\r", b"O\\r", b"O\\r"):
    os.write(port, text)
for motor in (1, 2):
    while True:
        line(0x7FF, bytes((motor, 0, 0x33, 10, 0, 0, 0, 0)))
        mode = answer(lambda data: data[:4] == bytes((motor, 0, 0x33, 10)))
        if mode and mode[4] == 3:
            break
        line(0x7FF, bytes((motor, 0, 0x55, 10, 3, 0, 0, 0)))
    line(motor, bytes.fromhex("fffffffffffffffc"))
while left:
    left -= 1
    for motor in (1, 2):
        line(0x200 + motor, struct.pack("<f", speed) + bytes(4))
        report = answer(lambda data: data[0] & 15 == motor and data[2] != 0x33, 0.1)
        if report:
            level = report[3] << 4 | report[4] >> 4
            print(motor, report[0] >> 4, "%.1f" % (level / 4095 * 90 - 45), flush=True)
    time.sleep(0.02)
for motor in (1, 2):
    line(0x200 + motor, bytes(8))
    line(motor, bytes.fromhex("fffffffffffffffd"))
"""
)
"""As damiao-motor 1.0.6 (ensure_control_mode, enable, send_cmd_vel, disable) through python-can 4.6.1."""
VESC = (
    HEAD
    + """
def packet(payload):
    os.write(port, bytes((2, len(payload))) + payload + binascii.crc_hqx(payload, 0).to_bytes(2, "big") + b"\\3")
while left:
    left -= 1
    packet(struct.pack(">Bi", 8, int(speed)))
    packet(struct.pack(">BBBi", 34, 1, 8, int(speed)))
    packet(b"\\4")
    read(0.05)
    while len(kept) > 1 and len(kept) >= kept[1] + 5:
        payload, kept = kept[2 : 2 + kept[1]], kept[kept[1] + 5 :]
        print(1, 1, struct.unpack_from(">i", payload, 23)[0], flush=True)
    time.sleep(0.02)
packet(struct.pack(">Bi", 5, 0))
packet(struct.pack(">BBBi", 34, 1, 5, 0))
"""
)
"""As pyvesc 1.0.5 writes speeds to one VESC, and to a second one behind its CAN; and as it reads values."""
DRIVERS = {"damiao": (SLCAN, 4.0, 0.05), "vesc": (VESC, 600.0, 2.0)}
"""What it writes, a speed in the board's unit, and how near to it a report is."""
FOR_LONG = "1000000"


@pytest.fixture(scope="module", params=DRIVERS)
def _scene(request: pytest.FixtureRequest, tmp_path_factory: pytest.TempPathFactory) -> Iterator[GuardScene]:
    with GuardScene(tmp_path_factory.mktemp(request.param), request.param) as scene:
        yield scene


@pytest.fixture
def scene(_scene: GuardScene) -> Iterator[GuardScene]:
    _scene.trial.robot.disable()
    _scene.rest()
    _scene.trial.board.events()
    yield _scene
    _scene.end_drivers()


def drives(scene: GuardScene, turns: str = FOR_LONG) -> Process:
    """A driver whose wheels turn."""
    source, speed, _ = DRIVERS[scene.kind]
    scene.rest()
    scene.enable()
    driver = scene.python(source, str(speed), turns)
    assert driver.line() == "open"
    scene.moves()
    return driver


def test_a_driver_drives_and_hears_its_motors_as_at_the_bare_board(scene: GuardScene) -> None:
    driver = drives(scene)
    _, speed, near = DRIVERS[scene.kind]

    def measured() -> bool:
        _, status, reported = driver.newest().split()
        return status == "1" and abs(float(reported) - speed) <= near

    wait_for("its motors' own answers to say so", measured)
    assert len(set(scene.trial.board.wheels())) == 1


def test_while_motion_is_disabled_it_sees_motors_that_are_enabled_and_at_rest(scene: GuardScene) -> None:
    source, speed, _ = DRIVERS[scene.kind]
    driver = scene.python(source, str(speed), FOR_LONG)
    assert driver.line() == "open"
    for _ in range(20):
        _, status, reported = driver.line().split()
        assert status == "1"
        assert abs(float(reported)) < 0.05
    assert scene.motion() == []


@pytest.mark.claim("GUARD-1")
def test_a_driver_that_is_killed_stops_and_nothing_drives_before_an_enable(scene: GuardScene) -> None:
    for _ in range(amount(3, 500)):
        driver = drives(scene)
        driver.kill()
        scene.stands()
        wait_for("motion to be disabled", lambda: not scene.trial.robot.state.enabled)
        assert f"(pid {driver.pid}) died after it had driven" in str(scene.trial.robot.why())
        source, speed, _ = DRIVERS[scene.kind]
        again = scene.python(source, str(speed), FOR_LONG)
        assert again.line() == "open"
        pid = again.pid
        wait_for("the guard to know it", lambda pid=pid: pid in scene.clients().values())  # type: ignore[misc]
        scene.trial.board.events()
        [again.line() for _ in range(4)]
        assert scene.motion() == []
        again.kill()


def test_a_suspended_driver_stops_and_goes_on_afterwards(scene: GuardScene) -> None:
    driver = drives(scene)
    os.kill(driver.pid, signal.SIGSTOP)
    scene.stands()
    assert scene.trial.robot.state.enabled
    os.kill(driver.pid, signal.SIGCONT)
    scene.moves()


def test_a_driver_that_ends_after_a_zero_leaves_motion_enabled(scene: GuardScene) -> None:
    driver = drives(scene, "40")
    driver.child.wait()
    scene.rest()
    assert scene.trial.robot.state.enabled
