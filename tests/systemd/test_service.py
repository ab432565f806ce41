"""The unit under every fault that systemd has a part in: the board sees the stop in time, nothing moves after it, no
process is left over, and the service is there again, with motion disabled.

Limits are for busy machines; the bars are in the bench (bench/service.py).
"""

from __future__ import annotations

import json
import os
import signal
import time
from collections.abc import Callable
from typing import Any

import pytest

from bench import installed
from bench.service_scene import CONFIG, DRIVER, DROP_IN, HARDY, RIGHTS, STRANGER, UNIT, Scene
from failstop.lab.sim.client import SimBoard
from failstop.lab.trial import Stopped, wait_for
from failstop.messages import layout
from tests.systemd.units import SYSTEMD

CHILDREN = [name for name in layout.PROCESS_NAMES if name != layout.SUPERVISOR]
LATEST_MS = 100.0
ALL_LATEST_MS = 1000.0
"""Time for systemd to notice, and to run the stop tool; p50 80 ms here."""
WATCHDOG_S = 1.0
SLEEP = "failstop-sleep.service"
SLEEP_S = 3.0
"""Time for the start of a Python program on a busy machine."""
BUSY_S = 2.0
"""Time that a busy machine may add to what systemd does by its timers."""


def stopped_in_time(stopped: Stopped, limit_ms: float = LATEST_MS) -> None:
    assert stopped.was_moving
    assert stopped.stop_ns is not None, "no stop"
    assert stopped.stop_ns < limit_ms * 1e6
    assert stopped.motion_after == 0


def whole_again(scene: Scene, before: dict[str, int], restarts: int) -> None:
    """systemd has restarted it: every process is a new one, and the client, which goes on commanding, moves
    nothing."""
    scene.recover(restarts)
    after = scene.pids()
    assert set(after) >= set(layout.PROCESS_NAMES)
    assert not set(before.values()) & set(scene.box.pids(UNIT))
    assert not any(os.path.exists(f"/proc/{pid}") for pid in before.values())
    scene.board.events()
    with pytest.raises(TimeoutError):
        scene.board.wait_wheels(True, 0.1)
    assert not any(event.is_motion for event in scene.board.events())


def stop_since(scene: Scene, since_ns: int) -> None:
    """Wait for a stop."""
    scene.board.wait_for(lambda event: event.is_stop and event.arrival_ns > since_ns, 10.0)


def status(scene: Scene) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(scene.failstop("status", "--json").stdout)
    return found


def told(scene: Scene, *texts: str) -> None:
    journal = scene.told()
    for text in texts:
        assert text in journal, journal


# The start.


def test_ready_means_stopped_and_healthy(shared_scene: Scene) -> None:
    scene = shared_scene
    scene.board.events()
    scene.start()
    frames = [event for event in scene.board.events() if event.is_motor]
    assert frames
    assert all(event.is_stop for event in frames)
    assert scene.ready()
    found = status(scene)
    assert not found["enabled"]
    assert found["device"]["state"] == "open"
    assert {name: row["state"] for name, row in found["processes"].items()} == dict.fromkeys(
        layout.PROCESS_NAMES, "running"
    )
    assert all(row["realtime"] and row["memory_locked"] for row in found["processes"].values())
    scene.end()
    assert scene.box.pids(UNIT) == []


def test_without_a_board_it_is_not_ready_and_stops_the_wheels_when_it_comes(shared_scene: Scene) -> None:
    scene = shared_scene
    scene.board.unplug()
    try:
        scene.start("--no-block")
        wait_for("the stop tool to wait for it", lambda: "no device /board/port" in scene.told())
        assert not scene.ready()
        assert "is ready" not in scene.told()
        scene.board.events()
    finally:
        scene.board.replug()
    assert scene.board.wait_for(lambda event: event.is_motor, 10.0).is_stop
    wait_for("it to be ready", scene.ready)
    scene.end()


def test_starts_with_the_machine() -> None:
    setup = "systemctl --quiet enable failstop.service\n"
    with Scene(setup=setup) as scene:
        wait_for("it to be ready", scene.ready)
        began = scene.box.show("", "UserspaceTimestampMonotonic")["UserspaceTimestampMonotonic"]
        ready = scene.box.show(UNIT, "ActiveEnterTimestampMonotonic")["ActiveEnterTimestampMonotonic"]
        assert (int(ready) - int(began)) / 1e6 < 1.0 + BUSY_S
        assert scene.box.run("ls", "/etc/systemd/system/dev-failstop.device.wants").stdout == f"{UNIT}\n"


