"""Places: nothing that somebody else may have planted is opened, whoever looks, root first of all."""

from __future__ import annotations

import errno
import os
import stat
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from failstop import instances
from failstop.shm import bell, claim, instance, place
from failstop.shm.place import Untrusted
from tests.support.children import NOBODY, call, needs_root, reachable, umask

OTHER = 61_235


@pytest.fixture
def folder(tmp_path: Path) -> Path:
    """A runtime directory of root's that everybody can reach, with a FIFO and a claims file in it."""
    reachable(tmp_path)
    made = tmp_path / "failstop" / "robot"
    made.mkdir(parents=True)
    bell.make_pipe(str(made / "stop"), 0o622)
    os.close(claim.open_claims(str(made / "claims"), create=True, mode=0o666))
    return made


@pytest.fixture
def reader(folder: Path) -> Iterator[int]:
    """The service's end of the FIFO."""
    fd = bell.open_pipe(str(folder / "stop"))
    yield fd
    os.close(fd)


def attempts(folder: Path) -> dict[str, Callable[[], object]]:
    """Every way in which the program opens what is in a runtime directory."""
    path = str(folder)
    return {
        "stop": lambda: bell.open_pipe_to_write(instance.stop_path(path)),
        "the service's end": lambda: bell.open_pipe(instance.stop_path(path)),
        "claims": lambda: claim.open_claims(instance.claims_path(path)),
        "make": lambda: bell.make_pipe(instance.bell_path(path), 0o622),
        "publish": lambda: instance.publish(path, 7),
    }


def refused(folder: Path, *ways: str) -> list[str]:
    """What each of these ways, or every one, is refused with."""
    found = []
    for way, attempt in attempts(folder).items():
        if not ways or way in ways:
            with pytest.raises(Untrusted) as caught:
                attempt()
            assert "\n" not in str(caught.value.strerror), way
            assert caught.value.errno == errno.EBADF
            assert str(caught.value.strerror).startswith(caught.value.filename)
            found.append(str(caught.value.strerror))
    assert found
    return found


def test_what_is_in_order_is_opened(folder: Path, reader: int, fds: list[int]) -> None:
    assert instances.running(str(folder))
    fds += [writing := bell.open_pipe_to_write(str(folder / "stop")), claim.open_claims(str(folder / "claims"))]
    bell.send(writing, b"stop\n")
    assert bell.take(reader) == b"stop\n"


@needs_root
@pytest.mark.parametrize("which", ["directory", "above"])
@pytest.mark.parametrize("trap", ["another user's", "a link", "everyone's", "a group's"])
def test_a_directory_that_somebody_else_may_write(folder: Path, reader: int, which: str, trap: str) -> None:
    victim = folder if which == "directory" else folder.parent
    if trap == "another user's":
        for path in (folder, *folder.iterdir()):
            os.chown(path, OTHER, OTHER)
        os.chown(victim, OTHER, OTHER)
        victim.parent.chmod(0o1777)
    elif trap == "a link":
        victim.rename(moved := victim.with_name("moved"))
        victim.symlink_to(moved)
        with pytest.raises(NotADirectoryError):
            bell.open_pipe_to_write(str(folder / "stop"))
        assert not instances.running(str(folder))
        return
    else:
        victim.chmod(0o777 if trap == "everyone's" else 0o775)
    assert not instances.running(str(folder))
    for said in refused(folder):
        assert said.startswith(str(victim))
        assert (f"uid {OTHER}" in said) == (trap == "another user's")


@needs_root
@pytest.mark.parametrize("trap", ["link to a file", "link to the FIFO", "regular file", "another user's", "directory"])
def test_a_stop_pipe_that_is_none(folder: Path, reader: int, tmp_path: Path, trap: str) -> None:
    """Root would write its stop request into it, and say that the robot was stopped."""
    victim = tmp_path / "victim"
    victim.write_text("precious")
    pipe = folder / "stop"
    if trap == "another user's":
        os.chown(pipe, OTHER, OTHER)
    else:
        pipe.rename(folder / "real")
        if trap == "regular file":
            pipe.write_text("precious")
        elif trap == "directory":
            pipe.mkdir()
        else:
            pipe.symlink_to(victim if trap == "link to a file" else folder / "real")
    if trap == "directory":
        with pytest.raises(IsADirectoryError):
            bell.open_pipe_to_write(str(pipe))
        return
    for said in refused(folder, "stop", "the service's end"):
        assert said.startswith(str(pipe))
    assert not instances.running(str(folder))
    assert victim.read_text() == "precious"
    if trap == "regular file":
        assert pipe.read_text() == "precious"


@needs_root
@pytest.mark.parametrize("trap", ["link", "FIFO", "another user's"])
def test_claims_that_are_none(folder: Path, tmp_path: Path, trap: str) -> None:
    """A FIFO is not waited for, either."""
    claims = folder / "claims"
    if trap == "another user's":
        os.chown(claims, OTHER, OTHER)
    else:
        claims.unlink()
        os.mkfifo(claims) if trap == "FIFO" else claims.symlink_to(tmp_path / "planted")
    for attempt in (claim.open_claims, lambda path: claim.open_claims(path, create=True)):
        with pytest.raises(Untrusted):
            attempt(str(claims))
    assert not (tmp_path / "planted").exists()


