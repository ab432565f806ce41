"""The unit's sandbox: what the service may do, and what it may not, tried by a program in its place."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest

from bench import installed
from bench.service_scene import RIGHTS, UNIT, Scene
from failstop.lab.trial import wait_for

NODES = ((1, 11), (4, 64))
ALLOWED = {
    "write /tmp",  # its own
    "write /dev/shm",
    "write /run/failstop",
    "write /var/lib/failstop",
    "unix socket",
    "chown to its group",
}
RIGHTS_ALONE = {"real time", "locked memory"}
"""Here by a drop-in's capabilities, on a machine by the unit's limits, which may not be raised here."""
REFUSED = {
    "write /etc": "EROFS",
    "write /usr": "EROFS",
    "write /opt": "EROFS",
    "write /proc/sys": "ENOENT",
    "list /root": "EACCES",
    "list /home": "EACCES",
    "see /proc/1": "ENOENT",
    "signal to another's process": "EPERM",
    "device of memory": "EPERM",
    "device of a serial port that is not the board's": "EPERM",
    "inet socket": "EAFNOSUPPORT",
    "netlink socket": "EAFNOSUPPORT",
    "executable memory": "EPERM",
    "namespace": "EPERM",
    "mount": "EPERM",
    "setuid": "EPERM",
    "keyring": "EPERM",
    "suid file": "EPERM",
}


def in_place_of_the_service(scene: Scene, rights: str) -> dict[str, Any]:
    """Findings of the probe in the unit's sandbox. Only how it is run and ended is the probe's own."""
    unit = re.sub(r"^(Exec|Watchdog|Restart|Timeout|Start)\w+=.*\n", "", installed.units()[UNIT], flags=re.MULTILINE)
    unit = unit.replace("Type=notify\n", "Type=oneshot\n").replace("Restart=always\n", "")
    program = f"{installed.PREFIX}/bin/python3 {installed.PREFIX}/src/tests/systemd/probe.py"
    scene.box.unit("probe.service", unit + rights + f"\n[Service]\nExecStart={program}\n")
    scene.box.ctl("daemon-reload")
    for major, minor in NODES:
        scene.box.run("mknod", "-m", "666", f"/dev/probe-{major}-{minor}", "c", str(major), str(minor), check=False)
    scene.box.ctl("start", "probe.service")
    # The journal may be behind, and it knows a process that has ended by less.
    where = ("_SYSTEMD_UNIT=probe.service", "_TRANSPORT=stdout")
    wait_for("the probe's findings in the journal", lambda: scene.box.journal(*where))
    found: dict[str, Any] = json.loads(scene.box.journal(*where)[-1]["MESSAGE"])
    return found


@pytest.fixture(scope="module")
def bare(shared_scene: Scene) -> dict[str, Any]:
    """A unit with nothing but what it gives."""
    return in_place_of_the_service(shared_scene, "")


def test_every_attempt_is_judged(bare: dict[str, Any]) -> None:
    facts = {"oom", "groups", "no new privileges", "capabilities", "core"}
    assert set(bare) == ALLOWED | RIGHTS_ALONE | set(REFUSED) | facts


@pytest.mark.parametrize("attempt", sorted(ALLOWED))
def test_what_it_needs_is_allowed(bare: dict[str, Any], attempt: str) -> None:
    assert bare[attempt] == "ok"


@pytest.mark.parametrize(("attempt", "error"), REFUSED.items())
def test_everything_else_is_refused(bare: dict[str, Any], attempt: str, error: str) -> None:
    assert bare[attempt] == error


def test_who_it_is(bare: dict[str, Any]) -> None:
    assert bare["groups"] == ["dialout", "failstop"]
    assert bare["no new privileges"] == "1"
    assert bare["capabilities"] == [0, 0, 0, 0]
    assert bare["core"] == [1, 1], "no dump fits, and a program in core_pattern heeds it, unlike 0"


def test_the_filter_lets_real_time_and_locked_memory_pass(shared_scene: Scene) -> None:
    found = in_place_of_the_service(shared_scene, RIGHTS)
    assert {attempt: found[attempt] for attempt in RIGHTS_ALONE} == dict.fromkeys(RIGHTS_ALONE, "ok")
