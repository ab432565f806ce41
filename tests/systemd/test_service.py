"""The unit under every fault that systemd has a part in: the board sees the stop, nothing moves after it, no
process is left over, and the service is there again, with motion disabled.

Tests here judge order and cause: how soon, has its bars in the bench (bench/service.py).
"""

from __future__ import annotations

import json
import os
import signal
import time
from typing import Any

import pytest

from bench import installed
from bench.service_scene import CONFIG, DRIVER, DROP_IN, HARDY, NEVER_S, RIGHTS, STRANGER, UNIT, Scene
from failstop.messages import layout
from failstop_lab.sim.client import SimBoard
from failstop_lab.trial import Stopped, wait_for

CHILDREN = [name for name in layout.PROCESS_NAMES if name != layout.SUPERVISOR]
WHOLE_S = 30.0
SLEEP = "failstop-sleep.service"
LATE = "failstop-late.service"


def well(stopped: Stopped) -> None:
    """The wheels turned, a stop came, and nothing moved them after it."""
    assert stopped.was_turning
    assert stopped.stop_ns is not None, "no stop"
    assert stopped.motion_after == 0


def whole_again(scene: Scene, before: dict[str, int]) -> None:
    """systemd has restarted it: every process is a new one, and the client, which goes on commanding, moves
    nothing."""
    gone = set(before.values())

    def anew() -> bool:
        found = scene.pids()
        return set(layout.PROCESS_NAMES) <= set(found) and not gone & set(found.values())

    wait_for("a new run", anew, WHOLE_S)
    scene.wait_ready()
    assert not any(os.path.exists(f"/proc/{pid}") for pid in gone)
    scene.board.events()
    with pytest.raises(TimeoutError):
        scene.board.wait_wheels(True, 0.1)
    assert not any(event.is_motion for event in scene.board.events())


def stop_since(scene: Scene, since_ns: int) -> None:
    scene.board.wait_for(lambda event: event.is_stop and event.arrival_ns > since_ns, NEVER_S)


def status(scene: Scene) -> dict[str, Any]:
    found: dict[str, Any] = json.loads(scene.failstop("status", "--json").stdout)
    return found


def told(scene: Scene, *texts: str) -> None:
    journal = scene.log_text()
    for text in texts:
        assert text in journal, journal


# The start.


def test_ready_means_stopped_and_healthy_and_waits_for_the_board(shared_scene: Scene) -> None:
    scene = shared_scene
    scene.end()
    scene.board.unplug()
    try:
        scene.start("--no-block")
        wait_for("the stop tool to wait for it", lambda: "no device /board/port" in scene.log_text())
        assert not scene.ready()
        assert "is ready" not in scene.log_text()
        scene.board.events()
    finally:
        scene.board.replug()
    scene.wait_ready()
    frames = [event for event in scene.board.events() if event.is_motor]
    assert frames
    assert all(event.is_stop for event in frames)
    found = status(scene)
    assert not found["enabled"]
    assert found["device"]["state"] == "open"
    assert {name: row["state"] for name, row in found["processes"].items()} == dict.fromkeys(
        layout.PROCESS_NAMES, "running"
    )
    assert all(row["realtime"] and row["memory_locked"] for row in found["processes"].values())


@pytest.mark.slow
def test_a_restart_whose_stop_can_t_be_written_starts_it_all_the_same(shared_scene: Scene) -> None:
    """The unit that goes on trying to stop gives way to the start that waits, because both would ask the board at once.
    Then that unit may fail, and its restart stops the service. Here it would fail in any case."""
    scene = shared_scene
    scene.start()
    scene.begin()
    scene.box.unit(f"{LATE}.d/fails.conf", "[Service]\nExecStart=\nExecStart=/bin/false\n")
    scene.box.ctl("daemon-reload")
    try:
        scene.board.unplug()
        try:
            scene.box.ctl("restart", "--no-block", UNIT)
            wait_for(
                "the stop tool to give up",
                lambda: "Triggering OnFailure= dependencies" in scene.log_text(),
                WHOLE_S,
            )
        finally:
            scene.board.replug()
        scene.wait_ready()
        assert scene.log_text(LATE) == ""
    finally:
        scene.box.unit(f"{LATE}.d/fails.conf", "")
        scene.box.ctl("daemon-reload")
    scene.board.events()
    assert not any(scene.board.wheels())


