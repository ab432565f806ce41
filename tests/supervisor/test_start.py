"""Where processes start: with what they were given and nothing else, and an end that is told where people look."""

from __future__ import annotations

import errno
import os
import select
import signal
from pathlib import Path
from typing import Any

import pytest

from failstop.board.rrc.board import BOARD
from failstop.messages import layout
from failstop.policy.processes import PROCESS_BY_NAME
from failstop.policy.settings import SETTINGS_VARIABLE
from failstop_lab.machine.files import Null, Open
from failstop_lab.machine.process import Process, Thread
from failstop_lab.machine.robot import DEVICE, MS, RUN, Robot
from tests.support.arm_settings import ARM, SERVOS
from tests.support.boards import own_folder
from tests.support.supervisor_scene import Scene

DIRECTORY = "/run/failstop/failstop"
LONG_NS = 10_000 * MS


# Any process but the supervisor.


def run(scene: Scene, name: str, program: Any) -> Process:
    """The supervisor starts a process, with this program in the place of its own. As another supervisor, it is started
    in the place of the gate."""
    main = scene.load("failstop.supervisor.bootstrap").main
    if name == layout.SUPERVISOR:
        scene.load("failstop.supervisor.entry").start = program
    else:
        scene.load(PROCESS_BY_NAME[name].module).run = program

    def child(process: Process, argv: list[str]) -> int:
        process.handlers[signal.SIGINT] = lambda *_: None  # Python's own: an error, later
        process.environ["FAILSTOP_PATH"] = "/a folder:/b"
        code: int = main([argv[0], name, *argv[2:], "dir=/run/a=b"])
        return code

    scene.machine.programs["bootstrap.py"] = child
    started = layout.GATE if name == layout.SUPERVISOR else name
    scene.supervisor.processes.start(scene.supervisor.processes[started])
    return scene.born[-1]


@pytest.mark.parametrize("name", list(PROCESS_BY_NAME))
def test_a_process_runs_its_program_with_what_it_was_given(scene: Scene, name: str) -> None:
    """Its folder's name may have an equals sign in it, and a folder of its search path a space."""
    given: list[Any] = []

    def program(context: Any) -> int:
        given.append((context.instance, context.runtime_dir, context.own.incarnation))
        return 7

    process = run(scene, name, program)
    scene.machine.run(lambda: process.code is not None, LONG_NS)
    assert given == [("stage", "/run/a=b", scene.run.incarnation)]
    assert process.sys_path == ["/a folder", "/b"]
    assert process.code == 7


@pytest.mark.parametrize("name", [layout.GATE, layout.SUPERVISOR])
def test_an_interrupt_ends_a_process_at_once(scene: Scene, name: str) -> None:
    """The supervisor too, until it starts the others: Ctrl-C right after `failstop run` is no error to be printed."""
    process = run(scene, name, lambda _: scene.machine.block())
    scene.machine.run(lambda: process.threads[0].waiting, LONG_NS)
    scene.machine.kill(process, signal.SIGINT)
    assert process.dead


def fail(scene: Scene, *, takes: bool) -> Process:
    """A process fails, and is gone at once. `takes`: its stderr has room."""
    failed_ns = []

    def program(context: Any) -> None:
        failed_ns.append(scene.now_ns)
        raise ValueError("seven \udcff")

    scene.stderr.mask = lambda opened: select.EPOLLOUT if takes else 0  # type: ignore[method-assign]
    process = run(scene, layout.GATE, program)
    scene.machine.run(lambda: process.dead, LONG_NS)
    assert failed_ns == [scene.now_ns]
    scene.machine.run(lambda: process.code is not None, LONG_NS)
    return process


def test_a_process_that_fails_says_where_and_why(scene: Scene) -> None:
    assert fail(scene, takes=True).code == 1
    first, *frames, last, rest = b"".join(scene.stderr.heard).decode().split("\n")
    assert (first, last, rest) == ("Traceback (most recent call last):", "ValueError: seven ?", "")
    assert len(frames) == 2
    assert '/supervisor/bootstrap.py", line ' in frames[0]
    assert f'File "{__file__}", line ' in frames[1]
    assert frames[1].endswith(", in program")


def test_a_process_that_fails_does_not_wait_for_its_stderr(scene: Scene) -> None:
    assert fail(scene, takes=False).code == 1
    assert scene.stderr.heard == []


# The supervisor, as `failstop run` becomes it.


class Journal:
    """The journal's datagrams."""

    def __init__(self, robot: Robot) -> None:
        self.got: list[str] = []
        robot.loader.load("failstop.notify").Outbox.send = self._send

    def _send(self, datagram: bytes) -> bool:
        self.got.append(datagram.decode())
        return True

    def of(self, kind: str) -> list[str]:
        return [text for text in self.got if f"\nFAILSTOP_EVENT={kind}\n" in text]


