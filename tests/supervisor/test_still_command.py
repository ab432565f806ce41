"""still.command: run once for each stop that the wheels do not obey, whatever became of it at the stop before."""

from __future__ import annotations

import os
from collections.abc import Callable

import pytest

from failstop.messages import layout
from failstop.policy import causes
from failstop_lab.machine.process import Process
from tests.support.stage import MS
from tests.support.supervisor_scene import Scene
from tests.support.why import why

S = 1_000_000_000
UNSTILL = str(causes.UNSTILL())
COMMAND = "call somebody"


def unheeded(program: Callable[[Process, list[str]], int] | None = None) -> Scene:
    """Stops that the wheels do not obey; the command waits to be killed, or is another program."""
    scene = Scene(settings={"still.command": COMMAND, "still.after_s": 1.0})
    scene.machine.programs["sh"] = program or scene.wait
    return scene


def follow(scene: Scene, elapsed_ns: int, *, still: bool = False) -> list[str]:
    scene.now_ns += elapsed_ns
    scene.judge(still=still)
    return [str(stop.cause) for stop in scene.supervisor.tracker.poll(scene.now_ns, listening=False)]


def reset(scene: Scene) -> None:
    epochs = scene.supervisor.epochs
    epochs.latch.reset(epochs.number, scene.now_ns)


def stop(scene: Scene) -> None:
    epochs = scene.supervisor.epochs
    epochs.number += 1
    made = scene.made_stop(why(f"stop {epochs.number}"), layout.GATE)
    made.answered_by("port owner", scene.now_ns, made, epochs.number)
    scene.supervisor.tracker.answered(made, ending=False)
    follow(scene, MS)


def stop_unheeded(scene: Scene) -> None:
    """People have reset, and a new stop is not obeyed."""
    reset(scene)
    follow(scene, MS)
    stop(scene)
    assert follow(scene, S) == [UNSTILL]


def commands(scene: Scene) -> list[tuple[str, str, dict[str, object]]]:
    """Events of the command since the last call: level, text and fields."""
    return [(level, text, fields) for kind, level, text, fields in scene.said() if kind == "command"]


def pids(scene: Scene) -> list[int]:
    """Of the commands that have not ended."""
    return [process.pid for process in scene.running("sh")]


def ends(process: Process, argv: list[str]) -> int:
    return 0


def test_a_command_that_has_not_ended_is_killed_with_what_it_started_and_run_anew() -> None:
    started: list[Process] = []

    def starts(process: Process, argv: list[str]) -> int:
        machine = process.machine
        started.append(machine.process("sleep", lambda _: machine.block(), parent=process))
        machine.block()
        return 0

    scene = unheeded(starts)
    stop_unheeded(scene)
    (first,) = pids(scene)
    follow(scene, MS)
    stop_unheeded(scene)
    (second,) = pids(scene)
    assert second != first
    assert started[0].dead
    again = f"still.command (pid {first}) has not ended since an earlier stop: killed, and run again"
    assert commands(scene)[1] == ("error", again, {"state": "hangs", "pid": first})
    follow(scene, MS)
    ((_, text, fields),) = commands(scene)
    assert text == f"still.command (pid {first}) ended with code -9"
    assert fields == {"state": "ended", "pid": first, "code": -9}
    assert pids(scene) == [second]


def test_the_command_runs_once_for_one_stop() -> None:
    scene = unheeded()
    stop_unheeded(scene)
    assert follow(scene, S) == [UNSTILL], "stopped again"
    (pid,) = pids(scene)
    told = (f"still.command runs (pid {pid}): {COMMAND}", {"state": "runs", "pid": pid})
    assert [told[1:] for told in commands(scene)] == [told]
    assert scene.born[-1].pid == pid


def test_the_command_runs_again_for_the_next_stop_once_the_wheels_were_still() -> None:
    """Though the supervisor has not seen the reset in between; and one that has ended is not told to hang."""
    scene = unheeded(ends)
    stop_unheeded(scene)
    follow(scene, MS, still=True)
    reset(scene)
    stop(scene)
    assert follow(scene, S) == [UNSTILL]
    stop_unheeded(scene)
    assert [process.name for process in scene.born] == ["sh"] * 3
    follow(scene, 100 * MS)
    told = [(level, fields) for level, _, fields in commands(scene) if fields["state"] != "runs"]
    assert told == [("warning", {"state": "ended", "pid": process.pid, "code": 0}) for process in scene.born]


@pytest.mark.parametrize(
    ("call", "number", "text"),
    [
        ("spawn", 11, f"cannot run still.command ({COMMAND}): [Errno 11] Resource temporarily unavailable"),
        ("kill", 1, "cannot be killed (Operation not permitted)"),
    ],
)
def test_a_command_that_can_not_be_started_or_killed_is_told_of(call: str, number: int, text: str) -> None:
    scene = unheeded()
    if call == "kill":
        stop_unheeded(scene)
    scene.refuse(call, OSError(number, os.strerror(number)))
    stop_unheeded(scene)
    [fields] = [fields for level, told, fields in commands(scene) if level == "error" and text in told]
    if call == "spawn":
        assert fields == {"state": "failed", "reason": text.partition(": ")[2]}
    assert len(pids(scene)) == (2 if call == "kill" else 0), "it keeps no stop from its own"


def test_clients_are_told_of_a_stop_that_the_kernel_still_holds() -> None:
    scene = unheeded(ends)
    scene.wire.hold()
    stop(scene)
    assert scene.table("stop")["sent"] is True, "nobody has looked yet"
    follow(scene, 10 * S)
    assert scene.table("stop")["sent"] is False


def test_clients_are_told_once_of_a_stop_of_which_nothing_more_is_learnt() -> None:
    """People are told what became of it; nothing of what clients read has changed."""
    scene = unheeded(ends)
    stop(scene)
    written = scene.number("stop")
    follow(scene, 10 * S)
    assert scene.said()[-1][0] == "stop_outcome"
    assert scene.number("stop") == written
