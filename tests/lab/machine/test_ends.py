"""The end of a simulated machine: nothing of it stays in memory, and what is collected late changes nothing."""

from __future__ import annotations

import gc
import sys
import threading
import weakref
from collections.abc import Iterator
from types import SimpleNamespace
from typing import Any

import pytest

from failstop_lab.machine.kernel import Machine, running_machines
from failstop_lab.machine.robot import MS, Robot

SERVICES = 4
MOST_OBJECTS = 2_000
"""Objects that the collector may find more after SERVICES ended services; one that is left has over 30,000."""
FINALIZED = """
import os, weakref

class Held:
    def __init__(self, fd):
        self.fd = fd

    def __del__(self):
        told.append("Held")
        os.write(self.fd, bytes(8))
        os.close(self.fd)

class Watched:
    pass

def watched(fd):
    made = Watched()
    weakref.finalize(made, os.close, fd)
    return made

def begun(fd):
    def body():
        try:
            yield
        finally:
            os.write(fd, bytes(8))
            os.close(fd)
    made = body()
    next(made)
    return made
"""


@pytest.fixture
def unraisable(monkeypatch: pytest.MonkeyPatch) -> list[Any]:
    """Errors that finalizers have ended by."""
    found: list[Any] = []
    monkeypatch.setattr(sys, "unraisablehook", found.append)
    return found


@pytest.fixture
def robot() -> Iterator[Robot]:
    """A machine with the test as one of its processes."""
    made = Robot()
    made.join("test")
    yield made
    made.machine.end()


def driven() -> Robot:
    """A service that runs, with a program that drives."""
    robot = Robot(imu_hz=20.0)
    robot.start()
    robot.join("test")
    client = robot.connect(client="test")
    client.enable()
    robot.drive(client, 0.1, (0.1, 0.0, 0.0))
    return robot


def finalized(robot: Robot) -> SimpleNamespace:
    """Objects of the machine with a finalizer each, and the names of those whose `__del__` has run."""
    names: dict[str, Any] = {
        "__builtins__": {**vars(robot.loader)["_builtins"]},
        "__name__": "finalized",
        "told": (told := list[str]()),
    }
    exec(FINALIZED, names)
    system = robot.loader.system["os"]
    return SimpleNamespace(told=told, objects=[names[each](system.eventfd(0)) for each in ("Held", "watched", "begun")])


def test_ended_services_leave_nothing_in_memory() -> None:
    driven().machine.end()
    gc.collect()
    before = len(gc.get_objects())
    left: list[weakref.ref[Any]] = []
    for _ in range(SERVICES):
        robot = driven()
        threads = [thread for process in robot.machine.processes.values() for thread in process.threads]
        left += [weakref.ref(thread.greenlet) for thread in threads if thread.greenlet is not robot.machine.hub]
        left += map(weakref.ref, (robot.machine, robot.loader.load("failstop"), robot.loader.load("failstop").Robot))
        robot.machine.end()
        assert robot.machine not in running_machines
        del robot, threads
    gc.collect()
    assert len(left) > SERVICES * 10
    assert [each() for each in left if each() is not None] == []
    assert len(gc.get_objects()) - before < MOST_OBJECTS


def test_a_machine_that_no_thread_waits_on_needs_no_end() -> None:
    robot = Robot()
    robot.loader.load("failstop.api.client")
    left = weakref.ref(robot.machine)
    del robot
    gc.collect()
    assert left() is None


def test_what_is_collected_with_its_machine_does_nothing(unraisable: list[Any]) -> None:
    robot = Robot()
    robot.join("test")
    made = finalized(robot)
    made.objects.append(made)
    left = weakref.ref(robot.machine)
    robot.machine.end()
    del robot, made
    gc.collect()
    assert left() is None
    assert unraisable == []


@pytest.mark.parametrize("ended", [False, True])
def test_the_collector_closes_no_descriptor_of_a_process(robot: Robot, unraisable: list[Any], ended: bool) -> None:
    """Its finalizers come in the middle of any process, where a number means another file, or after the end."""
    made = finalized(robot)
    test, told = robot.machine.caller().process, made.told
    fds = set(test.files)
    if ended:
        robot.machine.end()
    else:
        made.objects.append(made)
    at_ns = robot.machine.now_ns
    del made
    gc.collect()
    assert (set(test.files), robot.machine.now_ns, unraisable) == (fds, at_ns, [])
    assert ended or told == []


def test_a_collection_in_another_thread_of_python_takes_no_call_away(robot: Robot) -> None:
    """A collection may give the interpreter to the thread that the machine runs in, between its start and its end."""
    started, go = threading.Event(), threading.Event()

    def wait(phase: str, _: object) -> None:
        if phase == "start" and threading.current_thread() is collector:
            started.set()
            go.wait()

    collector = threading.Thread(target=gc.collect)
    gc.callbacks.append(wait)
    try:
        collector.start()
        started.wait()
        robot.time.sleep(0.01)
    finally:
        go.set()
        collector.join()
        gc.callbacks.remove(wait)


def test_a_living_process_finalizes_what_it_forgets(robot: Robot) -> None:
    made = finalized(robot)
    fds = set(robot.machine.caller().process.files)
    made.objects[:] = made.objects[1:2]
    assert len(fds - set(robot.machine.caller().process.files)) == 2
    made.objects.clear()
    assert len(fds - set(robot.machine.caller().process.files)) == 3


def test_threads_that_wait_are_ended_without_a_call() -> None:
    robot = Robot()
    system, told = robot.loader.system, list[str]()

    def body(_: object) -> None:
        robot.streams(robot.machine.caller().process)
        try:
            system["time"].sleep(1e6)
        finally:
            told.append("ended")
            system["os"].write(2, b"never")
            told.append("never")

    process = robot.machine.process("sleeper", body)
    robot.machine.run(lambda: False, 10 * MS)
    at_ns = robot.machine.now_ns
    robot.machine.end()
    assert told == ["ended"]
    assert robot.said == ""
    assert process.threads[0].greenlet.dead
    assert robot.machine.now_ns == at_ns


def test_an_end_comes_once_and_leaves_other_machines_alone(robot: Robot) -> None:
    other = Machine()
    other.end()
    other.end()
    assert other not in running_machines
    assert robot.machine in running_machines
    robot.time.sleep(0.01)
