"""A port that another user's file names is opened with that user's rights, whatever root itself may do."""

from __future__ import annotations

import fcntl
import os
import pty
import stat
import termios
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.board import named
from failstop.board.port import PortError, open_port
from failstop.board.rrc.board import BOARD

pytestmark = pytest.mark.skipif(os.geteuid() != 0, reason="only root has another user's rights")
NOBODY, OPERATORS = 65534, 54321
FLAGS = os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK | os.O_CLOEXEC


@pytest.fixture
def terminal() -> Iterator[str]:
    """Root's own: nobody else may open it."""
    master, slave = pty.openpty()
    path = os.ttyname(slave)
    os.chmod(path, 0o600)
    yield path
    os.close(master)
    os.close(slave)


@pytest.fixture
def open_place(tmp_path: Path) -> Path:
    """Everybody may enter it."""
    for folder in (tmp_path, *tmp_path.parents):
        if not folder.stat().st_mode & stat.S_IXOTH:
            folder.chmod(folder.stat().st_mode | stat.S_IXOTH)
    return tmp_path


def test_a_terminal_of_the_user_s_own_is_opened_also_while_a_service_holds_it(terminal: str) -> None:
    os.chown(terminal, NOBODY, -1)
    held = os.open(terminal, FLAGS)
    fcntl.ioctl(held, termios.TIOCEXCL)
    for _ in range(2):
        os.close(open_port(terminal, exclusive=False, line=BOARD.port, named_by=NOBODY))
    os.close(held)
    assert (os.geteuid(), os.getegid()) == (0, 0)


def test_a_terminal_that_is_not_theirs_is_not(terminal: str, open_place: Path) -> None:
    link = open_place / "board"
    link.symlink_to(terminal)
    groups = os.getgroups()
    for path in (terminal, str(link)):
        with pytest.raises(PermissionError):
            named.open_named(path, NOBODY, FLAGS)
        with pytest.raises(PortError, match="no permission"):
            open_port(path, exclusive=False, line=BOARD.port, named_by=NOBODY)
    os.close(open_port(terminal, exclusive=False, line=BOARD.port))
    assert (os.geteuid(), os.getegid(), os.getgroups()) == (0, 0, groups)


@pytest.mark.parametrize("member", [True, False])
def test_their_groups_count(member: bool, terminal: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    passwd, group = tmp_path / "passwd", tmp_path / "group"
    passwd.write_text(f"nonsense\nrobot:x:{NOBODY}:{NOBODY}::/:/bin/sh\n")
    group.write_text(f"ports:x:{OPERATORS}:ann,{'robot' if member else 'robo'}\n")
    monkeypatch.setattr(named, "PASSWD_FILE", str(passwd))
    monkeypatch.setattr(named, "GROUP_FILE", str(group))
    os.chown(terminal, 0, OPERATORS)
    os.chmod(terminal, 0o660)
    if member:
        os.close(named.open_named(terminal, NOBODY, FLAGS))
    else:
        with pytest.raises(PermissionError):
            named.open_named(terminal, NOBODY, FLAGS)


@pytest.mark.parametrize("what", ["file", "fifo", "folder", "/dev/null", "/dev/ptmx", "/dev/tty"])
def test_what_is_no_terminal_of_a_board_is_never_opened(what: str, open_place: Path) -> None:
    path = what if what.startswith("/") else str(open_place / what)
    makes = {"file": Path.touch, "fifo": lambda at: os.mkfifo(at), "folder": Path.mkdir}
    if what in makes:
        makes[what](Path(path))
        os.chmod(path, 0o777)
    with pytest.raises(OSError, match=r"ioctl|Inappropriate"):
        named.open_named(path, NOBODY, FLAGS)


def test_a_folder_that_they_may_not_enter_hides_what_is_in_it(terminal: str, tmp_path: Path) -> None:
    os.chown(terminal, NOBODY, -1)
    closed = tmp_path / "closed"
    closed.mkdir(mode=0o700)
    (closed / "board").symlink_to(terminal)
    with pytest.raises(PermissionError):
        named.open_named(str(closed / "board"), NOBODY, FLAGS)
