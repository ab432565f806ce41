"""`failstop stop` on a pty and files of this machine: the bytes on the wire, and what a bad file does to them."""

from __future__ import annotations

import os
import pty
import subprocess
import time
import tty
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from failstop import config, instances, stopping
from failstop.api import ask
from failstop.board.burst import BURST, burst_with
from failstop.board.interface import SUPERVISOR_ROW, Board
from failstop.board.kinds import board_of
from failstop.board.port import PortError
from failstop.board.rrc.board import BOARD
from failstop.cli import main as cli
from failstop.cli.commands import stop
from failstop.files import instance, root
from failstop.policy.layouts import BOARDS
from failstop.policy.settings import Settings
from tests.support.amounts import amount
from tests.support.commands import FAILSTOP, failstop


@pytest.fixture
def board(tmp_path: Path) -> Iterator[tuple[str, int]]:
    """A pty: its link, and the board's side of it."""
    master, slave = pty.openpty()
    tty.setraw(slave)
    link = tmp_path / "board"
    link.symlink_to(os.ttyname(slave))
    yield str(link), master
    os.close(master)
    os.close(slave)


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "failstop.toml"


@pytest.fixture(autouse=True)
def alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Path:
    """The folder for installed files, on a machine where no service runs and none is installed."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "run"))
    monkeypatch.setenv(root.VARIABLE, str(tmp_path))
    folder = Path(f"{tmp_path}{config.FOLDER}")
    folder.mkdir(parents=True)
    (tmp_path / "run").mkdir()
    return folder


def gets(master: int, expected: bytes) -> None:
    """Check that the board gets just these bytes: the kernel hands them over when it has the time."""
    found = b""
    while len(found) < len(expected):
        found += os.read(master, 4096)
    assert found == expected


def last_run(device: str, *servos: int, name: str = "failstop") -> None:
    """A service that somebody has started by hand, and that has died, was on this port."""
    instance.remember(instances.make_runtime_dir(name), instance.Last(device, "failstop run", servos))


def test_the_last_run_s_port_is_written_to_at_once(board: tuple[str, int], capsys: pytest.CaptureFixture[str]) -> None:
    link, master = board
    last_run(link, 1, 10)
    assert cli.main(["stop"]) == 0
    gets(master, BURST + burst_with((1, 10)))
    assert f"directly to {link}, the port of the last run (" in capsys.readouterr().out


def test_where_the_last_run_s_port_has_gone_the_other_is_written_to_and_doubted(
    board: tuple[str, int], alone: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    link, master = board
    last_run("/dev/gone", 1)
    (alone / "failstop.toml").write_text(f'device.path = "{link}"\n')
    assert cli.main(["stop"]) == 1
    gets(master, BURST)
    said = capsys.readouterr()
    assert f"directly to {link} (no service" in said.out
    assert said.err == (
        f"failstop: /dev/gone of the last run is not there, so it went to {link}: is this the board? Name it with "
        "--device\n"
    )


def test_a_last_run_s_port_that_fails_is_no_reason_to_write_to_another(
    board: tuple[str, int], alone: Path, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    link, master = board
    (tmp_path / "no-tty").touch()
    last_run(str(tmp_path / "no-tty"))
    (alone / "failstop.toml").write_text(f'device.path = "{link}"\n')
    assert cli.main(["stop", "--wait", "0"]) == 1
    os.set_blocking(master, False)
    with pytest.raises(BlockingIOError):
        os.read(master, 1)
    assert f"{tmp_path}/no-tty" in capsys.readouterr().err


def test_two_ports_that_are_not_there_are_both_named(alone: Path, capsys: pytest.CaptureFixture[str]) -> None:
    last_run("/dev/gone")
    (alone / "failstop.toml").write_text('device.path = "/dev/nor-this"\n')
    assert cli.main(["stop", "--wait", "0"]) == 1
    (said,) = capsys.readouterr().err.splitlines()
    assert said.startswith("failstop: no device /dev/gone: ")
    assert said.endswith(" (it was the last run's; /dev/nor-this is not there either)")


@pytest.mark.parametrize("stops", [True, False])
def test_a_service_that_was_just_starting_is_asked_once_it_listens(
    stops: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The service has the port before it can be asked."""
    tries: list[str] = []
    asked: list[str] = []

    def busy(path: str, board: Board, servos: tuple[int, ...] = ()) -> None:
        tries.append(path)
        raise PortError("busy", f"{path} is held")

    def ask_it(name: str, reason: str, who: str) -> tuple[str, str]:
        asked.append(reason)
        return ("stop latched", "") if stops else ("", "it hangs")

    monkeypatch.setattr(stopping, "write", busy)
    monkeypatch.setattr(instances, "listens", lambda name: bool(tries))
    monkeypatch.setattr(ask, "stop", ask_it)
    assert cli.main(["stop", "a", "hand", "--wait", "0.2"]) == (0 if stops else 1)
    assert asked == ["a hand"]
    said = capsys.readouterr()
    assert said.out == ("stop latched\n" if stops else "")
    assert ("is held exclusively by another process; asked in vain: failstop" in said.err) != stops


def test_the_setting_is_declared_once() -> None:
    assert stop.DEFAULTS == {"device.path": "/dev/ttyACM0", "stop.wait_s": 30.0, "board.kind": "rrc"}


