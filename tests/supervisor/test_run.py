"""A run makes files with exact rights, leaves nothing of them, and tells of a name that is taken away."""

from __future__ import annotations

import errno
import itertools
import os
import stat
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import pytest

from failstop.messages import layout
from failstop.policy.processes import PROCESSES, Process
from failstop.policy.settings import Settings
from failstop.supervisor.run import LOOK_EVERY_NS, Run
from failstop_lab.machine.kernel import TAKEDOWN_NS
from tests.support.supervisor_scene import DEVICE, RUNTIME_DIR, Scene

GROUP = 4321


@pytest.fixture
def ended(scene: Scene) -> Scene:
    """A run has ended in order."""
    scene.run.remove()
    return scene


def segments(scene: Scene) -> list[str]:
    found: list[str] = scene.os.listdir("/dev/shm")
    return found


def mode(scene: Scene, name: str) -> str:
    return stat.filemode(scene.os.stat(f"{RUNTIME_DIR}/{name}").st_mode)


def incarnation(scene: Scene, run: Any, process: str) -> int:
    found: int = scene.load("failstop.messages.segments").attach(run.memory, process).incarnation
    return found


def dies_before(scene: Scene) -> str:
    """Another process makes a run, which is killed; its memory."""
    made: list[Any] = []

    def body(_: object) -> None:
        made.append(scene.new_run())
        made[0].publish()
        bell = scene.load("failstop.shm.bell")
        bell.send(bell.open_pipe_to_write(f"{RUNTIME_DIR}/stop"), b"old\n")
        scene.machine.block()

    process = scene.machine.process("before", body)
    scene.machine.run(lambda: process.threads[0].waiting, TAKEDOWN_NS)
    scene.machine.die(process, -9)
    scene.now_ns += TAKEDOWN_NS
    memory: str = made[0].memory
    return memory


def test_every_segment_is_there_and_of_this_run(scene: Scene) -> None:
    assert len(segments(scene)) == len(layout.SEGMENTS)
    for process in layout.PROCESS_NAMES:
        assert incarnation(scene, scene.run, process) == scene.run.incarnation


def test_two_runs_differ(ended: Scene) -> None:
    assert ended.new_run().incarnation != ended.run.incarnation


@pytest.mark.parametrize(
    ("name", "rights"),
    [
        ("stop", "prw--w--w-"),  # who could read it could take a request away before the port owner sees it
        ("bell", "prw--w----"),
        ("claims", "-rw-rw----"),
    ],
)
def test_the_rights_of_pipes_and_claims_say_who_may_use_them(scene: Scene, name: str, rights: str) -> None:
    assert mode(scene, name) == rights


def test_a_request_waits_in_the_pipe_while_nobody_reads_it(scene: Scene) -> None:
    """As while the port owner is being restarted: the supervisor keeps the pipe open."""
    bell = scene.load("failstop.shm.bell")
    fd = bell.open_pipe_to_write(f"{RUNTIME_DIR}/stop")
    assert bell.send(fd, b"stop\n")
    scene.os.close(fd)
    assert bell.receive(scene.run.stop_pipe) == b"stop\n"
    assert bell.receive(scene.run.stop_pipe) == b"", "and no end of file when the client has gone"


def group_is(scene: Scene, gid: int) -> None:
    """The group of those who may drive."""
    scene.system["grp"].getgrnam = lambda name: SimpleNamespace(gr_gid={"failstop": gid}[name])


def test_the_group_is_the_client_s_where_it_exists(ended: Scene) -> None:
    group_is(ended, GROUP)
    made = ended.new_run()
    path_of = ended.load("failstop.messages.segments").path_of
    paths = f"{RUNTIME_DIR}/bell", f"{RUNTIME_DIR}/claims", path_of(made.memory, "client.0")
    assert [ended.os.stat(path).st_gid for path in paths] == [GROUP] * 3
    assert ended.os.stat(path_of(made.memory, layout.GATE)).st_gid == 0, "what clients only read stays"


