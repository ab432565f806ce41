"""Instances: names, runtime directories that are nobody else's, and one service of each name."""

from __future__ import annotations

import errno
import itertools
import os
from types import SimpleNamespace
from typing import Any

import pytest

from failstop import instances
from failstop.files import instance, root
from failstop.files.instance import InstanceError
from failstop_lab.machine.process import Process

from .simulated import OTHER, USER, content, give, kill, living, mode, open_fds, put, refusing, user

MS = 1_000_000


GOOD = ("a", "failstop", "robot-2", "left_arm", "0", "a" * 32, "-", "_")
BAD = ("", "a" * 33, "A", "a b", "a/b", "..", ".", "a.b", "ä", "a\n", "a\0", "\u0661", "/", "a:b", "~", "$x")


def test_a_name_is_of_few_letters() -> None:
    assert [instance.check_name(name) for name in GOOD] == list(GOOD)
    for name, use in itertools.product(BAD, (instance.check_name, instance.find, instances.make_runtime_dir)):
        with pytest.raises(InstanceError) as refused:
            use(name)
        assert str(refused.value) == f"name {name!r}: use 1 to 32 of a-z, 0-9, _ and -"


def test_the_order_of_candidates(on: SimpleNamespace) -> None:
    environ, private = on.own.environ, f"/dev/shm/failstop-{USER}"
    with user(on, USER):
        environ |= {"XDG_RUNTIME_DIR": "/elsewhere", root.VARIABLE: "/srv/apart"}
        assert on.instance.bases() == ["/srv/apart/run/failstop", "/elsewhere/failstop", private]
        del environ[root.VARIABLE]
        assert on.instance.bases() == ["/run/failstop", "/elsewhere/failstop", private]
        for session in ({"XDG_RUNTIME_DIR": ""}, {}):
            environ.clear()
            environ.update(session)
            assert on.instance.bases() == ["/run/failstop", f"/run/user/{USER}/failstop", private]
    assert on.instance.bases() == ["/run/failstop", "/run/user/0/failstop"], "root's are nobody else's to take"


def block(on: Any, base: str) -> None:
    with user(on, 0):
        put(on, base, "in the way")


def test_the_first_that_can_be_written_is_taken(on: SimpleNamespace, bases: list[str]) -> None:
    for base in bases:
        path = on.instances.make_runtime_dir("robot")
        assert path == f"{base}/robot"
        assert on.os.path.isdir(path)
        on.os.rmdir(path)
        on.os.rmdir(base)
        block(on, base)
    with pytest.raises(on.instance.InstanceError) as refused:
        on.instances.make_runtime_dir("robot")
    for part in ("'robot'", *bases, "none can be written: set XDG_RUNTIME_DIR to a directory that is yours alone"):
        assert part in str(refused.value)


def test_a_runtime_dir_is_taken_over(on: SimpleNamespace, bases: list[str]) -> None:
    path = on.instances.make_runtime_dir("robot")
    put(on, f"{path}/left", "by a dead run")
    assert on.instances.make_runtime_dir("robot") == path
    assert on.os.path.exists(f"{path}/left")


@pytest.mark.parametrize(("taken", "rights"), [(0, 0o755), (1, 0o755), (2, 0o700)])
def test_the_shared_place_alone_is_private(on: SimpleNamespace, bases: list[str], taken: int, rights: int) -> None:
    """So that every local user can reach the stop pipe."""
    for base in bases[:taken]:
        block(on, base)
    for mask in (0o000, 0o022, 0o077, 0o777):
        on.own.umask = mask
        path = on.instances.make_runtime_dir("robot")
        assert on.own.umask == mask
        assert (path, mode(on, path), mode(on, bases[taken])) == (f"{bases[taken]}/robot", rights, rights)
        assert on.os.stat(path).st_uid == on.os.stat(bases[taken]).st_uid == USER
        assert on.instances.make_runtime_dir("robot") == path
        for made in (path, bases[taken]):
            on.os.rmdir(made)


