"""The journal on a real systemd: entries with their fields and explanations, and each command of docs/logs.md."""

from __future__ import annotations

import json
import os
import re
import shlex
import signal
import time
from pathlib import Path
from typing import Any

import pytest

import failstop
from bench import installed
from bench.service_scene import UNIT, Scene
from failstop.supervisor.kinds import EVENT_BY_NAME, EVENT_KINDS, LEVELS
from failstop_lab.trial import wait_for

ROOT = Path(failstop.__file__).resolve().parent.parent
QUESTIONS = re.findall(r"^ +(journalctl -b .*)$", (ROOT / "docs" / "logs.md").read_text(), re.MULTILINE)


WITHOUT_SENSOR = f"""
import sys
import time
sys.path.insert(0, "{installed.PREFIX}/src")
from failstop import Robot
with Robot(disable_on_exit=False) as robot:
    for _ in range(10):
        robot.drive(0.1, 0.0, 0.0)
        time.sleep(0.02)
"""


def entries(scene: Scene, *words: str) -> list[dict[str, Any]]:
    return scene.box.journal(*words)


def wait(scene: Scene, *words: str, count: int = 1) -> list[dict[str, Any]]:
    wait_for(f"{count} of {words}", lambda: len(entries(scene, *words)) >= count)
    return entries(scene, *words)


@pytest.fixture(scope="module")
def incident(shared_scene: Scene) -> Scene:
    """A service that has been through everything, and has ended."""
    scene = shared_scene
    scene.end()
    scene.box.write("/usr/lib/systemd/catalog/failstop.catalog", (ROOT / "systemd" / "failstop.catalog").read_text())
    scene.start()
    wait(scene, "FAILSTOP_EVENT=link")
    scene.drive()
    scene.leave()
    for process, number in (("telemetry", signal.SIGKILL), ("stopper", signal.SIGSTOP)):
        os.kill(scene.pid(process), number)
        wait(scene, "FAILSTOP_EVENT=died", f"FAILSTOP_PROCESS={process}")
        wait_for(process, lambda name=process: name in scene.pids())  # type: ignore[misc]
    wait(scene, "FAILSTOP_EVENT=stop_outcome")
    scene.failstop("enable", check=False)
    wait_for("the reset", lambda: scene.failstop("reset", check=False).returncode == 0)
    wait_for("motion", lambda: scene.failstop("enable", check=False).returncode == 0)
    wait(scene, "FAILSTOP_EVENT=enabled", count=2)
    scene.box.run(f"{installed.PREFIX}/bin/python3", "-c", WITHOUT_SENSOR)
    wait(scene, "FAILSTOP_EVENT=scan")
    scene.board.pad(0x0100)
    wait(scene, "FAILSTOP_EVENT=pad")
    scene.board.deaf(True)
    wait(scene, "FAILSTOP_EVENT=link", "FAILSTOP_STATE=deaf")
    scene.board.deaf(False)
    scene.board.unplug()
    wait(scene, "FAILSTOP_EVENT=device_lost")
    scene.board.replug()
    wait(scene, "FAILSTOP_EVENT=device_back")
    scene.end()
    wait(scene, "FAILSTOP_EVENT=stopped")
    return scene


@pytest.mark.slow
def test_entries_have_their_fields_and_come_from_the_service(incident: Scene) -> None:
    found = entries(incident, "SYSLOG_IDENTIFIER=failstop", f"_SYSTEMD_UNIT={UNIT}", "_TRANSPORT=journal")
    assert {"ready", "stop", "stop_outcome", "died", "fenced", "enabled", "stopping", "stopped"} <= {
        entry["FAILSTOP_EVENT"] for entry in found
    }
    for entry in found:
        kind = EVENT_BY_NAME[entry["FAILSTOP_EVENT"]]
        assert entry["MESSAGE_ID"] == kind.message_id
        assert entry["FAILSTOP_NAME"] == "failstop"
        assert int(entry["PRIORITY"]) in LEVELS.values()
        assert {f"FAILSTOP_{field.upper()}" for field in kind.fields.split()} <= entry.keys()
        assert entry["_COMM"] == "fs:supervisor", "the processes tell it, and nobody else the journal"


@pytest.mark.slow
def test_nothing_is_told_twice(incident: Scene) -> None:
    assert entries(incident, "_TRANSPORT=stdout", f"_SYSTEMD_UNIT={UNIT}", "_COMM=fs:supervisor") == []


@pytest.mark.slow
def test_the_catalog_is_accepted_and_explains_a_stop(incident: Scene) -> None:
    done = incident.box.run("journalctl", "--update-catalog")
    assert done.stdout + done.stderr == ""
    listed = incident.box.run("journalctl", "--list-catalog").stdout
    assert all(f"{kind.message_id} failstop: " in listed for kind in EVENT_KINDS)
    explained = incident.box.run("journalctl", "-b", "-x", "-n", "1", "FAILSTOP_EVENT=fenced").stdout
    assert "Subject: stopper hung and was fenced" in explained
    assert "Next: was the machine overloaded or frozen?" in explained
    assert not re.search(r"@?FAILSTOP_(SILENT_MS|NAME)@?", explained), "every placeholder was filled"


ANSWERS = [
    {"stop"},
    {"stop", "stop_again"},
    {"stop_outcome"},
    {"enabled", "disabled", "reset", "refused"} - {"disabled"},
    {"died", "fenced"},
    {"device_lost", "device_back", "link"},
    {"pad"},
    {"scan", "driver_ended"},
    {"ready", "stopping", "stopped"},
    {"link", "stop_again"},
]


@pytest.mark.slow
@pytest.mark.parametrize(("question", "kinds"), list(zip(QUESTIONS, ANSWERS, strict=True)), ids=range(1, 11))
def test_each_question_is_answered(incident: Scene, question: str, kinds: set[str]) -> None:
    """The page's own command answers; it is asked once more for the kinds of what it has found."""
    words = [*shlex.split(question), "--no-pager", "--quiet"]
    done = incident.box.run(*words)
    assert done.stderr == ""
    again = incident.box.run(*words, "--output=json", "--output-fields=FAILSTOP_EVENT").stdout.splitlines()
    assert kinds <= {json.loads(line).get("FAILSTOP_EVENT") for line in again}
    if "json" in words:
        assert all("FAILSTOP_REASON" in json.loads(line) for line in done.stdout.splitlines())


JOURNAL = ("systemd-journald.socket", "systemd-journald-dev-log.socket", "systemd-journald.service")


@pytest.mark.slow
def test_without_the_journal_all_stops_as_before_and_with_it_entries_come_again(scene: Scene) -> None:
    restarts = scene.restarts()
    scene.box.ctl("stop", *JOURNAL, check=False)
    try:
        assert scene.box.show(JOURNAL[2], "ActiveState")["ActiveState"] == "inactive"
        stopped = scene.fault(scene.kill("gate"))
        assert stopped.was_turning
        assert stopped.stop_ns is not None
        assert stopped.motion_after == 0
        wait_for("the gate", lambda: "gate" in scene.pids())
    finally:
        scene.box.ctl("start", *JOURNAL)
    assert scene.restarts() == restarts, "the watchdog was beaten meanwhile"
    since = f"--since=@{time.time():.6f}"
    scene.board.key(1, 1)
    wait(scene, since, "FAILSTOP_EVENT=stop_again", "FAILSTOP_REASON=key1", "_TRANSPORT=journal")
