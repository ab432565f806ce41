"""Telemetry in a running service, in front of the board's model."""

from __future__ import annotations

import math

import pytest

from failstop.board.framing import BUZZER
from failstop.lab.sim.model import Frame
from failstop.procs.telemetry import pad
from failstop.shm.layout import TELEMETRY
from tests.support.running import Running

MODE = 0x2000
FOLDER = "/state"


def log_lines(run: Running) -> list[str]:
    """Of all files of the battery's log."""
    names = run.os.listdir(FOLDER) if run.os.path.exists(FOLDER) else []
    return "".join(run.read_text(f"{FOLDER}/{name}") for name in sorted(names) if name.endswith(".csv")).splitlines()


def test_bias_charger_log_and_tones_on_a_running_service() -> None:
    run = Running(**{"battery.directory": FOLDER, "battery.log_s": 1.0, "buzzer.tones": "on"})
    heard: list[Frame] = []
    run.robot.board.on_frame = heard.append
    run.model.imu.bias_rad_s = (0.0, 0.0, math.radians(0.4))
    run.model.battery_mv = 11_800
    run.start()

    def sounds(tone: bytes) -> bool:
        return any(frame.func == BUZZER and frame.data == tone[4:-1] for frame in heard)

    def bias_dps() -> float:
        return math.degrees(run.client.state.gyro_bias.bias_radps[2])

    run.robot.board.pad(MODE)
    run.until("the mode's tone", lambda: sounds(pad.MODES[1]), 5.0)
    run.robot.board.pad(0x0100)
    run.until("the trip's tone", lambda: sounds(pad.LATCH), 5.0)
    run.until("the button's raw frames in the log", lambda: "last frames: 0020" in run.said())

    run.until("the calibration", lambda: run.client.state.gyro_bias.calibrated)
    assert "gyro bias [" in run.said()
    assert bias_dps() == pytest.approx(0.4, abs=0.15)

    run.until("five lines and their header", lambda: len(log_lines(run)) >= 6)
    run.model.battery_mv += 249
    run.until("the charger", lambda: run.client.state.plugged == "plugged")
    assert run.read_text(f"{FOLDER}/charger") == "plugged\n"
    run.kill(TELEMETRY)
    run.until("a reading of the successor", lambda: run.client.state.battery_v > 12.0)
    assert run.client.state.plugged == "plugged", "the last state survives a restart"
    assert bias_dps() == pytest.approx(0.4, abs=0.15), "and so does the bias"
    lines = log_lines(run)
    assert lines[0] == "unix_s,battery_mv,enabled"
    assert all(len(line.split(",")) == 3 for line in lines)


def test_pipes_in_the_place_of_its_files_hold_nothing_up() -> None:
    """Telemetry comes up, and what it can't keep is told."""
    run = Running(**{"battery.directory": FOLDER})
    run.os.mkdir(FOLDER)
    run.os.mkfifo(f"{FOLDER}/charger")
    run.start()
    run.until("the remark", lambda: "charger state can't be read" in run.said())
    assert "a FIFO, not a regular file" in " ".join(run.said().split())
