"""Instances: names, runtime directories that are nobody else's, and one service of each name."""

from __future__ import annotations

import contextlib
import errno
import os
import resource
import signal
import stat
import time
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop import instances
from failstop.shm import bell, instance, root
from failstop.shm.instance import InstanceError, NoService
from failstop.shm.lifeline import Lifeline
from failstop.shm.place import Untrusted
from tests.support.children import NOBODY, Child, call, needs_root, reachable, umask

Send = Callable[[object], None]
Wait = Callable[[], None]
STRANGER = 61_000 + os.getpid() % 4000
"""A user that no one is, and of this process alone, so that its directories are this test's."""


@pytest.fixture
def bases(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> list[str]:
    """Three candidate directories of this test, none of them made yet."""
    places = [str(tmp_path / place) for place in ("run", "session", "private")]
    monkeypatch.setattr(instance, "bases", lambda: list(places))
    return places


@pytest.fixture
def private() -> Iterator[str]:
    """The stranger's directory in /dev/shm; whatever a test puts there is removed."""
    path = f"/dev/shm/failstop-{STRANGER}"
    _remove(path)
    yield path
    _remove(path)


def _remove(path: str) -> None:
    if os.path.islink(path) or os.path.isfile(path):
        os.unlink(path)
        return
    for base, directories, files in os.walk(path, topdown=False):
        for entry in directories + files:
            whole = os.path.join(base, entry)
            os.unlink(whole) if os.path.islink(whole) or entry in files else os.rmdir(whole)
    with contextlib.suppress(FileNotFoundError):
        os.rmdir(path)


@pytest.mark.parametrize("name", ["a", "failstop", "robot-2", "left_arm", "0", "a" * 32, "-", "_"])
def test_good_names(name: str) -> None:
    assert instance.check_name(name) == name


@pytest.mark.parametrize(
    "name", ["", "a" * 33, "A", "a b", "a/b", "..", ".", "a.b", "ä", "a\n", "a\0", "\u0661", "/", "a:b", "~", "$x"]
)
def test_bad_names(name: str) -> None:
    for use in (instance.check_name, instance.find, instances.make_runtime_dir):
        with pytest.raises(InstanceError) as refused:
            use(name)
        assert str(refused.value) == f"name {name!r}: use 1 to 32 of a-z, 0-9, _ and -"


@given(st.text(max_size=40))
def test_a_good_name_is_one_plain_path_component(name: str) -> None:
    try:
        instance.check_name(name)
    except InstanceError:
        return
    assert name == os.path.basename(name)
    assert name.isascii()
    assert name.strip(".")


def test_the_order_of_candidates(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(os, "getuid", lambda: 77)
    private = "/dev/shm/failstop-77"
    monkeypatch.setenv("XDG_RUNTIME_DIR", "/elsewhere")
    monkeypatch.setenv(root.VARIABLE, "/srv/apart")
    assert instance.bases() == ["/srv/apart/run/failstop", "/elsewhere/failstop", private]
    monkeypatch.delenv(root.VARIABLE)
    assert instance.bases() == ["/run/failstop", "/elsewhere/failstop", private]
    monkeypatch.setenv("XDG_RUNTIME_DIR", "")
    assert instance.bases() == ["/run/failstop", "/run/user/77/failstop", private]
    monkeypatch.delenv("XDG_RUNTIME_DIR")
    assert instance.bases() == ["/run/failstop", "/run/user/77/failstop", private]


def test_root_has_no_place_that_others_could_take(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv(root.VARIABLE, raising=False)
    monkeypatch.setattr(os, "getuid", lambda: 0)
    monkeypatch.delenv("XDG_RUNTIME_DIR", raising=False)
    assert instance.bases() == ["/run/failstop", "/run/user/0/failstop"]


def test_the_first_that_can_be_written_is_taken(bases: list[str]) -> None:
    for base in bases:
        path = instances.make_runtime_dir("robot")
        assert path == os.path.join(base, "robot")
        assert os.path.isdir(path)
        os.rmdir(path)
        os.rmdir(base)
        Path(base).write_text("in the way")


def test_when_none_can_be_written(bases: list[str]) -> None:
    for base in bases:
        Path(base).write_text("in the way")
    with pytest.raises(InstanceError) as refused:
        instances.make_runtime_dir("robot")
    for part in ("'robot'", *bases):
        assert part in str(refused.value)


def test_a_runtime_dir_is_taken_over(bases: list[str]) -> None:
    path = instances.make_runtime_dir("robot")
    Path(path, "left").write_text("by a dead run")
    assert instances.make_runtime_dir("robot") == path
    assert Path(path, "left").exists()


@pytest.mark.parametrize("mask", [0o000, 0o022, 0o077, 0o777])
def test_the_shared_place_is_private_under_any_umask(private: str, monkeypatch: pytest.MonkeyPatch, mask: int) -> None:
    monkeypatch.setattr(instance, "bases", lambda: [private])
    with umask(mask):
        path = instances.make_runtime_dir("robot")
        assert os.umask(mask) == mask
    assert stat.S_IMODE(os.stat(path).st_mode) == 0o700
    assert stat.S_IMODE(os.stat(private).st_mode) == 0o700


def test_a_full_disk_is_told_and_not_passed_over(bases: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    """Clients look in the first place, and would find nobody."""

    def mkdir(path: str, mode: int = 0o777, *, dir_fd: int | None = None) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), path)

    os.mkdir(bases[0])
    monkeypatch.setattr(os, "mkdir", mkdir)
    with pytest.raises(InstanceError) as refused:
        instances.make_runtime_dir("robot")
    assert f"{bases[0]}/robot: No space left on device" in str(refused.value)


@pytest.mark.parametrize("second", ["everyone's", "full"])
def test_every_place_that_is_no_good_is_told_of(bases: list[str], monkeypatch: pytest.MonkeyPatch, second: str) -> None:
    """To a user: root has the first alone."""
    monkeypatch.setattr(os, "geteuid", lambda: os.getuid() or STRANGER)
    Path(bases[2]).write_text("in the way")
    os.mkdir(bases[0])
    os.chmod(bases[0], 0o777)
    real = os.mkdir

    def mkdir(path: str, mode: int = 0o777, *, dir_fd: int | None = None) -> None:
        if path == bases[1]:
            raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), path)
        real(path, mode, dir_fd=dir_fd)

    if second == "full":
        monkeypatch.setattr(os, "mkdir", mkdir)
        expected = rf"{bases[1]}/robot: No space left on device$"
    else:
        os.mkdir(bases[1])
        os.chmod(bases[1], 0o777)
        expected = rf"{bases[1]} may be written by others .*$"
    with pytest.raises(InstanceError, match=rf"; {bases[0]} may be written by others .*; {expected}"):
        instances.make_runtime_dir("robot")