# One process dies.


def test_kill_of_a_child_is_the_supervisor_s_to_answer(scene: Scene) -> None:
    restarts, supervisor = scene.restarts(), scene.pid("supervisor")
    for process in CHILDREN:
        before = scene.pid(process)
        well(scene.fault(scene.kill(process)))
        wait_for(f"{process} to be restarted", lambda: status(scene)["waiting_for"] is None)
        assert scene.pid(process) != before
        assert (scene.pid("supervisor"), scene.restarts()) == (supervisor, restarts)
        assert status(scene)["estop"] == f"{process} died"
    told(scene, *(f"STOP latched: {process} died" for process in CHILDREN))


def test_kill_of_the_supervisor(scene: Scene) -> None:
    before, restarts = scene.pids(), scene.restarts()
    well(scene.fault(scene.kill("supervisor")))
    whole_again(scene, before)
    assert scene.restarts() == restarts + 1
    told(scene, "Main process exited, code=killed, status=9/KILL", "stop frame sent")


# All of them.


def test_kill_of_everything(scene: Scene) -> None:
    before = scene.pids()
    well(scene.fault(scene.kill_all))
    whole_again(scene, before)
    told(scene, "stop frame sent")


@pytest.mark.claim("SEVERAL-1")
def test_hang_of_everything_is_the_watchdog_s(scene: Scene) -> None:
    """Nobody in the service can stop: systemd kills the supervisor, the stop tool the others."""
    before = scene.pids()

    def freeze() -> None:
        for pid in before.values():
            os.kill(pid, signal.SIGSTOP)

    well(scene.fault(freeze))
    whole_again(scene, before)
    told(scene, "Watchdog timeout (limit 1s)!", "killed what was left of the service: 2 processes", "stop frame sent")


# People and the watchdog.


def test_hang_of_the_supervisor(scene: Scene) -> None:
    """The port owner's lease stops the wheels before systemd sees anything; then it restarts the service."""
    before, since = scene.pids(), f"--since=@{time.time():.6f}"
    stopped = scene.fault(scene.signal(signal.SIGSTOP, before["supervisor"]))
    well(stopped)
    whole_again(scene, before)
    told(scene, "Watchdog timeout (limit 1s)!", "stop frame sent")
    [noticed] = [entry for entry in scene.box.journal(since) if "Watchdog timeout" in str(entry["MESSAGE"])]
    assert stopped.stop_ns is not None
    assert stopped.fault_ns + stopped.stop_ns < int(noticed["__MONOTONIC_TIMESTAMP"]) * 1000


def test_a_supervisor_that_is_continued_was_no_hang_for_systemd(scene: Scene) -> None:
    pid, restarts = scene.pid("supervisor"), scene.restarts()

    def pause() -> None:
        os.kill(pid, signal.SIGSTOP)
        wait_for("the wheels to stop", lambda: not any(scene.board.wheels()))
        os.kill(pid, signal.SIGCONT)

    well(scene.fault(pause))
    assert (scene.restarts(), scene.pid("supervisor")) == (restarts, pid)
    assert status(scene)["estop"].startswith("supervisor was suspended")


