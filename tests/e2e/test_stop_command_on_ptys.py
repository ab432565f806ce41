"""`failstop stop` on a pty and files of this machine: the bytes on the wire, and what a bad file does to them."""

from __future__ import annotations

import contextlib
import os
import pty
import signal
import subprocess
import termios
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from failstop import config, instances, stop_tool
from failstop.api import ask
from failstop.board import asking, kept
from failstop.board.interface import SUPERVISOR_ROW, Board
from failstop.board.kinds import board_of
from failstop.board.port import PortError
from failstop.board.rrc.board import BOARD
from failstop.board.rrc.burst import BURST
from failstop.cli import main as cli
from failstop.cli import target
from failstop.files import instance, root
from failstop.policy.halted import MAY_TURN
from failstop.policy.layouts import BOARDS
from failstop.policy.settings import Settings
from tests.support.amounts import amount
from tests.support.boards import own_folder
from tests.support.children import NOBODY
from tests.support.commands import FAILSTOP
from tests.support.ptys import bare_port


@pytest.fixture
def board(tmp_path: Path) -> Iterator[tuple[str, int]]:
    """A pty: its link, and the board's side of it."""
    link = tmp_path / "board"
    with bare_port(link) as master:
        yield str(link), master


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "failstop.toml"


@pytest.fixture(autouse=True)
def alone(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """A machine where no service runs and none is installed."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "run"))
    monkeypatch.setenv(root.VARIABLE, str(tmp_path))
    monkeypatch.setattr(asking, "ANSWER_S", 0.01)  # nobody answers here
    (tmp_path / "run").mkdir()


def came(master: int, size: int) -> bytes:
    """So many bytes for the board at least: the kernel hands them over when it has the time."""
    found = b""
    while len(found) < size:
        found += os.read(master, 4096)
    return found


def gets(master: int, expected: bytes) -> None:
    """Check that the board gets these bytes, and then nothing but questions, each behind another stop."""
    found = came(master, len(expected))
    for ping in BOARD.pings:
        found = found.replace(ping, b"")
    assert found.startswith(expected)
    assert found[len(expected) :].replace(BURST, b"") == b""


def unanswered(link: str) -> str:
    """The complaint where nothing answers, and no settings name the kind of the board."""
    return (
        f"failstop: nothing at {link} answers as {BOARD.name} does, so the wheels may turn: use the POWER SWITCH. "
        "Without settings failstop takes every board for Hiwonder's: for another board give --config FILE with its "
        "board.kind, or run `failstop setup` first. If the board is at another port, name that port with --device\n"
    )


@pytest.mark.parametrize("stops", [True, False])
def test_a_service_that_was_just_starting_is_asked_once_it_listens(
    stops: bool, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    """The service has the port before it can be asked."""
    tries: list[str] = []
    asked: list[str] = []

    def busy(path: str, board: Board, servos: tuple[int, ...] = (), *, named_by: int = 0) -> None:
        tries.append(path)
        raise PortError("busy", f"{path} is held")

    def ask_it(name: str, reason: str, who: str) -> tuple[str, str, bool]:
        asked.append(reason)
        return ("stop latched", "", False) if stops else ("", "it hangs", False)

    monkeypatch.setattr(stop_tool, "write", busy)
    monkeypatch.setattr(instances, "listens", lambda name: bool(tries))
    monkeypatch.setattr(ask, "stop", ask_it)
    assert cli.main(["stop", "a", "hand", "--wait", "0.2"]) == (0 if stops else 1)
    assert asked == ["a hand"]
    said = capsys.readouterr()
    assert said.out == ("stop latched\n" if stops else "")
    assert ("is held exclusively by another process; asked without success: failstop" in said.err) != stops


def test_the_setting_is_declared_once() -> None:
    port = {"device.path": "/dev/ttyACM0", "stop.wait_s": 30.0}
    board = {"board.kind": "rrc", "board.baud": 0, "board.can_id": 1}
    assert port | board == target.DEFAULTS


@pytest.mark.parametrize("named", [True, False], ids=["port named", "port of the file"])
def test_the_arm_is_stopped_after_the_wheels_with_the_servos_that_can_be(
    named: bool, board: tuple[str, int], file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    link, master = board
    servos = {"a": "3", "b": "1", "c": "0", "d": "[2]", "e": "1.5", "f": "true", "g": "3"}
    lines = [f'device.path = "{link}"', *(f"joints.{name}.servo = {value}" for name, value in servos.items())]
    file.write_text("\n".join(lines))
    assert cli.main(["stop", "--config", str(file), *(["--device", link] if named else [])]) == 1
    assert capsys.readouterr().err == unanswered(link)
    gets(master, BURST + BOARD.burst + BOARD.arm.stops((1, 3)))


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
    assert cli.main(["stop", "--config", str(file), "--device", link]) == 1
    said = capsys.readouterr().err
    assert said.startswith(f"failstop: configuration {file}")
    assert said.endswith(f"; stopping without it\n{unanswered(link)}")
    assert said.count("\n") == 2
    gets(master, BURST)


@pytest.mark.parametrize("kind", BOARDS)
def test_the_stop_is_the_one_of_the_file_s_board(kind: str, board: tuple[str, int], file: Path) -> None:
    link, master = board
    file.write_text(f'board.kind = "{kind}"\n')
    assert cli.main(["stop", "--config", str(file), "--device", link]) == 1
    own = board_of(*Settings({"board.kind": kind}).board())
    # How many repeats follow hangs on whether the host holds the command up: test_stop_port.py has their times.
    whole = own.burst * (1 + len(own.repeats_ns[SUPERVISOR_ROW]))
    assert came(master, len(own.burst))[: len(own.burst)] == whole[: len(own.burst)]


WORDS = ("[device]\n", "[stop]\n", "path", "wait_s", " = ", "0x", "f" * 500, "[" * 40, "{a=", "'", '"""', "\n")
FRAGMENTS = st.sampled_from([*WORDS, "\ufeff", "é"])
FILES = st.binary() | st.text().map(str.encode) | st.lists(FRAGMENTS).map(lambda parts: "".join(parts).encode())


@given(content=FILES)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=amount(80, 1000))
def test_no_bytes_of_a_file_keep_the_stop_from_the_wire(content: bytes, board: tuple[str, int], file: Path) -> None:
    link, master = board
    instance.remember(instances.make_runtime_dir("failstop"), instance.Last(link, "failstop run", ()))
    file.write_bytes(content)
    cli.main(["stop", "--config", str(file), "--wait", "0"])
    gets(master, BURST)


