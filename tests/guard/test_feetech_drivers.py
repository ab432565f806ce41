"""Drivers of Feetech's servos at the guard port: LeRobot's LeKiwi host, call by call, and a user's script."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator

import pytest

from bench.guard_scene import GuardScene, Process
from failstop_lab.trial import wait_for
from tests.support.amounts import amount

BUS = """
import serial, sys, time
port = serial.Serial(sys.argv[1], 1_000_000, timeout=0)
def packet(to, kind, *data):
    body = bytes((to, len(data) + 2, kind, *data))
    return b"\\xff\\xff" + body + bytes((~sum(body) & 0xFF,))
def answer(servo):
    kept, until = b"", time.monotonic() + float(sys.argv[-1])
    while time.monotonic() < until:
        kept += port.read(6 - len(kept) if len(kept) < 6 else kept[3] + 4 - len(kept))
        if len(kept) > 5 and len(kept) == kept[3] + 4:
            assert kept[:3] == bytes((255, 255, servo)) and sum(kept[2:]) & 0xFF == 0xFF, kept.hex()
            return kept[5:-1]
    print("error no status packet of", servo, flush=True)
    sys.exit(1)
def ask(servo, kind, *data):
    port.write(packet(servo, kind, *data))
    return answer(servo)
def sync_read(address, size, servos):
    port.write(packet(0xFE, 0x82, address, size, *servos))
    return [int.from_bytes(answer(servo), "little") for servo in servos]
def sync_write(address, rows):
    data = [byte for servo, word in rows for byte in (servo, word & 255, word >> 8)]
    port.write(packet(0xFE, 0x83, address, 2, *data))
def word(speed):
    return speed if speed >= 0 else -speed | 0x8000
"""
HOST = (
    BUS
    + """
ARM, WHEELS = (1, 2, 3, 4, 5, 6), (7, 8, 9)
speed = int(sys.argv[2])
for servo in (*ARM, *WHEELS):
    ask(servo, 1)
    assert ask(servo, 2, 3, 2) == b"\\x09\\x03"
    ask(servo, 2, 0, 1), ask(servo, 2, 1, 1)
for servo in (*ARM, *WHEELS):
    found = [int.from_bytes(ask(servo, 2, at, 2), "little") for at in (9, 11, 31)]
    assert found == ([700, 3400, 0x800 | 20] if servo in ARM else [0, 4095, 0]), found
for servo in (*ARM, *WHEELS):
    modes = ((33, 0), (21, 16), (23, 0), (22, 32)) if servo in ARM else ((33, 1),)
    for address, value in ((40, 0), (55, 0), (7, 0), (85, 254), (41, 254), *modes, (40, 1), (55, 1)):
        ask(servo, 3, address, value)
print("open", flush=True)
while True:
    at = sync_read(56, 2, ARM)
    turns = sync_read(58, 2, WHEELS)
    sync_write(42, [(servo, position + 50) for servo, position in zip(ARM, at)])
    sync_write(46, [(7, word(-speed)), (8, 0), (9, word(speed))])
    print(*at, *turns, flush=True)
    time.sleep(1 / 30)
"""
)
"""LeRobot 0.4.4's bus code and host, which a missing answer ends."""
SCRIPT = (
    BUS
    + """
print("open", flush=True)
for wheel, speed in ((7, -300), (9, 300)):
    ask(wheel, 3, 46, word(speed) & 255, word(speed) >> 8)
if sys.argv[2] == "stop":
    time.sleep(0.25)
    for wheel in (7, 9):
        ask(wheel, 3, 46, 0, 0)
else:
    time.sleep(1000)
"""
)
"""It writes each wheel's speed once, one servo after the other."""
KNOWN = (
    BUS
    + """
unknown = [1, 2, 3, 4, 5, 6, 7, 8, 9]
while unknown:
    port.write(b"".join(packet(servo, 2, 56, 2) for servo in unknown))
    until, kept = time.monotonic() + 0.05, b""
    while time.monotonic() < until:
        kept += port.read(100)
    unknown = [servo for servo in unknown if bytes((255, 255, servo)) not in kept]
print("known", flush=True)
"""
)
PATIENCE_S = "2"
"""LeRobot's own is 50 ms. How fast the guard answers on a busy machine is no matter of these tests."""
JOINTS: dict[str, object] = {
    f"joints.j{servo}.{key}": value
    for servo in (1, 2, 3, 4, 5, 6)
    for key, value in (("servo", servo), ("low", 700), ("high", 3400), ("zero", 2048), ("offset", -20))
}