def test_a_full_disk_is_told_and_not_passed_over(on: SimpleNamespace, bases: list[str]) -> None:
    """Clients look in the first place, and would find nobody."""
    with refusing(on, "mkdir", errno.ENOSPC), pytest.raises(on.instance.InstanceError) as refused:
        on.instances.make_runtime_dir("robot")
    assert str(refused.value).endswith(f"; {bases[0]}/robot: No space left on device")


@pytest.mark.parametrize("second", ["everyone's", "full"])
def test_every_place_that_is_no_good_is_told_of(on: SimpleNamespace, bases: list[str], second: str) -> None:
    block(on, bases[2])
    for base in bases[: 1 if second == "full" else 2]:
        on.os.mkdir(base)
        on.os.chmod(base, 0o777)
    expected = f"{bases[1]}/robot: No space left" if second == "full" else f"{bases[1]} may be written by others"
    with (
        refusing(on, "mkdir", errno.ENOSPC, of=bases[1] if second == "full" else ""),
        pytest.raises(on.instance.InstanceError, match=rf"; {bases[0]} may be written by others .*; {expected} "),
    ):
        on.instances.make_runtime_dir("robot")


@pytest.mark.parametrize("part", ["base", "instance"])
@pytest.mark.parametrize("trap", ["other user's", "link to other user's", "link to own", "file", "dangling link"])
def test_a_trap_in_the_shared_place_is_refused(on: SimpleNamespace, bases: list[str], part: str, trap: str) -> None:
    """It is everyone's: what is there already may have been put there to be trusted."""
    for base in bases[:2]:
        block(on, base)
    place = bases[2]
    if part == "instance":
        on.os.mkdir(place, 0o700)
        place = f"{place}/robot"
    owner = USER if trap == "link to own" else OTHER
    with user(on, 0):
        for made in ("/tmp/target", *([place] if trap == "other user's" else [])):
            on.os.mkdir(made)
            on.os.chmod(made, 0o777)
            on.os.chown(made, owner, owner)
        if trap == "file":
            put(on, place)
        elif trap != "other user's":
            on.os.symlink("/tmp/nowhere" if trap == "dangling link" else "/tmp/target", place)
    with pytest.raises(on.instance.InstanceError, match=r"^no runtime directory for 'robot'") as refused:
        on.instances.make_runtime_dir("robot")
    assert bases[2] in str(refused.value)
    told = f"; {place} belongs to uid {OTHER}: not trusted; remove it, or run as that user"
    assert str(refused.value).endswith(told) is (trap == "other user's")
    assert "\n" not in str(refused.value)
    assert on.os.listdir("/tmp/target") == []


def holder(on: Any, path: str) -> Process:

    def work() -> None:
        on.instances.lock(path)
        on.bell.make_pipe(on.instance.stop_path(path), 0o622)
        on.bell.open_pipe(on.instance.stop_path(path))

    return living(on, work)


def pid_told(on: Any, path: str) -> str:
    return content(on, on.instance.lock_path(path)).decode()


def test_a_second_service_is_refused_with_the_first_one_s_pid(on: SimpleNamespace, bases: list[str]) -> None:
    path = on.instances.make_runtime_dir("robot")
    assert not on.instances.running(path)
    first, before = holder(on, path), open_fds(on)
    assert on.instances.running(path)
    for _ in range(3):
        with pytest.raises(on.instance.InstanceError) as refused:
            on.instances.lock(path)
        assert f"'robot' is already running (pid {first.pid})" in str(refused.value)
        assert "--name" in str(refused.value)
    assert on.instance.find("robot") == path
    assert open_fds(on) == before
    assert pid_told(on, path) == f"{first.pid}\n"
    for junk in (b"", b"\xff\xfe\0", b"x" * 5000):
        put(on, on.instance.lock_path(path), junk)
        with pytest.raises(on.instance.InstanceError, match="is already running"):
            on.instances.lock(path)
    kill(on, first)
    assert not on.instances.running(path)
    with pytest.raises(on.instance.NoService):
        on.instance.find("robot")
    put(on, on.instance.lock_path(path), "99999999999\n")
    on.instances.lock(path)
    assert pid_told(on, path) == f"{on.own.pid}\n", "no digits are left of a longer one"


