"""What people see of a driver at the guard port: the page, `why`, and the incident name its program and its pid."""

from __future__ import annotations

import os
import signal
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest

from bench.guard_scene import GuardScene, Process
from failstop.api.events import EventLog
from failstop.incidents import files, story
from failstop.incidents.incident import Incident
from failstop.web.view import view
from failstop_lab.trial import wait_for

pytestmark = pytest.mark.slow
RATE = "30"
SAVED_S = 20.0


@pytest.fixture
def scene(tmp_path: Path) -> Iterator[GuardScene]:
    with GuardScene(tmp_path, "arduino", **{"gate.driver_death": "latch"}) as made:
        yield made


def driving(scene: GuardScene, diffdrive: str) -> Process:
    scene.enable()
    driver = scene.driver(diffdrive, scene.path, "serial", "10", "10", RATE)
    driver.line()
    scene.moves()
    return driver


def saved(scene: GuardScene) -> Incident:
    """The service's one incident."""
    environ = {"STATE_DIRECTORY": scene.trial.state}

    def heads() -> list[Any]:
        return files.heads(scene.trial.name, files.folders(scene.trial.name, environ))[0]

    wait_for("an incident", heads, SAVED_S)
    return Incident.read(files.find("last", scene.trial.name, environ))


@pytest.mark.claim("GUARD-1")
def test_the_page_and_the_incident_name_the_driver_that_died(scene: GuardScene, diffdrive: str) -> None:
    def page() -> Any:
        return view(scene.trial.robot.state, EventLog(scene.trial.name).read(), time.time())

    driver = driving(scene, diffdrive)
    who = f"diffdrive (pid {driver.pid})"
    wait_for("the page to name it", lambda: page()["driver"] == who)
    assert who in page()["clients"]
    os.kill(driver.pid, signal.SIGKILL)
    driver.child.wait()
    scene.stands()
    wait_for("the page to say why", lambda: page()["latched"] and who in page()["why"])
    assert page()["driver"] == ""
    wait_for("it to be gone from the page", lambda: who not in page()["clients"])
    assert who in str(scene.trial.robot.why())
    incident = saved(scene)
    assert who in incident.why
    commands = [line.text for line in story.whole(incident) if line.what == "command"]
    assert [text for text in commands if text.startswith(f"{who} as cmd_vel: ")], commands
    assert not [text for text in commands if "guard" in text or "python" in text], "the guard is nobody's driver"
    assert any(who in line.text for line in story.brief(incident)), "at a glance"


def test_the_incident_of_a_stop_names_the_driver_that_drove_until_then(scene: GuardScene, diffdrive: str) -> None:
    driver = driving(scene, diffdrive)
    scene.trial.robot.estop("a test says so")
    scene.stands()
    incident = saved(scene)
    assert "a test says so" in incident.why
    who = f"diffdrive (pid {driver.pid})"
    assert any(line.what == "command" and who in line.text for line in story.whole(incident))
