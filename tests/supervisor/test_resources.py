"""What a run makes, with which rights, and that nothing of it is left."""

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
from failstop.shm import bell, claim, instance, layout, segment
from failstop.supervisor import resources as module
from failstop.supervisor.resources import Resources, client_gid

_numbers = itertools.count()


@pytest.fixture
def name() -> str:
    return f"r{os.getpid()}x{next(_numbers)}"


def close(made: Resources) -> None:
    made.remove()
    for fd in (made.stop_pipe, made.client_bell, made.published, *(found.fd for found in made.bells.values())):
        os.close(fd)
    for pair in made.controls.values():
        for fd in pair:
            os.close(fd)


@pytest.fixture
def made(name: str, tmp_path: Path) -> Iterator[Resources]:
    created = Resources(name, str(tmp_path))
    yield created
    close(created)


def left(name: str) -> list[str]:
    return [entry for entry in os.listdir("/dev/shm") if entry.startswith(f"failstop.{name}.")]


def mode(path: str) -> int:
    return stat.S_IMODE(os.stat(path).st_mode)


def test_every_segment_is_there_and_of_this_run(made: Resources) -> None:
    assert len(left(made.name)) == len(layout.SEGMENTS)
    for process in layout.PROCESSES:
        assert segment.attach(made.memory, process).incarnation == made.incarnation


def test_two_runs_differ(made: Resources, name: str, tmp_path: Path) -> None:
    other = Resources(f"{name}b", str(tmp_path))
    assert other.incarnation != made.incarnation
    close(other)


def test_everyone_may_ask_to_stop_and_nobody_else_may_take_a_request_away(made: Resources) -> None:
    """A pipe that others can read is one from which they can take stop requests before the port owner sees them."""
    path = instance.stop_path(made.runtime_dir)
    assert stat.S_ISFIFO(os.stat(path).st_mode)
    assert mode(path) == 0o622


def test_the_group_may_ring_and_nobody_else_may_take_a_ring_away(made: Resources) -> None:
    path = instance.bell_path(made.runtime_dir)
    assert stat.S_ISFIFO(os.stat(path).st_mode)
    assert mode(path) == 0o620


def test_only_the_group_may_claim(made: Resources) -> None:
    assert mode(instance.claims_path(made.runtime_dir)) == 0o660


def test_a_request_waits_in_the_pipe_while_nobody_reads_it(made: Resources) -> None:
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
    made = Resources(name, str(tmp_path))
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
    name: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, gid: int, user: int, groups: list[int], given: int
) -> None:
    """Root, and a member; anybody else's service has the clients of its own group."""
    found: list[int] = []
    monkeypatch.setattr(module, "client_gid", lambda: gid)
    monkeypatch.setattr(os, "geteuid", lambda: user)
    monkeypatch.setattr(os, "getgroups", lambda: groups)
    monkeypatch.setattr(Resources, "_refuse_living", lambda _: None)
    monkeypatch.setattr(Resources, "_make", lambda _, gid: found.append(gid))
    Resources(name, str(tmp_path))
    assert found == [given]


def test_a_group_that_does_not_exist_is_the_service_s_own(monkeypatch: pytest.MonkeyPatch) -> None:
    def missing(name: str) -> grp.struct_group:
        raise KeyError(name)

    monkeypatch.setattr(grp, "getgrnam", missing)
    assert client_gid() == -1


def test_what_a_dead_run_left_is_replaced(made: Resources, tmp_path: Path) -> None:
    fd = bell.open_pipe_to_write(instance.stop_path(made.runtime_dir))
    bell.send(fd, b"old\n")
    os.close(fd)
    for dead in made._segments:
        dead.close()
    again = Resources(made.name, str(tmp_path))
    assert segment.attach(again.memory, layout.GATE).incarnation == again.incarnation
    assert bell.take(again.stop_pipe) == b""
    close(again)


@pytest.mark.parametrize("row", PROCESSES, ids=lambda row: row.name)
def test_every_descriptor_that_a_process_is_to_get_is_there(made: Resources, row: Process) -> None:
    found = made.descriptors(row.name, 55)
    assert set(row.descriptors) <= set(found)
    assert found["port"] == 55
    assert found["bell"] == made.bells[row.name].fd


def test_no_descriptor_is_inherited_unless_it_is_passed_on(made: Resources) -> None:
    for row in PROCESSES:
        for key, fd in made.descriptors(row.name, -1).items():
            assert fd < 0 or not os.get_inheritable(fd), key


def test_both_ends_of_the_sockets_stay_with_the_supervisor(made: Resources) -> None:
    """A successor inherits the same end, with what was sent to its predecessor."""
    assert set(made.controls) == {layout.PORT_OWNER, layout.STOPPER}
    for process, (_, theirs) in made.controls.items():
        assert made.descriptors(process, -1)["control"] == theirs


def test_nothing_is_left(name: str, tmp_path: Path) -> None:
    made = Resources(name, str(tmp_path))
    close(made)
    assert left(name) == []
    assert list(tmp_path.iterdir()) == []
    made.remove()


def test_claims_of_clients_work_on_the_file(made: Resources) -> None:
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
        Resources(name, str(tmp_path))
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
            Resources(name, str(tmp_path))
    assert segment.dead_runs(name) == [before]
    made = Resources(name, str(tmp_path))
    assert set(made.left) == set(layout.PROCESSES)
    assert segment.dead_runs(name) == []
    for fd in made.left.values():
        os.close(fd)
    close(made)


def test_what_a_living_run_has_is_not_taken_from_it(made: Resources) -> None:
    """Whatever has become of the lock's file."""
    before = sorted(os.listdir(made.runtime_dir))
    with pytest.raises(instance.InstanceError, match="already running"):
        Resources(made.name, made.runtime_dir)
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
        Resources(name, str(tmp_path))
    assert left(name) == []


def test_whatever_others_find_by_its_name_is_watched(made: Resources) -> None:
    others = {"the stop pipe", "the bell of the clients", "the name of the run"}
    assert set(made.named) == {*others, *(f"shared memory {spec.name}" for spec in layout.SEGMENTS)}
    assert all(os.fstat(fd).st_nlink for fd in made.named.values())