@pytest.mark.parametrize("ends", ["in time", "by ctrl-c"])
def test_a_stop_that_was_not_written_says_that_a_wheel_may_turn(ends: str, board: tuple[str, int]) -> None:
    """The plug is out: the other side of the pty is gone, and its path with it."""
    link, master = board
    os.dup2(os.open(os.devnull, os.O_RDONLY), master)
    command = [*FAILSTOP, "stop", "--device", link, "--wait", "1.1" if ends == "in time" else "60"]
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        assert process.stderr
        assert f"no device {link}" in process.stderr.readline()  # it goes on trying
        if ends == "by ctrl-c":
            process.send_signal(signal.SIGINT)
        out, err = process.communicate(timeout=20)
    assert (process.returncode, out) == (1 if ends == "in time" else 130, "")
    assert err.endswith(f"{MAY_TURN}\n")


@pytest.mark.parametrize("stderr", ["pipe", "full disk"])
def test_nobody_to_tell_it_to_is_no_reason_not_to_stop(stderr: str, board: tuple[str, int], file: Path) -> None:
    """Of a file that is wrong before the stop, and of the stop."""
    link, master = board
    file.write_text(f'device.path = "{link}"\nstop.wait_s = "long"\n')
    with open("/dev/full", "w") as full:
        to = subprocess.PIPE if stderr == "pipe" else full
        command = [*FAILSTOP, "stop", "--config", str(file)]
        done = subprocess.run(command, stdout=full, stderr=to, text=True, timeout=20, check=False)
    assert done.returncode == 1
    sent = (
        f"failstop: stop frame for {BOARD.name} sent (after 0.0 s), directly to {link}; "
        "no settings name another board\n"
        f"{unanswered(link)}"
    )
    assert (done.stderr or "").endswith(sent * (to != full))
    gets(master, BURST)


# Your own board, and files of other users.

BREAKS = {
    "a syntax error": lambda wire: wire.write_text("WIRE = (\n"),
    "another vocabulary": lambda wire: wire.write_text(wire.read_text().replace("VOCABULARY = 1", "VOCABULARY = 9")),
    "another user's": lambda wire: os.chown(wire, NOBODY, NOBODY),
    "an end of the process": lambda wire: wire.write_text("VOCABULARY = 1\nimport os\nos._exit(3)\n"),
    "gone": lambda wire: wire.unlink(),
}


@pytest.mark.parametrize("broken", BREAKS)
@pytest.mark.skipif(os.geteuid() != 0, reason="only root gives a file to another user")
def test_the_stop_of_an_own_board_is_written_whatever_became_of_its_description(
    broken: str, board: tuple[str, int], tmp_path: Path
) -> None:
    link, master = board
    folder = own_folder(tmp_path / "tank")
    own = board_of(folder, 0.08, 0.0)
    kind = instance.Last(link, "failstop run", (), folder, kept.pack_stop(own))
    instance.remember(instances.make_runtime_dir("failstop"), kind)
    BREAKS[broken](Path(folder, "wire.py"))
    done = subprocess.run([*FAILSTOP, "stop", "hand near"], capture_output=True, text=True, check=False)
    assert (done.returncode, done.stderr) == (0, "")
    assert came(master, len(own.burst)).startswith(own.burst)
    assert "nobody knows whether the board has heard the stop, because its description can't be used" in done.stdout