@needs_root
def test_what_root_alone_could_put_there_is_its_owner_s(folder: Path) -> None:
    """As systemd makes /run/failstop for the service's user: everybody trusts it, root too."""
    for path in (folder.parent, folder, *folder.iterdir()):
        os.chown(path, OTHER, OTHER)
    reading = os.open(folder / "stop", os.O_RDONLY | os.O_NONBLOCK)
    try:
        assert instances.running(str(folder))
        assert call(lambda: instances.running(str(folder)), NOBODY)
        # But not its word for what is another user's.
        os.chown(folder / "stop", NOBODY, NOBODY)
        refused(folder, "stop")
        assert not instances.running(str(folder))
    finally:
        os.close(reading)


@needs_root
def test_a_stranger_s_service_is_none_and_find_says_why(folder: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    folder.parent.parent.chmod(0o1777)
    for path in (folder.parent, folder, *folder.iterdir()):
        os.chown(path, OTHER, OTHER)
    monkeypatch.setattr(instance, "bases", lambda: [str(folder.parent)])
    reading = os.open(folder / "stop", os.O_RDONLY | os.O_NONBLOCK)
    try:
        assert f"; {folder.parent} belongs to uid {OTHER}: not trusted" in _not_found("robot")
        for uid in (0, NOBODY):
            said = call(lambda: _not_found("robot"), uid)
            assert said.startswith("no service named 'robot' is running")
            assert f"{folder.parent} belongs to uid {OTHER}: not trusted" in said
        assert call(lambda: instance.find("robot"), OTHER) == str(folder), "it is that user's own"
    finally:
        os.close(reading)


def _not_found(name: str) -> str:
    try:
        return f"found {instance.find(name)}"
    except instance.NoService as error:
        return str(error)


@needs_root
@pytest.mark.parametrize(
    ("above", "mode", "owner", "looks", "trusted"),
    [
        (0, 0o1777, 0, 0, True),
        (0, 0o1777, 0, NOBODY, True),
        (0, 0o1777, NOBODY, NOBODY, True),
        (0, 0o1777, NOBODY, 0, False),
        (0, 0o1777, 1, 0, False),
        (0, 0o1777, 1, NOBODY, False),
        (0, 0o755, OTHER, 0, True),
        (0, 0o755, OTHER, NOBODY, True),
        (0, 0o775, OTHER, 0, False),
        (OTHER, 0o755, OTHER, 0, False),
        (OTHER, 0o755, NOBODY, 0, False),
        (OTHER, 0o755, 0, NOBODY, True),
    ],
)
def test_whose_base_is_trusted(folder: Path, above: int, mode: int, owner: int, looks: int, *, trusted: bool) -> None:
    """Root's and one's own, and whosever root alone can have made it."""
    base = folder.parent
    os.chown(base, owner, owner)
    os.chown(base.parent, above, above)
    base.parent.chmod(mode)

    def attempt() -> str:
        try:
            os.close(place.base_directory(str(base)))
        except Untrusted as error:
            return str(error.strerror)
        return ""

    said = call(attempt, looks)
    if trusted:
        assert said == ""
    else:
        assert said.startswith(f"{base} belongs to {place.user(owner)}: not trusted")


@needs_root
@pytest.mark.parametrize(("owner", "looks", "trusted"), [(OTHER, 0, True), (0, NOBODY, True), (1, 0, False)])
def test_what_is_in_a_user_s_base_is_that_user_s_or_root_s(
    folder: Path, owner: int, looks: int, *, trusted: bool
) -> None:
    os.chown(folder.parent, OTHER, OTHER)
    os.chown(folder, owner, owner)

    def attempt() -> bool:
        try:
            os.close(place.directory(str(folder)))
        except Untrusted:
            return False
        return True

    assert call(attempt, looks) is trusted


def test_what_is_created_is_its_user_s_alone(folder: Path, fds: list[int]) -> None:
    with umask(0):
        fds.append(place.opened(str(folder / "new"), os.O_RDWR | os.O_CREAT))
    assert stat.S_IMODE((folder / "new").stat().st_mode) == 0o600


def test_a_user_is_told_by_name_and_number_where_there_is_a_name() -> None:
    assert place.user(0) == "root (uid 0)"
    assert place.user(OTHER) == f"uid {OTHER}"


def test_a_new_pipe_takes_the_place_of_a_link(folder: Path, tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("precious")
    victim.chmod(0o600)
    (folder / "bell").symlink_to(victim)
    bell.make_pipe(str(folder / "bell"), 0o622)
    assert stat.S_ISFIFO(os.lstat(folder / "bell").st_mode)
    assert stat.S_IMODE(victim.stat().st_mode) == 0o600


def test_nothing_stays_open(folder: Path, reader: int) -> None:
    before = len(os.listdir("/proc/self/fd"))
    (folder / "link").symlink_to("claims")
    for _ in range(10):
        instances.running(str(folder))
        for path in ("link", "absent"):
            with pytest.raises(OSError, match=r"is a link|No such file"):
                place.opened(str(folder / path), os.O_RDONLY)
        with pytest.raises(Untrusted):
            place.opened(str(folder / "claims"), os.O_WRONLY, pipe=True)
    assert len(os.listdir("/proc/self/fd")) == before
