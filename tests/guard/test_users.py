"""Hostile users: who may open the guard port, what waits for the guard at its path, and one program more."""

from __future__ import annotations

import errno
import fcntl
import os
import stat
import termios
from pathlib import Path

import pytest

from bench.guard_scene import GuardScene
from failstop.api.errors import FailstopError
from failstop.guard import pty as pty_module
from failstop.guard.pty import Pty
from failstop_lab.trial import wait_for
from tests.support.unprivileged import unprivileged

AS_ROOT = pytest.mark.skipif(os.geteuid() != 0, reason="needs root, to become somebody else")
STRANGER, MEMBER = "tty", "daemon"
"""Two groups that every machine has; the second stands for the group failstop."""
RATE = "30"


def open_as_nobody(path: str, *groups: int) -> str:
    """What a user without rights gets who opens this path, in these groups: "open", or the name of the error."""

    def opened() -> str:
        try:
            os.close(os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK))
        except OSError as error:
            return errno.errorcode.get(error.errno or 0, "?")
        return "open"

    return unprivileged(opened, groups)


def gid_of(name: str) -> int:
    import grp

    return grp.getgrnam(name).gr_gid


@AS_ROOT
@pytest.mark.claim("GUARD-1")
def test_the_group_may_open_it_and_a_stranger_may_not(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pty_module, "GROUP", MEMBER)
    pty = Pty(str(tmp_path / "port"))
    try:
        found = os.stat(pty.name)
        assert (stat.S_IMODE(found.st_mode), found.st_uid, found.st_gid) == (0o660, 0, gid_of(MEMBER))
        assert open_as_nobody(pty.name, gid_of(MEMBER)) == "open"
        assert open_as_nobody(pty.name) == "EACCES"
        assert open_as_nobody(pty.name, gid_of(STRANGER)) == "EACCES", "the group that a terminal has by itself"
        pty.hang_up()
        assert open_as_nobody(pty.name) == "EACCES", "the terminal that takes its place is no more open"
        assert open_as_nobody(pty.name, gid_of(MEMBER)) == "open"
    finally:
        pty.close()


@AS_ROOT
def test_without_the_group_the_owner_alone_may_open_it(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(pty_module, "GROUP", "no-such-group")
    pty = Pty(str(tmp_path / "port"))
    try:
        assert stat.S_IMODE(os.stat(pty.name).st_mode) == 0o600
        assert open_as_nobody(pty.name, gid_of(STRANGER), gid_of(MEMBER)) == "EACCES"
    finally:
        pty.close()


@AS_ROOT
def test_a_second_program_of_an_ordinary_user_is_refused_by_the_kernel(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(pty_module, "GROUP", MEMBER)
    pty = Pty(str(tmp_path / "port"))
    try:
        pty.exclusive(on=True)
        assert open_as_nobody(pty.name, gid_of(MEMBER)) == "EBUSY"
        pty.exclusive(on=False)
        assert open_as_nobody(pty.name, gid_of(MEMBER)) == "open", "the next driver gets it"
        slave = os.open(pty.name, os.O_RDWR | os.O_NOCTTY)
        fcntl.ioctl(slave, termios.TIOCEXCL)
        os.close(slave)
        assert open_as_nobody(pty.name, gid_of(MEMBER)) == "EBUSY", "a dead driver's exclusive mode is still on"
        pty.exclusive(on=False)
        assert open_as_nobody(pty.name, gid_of(MEMBER)) == "open"
    finally:
        pty.close()


@AS_ROOT
def test_a_stranger_keeps_no_driver_from_driving(arduino: GuardScene, diffdrive: str) -> None:
    """It may try as often as it likes, by the terminal's own path too."""
    arduino.rest()
    arduino.enable()
    driver = arduino.driver(diffdrive, arduino.path, "serial", "10", "10", RATE)
    driver.line()
    arduino.moves()
    for _ in range(200):
        assert open_as_nobody(os.readlink(arduino.path), gid_of(STRANGER)) == "EACCES"
    wait_for("more counts", lambda: driver.line().split("|")[1] == "OK")
    assert arduino.trial.turning()
    assert arduino.trial.robot.state.driver
    assert arduino.trial.robot.state.driver.who == f"diffdrive (pid {driver.pid})"


# What somebody has put at its path before.


@pytest.mark.parametrize("name", ["port", "port.new"])
def test_a_link_of_somebody_s_is_never_followed(tmp_path: Path, name: str) -> None:
    """At the path it is left. Beside it is only the draft of the guard's own link."""
    victim = tmp_path / "victim"
    victim.write_text("mine")
    (tmp_path / name).symlink_to(victim)
    if name == "port":
        with pytest.raises(FailstopError, match=f"leads to {victim}: choose another --path"):
            Pty(str(tmp_path / "port"))
        assert os.readlink(tmp_path / "port") == str(victim)
    else:
        pty = Pty(str(tmp_path / "port"))
        assert os.readlink(tmp_path / "port") == pty.name
        pty.close()
    assert victim.read_text() == "mine"
    assert stat.S_IMODE(victim.stat().st_mode) != 0o660


def test_a_link_in_the_place_of_the_lock_is_not_followed(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    (tmp_path / "port.lock").symlink_to(victim)
    with pytest.raises(FailstopError, match=r"port\.lock.*choose another place with --path"):
        Pty(str(tmp_path / "port"))
    assert not victim.exists()


@pytest.mark.parametrize(
    ("name", "message"),
    [("port", "exists already and is not a link"), ("port.new", "another place"), ("port.lock", "another place")],
)
def test_a_folder_in_its_way_is_named_and_left_as_it_is(tmp_path: Path, name: str, message: str) -> None:
    (tmp_path / name).mkdir()
    (tmp_path / name / "file").write_text("mine")
    before = len(os.listdir("/proc/self/fd"))
    with pytest.raises(FailstopError, match=message):
        Pty(str(tmp_path / "port"))
    assert (tmp_path / name / "file").read_text() == "mine"
    assert len(os.listdir("/proc/self/fd")) == before, "nothing of it is left open"


def test_a_link_that_somebody_turns_elsewhere_is_turned_back_from_a_terminal_only(tmp_path: Path) -> None:
    pty = Pty(str(tmp_path / "port"))
    try:
        os.unlink(tmp_path / "port")
        (tmp_path / "port").symlink_to("/dev/null")
        assert not pty.linked()
        with pytest.raises(FailstopError, match="leads to /dev/null"):
            pty.link_again()
        os.unlink(tmp_path / "port")
        (tmp_path / "port").symlink_to("/dev/pts/nowhere")
        assert not pty.linked()
        pty.link_again()
        assert os.readlink(tmp_path / "port") == pty.name
        os.unlink(tmp_path / "port")
        (tmp_path / "port").symlink_to("/dev/null")
    finally:
        pty.close()
    assert os.readlink(tmp_path / "port") == "/dev/null", "another's link is not taken away at its end"