@pytest.fixture(scope="module")
def _lekiwi(tmp_path_factory: pytest.TempPathFactory) -> Iterator[GuardScene]:
    with GuardScene(tmp_path_factory.mktemp("lekiwi"), "feetech", **JOINTS) as scene:
        # Each servo has been asked since the guard began to listen.
        assert scene.python(KNOWN).line() == "known"
        yield scene


@pytest.fixture
def lekiwi(_lekiwi: GuardScene) -> Iterator[GuardScene]:
    _lekiwi.trial.robot.disable()
    _lekiwi.rest()
    _lekiwi.trial.board.events()
    yield _lekiwi
    _lekiwi.end_drivers()


def drives(scene: GuardScene) -> Process:
    """A host whose wheels turn."""
    scene.rest()
    scene.enable()
    driver = scene.python(HOST, "300", PATIENCE_S)
    assert driver.line() == "open"
    scene.moves()
    return driver


def test_a_host_connects_drives_and_reads_as_at_the_bare_bus(lekiwi: GuardScene) -> None:
    driver = drives(lekiwi)
    wait_for(
        "the wheels at their speed",
        lambda: [round(rps * 4096) for rps in lekiwi.trial.board.wheels()] == pytest.approx([-300, 0, 300], abs=2),
    )

    def measured() -> bool:
        *at, left, rear, right = map(int, driver.newest().split())
        assert at == [2048] * 6
        return (left & 0x7FFF, left >> 15, rear, right) == pytest.approx((300, 1, 0, 300), abs=3)

    wait_for("the servos to say so", measured)


def test_the_arm_is_refused_by_name_and_does_not_move(lekiwi: GuardScene) -> None:
    driver = drives(lekiwi)
    assert lekiwi.guard
    said = lekiwi.guard.until("moving the arm (42 to 49)")
    assert "plugin" in said
    [driver.line() for _ in range(10)]
    assert driver.newest().split()[:6] == ["2048"] * 6


@pytest.mark.claim("GUARD-1")
def test_a_host_that_is_killed_stops_and_nothing_drives_before_an_enable(lekiwi: GuardScene) -> None:
    for _ in range(amount(10, 500)):
        driver = drives(lekiwi)
        driver.kill()
        lekiwi.stands()
        wait_for("motion to be disabled", lambda: not lekiwi.trial.robot.state.enabled)
        name = os.path.basename(str(driver.child.args[1]))  # type: ignore[index]
        assert f"{name} (pid {driver.pid}) died after it had driven" in str(lekiwi.trial.robot.why())
        again = lekiwi.python(HOST, "300", PATIENCE_S)
        assert again.line() == "open"
        lekiwi.trial.board.events()
        [again.line() for _ in range(5)]
        assert lekiwi.motion() == []
        again.kill()


def test_a_suspended_host_stops_and_goes_on_afterwards(lekiwi: GuardScene) -> None:
    driver = drives(lekiwi)
    os.kill(driver.pid, signal.SIGSTOP)
    lekiwi.stands()
    assert lekiwi.trial.robot.state.enabled
    os.kill(driver.pid, signal.SIGCONT)
    wait_for("the host to go on", lambda: driver.line())
    lekiwi.moves()


@pytest.mark.claim("GUARD-1")
@pytest.mark.parametrize("latched", [False, True], ids=["disabled", "latched"])
def test_nothing_moves_while_motion_is_disabled_or_a_stop_is_latched(lekiwi: GuardScene, latched: bool) -> None:
    if latched:
        lekiwi.trial.robot.estop("a test")
    driver = lekiwi.python(HOST.replace("1 / 30", "0"), "300", PATIENCE_S)
    driver.line()
    for _ in range(amount(100, 10_000)):
        assert driver.line().split()[6:] == ["0", "0", "0"], "it reads a board at rest"
    assert lekiwi.motion() == []
    if latched:
        wait_for("a reset to be taken", lekiwi.trial.reset)


@pytest.mark.parametrize("stops", [True, False], ids=["it writes zero", "it sleeps"])
def test_a_script_that_names_one_wheel_after_the_other(lekiwi: GuardScene, stops: bool) -> None:
    lekiwi.enable()
    driver = lekiwi.python(SCRIPT, "stop" if stops else "sleep", PATIENCE_S)
    assert driver.line() == "open"
    wait_for("the wheels to have turned", lekiwi.motion)
    lekiwi.stands()
    if stops:
        driver.child.wait()
        lekiwi.rest()
        assert lekiwi.trial.robot.state.enabled
    else:
        wait_for("why to say so", lambda: "stopped sending" in str(lekiwi.trial.robot.why()))
