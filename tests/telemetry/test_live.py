"""Telemetry in a running service, in front of the board's model."""

from __future__ import annotations

import math

import pytest

from failstop.board.codec import buzzer
from failstop.board.framing import BUZZER
from failstop.lab.machine.robot import Robot
from failstop.messages.layout import TELEMETRY
from failstop.procs.telemetry import pad
from tests.support.simulated import Simulated

MODE = 0x2000
FOLDER = "/state"
SETTINGS = {"battery.directory": FOLDER, "battery.log_s": 1.0, "buzzer.tones": "on"}


@pytest.mark.slow
def test_bias_charger_log_and_tones_on_a_running_service() -> None:
    service = Simulated(SETTINGS, imu_hz=110.0)
    robot, model, wait_for = service.robot, service.lab.board.model, service.wait_for
    model.imu.bias_rad_s = (0.0, 0.0, math.radians(0.4))
    model.battery_mv = 11_800

    def lines() -> list[str]:
        names = service.os.listdir(FOLDER) if service.os.path.exists(FOLDER) else []
        return "".join(service.lab.read(f"{FOLDER}/{name}") for name in names if name.endswith("csv")).splitlines()

    def bias_dps() -> float:
        return math.degrees(robot.state.gyro_bias.bias_radps[2])

    service.board.pad(MODE)
    service.board.wait_for(lambda frame: frame.func == BUZZER and frame.data == buzzer(*pad.MODE_SOUNDS[1])[4:-1])
    service.board.pad(0x0100)
    service.board.wait_for(lambda frame: frame.func == BUZZER and frame.data == buzzer(*pad.LATCH_SOUND)[4:-1])
    wait_for("the button's raw frames in the log", lambda: "last frames: 0020" in service.said)

    service.wait(2.5)
    wait_for("the calibration", lambda: robot.state.gyro_bias.calibrated)
    assert "gyro bias [" in service.said
    wait_for("the bias", lambda: bias_dps() == pytest.approx(0.4, abs=0.15))

    service.wait(2.0)
    wait_for("five lines and their header", lambda: len(lines()) >= 6)
    model.battery_mv += 249
    service.wait(3.0)
    wait_for("the charger", lambda: robot.state.plugged == "plugged")
    assert service.lab.read(f"{FOLDER}/charger") == "plugged\n"
    pid = service.pids()[TELEMETRY]
    service.die(TELEMETRY)
    service.recover(TELEMETRY, pid)
    wait_for("a reading of the successor", lambda: robot.state.battery_v > 12.0)
    assert robot.state.plugged == "plugged", "the last state survives a restart"
    assert bias_dps() == pytest.approx(0.4, abs=0.15), "and so does the bias"
    assert lines()[0] == "unix_s,battery_mv,enabled"
    assert all(len(line.split(",")) == 3 for line in lines())


def test_pipes_in_the_place_of_its_files_hold_nothing_up() -> None:
    """Telemetry comes up, and what it can't keep is told."""
    lab = Robot(settings=SETTINGS)
    lab.join("test")
    system = lab.loader.system["os"]
    system.mkdir(FOLDER)
    system.mkfifo(f"{FOLDER}/charger")
    lab.start()
    lab.connect().close()
    said = " ".join(lab.said.split())
    assert "charger state can't be read" in said
    assert "a FIFO, not a regular file" in said