@pytest.mark.parametrize("by", ["the last run", "the file"])
def test_the_stop_goes_out_at_the_baud_rate_of_the_board(by: str, board: tuple[str, int], file: Path) -> None:
    link, master = board
    arduino = board_of("arduino", 0.08, 0.0, baud=115_200)
    if by == "the last run":
        run = instance.Last(link, "failstop run", (), "arduino", kept.pack_stop(arduino))
        instance.remember(instances.make_runtime_dir("failstop"), run)
        words = []
    else:
        file.write_text(f'device.path = "{link}"\nboard.kind = "arduino"\nboard.baud = 115200\n')
        words = ["--config", str(file)]
    assert cli.main(["stop", *words]) == 1, "nothing answers"
    assert termios.tcgetattr(master)[4:6] == [termios.B115200] * 2
    assert came(master, len(arduino.burst)).startswith(arduino.burst)


@pytest.mark.parametrize("kind", BOARDS)
def test_the_stop_of_every_board_can_be_kept(kind: str) -> None:
    board = board_of(kind, 0.08, 0.0)
    known = kept.unpack_stop(kept.pack_stop(board))
    assert known
    assert (known.burst, known.idle_ns, known.after_ns) == (board.burst, board.idle_ns, board.after_ns)
    assert known.repeats_ns[SUPERVISOR_ROW] == board.repeats_ns[SUPERVISOR_ROW]


def test_a_kept_stop_that_is_nonsense_is_none() -> None:
    good = kept.pack_stop(board_of("arduino", 0.08, 0.0)).split(" ")
    assert kept.unpack_stop(" ".join(good)) is not None
    for at, wrong in ((0, "-1"), (0, "x"), (3, "9" * 20), (5, "1,x"), (5, ",".join("1" * 32)), (6, "0g"), (6, "")):
        assert kept.unpack_stop(" ".join([*good[:at], wrong, *good[at + 1 :]])) is None, (at, wrong)
    for other in ("", "stop", " ".join(good[:-1]), " ".join([*good, "00"])):
        assert kept.unpack_stop(other) is None


@pytest.mark.skipif(os.geteuid() != 0, reason="only root drops to another user")
def test_a_port_that_another_user_s_file_names_and_that_is_not_theirs_is_not_written(
    board: tuple[str, int], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """Root's stop goes to the port of root's own settings."""
    link, master = board
    other, theirs = pty.openpty()
    os.chmod(os.ttyname(theirs), 0o600)
    where = instances.make_runtime_dir("failstop")
    instance.remember(where, instance.Last(os.ttyname(theirs), "failstop run", (), "rrc"))
    for path in (where, instance.last_path(where)):
        os.chown(path, NOBODY, NOBODY)
    settings = Path(config.installed("failstop"))
    settings.parent.mkdir(parents=True)
    settings.write_text(f'device.path = "{link}"\n')
    assert cli.main(["stop"]) == 1
    gets(master, BURST)
    told = capsys.readouterr().err
    assert "the port of the last run, may not be opened by the user who made that run" in told
    assert f"so the stop went to {link}. If that is not the board," in told
    settings.unlink()
    assert cli.main(["stop", "--wait", "0"]) == 1
    said = capsys.readouterr().err
    assert f"a file of nobody (uid {NOBODY}) names {os.ttyname(theirs)}, but that user may not open it: name" in said
    os.set_blocking(other, False)
    with pytest.raises(BlockingIOError):
        os.read(other, 1)
    assert cli.main(["stop", "--device", os.ttyname(theirs)]) == 1, "a person who names it may"
    gets(other, BURST)
    os.close(other)
    os.close(theirs)


def test_a_stop_does_not_wait_for_somebody_to_read_what_it_prints(board: tuple[str, int]) -> None:
    """Its output is a full pipe, as of a program that starts it and does not read, and it has something to say before
    it writes the stop."""
    link, master = board
    reads, writes = os.pipe()
    os.set_blocking(writes, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(writes, b"." * 4096)
    os.set_blocking(writes, True)
    words = (*FAILSTOP, "stop", "--end-service", "--device", link)
    with subprocess.Popen(words, stdout=writes, stderr=writes) as stop:
        os.close(writes)
        gets(master, BURST)
        assert stop.poll() is None, "it has more to say"
        said = b""
        while chunk := os.read(reads, 65536):
            said += chunk
        assert stop.wait(10) == 1
    os.close(reads)
    assert said.lstrip(b".").startswith(b"failstop: nothing killed"), said[-500:]
    assert b"stop frame sent" in said
