"""What a run makes, with which rights, that nothing of it is left, and what is told of a name that is taken away."""

from __future__ import annotations

import errno
import grp
import itertools
import os
import stat
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.policy.processes import PROCESSES, Process
from failstop.policy.settings import Settings
from failstop.procs.world import World
from failstop.shm import bell, claim, instance, layout, segment
from failstop.supervisor import run as module
from failstop.supervisor.events import Events
from failstop.supervisor.run import LOOK_EVERY_NS, Run, client_gid

_numbers = itertools.count()


@pytest.fixture
def name() -> str:
    return f"r{os.getpid()}x{next(_numbers)}"


def new(name: str, directory: Path | str) -> Run:
    """A run that can be found."""
    found = Run(World(), Settings(), name, str(directory))
    found.publish()
    return found


def close(made: Run) -> None:
    made.remove()
    for fd in (made.stop_pipe, made.client_bell, made.published, *(found.fd for found in made.bells.values())):
        os.close(fd)
    for pair in made.controls.values():
        for fd in pair:
            os.close(fd)


@pytest.fixture
def made(name: str, tmp_path: Path) -> Iterator[Run]:
    created = new(name, tmp_path)
    yield created
    close(created)


def left(name: str) -> list[str]:
    return [entry for entry in os.listdir("/dev/shm") if entry.startswith(f"failstop.{name}.")]


def mode(path: str) -> int:
    return stat.S_IMODE(os.stat(path).st_mode)


def test_every_segment_is_there_and_of_this_run(made: Run) -> None:
    assert len(left(made.name)) == len(layout.SEGMENTS)
    for process in layout.PROCESSES:
        assert segment.attach(made.memory, process).incarnation == made.incarnation


def test_two_runs_differ(made: Run, name: str, tmp_path: Path) -> None:
    other = new(f"{name}b", tmp_path)
    assert other.incarnation != made.incarnation
    close(other)


def test_everyone_may_ask_to_stop_and_nobody_else_may_take_a_request_away(made: Run) -> None:
    """A pipe that others can read is one from which they can take stop requests before the port owner sees them."""
    path = instance.stop_path(made.runtime_dir)
    assert stat.S_ISFIFO(os.stat(path).st_mode)
    assert mode(path) == 0o622


def test_the_group_may_ring_and_nobody_else_may_take_a_ring_away(made: Run) -> None:
    path = instance.bell_path(made.runtime_dir)
    assert stat.S_ISFIFO(os.stat(path).st_mode)
    assert mode(path) == 0o620


def test_only_the_group_may_claim(made: Run) -> None:
    assert mode(instance.claims_path(made.runtime_dir)) == 0o660


def test_a_request_waits_in_the_pipe_while_nobody_reads_it(made: Run) -> None:
    """As while the port owner is being restarted: the supervisor keeps the pipe open."""
    fd = bell.open_pipe_to_write(instance.stop_path(made.runtime_dir))
    assert bell.send(fd, b"stop\n")
    os.close(fd)
    assert bell.take(made.stop_pipe) == b"stop\n"
    assert bell.take(made.stop_pipe) == b"", "and no end of file when the client has gone"


