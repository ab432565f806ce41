"""The unit's sandbox: what the service may do, and what it may not, tried by a program in its place."""

from __future__ import annotations

import json
import re
from typing import Any

import pytest

from bench import installed
from bench.service_scene import RIGHTS, UNIT, Scene
from failstop_lab.trial import wait_for

NODES = ((1, 11), (207, 16))
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
DEVICES = ("device of memory", "device of a serial port that is not the board's")
SOCKETS = ("inet socket", "netlink socket")
RIGHTS_OF_ROOT = ("executable memory", "namespace", "mount", "setuid", "keyring", "suid file")
REFUSED = (
    dict.fromkeys(("write /etc", "write /usr", "write /opt"), "EROFS")
    | dict.fromkeys(("write /proc/sys", "see /proc/1"), "ENOENT")
    | dict.fromkeys(("list /root", "list /home"), "EACCES")
    | dict.fromkeys(SOCKETS, "EAFNOSUPPORT")
    | dict.fromkeys(("signal to another's process", *DEVICES, *RIGHTS_OF_ROOT), "EPERM")
)


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
    return in_place_of_the_service(shared_scene, "")


def test_it_may_do_what_it_needs_and_everything_else_is_refused(bare: dict[str, Any]) -> None:
    facts = {
        "groups": ["dialout", "failstop"],
        "no new privileges": "1",
        "capabilities": [0, 0, 0, 0],
        "core": [1, 1],  # no dump fits, and a program in core_pattern heeds it, unlike 0
    }
    rights = {name: bare[name] for name in (*RIGHTS_ALONE, "oom")}
    assert bare == {**dict.fromkeys(ALLOWED, "ok"), **REFUSED, **facts, **rights}


def test_the_filter_lets_real_time_and_locked_memory_pass(shared_scene: Scene) -> None:
    found = in_place_of_the_service(shared_scene, RIGHTS)
    assert {attempt: found[attempt] for attempt in RIGHTS_ALONE} == dict.fromkeys(RIGHTS_ALONE, "ok")