@pytest.mark.parametrize(
    ("gid", "user", "groups", "given"),
    [(0, 0, [], 0), (GROUP, 0, [], GROUP), (GROUP, 7, [GROUP], GROUP), (GROUP, 7, [4322], -1), (-1, 0, [], -1)],
)
def test_a_user_who_may_gives_files_to_the_group(
    scene: Scene, gid: int, user: int, groups: list[int], given: int
) -> None:
    """Root, and a member; anybody else's service has the clients of its own group, and so where there is none."""
    if gid >= 0:
        group_is(scene, gid)
    scene.os.geteuid, scene.os.getgroups = (lambda: user), (lambda: groups)
    assert scene.load("failstop.supervisor.run").client_gid() == given


def test_a_run_replaces_what_a_dead_one_left(ended: Scene) -> None:
    dead = dies_before(ended)
    again = ended.new_run()
    again.publish()
    assert incarnation(ended, again, layout.GATE) == again.incarnation
    assert not any(dead in name for name in segments(ended))
    assert ended.load("failstop.shm.bell").receive(again.stop_pipe) == b""


@pytest.mark.parametrize("row", PROCESSES, ids=lambda row: row.name)
def test_every_descriptor_that_a_process_is_to_get_is_there(scene: Scene, row: Process) -> None:
    found = scene.run.descriptors(row.name, 55)
    assert set(row.descriptors) <= set(found)
    assert found["port"] == 55
    assert found["bell"] == scene.run.bells[row.name].fd


def test_no_descriptor_is_inherited_unless_it_is_passed_on(tmp_path: Path) -> None:
    """Of the kernel's own."""
    made = Run(Settings(), f"r{os.getpid()}", str(tmp_path))
    fds = {fd for row in PROCESSES for fd in made.descriptors(row.name, -1).values() if fd >= 0}
    inherited = [fd for fd in fds if os.get_inheritable(fd)]
    made.remove()
    for fd in fds | {mine for mine, _ in made.controls.values()}:
        os.close(fd)
    assert inherited == []


def test_both_ends_of_the_sockets_stay_with_the_supervisor(scene: Scene) -> None:
    """A successor inherits the same end, with what was sent to its predecessor."""
    assert set(scene.run.controls) == {layout.PORT_OWNER, layout.STOPPER, layout.TELEMETRY}
    for process, (_, theirs) in scene.run.controls.items():
        assert scene.run.descriptors(process, -1)["control"] == theirs


def test_nothing_is_left_but_how_it_was_started(ended: Scene) -> None:
    for _ in range(2):
        assert segments(ended) == []
        assert ended.os.listdir(RUNTIME_DIR) == ["last"], "how it was started"
        ended.run.remove()


def test_claims_of_clients_work_on_the_file(scene: Scene) -> None:
    claim, path = scene.load("failstop.shm.claim"), f"{RUNTIME_DIR}/claims"
    client, service = claim.open_claims(path), scene.os.open(path, os.O_RDONLY)
    assert claim.acquire(client, 3)
    assert claim.held(service, 3)
    scene.os.close(client)
    assert not claim.held(service, 3)


def fail(scene: Scene, at: int) -> None:
    """No room from the segment of this number on; past the last one, none for the file that names the run."""
    made = itertools.count()
    call = "fallocate" if at < len(layout.SEGMENTS) else "mkfifo"
    no_space = OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
    scene.refuse(call, no_space, lambda *_: call == "mkfifo" or next(made) >= at)


@pytest.mark.parametrize("at", [0, 1, 7, len(layout.SEGMENTS)])
def test_a_start_that_fails_midway_leaves_nothing(ended: Scene, at: int) -> None:
    fail(ended, at)
    with pytest.raises((ended.load("failstop.messages.segments").AttachError, OSError), match=r"No space|no room"):
        ended.new_run()
    assert segments(ended) == []
    assert ended.os.listdir(RUNTIME_DIR) == ["last"]


def test_a_start_that_fails_keeps_the_black_box_of_the_run_before(ended: Scene) -> None:
    before, segment = dies_before(ended), ended.load("failstop.messages.segments")
    fail(ended, 3)
    with pytest.raises(segment.AttachError, match="no room"):
        ended.new_run()
    assert segment.dead_runs("stage") == [before]
    ended.allow()
    made = ended.new_run()
    assert set(made.left) == set(layout.PROCESS_NAMES)
    made.publish()
    assert segment.dead_runs("stage") == []


def test_a_run_takes_nothing_from_one_that_lives(scene: Scene) -> None:
    """The lock's file may have been replaced or removed."""
    before = scene.os.listdir(RUNTIME_DIR), segments(scene)
    with pytest.raises(scene.load("failstop.files.instance").InstanceError, match="already running"):
        scene.new_run()
    assert (scene.os.listdir(RUNTIME_DIR), segments(scene)) == before