@pytest.mark.parametrize("mask", [0o000, 0o077])
def test_other_directories_let_everyone_in_to_read(monkeypatch: pytest.MonkeyPatch, mask: int) -> None:
    """So that every local user can reach the stop pipe."""
    base = f"/var/tmp/failstop-test-{os.getpid()}"
    monkeypatch.setattr(instance, "bases", lambda: [base])
    try:
        with umask(mask):
            path = instances.make_runtime_dir("robot")
        assert stat.S_IMODE(os.stat(path).st_mode) == 0o755
        assert stat.S_IMODE(os.stat(base).st_mode) == 0o755
    finally:
        _remove(base)


def made_as_stranger(name: str = "robot") -> str:
    """What a user without a session or rights gets: its directory, or the refusal."""

    def attempt() -> str:
        os.environ.pop("XDG_RUNTIME_DIR", None)
        try:
            return instances.make_runtime_dir(name)
        except InstanceError as error:
            return f"refused: {error}"

    answer: str = call(attempt, STRANGER)
    return answer


@needs_root
def test_a_user_s_own_directory_in_the_shared_place(private: str) -> None:
    assert made_as_stranger() == f"{private}/robot"
    for path in (private, f"{private}/robot"):
        found = os.lstat(path)
        assert (found.st_uid, stat.S_IMODE(found.st_mode)) == (STRANGER, 0o700)
    assert made_as_stranger() == f"{private}/robot"


