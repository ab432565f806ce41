"""Places: nothing that somebody else may have planted is opened, whoever looks, root first of all."""

from __future__ import annotations

import errno
import os
from types import SimpleNamespace
from typing import Any

import pytest

from .simulated import content, mode, open_fds, put, user

OTHER, NOBODY = 61_235, 65_534
BASE = "/srv/failstop"
FOLDER = f"{BASE}/robot"
STOP_PIPE, CLAIMS = f"{FOLDER}/stop", f"{FOLDER}/claims"


@pytest.fixture
def folder(on: SimpleNamespace) -> Any:
    """The machine, with a runtime directory of root's that has a FIFO, to which somebody listens, and claims."""
    on.os.makedirs(FOLDER)
    on.bell.make_pipe(STOP_PIPE, 0o622)
    on.os.close(on.claim.open_claims(CLAIMS, create=True, mode=0o666))
    on.reader = on.bell.open_pipe(STOP_PIPE)
    return on


def give(on: Any, uid: int, *paths: str) -> None:
    for path in paths:
        on.os.chown(path, uid, uid)


def refused(on: Any, *ways: str) -> list[str]:
    """The refusals of the ways in which the program opens what is in there: of these, or of every one."""
    attempts = {
        "stop": lambda: on.bell.open_pipe_to_write(on.instance.stop_path(FOLDER)),
        "the service's end": lambda: on.bell.open_pipe(on.instance.stop_path(FOLDER)),
        "claims": lambda: on.claim.open_claims(on.instance.claims_path(FOLDER)),
        "create": lambda: on.claim.open_claims(on.instance.claims_path(FOLDER), create=True),
        "make": lambda: on.bell.make_pipe(on.instance.bell_path(FOLDER), 0o622),
        "publish": lambda: on.instance.publish_run(FOLDER, 7),
    }
    found = []
    before = open_fds(on)
    for way in ways or attempts:
        with pytest.raises(on.place.Untrusted) as caught:
            attempts[way]()
        assert "\n" not in str(caught.value.strerror), way
        assert caught.value.errno == errno.EBADF
        assert str(caught.value.strerror).startswith(caught.value.filename)
        found.append(str(caught.value.strerror))
    assert open_fds(on) == before
    return found


def test_what_is_in_order_is_opened(folder: Any) -> None:
    assert folder.instances.running(FOLDER)
    writing, _ = folder.bell.open_pipe_to_write(STOP_PIPE), folder.claim.open_claims(CLAIMS)
    folder.bell.send(writing, b"stop\n")
    assert folder.bell.receive(folder.reader) == b"stop\n"


@pytest.mark.parametrize("victim", [FOLDER, BASE])
@pytest.mark.parametrize("trap", ["another user's", "a link", "everyone's", "a group's"])
def test_a_directory_that_somebody_else_may_write(folder: Any, victim: str, trap: str) -> None:
    on = folder
    if trap == "another user's":
        give(on, OTHER, STOP_PIPE, CLAIMS, FOLDER, victim)
        on.os.chmod(os.path.dirname(victim), 0o1777)
    elif trap == "a link":
        on.os.rename(victim, f"{victim}-moved")
        on.os.symlink(f"{victim}-moved", victim)
        with pytest.raises(NotADirectoryError):
            on.bell.open_pipe_to_write(STOP_PIPE)
        assert not on.instances.running(FOLDER)
        return
    else:
        on.os.chmod(victim, 0o777 if trap == "everyone's" else 0o775)
    assert not on.instances.running(FOLDER)
    for said in refused(on):
        assert said.startswith(victim)
        assert (f"uid {OTHER}" in said) == (trap == "another user's")


@pytest.mark.parametrize("trap", ["link to a file", "link to the FIFO", "regular file", "another user's", "directory"])
def test_a_stop_pipe_that_is_none(folder: Any, trap: str) -> None:
    """Root would write its stop request into it, and say that the robot was stopped."""
    on, victim = folder, STOP_PIPE if trap == "regular file" else "/tmp/victim"
    if trap == "another user's":
        give(on, OTHER, STOP_PIPE)
    else:
        on.os.rename(STOP_PIPE, f"{FOLDER}/real")
    put(on, victim, "precious") if trap != "another user's" else None
    if trap == "directory":
        on.os.mkdir(STOP_PIPE)
        with pytest.raises(IsADirectoryError):
            on.bell.open_pipe_to_write(STOP_PIPE)
        return
    if trap.startswith("link"):
        on.os.symlink(victim if trap == "link to a file" else f"{FOLDER}/real", STOP_PIPE)
    for said in refused(on, "stop", "the service's end"):
        assert said.startswith(STOP_PIPE)
    assert not on.instances.running(FOLDER)
    if trap != "another user's":
        assert content(on, victim) == b"precious"