def test_before_a_sleep_the_wheels_are_stopped(scene: Scene) -> None:
    """The unit by itself, as sleep.target may not be started by hand: it ends when the stop is out, and latched."""
    asleep_ns: list[int] = []

    def sleep() -> None:
        scene.box.ctl("start", SLEEP)
        asleep_ns.append(time.monotonic_ns())

    stopped = scene.fault(sleep)
    well(stopped)
    assert stopped.stop_ns is not None
    assert stopped.fault_ns + stopped.stop_ns < asleep_ns[0]
    assert scene.box.show(SLEEP, "Result")["Result"] == "success"
    assert status(scene)["estop"].startswith("stop request: the machine goes to sleep")
    scene.end()
    scene.box.ctl("start", SLEEP)
    assert scene.box.show(SLEEP, "Result")["Result"] == "success", "where nothing runs there is nothing to stop"


def test_systemctl_restart_and_stop(scene: Scene) -> None:
    before = scene.pids()
    well(scene.fault(lambda: scene.box.ctl("restart", UNIT)))
    whole_again(scene, before)
    before = scene.pids()
    scene.begin()
    well(scene.fault(lambda: scene.box.ctl("stop", UNIT)))
    assert scene.box.pids(UNIT) == []
    assert not any(os.path.exists(f"/proc/{pid}") for pid in before.values())
    assert scene.box.show(UNIT, "Result", "NRestarts") == {"Result": "success", "NRestarts": "0"}
    told(scene, "stopped; the stop was written twice", "stop frame sent", "Deactivated successfully")
    assert not any(path.startswith("failstop.") for path in os.listdir(scene.box.path("/dev/shm")))


def test_a_stop_that_could_not_be_written_is_written_when_the_board_is_back(shared_scene: Scene) -> None:
    """The service is gone by then; who goes on trying ends when it is written, or when the service is started."""
    scene = shared_scene
    scene.end()
    settings = scene.box.path(CONFIG).read_text()
    scene.box.write(CONFIG, f"{settings}[stop]\nwait_s = 0.2\n")

    try:
        for by_start in (False, True):
            scene.start()
            scene.drive()
            scene.board.unplug()
            scene.leave()
            scene.box.ctl("stop", UNIT, check=False)
            assert scene.box.show(UNIT, "Result")["Result"] == "exit-code"
            scene.box.wait(LATE, WHOLE_S, ActiveState="active")
            assert any(scene.board.wheels())
            scene.board.events()
            if by_start:
                scene.box.ctl("start", "--no-block", UNIT)
                scene.box.wait(LATE, WHOLE_S, ActiveState="inactive")
            scene.board.replug()
            assert scene.board.wait_for(lambda event: event.is_motor, NEVER_S).is_stop
            scene.box.wait(LATE, WHOLE_S, ActiveState="inactive")
            scene.end()
    finally:
        scene.box.write(CONFIG, settings)


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
    opening = (
        "from failstop.board import port; from failstop.board.rrc.board import RRC_PORT; "
        "port.open_port('/board/port', exclusive=False, line=RRC_PORT)"
    )
    opening = f"import sys; sys.path.insert(0, '{installed.PREFIX}/src'); {opening}"
    user = ("setpriv", f"--reuid={DRIVER}", f"--regid={DRIVER}", "--init-groups", "--")
    refused = scene.box.run(*user, f"{installed.PREFIX}/bin/python3", "-c", opening, check=False)
    assert refused.returncode == 1
    assert "held exclusively" in refused.stderr


# Two robots.


def test_two_robots_share_nothing_but_the_user(scene: Scene) -> None:
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


# Many deaths.


def test_a_crash_loop_ends_stopped(shared_scene: Scene) -> None:
    scene = shared_scene
    scene.end()
    scene.box.unit(DROP_IN, f"{RIGHTS}[Unit]\nStartLimitBurst=2\n")
    scene.box.ctl("daemon-reload")
    try:
        scene.start()
        for start in (1, 2):
            killed_ns = time.monotonic_ns()
            scene.kill_all()
            stop_since(scene, killed_ns)
            scene.board.events()
            if start < 2:
                scene.recover(start)
        scene.box.wait(UNIT, WHOLE_S, ActiveState="failed")
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