@needs_root
@pytest.mark.parametrize("part", ["base", "instance"])
@pytest.mark.parametrize("trap", ["other user's", "link to other user's", "link to own", "file", "dangling link"])
def test_a_trap_in_the_shared_place_is_refused(private: str, tmp_path: Path, part: str, trap: str) -> None:
    """It is everyone's: what is there already may have been put there to be trusted."""
    target = tmp_path / "target"
    target.mkdir()
    reachable(tmp_path)
    if trap == "link to own":
        os.chown(target, STRANGER, STRANGER)
    else:
        os.chown(target, NOBODY, NOBODY)
        target.chmod(0o777)
    place = private
    if part == "instance":
        os.mkdir(private, 0o700)
        os.chown(private, STRANGER, STRANGER)
        place = f"{private}/robot"
    if trap == "other user's":
        os.mkdir(place)
        os.chown(place, NOBODY, NOBODY)
        os.chmod(place, 0o777)
    elif trap == "file":
        Path(place).write_text("")
    else:
        os.symlink(tmp_path / "nowhere" if trap == "dangling link" else target, place)
    answer = made_as_stranger()
    assert answer.startswith("refused: no runtime directory for 'robot'")
    assert private in answer
    assert "\n" not in answer
    assert list(target.iterdir()) == []


def holder(path: str) -> Child:
    """A process that is the service of this directory."""

    def work(send: Send, wait: Wait) -> None:
        instances.lock(path)
        bell.make_pipe(instance.stop_path(path), 0o622)
        bell.open_pipe(instance.stop_path(path))
        send(os.getpid())
        wait()

    child = Child(work)
    assert child.receive() == child.pid
    return child


def test_a_second_service_is_refused_with_the_first_one_s_pid(bases: list[str]) -> None:
    path = instances.make_runtime_dir("robot")
    assert not instances.running(path)
    with holder(path) as first:
        assert instances.running(path)
        for _ in range(3):
            with pytest.raises(InstanceError) as refused:
                instances.lock(path)
            assert f"'robot' is already running (pid {first.pid})" in str(refused.value)
            assert "--name" in str(refused.value)
        assert instance.find("robot") == path
        first.go()
        first.wait()
    assert not instances.running(path)


def test_a_refused_one_leaves_nothing_open_and_the_pid_alone(bases: list[str]) -> None:
    path = instances.make_runtime_dir("robot")
    with holder(path) as first:
        before = len(os.listdir("/proc/self/fd"))
        for _ in range(10):
            with pytest.raises(InstanceError):
                instances.lock(path)
            instances.running(path)
        assert len(os.listdir("/proc/self/fd")) == before
        assert Path(instance.lock_path(path)).read_text() == f"{first.pid}\n"


def test_sigkill_of_the_holder_frees_the_name(bases: list[str], fds: list[int]) -> None:
    path = instances.make_runtime_dir("robot")
    for _ in range(10):
        with holder(path) as first:
            first.kill()
        assert not instances.running(path)
        with pytest.raises(NoService):
            instance.find("robot")
    fds.append(instances.lock(path))
    assert Path(instance.lock_path(path)).read_text() == f"{os.getpid()}\n"


def test_a_longer_pid_before_leaves_no_digits(bases: list[str], fds: list[int]) -> None:
    path = instances.make_runtime_dir("robot")
    Path(instance.lock_path(path)).write_text("99999999999\n")
    fds.append(instances.lock(path))
    assert Path(instance.lock_path(path)).read_text() == f"{os.getpid()}\n"


@pytest.mark.parametrize("junk", [b"", b"\xff\xfe\0", b"x" * 5000])
def test_junk_in_the_lock_file_is_no_crash(bases: list[str], junk: bytes) -> None:
    path = instances.make_runtime_dir("robot")
    with holder(path):
        Path(instance.lock_path(path)).write_bytes(junk)
        with pytest.raises(InstanceError, match="is already running"):
            instances.lock(path)


def test_of_two_that_start_at_once_one_runs(bases: list[str]) -> None:
    path = instances.make_runtime_dir("robot")

    def work(send: Send, wait: Wait) -> None:
        for _ in range(100):
            wait()
            try:
                fd = instances.lock(path)
                send("runs")
            except InstanceError:
                fd = -1
                send("refused")
            wait()
            if fd >= 0:
                os.close(fd)
            send("gone")

    with Child(work) as one, Child(work) as two:
        for _ in range(100):
            one.go()
            two.go()
            assert sorted([one.receive(), two.receive()]) == ["refused", "runs"]
            for racer in (one, two):
                racer.go()
                assert racer.receive() == "gone"


@contextlib.contextmanager
def died_with_a_copy(path: str) -> Iterator[Lifeline]:
    """The service has died, and a copy of it, which has exec'd nothing, still has its lock."""

    def work(send: Send, wait: Wait) -> None:
        instances.lock(path)
        copy = os.fork()
        if not copy:
            signal.alarm(60)
            signal.pause()
        send(copy)
        wait()

    with Child(work) as dead:
        copy = Lifeline(dead.receive())
    try:
        yield copy
    finally:
        copy.kill()
        copy.close()