def test_before_a_sleep_the_wheels_are_stopped() -> None:
    """The unit by itself, as sleep.target may not be started by hand: it ends when the stop is out, and latched."""
    with Scene(units={SLEEP: (SYSTEMD / SLEEP).read_text()}) as scene:
        scene.start()
        stopped_in_time(scene.fault(lambda: scene.box.ctl("start", SLEEP), aftermath_s=SLEEP_S), SLEEP_S * 1e3)
        assert scene.box.show(SLEEP, "Result")["Result"] == "success"
        assert status(scene)["estop"].startswith("stop request: the machine goes to sleep")
        scene.end()
        scene.box.ctl("start", SLEEP)
        assert scene.box.show(SLEEP, "Result")["Result"] == "success", "where nothing runs there is nothing to stop"


def test_a_stop_that_could_not_be_written_is_written_when_the_board_is_back() -> None:
    """The service is gone by then; who goes on trying ends when it is written, or when the service is started."""
    late = "failstop-late@failstop.service"
    setup = f"printf '[stop]\\nwait_s = 0.2\\n' >> {CONFIG}\n"
    with Scene(
        units={"failstop-late@.service": (SYSTEMD / "failstop-late@.service").read_text()}, setup=setup
    ) as scene:

        def state() -> str:
            return scene.box.show(late, "ActiveState")["ActiveState"]

        for by_start in (False, True):
            scene.start()
            scene.drive()
            scene.board.unplug()
            scene.leave()
            scene.box.ctl("stop", UNIT, check=False)
            assert scene.box.show(UNIT, "Result")["Result"] == "exit-code"
            wait_for("who goes on trying", lambda: state() == "active")
            assert any(scene.board.wheels())
            scene.board.events()
            if by_start:
                scene.box.ctl("start", "--no-block", UNIT)
                wait_for("it to leave the port to the service", lambda: state() == "inactive")
            scene.board.replug()
            assert scene.board.wait_for(lambda event: event.is_motor, 10.0).is_stop
            wait_for("its end", lambda: state() == "inactive")
            scene.box.ctl("stop", UNIT)
            scene.box.ctl("reset-failed", UNIT, check=False)


# One process dies.


def test_kill_of_the_supervisor(scene: Scene) -> None:
    before = scene.pids()
    stopped_in_time(scene.fault(scene.kill("supervisor")))
    whole_again(scene, before, 1)
    told(scene, "Main process exited, code=killed, status=9/KILL", "stop frame sent")


@pytest.mark.parametrize("process", CHILDREN)
def test_kill_of_a_child_is_the_supervisor_s_to_answer(scene: Scene, process: str) -> None:
    before = scene.pids()
    stopped_in_time(scene.fault(scene.kill(process)))
    wait_for("it to be restarted", lambda: status(scene)["waiting_for"] is None)
    after = scene.pids()
    assert after[process] != before[process]
    assert after["supervisor"] == before["supervisor"]
    assert scene.restarts() == 0
    assert status(scene)["estop"] == f"{process} died"
    told(scene, f"STOP latched: {process} died")


# All of them.


def kill_by_cgroup(scene: Scene) -> Callable[[], object]:
    return scene.kill_all


def kill_by_systemctl(scene: Scene) -> Callable[[], object]:
    return lambda: scene.box.ctl("kill", "--signal=KILL", "--kill-who=all", UNIT)


@pytest.mark.parametrize("how", [kill_by_cgroup, kill_by_systemctl])
def test_kill_of_everything(scene: Scene, how: Callable[[Scene], Callable[[], object]]) -> None:
    before = scene.pids()
    stopped_in_time(scene.fault(how(scene), aftermath_s=ALL_LATEST_MS / 1000), ALL_LATEST_MS)
    whole_again(scene, before, 1)
    told(scene, "stop frame sent")


def test_hang_of_everything_is_the_watchdog_s(scene: Scene) -> None:
    """Nobody in the service can stop: systemd kills the supervisor, the stop tool the others."""
    before = scene.pids()

    def freeze() -> None:
        for pid in before.values():
            os.kill(pid, signal.SIGSTOP)

    limit_s = WATCHDOG_S + 0.5 + BUSY_S
    stopped_in_time(scene.fault(freeze, aftermath_s=limit_s), limit_s * 1e3)
    whole_again(scene, before, 1)
    told(scene, "Watchdog timeout", "killed what was left of the service: 2 processes", "stop frame sent")


# People and the watchdog.


def test_systemctl_stop(scene: Scene) -> None:
    before = scene.pids()
    stopped_in_time(scene.fault(lambda: scene.box.ctl("stop", UNIT)), 500)
    assert scene.box.pids(UNIT) == []
    assert not any(os.path.exists(f"/proc/{pid}") for pid in before.values())
    assert scene.box.show(UNIT, "Result", "NRestarts") == {"Result": "success", "NRestarts": "0"}
    told(scene, "stopped; the stop was written twice", "stop frame sent", "Deactivated successfully")
    assert not any(path.startswith("failstop.") for path in os.listdir(scene.box.path("/dev/shm")))


