"""The C library for other processors, run by qemu against the service of this machine: the records are the same bytes
there. qemu's user mode reports no death by a robust futex, so a death is noticed by the process's end."""

from __future__ import annotations

import math
import os
import shutil
import signal
import subprocess
from pathlib import Path

import pytest

from failstop.policy import causes
from failstop_lab.trial import Trial, wait_for
from tests.clients.scene import OK, REFUSED, set_off
from tests.support.c_client import SOURCE, Driver

PROCESSORS = {"aarch64": "aarch64-linux-gnu", "arm": "arm-linux-gnueabihf"}


@pytest.fixture(params=PROCESSORS)
def foreign(request: pytest.FixtureRequest, tmp_path: Path) -> tuple[str, ...]:
    """The command that runs a C client of another processor."""
    processor = request.param
    compiler, qemu = f"{PROCESSORS[processor]}-gcc", f"qemu-{processor}-static"
    for tool, package in ((compiler, f"gcc-{PROCESSORS[processor]}"), (qemu, "qemu-user-static")):
        if not shutil.which(tool):
            pytest.skip(f"not tried for {processor}: apt install {package}")
    flags = ("-std=c11", "-O2", "-static", "-pthread", "-D_GNU_SOURCE", "-D_FILE_OFFSET_BITS=64", "-D_TIME_BITS=64")
    places = (f"-I{SOURCE}/include", f"-I{SOURCE}/src", '-DFS_VERSION_TEXT="tried"', "-o", str(tmp_path / "driver"))
    sources = [str(path) for path in sorted((SOURCE / "src").glob("*.c"))]
    words = (compiler, "-Wall", "-Wextra", "-Wconversion", "-Werror", *flags, *places)
    done = subprocess.run(
        (*words, f"{SOURCE}/tests/driver.c", *sources, "-lm"), capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stderr
    return qemu, str(tmp_path / "driver")


@pytest.mark.slow
def test_it_drives_stops_is_refused_and_dies(trial: Trial, foreign: tuple[str, ...]) -> None:
    with Driver(command=foreign) as driver:
        driver.connect(trial.name)
        set_off(trial, driver)
        assert driver.do("for 0.3 0.2") == OK
        assert trial.turning()
        state, seen = driver.state(), trial.robot.state
        assert (state["enabled"], state["moving"], state["answer"]) == (1, 1, 1)
        assert int(state["epoch"]) == seen.epoch
        assert math.isclose(state["battery"], seen.battery_v or math.nan)
        for key in ("wheels.diameter_m", "wheels.layout", "gate.lease_s"):
            assert driver.text(f"setting {key}") == str(trial.robot.settings[key])
        assert driver.do("stop from afar") == OK
        trial.board.wait_wheels(turning=False, timeout_s=5.0)
        wait_for("the stop to be latched", lambda: trial.robot.state.cause)
        cause = trial.robot.state.cause
        assert isinstance(cause, causes.Cause)
        assert driver.text("why") == str(cause)
        assert driver.do("enable -1") == REFUSED
        assert driver.do("reset 0") == OK
        set_off(trial, driver)
        driver.tell("for -1 0.2")
        assert driver.answer() == "driving"
        trial.board.wait_wheels(turning=True, timeout_s=5.0)
        os.kill(driver.pid, signal.SIGKILL)
        trial.board.wait_wheels(turning=False, timeout_s=5.0)
        wait_for("motion to be disabled", lambda: not trial.robot.state.enabled)