def test_a_lock_whose_owner_has_died_is_waited_for(
    bases: list[str], fds: list[int], monkeypatch: pytest.MonkeyPatch
) -> None:
    """A supervisor that dies while it starts a process: that one lets go at its exec."""
    path = instances.make_runtime_dir("robot")
    with died_with_a_copy(path) as copy:
        assert instances.holder(path) == "", "no living process's"
        instances.refuse_locked("robot")
        monkeypatch.setattr(instances, "LETTING_GO_S", 60)
        slept_s: list[float] = []
        monkeypatch.setattr(time, "sleep", lambda seconds: (slept_s.append(seconds), copy.kill()))
        fds.append(instances.lock(path))
        assert max(slept_s) < 0.1, "a start does not wait long for it"
    assert Path(instance.lock_path(path)).read_text() == f"{os.getpid()}\n"


def test_it_is_not_waited_for_without_end(bases: list[str], monkeypatch: pytest.MonkeyPatch) -> None:
    path = instances.make_runtime_dir("robot")
    monkeypatch.setattr(instances, "LETTING_GO_S", 0.01)
    with died_with_a_copy(path), pytest.raises(InstanceError, match="is already running"):
        instances.lock(path)


def test_a_living_holder_is_refused_by_its_pid_in_whatever_place(bases: list[str]) -> None:
    instances.refuse_locked("robot")
    for base in bases:
        path = os.path.join(base, "robot")
        os.makedirs(path)
        assert instances.holder(path) == ""
        with holder(path) as first:
            assert instances.holder(path) == str(first.pid)
            with pytest.raises(InstanceError, match=rf"'robot' is already running \(pid {first.pid}\)"):
                instances.refuse_locked("robot")
        assert instances.holder(path) == ""
        instances.refuse_locked("robot")


def test_who_listens_in_another_directory_is_refused(bases: list[str]) -> None:
    instances.refuse_listening("robot")
    path = os.path.join(bases[1], "robot")
    os.makedirs(path)
    with holder(path):
        instances.refuse_listening("robot", but=path)
        for but in ("", os.path.join(bases[0], "robot")):
            with pytest.raises(InstanceError, match="'robot' is already running"):
                instances.refuse_listening("robot", but)
    instances.refuse_listening("robot")


@needs_root
def test_what_is_not_believed_does_not_listen(bases: list[str]) -> None:
    path = os.path.join(bases[1], "robot")
    os.makedirs(path)
    with holder(path):
        os.chmod(path, 0o777)
        instances.refuse_listening("robot")


def test_all_that_listen_are_found_by_name(bases: list[str]) -> None:
    assert instances.listening() == []
    for base, name in ((bases[2], "alpha"), (bases[1], "robot"), (bases[1], "silent"), (bases[1], "No name")):
        os.makedirs(os.path.join(base, name))
    with holder(os.path.join(bases[1], "robot")), holder(os.path.join(bases[2], "alpha")):
        assert instances.listening() == ["alpha", "robot"]
        assert [instances.listens(name) for name in ("robot", "silent", "No name", "absent")] == [True, *[False] * 3]
    assert instances.listening() == []


def test_a_command_names_every_instance_but_the_default_one() -> None:
    assert instance.option("failstop") == ""
    assert instance.option("robot") == " --name robot"


def test_a_lock_that_can_not_be_made_or_written_is_told_and_nothing_stays_open(bases: list[str]) -> None:
    path = os.path.join(bases[0], "robot")
    with pytest.raises(InstanceError, match=rf"the lock {path}/lock can't be made: No such file or directory"):
        instances.lock(path)
    os.makedirs(path)

    def attempt() -> tuple[str, int]:
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
        before = len(os.listdir("/proc/self/fd"))
        with pytest.raises(InstanceError) as refused:
            instances.lock(path)
        return str(refused.value), len(os.listdir("/proc/self/fd")) - before

    assert call(attempt) == (f"the lock {path}/lock can't be written: File too large", 0)


def test_instances_do_not_lock_each_other(bases: list[str], fds: list[int]) -> None:
    fds.append(instances.lock(instances.make_runtime_dir("one")))
    fds.append(instances.lock(instances.make_runtime_dir("two")))
    assert len(fds) == 2