@pytest.mark.parametrize("lets_go", [True, False])
def test_a_lock_of_a_dead_owner_is_waited_for_a_while(on: SimpleNamespace, bases: list[str], lets_go: bool) -> None:
    """A supervisor that dies while it starts a process, which has its lock too: that one lets go at its exec."""
    path, machine = on.instances.make_runtime_dir("robot"), on.machine
    dead = holder(on, path)
    copy = living(on, lambda: None)
    (lock,) = (opened for opened in dead.files.values() if opened.node.locks)
    copy.descriptor(lock)
    kill(on, dead)
    assert on.instances.holder(path) == "", "no living process's"
    on.instances.refuse_locked("robot")
    began_ns = machine.now_ns
    if lets_go:
        machine.at(began_ns + 100 * MS, lambda: machine.die(copy, -9))
        on.instances.lock(path)
        assert 100 * MS < machine.now_ns - began_ns < 105 * MS
        assert pid_told(on, path) == f"{on.own.pid}\n"
    else:
        with pytest.raises(on.instance.InstanceError, match="is already running"):
            on.instances.lock(path)
        assert 500 * MS < machine.now_ns - began_ns < 505 * MS


def test_a_living_holder_is_refused_by_its_pid_in_whatever_place(on: SimpleNamespace, bases: list[str]) -> None:
    on.instances.refuse_locked("robot")
    for base in bases:
        path = f"{base}/robot"
        on.os.makedirs(path)
        give(on, path)
        assert on.instances.holder(path) == ""
        first = holder(on, path)
        assert on.instances.holder(path) == str(first.pid)
        with pytest.raises(on.instance.InstanceError, match=rf"'robot' is already running \(pid {first.pid}\)"):
            on.instances.refuse_locked("robot")
        kill(on, first)
        assert on.instances.holder(path) == ""
        on.instances.refuse_locked("robot")


def test_who_listens_in_another_directory_is_refused(on: SimpleNamespace, bases: list[str]) -> None:
    on.instances.refuse_listening("robot")
    path = f"{bases[1]}/robot"
    on.os.makedirs(path)
    give(on, path)
    first = holder(on, path)
    on.instances.refuse_listening("robot", but=path)
    for but in ("", f"{bases[0]}/robot"):
        with pytest.raises(on.instance.InstanceError, match="'robot' is already running"):
            on.instances.refuse_listening("robot", but)
    on.os.chmod(path, 0o777)
    on.instances.refuse_listening("robot")  # what is not believed does not listen
    on.os.chmod(path, 0o755)
    kill(on, first)
    on.instances.refuse_listening("robot")


def test_all_that_listen_are_found_by_name(on: SimpleNamespace, bases: list[str]) -> None:
    assert on.instances.listening() == []
    for base, name in ((bases[2], "alpha"), (bases[1], "robot"), (bases[1], "silent"), (bases[1], "No name")):
        on.os.makedirs(f"{base}/{name}")
        give(on, f"{base}/{name}")
    both = [holder(on, path) for path in (f"{bases[1]}/robot", f"{bases[2]}/alpha")]
    assert on.instances.listening() == ["alpha", "robot"]
    assert [on.instances.listens(name) for name in ("robot", "silent", "No name", "absent")] == [True, *[False] * 3]
    for each in both:
        kill(on, each)
    assert on.instances.listening() == []