def test_a_segment_that_is_taken_away_during_the_start_is_named(ended: Scene) -> None:
    def attaches(path: str, flags: int) -> bool:
        return path.endswith(f".{layout.GATE}") and not flags & os.O_CREAT

    ended.refuse("open", FileNotFoundError(errno.ENOENT, "gone"), attaches)
    error = ended.load("failstop.messages.segments").AttachError
    with pytest.raises(error, match=r"^shared memory gate was there and can't be opened: try again"):
        ended.new_run()
    assert segments(ended) == []


def test_whatever_others_find_by_its_name_is_watched(scene: Scene) -> None:
    others = {"the stop pipe", "the bell of the clients", "the name of the run"}
    assert set(scene.run.named) == {*others, *(f"shared memory {spec.name}" for spec in layout.SEGMENTS)}
    assert all(scene.os.fstat(fd).st_nlink for fd in scene.run.named.values())


VITAL = ("gate", "lifelines", "stop")
SLOTS = ("client.0", "client.7")
TEXT = {"gate": "shared memory gate", "lifelines": "shared memory lifelines", "stop": "the stop pipe"}


def remove(scene: Scene, name: str) -> str:
    """Take a name away; returns its path."""
    path_of = scene.load("failstop.messages.segments").path_of
    path: str = f"{RUNTIME_DIR}/stop" if name == "stop" else path_of(scene.run.memory, name)
    scene.os.unlink(path)
    return path


def lost(scene: Scene, *names: str, elapsed_ns: int = LOOK_EVERY_NS) -> str:
    for name in names:
        remove(scene, name)
    scene.now_ns += elapsed_ns
    return str(scene.run.lost(scene.now_ns) or "")


@pytest.mark.parametrize(
    ("names", "level", "words"),
    [
        ((), "", ()),
        *(((name,), "error", (TEXT[name], "RemoveIPC")) for name in VITAL),
        (("client.7",), "warning", ("client.7", "; next: restart the service when the robot may stop")),
        ((*VITAL, *SLOTS), "error", ("shared memory gate", "lifelines")),
    ],
)
def test_a_run_ends_for_names_that_it_needs_and_tells_of_all_once(
    scene: Scene, names: tuple[str, ...], level: str, words: tuple[str, ...]
) -> None:
    assert lost(scene, *names) == (f"{TEXT[names[0]]} was removed: restart the service" if level == "error" else "")
    assert lost(scene) == "", "once"
    told = scene.said()
    assert [of_it for _, of_it, _, _ in told] == [level] * bool(level)
    assert all(word in text for _, _, text, _ in told for word in words)


def test_a_name_that_somebody_else_has_taken_is_gone(scene: Scene) -> None:
    scene.os.mkfifo(remove(scene, "stop"))
    assert lost(scene) == "the stop pipe was removed: restart the service"


def test_a_run_looks_for_its_names_once_a_second(scene: Scene) -> None:
    assert lost(scene) == ""
    assert lost(scene, "stop", elapsed_ns=LOOK_EVERY_NS - 1) == ""
    assert lost(scene, elapsed_ns=1)


def test_the_next_program_finds_how_the_run_was_started_and_the_stop_of_its_board(scene: Scene) -> None:
    scene.run.publish("a stop")
    last = scene.load("failstop.files.instance").last("stage")
    assert (last.device, last.board, last.stop) == (DEVICE, "rrc", "a stop")


def test_a_new_port_of_the_board_is_saved_once_and_a_disk_that_refuses_ends_nothing(scene: Scene) -> None:
    last = scene.load("failstop.files.instance").last
    scene.run.follow_port("/dev/ttyACM1", "its device")
    assert (last("stage").device, last("stage").usb, last("stage").board) == ("/dev/ttyACM1", "its device", "rrc")
    scene.refuse("rename", OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))
    for _ in range(2):
        scene.run.follow_port("/dev/ttyACM2", "its device")
    scene.allow()
    assert last("stage").device == "/dev/ttyACM1"
    scene.run.events.flush()
    [event] = scene.events()
    assert event["text"].startswith(
        "the board's new port /dev/ttyACM2 could not be saved (No space left on device); next: restart the service"
    )