@needs_root
def test_a_stranger_cannot_open_the_lock(bases: list[str], fds: list[int]) -> None:
    fds.append(instances.lock(path := instances.make_runtime_dir("robot")))
    assert stat.S_IMODE(os.stat(instance.lock_path(path)).st_mode) == 0o600


def test_the_lock_does_not_cross_an_exec(bases: list[str], fds: list[int]) -> None:
    fds.append(fd := instances.lock(path := instances.make_runtime_dir("robot")))
    assert instances.holder(path) == str(os.getpid())
    assert not os.get_inheritable(fd)


def test_find_looks_everywhere_for_the_one_that_runs(bases: list[str]) -> None:
    for base in bases:
        os.makedirs(os.path.join(base, "robot"))
        Path(base, "robot", "lock").write_text("123\n")
    with pytest.raises(
        NoService, match=r"no service named 'robot' is running: start it with `failstop run --name robot`"
    ):
        instance.find("robot")
    for base in reversed(bases):
        with holder(os.path.join(base, "robot")):
            assert instance.find("robot") == os.path.join(base, "robot")


@needs_root
def test_everyone_can_find_a_service_that_everyone_may_stop(monkeypatch: pytest.MonkeyPatch) -> None:
    base = f"/var/tmp/failstop-test-{os.getpid()}"
    monkeypatch.setattr(instance, "bases", lambda: [base])
    try:
        with umask(0o077):
            path = instances.make_runtime_dir("robot")
            with holder(path):
                assert call(lambda: instance.find("robot"), NOBODY) == path
    finally:
        _remove(base)


def test_paths_lie_in_the_runtime_dir_and_differ() -> None:
    each = (instance.lock_path, instance.claims_path, instance.stop_path, instance.bell_path, instance.run_path)
    paths = [path("/run/x") for path in each]
    assert len(set(paths)) == len(each)
    assert all(os.path.dirname(path) == "/run/x" for path in paths)


def test_a_file_of_a_runtime_dir_is_reached_by_its_own_name_there() -> None:
    assert [instance._file(name)("/run/x") for name in ("lock", "other")] == ["/run/x/lock", "/run/x/other"]


def test_the_run_that_is_published_is_the_one_that_is_read(bases: list[str], fds: list[int]) -> None:
    path = instances.make_runtime_dir("robot")
    with pytest.raises(NoService):
        instance.run(path)
    for incarnation in (7, 2**64 - 1, 0):
        fds.append(fd := instance.publish(path, incarnation))
        assert instance.run(path) == (incarnation, os.geteuid())
        assert os.fstat(fd).st_nlink == 1
        assert stat.S_IMODE(os.fstat(fd).st_mode) == 0o644
    assert os.fstat(fds[0]).st_nlink == 0
    instance.clear(path)
    assert os.listdir(path) == []


def test_a_run_that_can_not_be_published_leaves_nothing_open_and_the_one_before(
    bases: list[str], fds: list[int]
) -> None:
    path = instances.make_runtime_dir("robot")
    fds.append(instance.publish(path, 7))

    def attempt() -> int:
        resource.setrlimit(resource.RLIMIT_FSIZE, (0, 0))
        before = len(os.listdir("/proc/self/fd"))
        with pytest.raises(OSError, match="File too large"):
            instance.publish(path, 8)
        return len(os.listdir("/proc/self/fd")) - before

    assert call(attempt) == 0
    assert instance.run(path) == (7, os.geteuid())
    os.unlink(f"{instance.run_path(path)}.new")
    os.symlink(bases[0], f"{instance.run_path(path)}.new")
    before = os.listdir("/proc/self/fd")
    with pytest.raises(Untrusted, match="is a link"):
        instance.publish(path, 8)
    assert os.listdir("/proc/self/fd") == before


def test_what_a_run_has_left_is_cleared_but_for_the_lock(bases: list[str], fds: list[int]) -> None:
    path = instances.make_runtime_dir("robot")
    each = (instance.lock_path, instance.claims_path, instance.stop_path, instance.bell_path, instance.run_path)
    for place in each:
        Path(place(path)).write_text("")
    for place in (instance.run_path, instance.last_path):
        Path(f"{place(path)}.new").write_text("")
    Path(path, "kept").write_text("somebody else's")
    before = len(os.listdir("/proc/self/fd"))
    for _ in range(2):
        instance.clear(path)
        assert sorted(os.listdir(path)) == ["kept", "lock"]
    instance.clear(f"{path}-absent")
    assert len(os.listdir("/proc/self/fd")) == before


