"""`failstop doctor` and `failstop prove` beside the installed service, on a systemd of its own."""

from __future__ import annotations

import json
from collections.abc import Iterator
from typing import Any

import pytest

from bench.container import ContainerMissing
from bench.service_scene import STRANGER, UNIT, Scene
from failstop_lab.trial import wait_for

pytestmark = pytest.mark.slow


@pytest.fixture(scope="module")
def scene() -> Iterator[Scene]:
    try:
        found = Scene()
    except ContainerMissing as missing:
        pytest.skip(str(missing))
    with found:
        yield found


def findings(scene: Scene, *words: str, user: str = "root") -> dict[str, list[dict[str, Any]]]:
    done = scene.failstop("doctor", "--quick", "--json", *words, user=user, check=False)
    assert done.returncode in (0, 1), done.stderr
    found: dict[str, list[dict[str, Any]]] = {}
    for finding in json.loads(done.stdout)["findings"]:
        found.setdefault(finding["check"], []).append(finding)
    return found


def link(scene: Scene) -> str:
    text: str = json.loads(scene.failstop("status", "--json").stdout)["device"]["link"]
    return text


def test_the_installed_service(scene: Scene) -> None:
    scene.start()
    wait_for("the board's answer", lambda: link(scene) == "alive")
    found = findings(scene)
    assert f"{UNIT} is active" in found["unit"][0]["text"]
    assert "user failstop" in found["service"][0]["text"]
    assert found["permission"][0]["text"] == "the running service opens the port; it is open"
    assert (found["holders"][0]["level"], found["RemoveIPC"][0]["level"]) == ("ok", "ok")
    scene.failstop("stop", user="root")
    wait_for("the board's answer", lambda: "acknowledged by" in findings(scene)["stop path"][0]["text"])
    scene.failstop("reset", user="root")
    assert not any(finding["level"] == "fail" for rows in found.values() for finding in rows)


def test_a_stranger_is_told_that_files_are_hidden(scene: Scene) -> None:
    scene.start()
    assert findings(scene, user=STRANGER)["holders"][0]["level"] == "warn"


def test_the_stand_test_wants_the_service_stopped(scene: Scene) -> None:
    scene.start()
    done = scene.failstop("prove", user="root", check=False)
    assert done.returncode == 2
    assert f"sudo systemctl stop {UNIT}" in done.stderr


def test_a_service_that_failed(scene: Scene) -> None:
    scene.end()
    scene.box.write("/etc/failstop/failstop.toml", '[device]\npath = "/board/port"\n[gate]\nlease_s = 9.0\n')
    scene.box.ctl("start", "--no-block", UNIT)
    wait_for("a restart", lambda: scene.restarts() > 0)
    found = findings(scene)
    assert "gate.lease_s = 9.0" in found["settings"][0]["text"]
    assert found["settings"][0]["level"] == found["unit"][0]["level"] == "fail"
    assert f"journalctl -xeu {UNIT}" in found["unit"][0]["fix"]