def test_the_group_is_the_client_s_where_it_exists(name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    if os.geteuid() != 0:
        pytest.skip("needs root, to give files to any group")
    monkeypatch.setattr(module, "client_gid", lambda: 4321)
    made = new(name, tmp_path)
    try:
        for path in (instance.bell_path, instance.claims_path):
            assert os.stat(path(str(tmp_path))).st_gid == 4321
        assert os.stat(segment.path_of(made.memory, "client.0")).st_gid == 4321
        assert os.stat(segment.path_of(made.memory, layout.GATE)).st_gid == os.getegid(), "what clients only read stays"
    finally:
        close(made)


@pytest.mark.parametrize(
    ("gid", "user", "groups", "given"),
    [(0, 0, [], 0), (4321, 0, [], 4321), (4321, 7, [4321], 4321), (4321, 7, [4322], -1), (-1, 0, [], -1)],
)
def test_only_who_may_gives_files_to_the_group(
    monkeypatch: pytest.MonkeyPatch, gid: int, user: int, groups: list[int], given: int
) -> None:
    """Root, and a member; anybody else's service has the clients of its own group, and so where there is none."""

    def group(name: str) -> grp.struct_group:
        if gid < 0:
            raise KeyError(name)
        return grp.struct_group((name, "x", gid, []))

    monkeypatch.setattr(grp, "getgrnam", group)
    monkeypatch.setattr(os, "geteuid", lambda: user)
    monkeypatch.setattr(os, "getgroups", lambda: groups)
    assert client_gid() == given


def test_what_a_dead_run_left_is_replaced(made: Run, tmp_path: Path) -> None:
    fd = bell.open_pipe_to_write(instance.stop_path(made.runtime_dir))
    bell.send(fd, b"old\n")
    os.close(fd)
    for dead in made._segments:
        dead.close()
    again = new(made.name, tmp_path)
    assert segment.attach(again.memory, layout.GATE).incarnation == again.incarnation
    assert bell.take(again.stop_pipe) == b""
    close(again)


@pytest.mark.parametrize("row", PROCESSES, ids=lambda row: row.name)
def test_every_descriptor_that_a_process_is_to_get_is_there(made: Run, row: Process) -> None:
    found = made.descriptors(row.name, 55)
    assert set(row.descriptors) <= set(found)
    assert found["port"] == 55
    assert found["bell"] == made.bells[row.name].fd


def test_no_descriptor_is_inherited_unless_it_is_passed_on(made: Run) -> None:
    for row in PROCESSES:
        for key, fd in made.descriptors(row.name, -1).items():
            assert fd < 0 or not os.get_inheritable(fd), key


def test_both_ends_of_the_sockets_stay_with_the_supervisor(made: Run) -> None:
    """A successor inherits the same end, with what was sent to its predecessor."""
    assert set(made.controls) == {layout.PORT_OWNER, layout.STOPPER}
    for process, (_, theirs) in made.controls.items():
        assert made.descriptors(process, -1)["control"] == theirs


def test_nothing_is_left_but_how_it_was_started(name: str, tmp_path: Path) -> None:
    made = new(name, tmp_path)
    close(made)
    assert left(name) == []
    assert os.listdir(tmp_path) == ["last"], "how it was started"
    made.remove()


def test_claims_of_clients_work_on_the_file(made: Run) -> None:
    path = instance.claims_path(made.runtime_dir)
    client, service = claim.open_claims(path), os.open(path, os.O_RDONLY)
    assert claim.take(client, 3)
    assert claim.held(service, 3)
    os.close(client)
    assert not claim.held(service, 3)
    os.close(service)


def failing(at: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """No room from the segment of this number on; past the last one, none for the file that names the run."""
    made = iter(range(100))
    allocate = os.posix_fallocate

    def fallocate(fd: int, offset: int, size: int) -> None:
        if next(made) >= at:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
        allocate(fd, offset, size)

    def pipe(path: str, mode: int, gid: int = -1) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), path)

    monkeypatch.setattr(os, "posix_fallocate", fallocate)
    if at >= len(layout.SEGMENTS):
        monkeypatch.setattr(bell, "make_pipe", pipe)


@pytest.mark.parametrize("at", [0, 1, 7, len(layout.SEGMENTS)])
def test_a_start_that_fails_midway_leaves_nothing(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, at: int
) -> None:
    failing(at, monkeypatch)
    with pytest.raises((segment.AttachError, OSError), match=r"No space|no room"):
        new(name, tmp_path)
    assert left(name) == []
    assert list(tmp_path.iterdir()) == []