def remembered(name: str) -> tuple[str, str, tuple[int, ...]]:
    """How the last run of this name was started."""
    found = instance.last(name)
    return found.device, found.command, found.servos


NO_RUN = ("", "", ())


def test_how_the_last_run_was_started_outlives_it(bases: list[str]) -> None:
    assert remembered("robot") == NO_RUN
    path = instances.make_runtime_dir("robot")
    for servos in ((), (1, 2, 10)):
        instance.remember(path, instance.Last("/dev/my board", "failstop run --device '/dev/my board'", servos))
        assert remembered("robot") == ("/dev/my board", "failstop run --device '/dev/my board'", servos)
    instance.clear(path)
    assert remembered("robot")[0] == "/dev/my board"
    assert os.listdir(path) == ["last"]
    assert stat.S_IMODE(os.stat(instance.last_path(path)).st_mode) == 0o644
    assert remembered("other") == NO_RUN
    with pytest.raises(NoService, match=r"start it with `failstop run --device '/dev/my board'`$"):
        instance.find("robot")


def test_of_two_places_the_newer_run_counts(bases: list[str]) -> None:
    for at, base in enumerate(bases):
        path = os.path.join(base, "robot")
        os.makedirs(path)
        instance.remember(path, instance.Last(f"/dev/{at}", "failstop run"))
        os.utime(instance.last_path(path), ns=(1000, 1000 + at))
    assert remembered("robot")[0] == f"/dev/{len(bases) - 1}"
    os.utime(instance.last_path(os.path.join(bases[0], "robot")), ns=(1000, 2000))
    assert remembered("robot")[0] == "/dev/0"


@pytest.mark.parametrize("junk", [b"", b"\xff\xfe", b"/dev/x", b"/dev/x\0failstop run\0one", b"\0" * 99])
def test_nonsense_is_no_run(bases: list[str], junk: bytes) -> None:
    Path(instance.last_path(instances.make_runtime_dir("robot"))).write_bytes(junk)
    assert remembered("robot") == NO_RUN


@pytest.mark.parametrize("name", ["no/slash", "", "robot"])
def test_a_last_run_is_not_looked_for_where_none_can_be(bases: list[str], name: str) -> None:
    assert remembered(name) == NO_RUN


def test_a_last_run_that_somebody_has_planted_is_not_believed(bases: list[str], tmp_path: Path) -> None:
    (tmp_path / "planted").write_bytes(b"/dev/x\0failstop run")
    os.symlink(tmp_path / "planted", instance.last_path(instances.make_runtime_dir("robot")))
    assert remembered("robot") == NO_RUN


def test_a_command_that_would_write_on_the_terminal_is_not_shown(bases: list[str]) -> None:
    path = instances.make_runtime_dir("robot")
    instance.remember(path, instance.Last("/dev/x", "failstop run --config '\x1b[2J'"))
    assert remembered("robot") == ("/dev/x", "", ())


def test_a_run_that_somebody_has_planted_is_not_believed(bases: list[str], tmp_path: Path) -> None:
    path = instances.make_runtime_dir("robot")
    (tmp_path / "planted").write_text("0000000000000007")
    os.symlink(tmp_path / "planted", instance.run_path(path))
    with pytest.raises(InstanceError, match="run is a link: remove it"):
        instance.run(path)


@pytest.mark.parametrize("junk", [b"", b"\xff\xfe\0", b"not a number", b"-"])
def test_a_run_that_can_not_be_read_is_no_service(bases: list[str], junk: bytes) -> None:
    path = instances.make_runtime_dir("robot")
    Path(instance.run_path(path)).write_bytes(junk)
    with pytest.raises(NoService):
        instance.run(path)


@needs_root
def test_root_takes_over_no_directory_of_another_user(bases: list[str]) -> None:
    """That one could neither use what root leaves there nor remove it."""
    path = instances.make_runtime_dir("robot")
    os.chown(bases[0], NOBODY, NOBODY)
    os.chown(path, NOBODY, NOBODY)
    with pytest.raises(InstanceError, match=rf"; {path} belongs to .*uid 65534.*choose another --name"):
        instances.make_runtime_dir("robot")


def test_a_directory_that_others_may_write_is_not_taken_over(bases: list[str]) -> None:
    path = instances.make_runtime_dir("robot")
    os.chmod(path, 0o777)
    with pytest.raises(InstanceError, match=rf"; {path} may be written by others"):
        instances.make_runtime_dir("robot")