def test_systemctl_restart(scene: Scene) -> None:
    before = scene.pids()
    stopped_in_time(scene.fault(lambda: scene.box.ctl("restart", UNIT)), 500)
    whole_again(scene, before, 0)


def test_hang_of_the_supervisor(scene: Scene) -> None:
    """The port owner's lease stops the wheels; systemd restarts the service."""
    before = scene.pids()
    stopped = scene.fault(scene.signal(signal.SIGSTOP, before["supervisor"]), aftermath_s=WATCHDOG_S)
    stopped_in_time(stopped, 300)
    whole_again(scene, before, 1)
    started_us = int(scene.box.show(UNIT, "ExecMainStartTimestampMonotonic")["ExecMainStartTimestampMonotonic"])
    assert WATCHDOG_S / 2 < (started_us * 1000 - stopped.fault_ns) / 1e9 < WATCHDOG_S + 0.3 + BUSY_S
    told(scene, "Watchdog timeout (limit 1s)!", "stop frame sent")


def test_a_supervisor_that_is_continued_was_no_hang_for_systemd(scene: Scene) -> None:
    pid = scene.pid("supervisor")

    def pause() -> None:
        os.kill(pid, signal.SIGSTOP)
        wait_for("the wheels to stop", lambda: not any(scene.board.wheels()))
        os.kill(pid, signal.SIGCONT)

    stopped_in_time(scene.fault(pause), 300)
    assert (scene.restarts(), scene.pid("supervisor")) == (0, pid)
    assert status(scene)["estop"].startswith("supervisor was suspended")


# Who may do what.


def test_everybody_may_stop_and_only_the_group_may_drive(scene: Scene) -> None:
    refused = scene.failstop("enable", user=STRANGER, check=False)
    assert refused.returncode == 1
    assert "join the group `failstop`" in refused.stderr
    scene.drive()
    scene.failstop("estop", "by a stranger", user=STRANGER)
    scene.board.wait_wheels(False, 5.0)
    assert status(scene)["estop"].startswith("stop request: by a stranger")


def test_the_port_is_not_to_be_had_beside_the_service(scene: Scene) -> None:
    opening = "from failstop.board import port; port.open_port('/board/port', exclusive=False)"
    opening = f"import sys; sys.path.insert(0, '{installed.PREFIX}/src'); {opening}"
    user = ("setpriv", f"--reuid={DRIVER}", f"--regid={DRIVER}", "--init-groups", "--")
    refused = scene.box.run(*user, f"{installed.PREFIX}/bin/python3", "-c", opening, check=False)
    assert refused.returncode == 1
    assert "held exclusively" in refused.stderr


# Many deaths.


def test_a_crash_loop_ends_stopped(shared_scene: Scene) -> None:
    """Five starts soon after each other: then it stays down, until people have looked."""
    scene = shared_scene
    scene.box.unit(DROP_IN, RIGHTS)
    scene.box.ctl("daemon-reload")
    try:
        scene.start()
        for start in range(1, 6):
            killed_ns = time.monotonic_ns()
            scene.kill_all()
            stop_since(scene, killed_ns)
            scene.board.events()
            if start < 5:
                scene.recover(start)
        scene.box.wait(UNIT, ActiveState="failed")
        assert scene.box.pids(UNIT) == []
        assert not any(scene.board.wheels())
        told(scene, "Start request repeated too quickly")
        scene.box.ctl("reset-failed", UNIT)
        scene.start()
        assert scene.ready()
    finally:
        scene.box.unit(DROP_IN, HARDY)
        scene.box.ctl("daemon-reload")
        scene.end()


# Two robots.


def test_two_robots_share_nothing_but_the_user(scene: Scene) -> None:
    """Files that the one removes at its end are not the other's."""
    link = os.path.join(os.path.dirname(scene.board.link), "two")
    other = "failstop@two.service"
    with SimBoard(link, mode=0o666) as board:
        scene.box.write("/etc/failstop/two.toml", '[device]\npath = "/board/two"\n')
        scene.box.ctl("start", other)
        wait_for("the other to stop its wheels", lambda: any(event.is_stop for event in board.events(since=0)))
        found = json.loads(scene.failstop("status", "--name", "two", "--json").stdout)
        assert (found["name"], found["waiting_for"]) == ("two", None)
        scene.drive()
        scene.box.ctl("stop", other)
        assert scene.box.pids(other) == []
        scene.board.events()
        scene.board.wait_for(lambda event: event.is_motion, 5.0)
        assert status(scene)["enabled"]
        assert sorted(os.listdir(scene.box.path("/run/failstop"))) == ["failstop", "two"]
        assert {"failstop", "two"} <= set(os.listdir(scene.box.path("/var/lib/failstop")))