@pytest.mark.parametrize("named", [True, False], ids=["port named", "port of the file"])
def test_the_arm_is_stopped_after_the_wheels_with_the_servos_that_can_be(
    named: bool, board: tuple[str, int], file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    link, master = board
    servos = {"a": "3", "b": "1", "c": "0", "d": "[2]", "e": "1.5", "f": "true", "g": "3"}
    lines = [f'device.path = "{link}"', *(f"joints.{name}.servo = {value}" for name, value in servos.items())]
    file.write_text("\n".join(lines))
    assert cli.main(["stop", "--config", str(file), *(["--device", link] if named else [])]) == 0
    assert capsys.readouterr().err == ""
    gets(master, BURST + BOARD.burst_with((1, 3)))


BAD_FILES: dict[str, Callable[[Path], object]] = {
    "digits": lambda path: path.write_text("a = " + "1" * 5000),
    "nested": lambda path: path.write_text("a = " + "[\n" * 5000),
    "bytes": lambda path: path.write_bytes(bytes(range(256))),
    "huge": lambda path: os.truncate(os.open(path, os.O_RDWR | os.O_CREAT), 1 << 40),
    "pipe": os.mkfifo,
    "endless": lambda path: path.symlink_to("/dev/zero"),
    "folder": Path.mkdir,
    "absent": lambda path: None,
}


@pytest.mark.parametrize("bad", BAD_FILES)
def test_no_file_keeps_the_stop_from_the_wire(
    bad: str, board: tuple[str, int], file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """The file says which board it is that is named with --device; a bad one keeps nothing back."""
    link, master = board
    BAD_FILES[bad](file)
    assert cli.main(["stop", "--config", str(file), "--device", link]) == 0
    said = capsys.readouterr().err
    assert said.startswith(f"failstop: configuration {file}")
    assert said.endswith("; going on without it\n")
    assert said.count("\n") == 1
    gets(master, BURST)


@pytest.mark.parametrize("kind", BOARDS)
def test_the_stop_is_the_one_of_the_file_s_board(kind: str, board: tuple[str, int], file: Path) -> None:
    link, master = board
    file.write_text(f'board.kind = "{kind}"\n')
    assert cli.main(["stop", "--config", str(file), "--device", link]) == 0
    own = board_of(*Settings({"board.kind": kind}).board())
    gets(master, own.burst * (1 + len(own.repeats_ns[SUPERVISOR_ROW])))


@pytest.mark.parametrize("bad", BAD_FILES)
@pytest.mark.timeout(20)
def test_no_file_keeps_the_stop_from_the_default_port(
    bad: str, file: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    asked: list[str] = []
    monkeypatch.setattr(stopping, "write", lambda path, board: asked.append(path))
    BAD_FILES[bad](file)
    assert cli.main(["stop", "--config", str(file)]) == 1
    assert asked == ["/dev/ttyACM0"]
    problem, where = capsys.readouterr().err.splitlines()
    assert problem.startswith(f"failstop: configuration {file}")
    assert where.startswith("failstop: it went to /dev/ttyACM0, the default")


WORDS = ("[device]\n", "[stop]\n", "path", "wait_s", " = ", "0x", "f" * 500, "[" * 40, "{a=", "'", '"""', "\n")
FRAGMENTS = st.sampled_from([*WORDS, "\ufeff", "é"])
FILES = st.binary() | st.text().map(str.encode) | st.lists(FRAGMENTS).map(lambda parts: "".join(parts).encode())


@given(content=FILES)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=amount(80, 1000))
def test_no_bytes_of_a_file_keep_the_stop_from_the_wire(content: bytes, board: tuple[str, int], file: Path) -> None:
    link, master = board
    last_run(link)
    file.write_bytes(content)
    cli.main(["stop", "--config", str(file), "--wait", "0"])
    gets(master, BURST)


@pytest.mark.parametrize(
    ("streams", "said"),
    [
        (("stdout",), "failstop: stop frame sent (after 0.0 s), directly to LINK\n"),
        (("stdout", "stderr"), ""),
    ],
    ids=str,
)
def test_nobody_to_tell_it_to_is_no_reason_not_to_stop(
    streams: tuple[str, ...], said: str, board: tuple[str, int]
) -> None:
    link, master = board
    with open("/dev/full", "w") as full:
        to = {stream: full if stream in streams else subprocess.PIPE for stream in ("stdout", "stderr")}
        command = [*FAILSTOP, "stop", "--device", link]
        done = subprocess.run(command, **to, text=True, timeout=20, check=False)  # type: ignore[call-overload]
    assert (done.returncode, done.stderr or "") == (0, said.replace("LINK", link))
    gets(master, BURST)


def test_what_is_to_be_said_before_holds_no_stop_up(board: tuple[str, int], file: Path) -> None:
    """A file that is wrong is told of on a full disk."""
    link, master = board
    file.write_text(f'device.path = "{link}"\nstop.wait_s = "long"\n')
    with open("/dev/full", "w") as full:
        command = [*FAILSTOP, "stop", "--config", str(file)]
        assert subprocess.run(command, stdout=full, stderr=full, timeout=20, check=False).returncode == 0
    gets(master, BURST)


def test_after_the_wait_exit_code_1_and_a_clear_message(tmp_path: Path, file: Path) -> None:
    """The command warns after 1 s, once."""
    missing = tmp_path / "board"
    file.write_text(f'[device]\npath = "{missing}"\n[stop]\nwait_s = 1.3\n')
    start_s = time.monotonic()
    result = failstop("stop", "--config", str(file))
    assert time.monotonic() - start_s >= 1.3
    assert (result.returncode, result.stdout) == (1, "")
    warning, end = result.stderr.splitlines()
    assert warning.startswith(f"failstop: no device {missing}: plug the board in")
    assert warning.endswith("; trying for 1.3 s")
    assert end.startswith(f"failstop: no device {missing}: plug the board in")