@pytest.mark.parametrize("trap", ["link", "FIFO", "another user's"])
def test_claims_that_are_none(folder: Any, trap: str) -> None:
    if trap == "another user's":
        give(folder, OTHER, CLAIMS)
    else:
        folder.os.unlink(CLAIMS)
        folder.os.mkfifo(CLAIMS) if trap == "FIFO" else folder.os.symlink("/tmp/planted", CLAIMS)
    refused(folder, "claims", "create")
    assert not folder.os.path.exists("/tmp/planted")


def test_what_root_alone_could_put_there_is_its_owner_s(folder: Any) -> None:
    """As systemd makes /run/failstop for the service's user: everybody trusts it, root too."""
    on = folder
    give(on, OTHER, BASE, FOLDER, STOP_PIPE, CLAIMS)
    for uid in (0, NOBODY):
        with user(on, uid):
            assert on.instances.running(FOLDER)
    # But not its word for what is another user's.
    give(on, NOBODY, STOP_PIPE)
    refused(on, "stop")
    assert not on.instances.running(FOLDER)


def test_a_stranger_s_service_is_none_and_find_says_why(folder: Any) -> None:
    on = folder
    on.os.chmod("/srv", 0o1777)
    give(on, OTHER, BASE, FOLDER, STOP_PIPE, CLAIMS)
    on.own.environ["XDG_RUNTIME_DIR"] = "/srv"
    for uid in (0, NOBODY):
        with user(on, uid), pytest.raises(on.instance.NoService, match=r"^no service named 'robot' is running") as none:
            on.instance.find("robot")
        assert f"; {BASE} belongs to uid {OTHER}: not trusted" in str(none.value)
    with user(on, OTHER):
        assert on.instance.find("robot") == FOLDER, "it is that user's own"


@pytest.mark.parametrize(
    ("above", "rights", "owner", "looks", "trusted"),
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
def test_whose_base_is_trusted(folder: Any, above: int, rights: int, owner: int, looks: int, *, trusted: bool) -> None:
    on = folder
    give(on, owner, BASE)
    give(on, above, "/srv")
    on.os.chmod("/srv", rights)
    with user(on, looks):
        if trusted:
            on.place.base_directory(BASE)
        else:
            with pytest.raises(on.place.Untrusted) as refused:
                on.place.base_directory(BASE)
            assert str(refused.value.strerror).startswith(f"{BASE} belongs to {on.place.user(owner)}: not trusted")


@pytest.mark.parametrize(("owner", "looks", "trusted"), [(OTHER, 0, True), (0, NOBODY, True), (1, 0, False)])
def test_a_user_s_base_has_that_user_s_or_root_s(folder: Any, owner: int, looks: int, *, trusted: bool) -> None:
    on = folder
    give(on, OTHER, BASE)
    give(on, owner, FOLDER)
    with user(on, looks):
        if trusted:
            on.place.directory(FOLDER)
        else:
            with pytest.raises(on.place.Untrusted):
                on.place.directory(FOLDER)


def test_what_is_created_is_its_user_s_alone(folder: Any) -> None:
    folder.own.umask = 0
    folder.place.opened(f"{FOLDER}/new", os.O_RDWR | os.O_CREAT)
    assert mode(folder, f"{FOLDER}/new") == 0o600


def test_a_user_is_told_by_name_and_number_where_there_is_a_name(on: Any) -> None:
    assert on.place.user(0) == "root (uid 0)"
    assert on.place.user(OTHER) == f"uid {OTHER}"


def test_nothing_stays_open(folder: Any) -> None:
    on, before = folder, open_fds(folder)
    on.os.symlink("claims", f"{FOLDER}/link")
    on.instances.running(FOLDER)
    for path in ("link", "absent"):
        with pytest.raises(OSError, match=r"is a link|No such file"):
            on.place.opened(f"{FOLDER}/{path}", os.O_RDONLY)
    for path, pipe, kind in ((CLAIMS, True, "FIFO"), (STOP_PIPE, False, "regular file")):
        with pytest.raises(on.place.Untrusted, match=f"is not a {kind}: remove it"):
            on.place.opened(path, os.O_RDWR, pipe=pipe)
    assert open_fds(on) == before