@pytest.fixture
def robot() -> Robot:
    made = Robot(imu_hz=20.0)
    made.join("test")
    return made


def begun(robot: Robot, **environ: str) -> Process:
    """A service that is ready."""
    process = robot.start()
    process.environ |= environ
    robot.connect().close()
    return process


def code_of(robot: Robot, process: Process) -> int | None:
    """How it ends."""
    robot.machine.run(lambda: process.code is not None, LONG_NS)
    return process.code


def stream(robot: Robot, device: int = 1) -> str:
    """The variable of a service manager whose journal stderr is; of another `device` it is another's."""
    return f"{device}:{robot.stderr.number}"


@pytest.mark.parametrize("number", [signal.SIGTERM, signal.SIGINT])
def test_a_service_that_is_told_to_end_ends_in_order(robot: Robot, number: int) -> None:
    process = begun(robot)
    robot.machine.kill(process, number)
    assert code_of(robot, process) == 0
    assert "the stop was written twice" in robot.said


def test_the_exit_code_tells_of_an_end_that_nobody_wanted(robot: Robot) -> None:
    process = begun(robot)
    robot.loader.system["os"].unlink(f"{DIRECTORY}/stop")
    assert code_of(robot, process) == 1
    assert "the stop was written twice" in robot.said, "it was carried out all the same"


def test_the_exit_code_tells_of_a_last_stop_that_was_not_heard(robot: Robot) -> None:
    process = begun(robot)
    robot.board.model.deaf = True
    robot.machine.kill(process, signal.SIGTERM)
    assert code_of(robot, process) == 1


def test_the_supervisor_keeps_its_streams_and_nothing_else_that_it_inherits(robot: Robot) -> None:
    process, foreign = robot.start(), Open(Null())
    for _ in range(3):
        process.inheritable.add(process.descriptor(foreign, 5))
    robot.connect().close()
    assert [process.files[fd].node for fd in (0, 1, 2)] == [robot.stderr] * 3
    assert foreign not in process.files.values()


def test_the_last_stop_of_a_robot_with_an_arm_is_the_arm_s_too() -> None:
    robot = Robot(imu_hz=20.0, settings=ARM)
    robot.join("test")
    process = begun(robot)
    writes: list[bytes] = []
    robot.board.on_bytes = writes.append
    robot.machine.kill(process, signal.SIGTERM)
    assert code_of(robot, process) == 0
    assert writes[-1] == BOARD.burst + BOARD.arm.stops(SERVOS) != BOARD.burst


@pytest.mark.parametrize("device", [1, 2])
def test_a_service_speaks_to_the_journal_where_that_has_its_stderr(robot: Robot, device: int) -> None:
    journal = Journal(robot)
    process = begun(robot, JOURNAL_STREAM=stream(robot, device))
    robot.machine.kill(process, signal.SIGTERM)
    code_of(robot, process)
    told = [len(journal.of("ready")), robot.said.count("is ready: it has told the wheels to stop")]
    assert told == ([1, 0] if device == 1 else [0, 1])
    assert "JOURNAL_STREAM" not in process.environ, "nothing that it starts may speak for it"


@pytest.mark.starts
def test_your_own_board_is_tried_before_the_service_begins_and_never_in_it(tmp_path: Path) -> None:
    """A trial needs a child process and time, and a port owner that restarts has none to lose."""
    robot = Robot(imu_hz=20.0, kind=own_folder(tmp_path / "tank"))
    robot.join("test")
    own, asked = robot.loader.load("failstop.board.own"), set()
    wire = own.wire

    def watched(folder: str, *, tried: bool = False) -> Any:
        assert robot.machine.current
        asked.add((SETTINGS_VARIABLE in robot.machine.current.process.environ, tried))
        return wire(folder, tried=tried)

    own.wire = watched
    begun(robot)
    assert asked == {(False, False), (True, True)}


def test_it_is_known_how_a_service_was_started(robot: Robot) -> None:
    begun(robot)
    last = robot.loader.load("failstop.files.instance").last("failstop")
    assert (last.device, last.board, last.command) == (DEVICE, "rrc", f"failstop run {' '.join(RUN[:-2])}")


def test_a_service_that_can_t_begin_tells_the_journal_why(robot: Robot) -> None:
    journal = Journal(robot)
    process = robot.start()
    process.environ["JOURNAL_STREAM"] = stream(robot)

    def no_room(thread: Thread, call: str, about: tuple[Any, ...]) -> None:
        if thread.process is process and call == "mkfifo":
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    robot.machine.at_seam = no_room
    assert code_of(robot, process) == 1
    [told] = journal.of("not_started")
    assert "\nFAILSTOP_REASON=[Errno 28] No space left on device\n" in told
    assert robot.said == ""
