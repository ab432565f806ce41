"""Drivers of Waveshare's UGV at the guard port: pyserial's, as the vendor's ROS 2 nodes and a user's script use it."""

from __future__ import annotations

import os
import signal
from collections.abc import Iterator

import pytest

from bench.guard_scene import GuardScene, Process
from failstop_lab.trial import wait_for
from tests.support.amounts import amount

WRITER = """
import json, serial, sys, time
port = serial.Serial(sys.argv[1], 115200)
command = json.loads(sys.argv[2])
print("open", flush=True)
while True:
    port.write((json.dumps(command) + "\\n").encode())
    time.sleep(0.05)
"""
"""As ugv_driver, which writes T as a text, and Waveshare's web app, with spaces."""
READER = """
import json, serial, sys
port = serial.Serial(sys.argv[1], 115200)
print("open", flush=True)
while True:
    try:
        said = json.loads(port.readline().decode("utf-8"))
    except ValueError:
        continue  # pyserial in the other program has opened the port, and has dropped what waited there
    if said["T"] == 1001:
        print(said["odl"], said["odr"], said["v"], said["az"], flush=True)
"""
"""As ugv_bringup, which ends by an object without T, and by a report without one of its fields."""
ONCE = """
import serial, sys, time
port = serial.Serial(sys.argv[1], 115200)
port.write(b'{"T":1,"L":0.1,"R":0.1}\\n')
print("open", flush=True)
time.sleep(1000)
"""
NODE = '{"T": "13", "X": 0.1, "Z": 0.0}'
APP = '{"T": 1, "L": 0.1, "R": 0.1}'


@pytest.fixture(scope="module")
def _ugv(tmp_path_factory: pytest.TempPathFactory) -> Iterator[GuardScene]:
    with GuardScene(tmp_path_factory.mktemp("ugv"), "ugv") as scene:
        yield scene


@pytest.fixture
def ugv(_ugv: GuardScene) -> Iterator[GuardScene]:
    _ugv.trial.robot.disable()
    _ugv.rest()
    _ugv.trial.board.events()
    yield _ugv
    _ugv.end_drivers()


def drives(scene: GuardScene, command: str = NODE) -> Process:
    """A driver whose wheels turn."""
    scene.rest()
    scene.enable()
    driver = scene.python(WRITER, command)
    assert driver.line() == "open"
    scene.moves()
    return driver


@pytest.mark.parametrize("command", [NODE, APP], ids=["T:13", "T:1"])
def test_a_driver_drives_as_at_the_bare_board(ugv: GuardScene, command: str) -> None:
    drives(ugv, command)
    diameter_m = float(ugv.trial.robot.settings["wheels.diameter_m"])

    def at_its_speed() -> bool:
        return all(abs(rps * 3.14159265 * diameter_m - 0.1) < 0.0015 for rps in ugv.trial.board.wheels())

    wait_for("the wheels at their speed", at_its_speed)


@pytest.mark.claim("GUARD-1")
@pytest.mark.parametrize("command", [NODE, APP], ids=["T:13", "T:1"])
def test_a_driver_that_is_killed_stops_and_nothing_drives_before_an_enable(ugv: GuardScene, command: str) -> None:
    for _ in range(amount(10, 500)):
        driver = drives(ugv, command)
        driver.kill()
        ugv.stands()
        wait_for("motion to be disabled", lambda: not ugv.trial.robot.state.enabled)
        name = os.path.basename(str(driver.child.args[1]))  # type: ignore[index]
        assert f"{name} (pid {driver.pid}) died after it had driven" in str(ugv.trial.robot.why())


@pytest.mark.parametrize("dies", ["writer", "reader"])
def test_one_node_writes_and_another_reads_and_the_death_of_either_stops_the_wheels(ugv: GuardScene, dies: str) -> None:
    ugv.enable()
    nodes = {"reader": ugv.python(READER), "writer": ugv.python(WRITER, NODE)}
    assert [node.line() for node in nodes.values()] == ["open", "open"]
    ugv.moves()
    before = int(nodes["reader"].line().split()[0])
    wait_for("the odometer to go on", lambda: int(nodes["reader"].line().split()[0]) > before)
    nodes[dies].kill()
    ugv.stands()
    wait_for("motion to be disabled", lambda: not ugv.trial.robot.state.enabled)
    names = sorted(os.path.basename(str(node.child.args[1])) for node in nodes.values())  # type: ignore[index]
    why = str(ugv.trial.robot.why())
    assert any(f"{' or '.join(order)} (pid " in why for order in (names, names[::-1])), why
    assert "died after it had driven" in why


def test_a_suspended_driver_stops_and_goes_on_afterwards(ugv: GuardScene) -> None:
    driver = drives(ugv)
    os.kill(driver.pid, signal.SIGSTOP)
    ugv.stands()
    os.kill(driver.pid, signal.SIGCONT)
    ugv.moves()


def test_a_script_that_writes_once_is_told_why_it_stops(ugv: GuardScene) -> None:
    ugv.enable()
    driver = ugv.python(ONCE)
    assert driver.line() == "open"
    wait_for("the wheels to have turned", ugv.motion)
    ugv.stands()
    why = str(ugv.trial.robot.why())
    assert f"(pid {driver.pid})" in why
    assert "stopped sending" in why

    def wrong() -> str:
        return " ".join(client.wrong for client in ugv.trial.robot.state.clients)

    wait_for("the guard to say so", lambda: "has written no speed for" in wrong())
    assert "guard.timeout_s" in wrong()