def test_a_command_names_every_instance_but_the_default_one() -> None:
    assert instance.option("failstop") == ""
    assert instance.option("robot") == " --name robot"


def test_every_instance_but_the_default_one_has_a_unit_of_its_name() -> None:
    assert instances.unit_of("failstop") == "failstop.service"
    assert instances.unit_of("left") == "failstop@left.service"


def test_a_lock_that_can_not_be_made_or_written_is_told(on: SimpleNamespace, bases: list[str]) -> None:
    path = f"{bases[0]}/robot"
    with pytest.raises(on.instance.InstanceError, match=rf"{path}/lock can't be made: No such file or directory"):
        on.instances.lock(path)
    assert on.instances.make_runtime_dir("robot") == path
    before = open_fds(on)
    for call in ("pwrite", "ftruncate"):
        with (
            refusing(on, call, errno.EFBIG),
            pytest.raises(on.instance.InstanceError, match=rf"^the lock {path}/lock can't be written: File too large$"),
        ):
            on.instances.lock(path)
        assert open_fds(on) == before


def test_a_lock_is_its_directory_s_alone_and_crosses_no_exec(on: SimpleNamespace, bases: list[str]) -> None:
    paths = [on.instances.make_runtime_dir(name) for name in ("one", "two")]
    fds = [on.instances.lock(path) for path in paths]
    assert len(set(fds)) == 2
    assert [mode(on, on.instance.lock_path(path)) for path in paths] == [0o600] * 2
    assert on.instances.holder(paths[0]) == str(on.own.pid)
    assert not on.own.inheritable & set(fds)


def test_find_looks_everywhere_for_the_one_that_runs(on: SimpleNamespace, bases: list[str]) -> None:
    for base in bases:
        on.os.makedirs(f"{base}/robot")
        give(on, f"{base}/robot")
        put(on, f"{base}/robot/lock", "123\n")
    with pytest.raises(
        on.instance.NoService, match=r"no service named 'robot' is running: start it with `failstop run --name robot`"
    ):
        on.instance.find("robot")
    for base in reversed(bases):
        first = holder(on, f"{base}/robot")
        assert on.instance.find("robot") == f"{base}/robot"
        kill(on, first)


@pytest.mark.parametrize("number", [errno.EMFILE, errno.ENFILE])
def test_a_program_without_descriptors_does_not_say_that_no_service_runs(
    on: SimpleNamespace, bases: list[str], number: int
) -> None:
    path = on.instances.make_runtime_dir("robot")
    on.instance.publish_run(path, 7)
    holder(on, path)
    why = os.strerror(number)
    with refusing(on, "open", number):
        with pytest.raises(on.instance.InstanceError, match=rf"^{path}/stop can't be opened: {why}$"):
            on.instance.find("robot")
        with pytest.raises(on.instance.InstanceError, match=rf"^{path}/run can't be opened: {why}$"):
            on.instance.current_run(path)
    with refusing(on, "open", errno.EIO):
        with pytest.raises(on.instance.NoService):
            on.instance.find("robot")
        with pytest.raises(on.instance.NoService):
            on.instance.current_run(path)


def test_everyone_can_find_a_service_of_root_s_that_everyone_may_stop(on: SimpleNamespace) -> None:
    on.own.umask = 0o077
    path = on.instances.make_runtime_dir("robot")
    holder(on, path)
    with user(on, OTHER):
        assert on.instance.find("robot") == path


def test_root_takes_over_no_directory_of_another_user(on: SimpleNamespace) -> None:
    path = on.instances.make_runtime_dir("robot")
    for each in (path, os.path.dirname(path)):
        on.os.chown(each, OTHER, OTHER)
    before = open_fds(on)
    with pytest.raises(
        on.instance.InstanceError,
        match=rf"; {path} belongs to uid {OTHER}: start it as that user.*choose another --name",
    ):
        on.instances.make_runtime_dir("robot")
    assert open_fds(on) == before