def test_nor_does_it_cost_the_black_box_of_the_run_before(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    before = segment.memory(name, 7)
    for spec in layout.SEGMENTS:
        segment.create(before, spec.name, 7).close()
    with monkeypatch.context() as patch:
        failing(3, patch)
        with pytest.raises(segment.AttachError, match="no room"):
            new(name, tmp_path)
    assert segment.dead_runs(name) == [before]
    made = new(name, tmp_path)
    assert set(made.left) == set(layout.PROCESSES)
    assert segment.dead_runs(name) == []
    for fd in made.left.values():
        os.close(fd)
    close(made)


def test_what_a_living_run_has_is_not_taken_from_it(made: Run) -> None:
    """Whatever has become of the lock's file."""
    before = sorted(os.listdir(made.runtime_dir))
    with pytest.raises(instance.InstanceError, match="already running"):
        new(made.name, made.runtime_dir)
    assert sorted(os.listdir(made.runtime_dir)) == before
    assert len(left(made.name)) == len(layout.SEGMENTS)


def test_a_segment_that_is_taken_away_during_the_start_is_named(
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    real = segment.open_all

    def but_the_gate_s(memory: str) -> dict[str, int]:
        found = real(memory)
        os.close(found.pop(layout.GATE))
        return found

    monkeypatch.setattr(segment, "open_all", but_the_gate_s)
    with pytest.raises(segment.AttachError, match=r"^shared memory gate was there and can't be opened: try again"):
        new(name, tmp_path)
    assert left(name) == []


def test_whatever_others_find_by_its_name_is_watched(made: Run) -> None:
    others = {"the stop pipe", "the bell of the clients", "the name of the run"}
    assert set(made.named) == {*others, *(f"shared memory {spec.name}" for spec in layout.SEGMENTS)}
    assert all(os.fstat(fd).st_nlink for fd in made.named.values())


ALL = (
    "shared memory gate",
    "shared memory lifelines",
    "shared memory client.0",
    "shared memory client.7",
    "the stop pipe",
)


class Told(Events):
    """What people were told."""

    def __init__(self) -> None:
        super().__init__(World(), "none")
        self.found: list[tuple[str, str]] = []

    def tell(self, kind: str, text: str, fields: object = None, *, level: str = "") -> None:
        self.found.append((level, text))


class Scene:
    """A run, for which files that can be taken away stand in for what it has made."""

    def __init__(self, made: Run, directory: Path) -> None:
        self.paths = {name: directory / name for name in ALL}
        self.named = {name: os.open(path, os.O_CREAT | os.O_RDWR) for name, path in self.paths.items()}
        self.run = made
        self.run.named = dict(self.named)
        self.run.events = self.told = Told()
        self.now_ns = 5 * LOOK_EVERY_NS

    def lost(self, *removed: str, elapsed_ns: int = LOOK_EVERY_NS) -> str:
        for name in removed:
            self.paths[name].unlink()
        self.now_ns += elapsed_ns
        return str(self.run.lost(self.now_ns) or "")


@pytest.fixture
def scene(made: Run, tmp_path: Path) -> Iterator[Scene]:
    found = Scene(made, tmp_path)
    yield found
    for fd in found.named.values():
        os.close(fd)


def test_nothing_is_lost(scene: Scene) -> None:
    assert scene.lost() == ""
    assert scene.told.found == []


@pytest.mark.parametrize("name", [name for name in ALL if "client" not in name])
def test_a_name_that_the_service_needs(scene: Scene, name: str) -> None:
    assert scene.lost(name) == f"{name} was removed: restart the service"
    ((level, text),) = scene.told.found
    assert level == "error"
    assert name in text
    assert "RemoveIPC" in text
    assert scene.lost() == "", "once"


def test_a_client_slot_is_told_of_once(scene: Scene) -> None:
    assert scene.lost("shared memory client.7") == ""
    assert scene.lost() == ""
    ((level, text),) = scene.told.found
    assert level == "warning"
    assert "client.7" in text


def test_all_at_once_is_one_remark(scene: Scene) -> None:
    assert scene.lost(*ALL) == "shared memory gate was removed: restart the service"
    ((_, text),) = scene.told.found
    assert "lifelines" in text


def test_a_name_that_somebody_else_has_taken_is_gone(scene: Scene) -> None:
    scene.paths["the stop pipe"].unlink()
    scene.paths["the stop pipe"].touch()
    assert scene.lost() == "the stop pipe was removed: restart the service"


def test_it_looks_once_a_second(scene: Scene) -> None:
    assert scene.lost() == ""
    assert scene.lost("the stop pipe", elapsed_ns=LOOK_EVERY_NS - 1) == ""
    assert scene.lost(elapsed_ns=1)
