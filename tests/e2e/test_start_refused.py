"""A start that is refused: wheels that turn are stopped all the same, one line says why, and nothing is left.

The wheels turn as after a crash: the board keeps the speed that somebody gave it, and nobody drives any more.
"""

from __future__ import annotations

import contextlib
import glob
import os
import resource
import shutil
import signal
import subprocess
import sys
from argparse import Namespace
from collections.abc import Callable, Iterator
from pathlib import Path

import psutil
import pytest

from failstop import instances
from failstop.board import finder, kept
from failstop.board.interface import Board
from failstop.board.kinds import board_of
from failstop.board.port import open_port
from failstop.board.rrc.board import BOARD
from failstop.cli.commands import run
from failstop.files import instance, root
from failstop.messages import layout
from failstop.procs.rights import DESCRIPTORS
from failstop.supervisor.blackbox import MOST_SAVERS
from failstop_lab.sim.client import SimBoard
from failstop_lab.trial import Trial, wait_for
from tests.support.children import needs_root
from tests.support.commands import FAILSTOP, failstop
from tests.support.shared_trial import goes_on

LIMITS = {
    "no file may grow": (resource.RLIMIT_FSIZE, 0),
    "no file may grow to a segment": (resource.RLIMIT_FSIZE, 65536),
    "as many descriptors as Python needs": (resource.RLIMIT_NOFILE, 6),
    **{f"{files} descriptors": (resource.RLIMIT_NOFILE, files) for files in (8, 40, DESCRIPTORS - 1)},
}
LACKING = f"failstop: RLIMIT_NOFILE is {{}}, and {DESCRIPTORS} open files are needed: raise it"
FULL = {
    "/run without a directory more": ("/run", "nr_inodes=1", "", "No space left"),
    "/run with room for the lock alone": ("/run", "nr_inodes=4", "", "No space left"),
    "/run without a byte more": ("/run", "size=4k", "head -c 4096 /dev/zero > {where}/full", "No space left"),
    "/dev/shm without a byte more": ("/dev/shm", "size=4k", "head -c 4096 /dev/zero > {where}/full", "no room"),
    "/dev/shm with room for a part": ("/dev/shm", "size=700k", "", "no room"),
}


NOBODY_KNOWS = (
    "the stop of the STM32 controller of Hiwonder's robots is written to {}; if another board is there, use the POWER "
    "SWITCH"
)


@pytest.fixture(scope="module")
def one_board(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SimBoard]:
    with SimBoard(tmp_path_factory.mktemp("refused") / "board") as made:
        yield made


@pytest.fixture
def board(one_board: SimBoard) -> SimBoard:
    """Its wheels turn."""
    turn(one_board)
    return one_board


def turn(board: SimBoard) -> None:
    """Give the wheels a speed, and leave."""
    turn_at(board, BOARD, 4)


def turn_at(board: SimBoard, own: Board, motors: int) -> None:
    port = open_port(board.link, exclusive=False, line=own.port)
    os.write(port, own.motor_speeds((1.0,) * motors, 2.0))
    board.wait_wheels(turning=True, timeout_s=5.0)
    os.close(port)
    board.events()


def refused(board: SimBoard, *command: str, before: Callable[[], None] | None = None) -> str:
    """Run it; returns the one line that it says, once the wheels have come to rest."""
    result = subprocess.run(
        command, capture_output=True, text=True, timeout=20.0, check=False, preexec_fn=before, stdin=subprocess.DEVNULL
    )
    assert result.returncode == 1, result.stderr
    said = result.stderr
    assert "Traceback" not in said
    assert said.count("\n") == 1, said
    board.wait_wheels(turning=False, timeout_s=5.0)
    events = [event for event in board.events() if event.is_motor]
    assert events[0].is_stop
    assert not any(event.is_motion for event in events)
    return f"{said}{result.stdout}"


def service(name: str, board: SimBoard) -> tuple[str, ...]:
    """The command that starts it."""
    return (*FAILSTOP, "run", "--name", name, "--device", board.link)


def left(name: str) -> list[str]:
    """Files that a run of this name has left, but for its lock."""
    places = [path for place in instance.places(name) for path in glob.glob(f"{place}/*")]
    return [path for path in glob.glob(f"/dev/shm/failstop.{name}.*") + places if os.path.basename(path) != "lock"]


@pytest.mark.parametrize("limit", LIMITS)
def test_limits_of_the_process(name: str, board: SimBoard, limit: str) -> None:
    which, most = LIMITS[limit]
    said = refused(board, *service(name, board), before=lambda: resource.setrlimit(which, (most, most)))
    assert ("ulimit -n" if which == resource.RLIMIT_NOFILE else "File too large") in said
    if which == resource.RLIMIT_NOFILE and most >= 8:
        assert said.startswith(LACKING.format(most))
    if most != 65536:  # else the supervisor says it, in its own words
        assert f"the stop is written to {board.link}" in said
    assert left(name) == []


ISOLATED = (sys.executable, "-I", "-m", "failstop")
"""The arguments of the package's command. Without -I the interpreter itself needs more than 80 KB of stack before it
has read a line of any program; Python 3.14 needs more than 64 KB with it."""


@pytest.mark.parametrize("most_kb", [40 if sys.version_info < (3, 14) else 100, 255])
def test_too_small_a_stack_is_told_after_the_stop(name: str, board: SimBoard, most_kb: int) -> None:
    """The supervisor would be ended by SIGSEGV, without a word."""
    most = most_kb * 1024
    command = *ISOLATED, *service(name, board)[len(FAILSTOP) :]
    said = refused(board, *command, before=lambda: resource.setrlimit(resource.RLIMIT_STACK, (most, most)))
    assert f"RLIMIT_STACK is {most_kb} KB, and 256 KB are needed: raise it (`ulimit -s 8192`" in said
    assert f"the stop is written to {board.link}" in said
    assert left(name) == []


@needs_root
@pytest.mark.skipif(shutil.which("unshare") is None, reason="needs unshare")
@pytest.mark.parametrize("full", FULL)
def test_a_full_file_system(name: str, board: SimBoard, full: str) -> None:
    place, options, fill, told = FULL[full]
    where = root.at(place) if place == "/run" else place
    if subprocess.run(["unshare", "--mount", "true"], check=False).returncode:
        pytest.skip("this machine lets nobody mount anything")
    script = (
        f'mount -t tmpfs -o {options} tmpfs {where} || exit 99; {fill.format(where=where) or ":"}; "$@"; code=$?; '
        f"find {root.at('/run/failstop')}/{name} /dev/shm -mindepth 1 -name '*{name}*' -o -path '*/{name}/*' "
        "2>/dev/null; exit $code"
    )
    said, *rest = refused(
        board, "unshare", "--mount", "sh", "-c", script, "sh", *service(name, board)
    ).splitlines()  # fmt: skip
    assert told in said
    assert {os.path.basename(path) for path in rest} <= {"lock"}, rest


@pytest.mark.claim("START-1")
@pytest.mark.parametrize(
    ("text", "told", "written"),
    [
        ("[gate]\nlease_s = 9.0\n", "gate.lease_s = 9.0: it must be 0.04 to 1 s", "the stop is written to {}"),
        ("nonsense", "is not TOML", NOBODY_KNOWS),
        (None, "check the path", NOBODY_KNOWS),
    ],
    ids=["a bad value", "no TOML", "no file"],
)  # fmt: skip
def test_settings_that_are_refused(
    name: str, board: SimBoard, tmp_path: Path, text: str | None, told: str, written: str
) -> None:
    file = tmp_path / "failstop.toml"
    if text is not None:
        file.write_text(text)
    said = refused(board, *service(name, board), "--config", str(file))
    assert told in said
    assert written.format(board.link) in said


@pytest.mark.claim("START-1")
@pytest.mark.parametrize("kind", ["ugv", "vesc"])
def test_with_settings_that_cannot_be_read_the_stop_is_that_of_the_last_run_s_board(tmp_path: Path, kind: str) -> None:
    """The bytes that stop one board mean nothing to another."""
    (tmp_path / "failstop.toml").write_text("nonsense")
    with Trial(f"unread-{os.getpid()}-{kind}", kind=kind) as trial:
        trial.enable()
        trial.drive(0.3)
        trial.service.pids()
        assert trial.turning()
        trial.service.kill_known()
        trial.service.kill()
        trial.leave()
        wait_for("all processes to be gone", trial.service.gone)
        trial.board.events()
        said = refused(trial.board, *FAILSTOP, "run", "--name", trial.name, "--config", str(tmp_path / "failstop.toml"))
        assert "is not TOML" in said
        assert f"the stop of the last run's board is written to {trial.link}" in said
        assert not trial.turning()


@pytest.fixture(scope="module")
def arduino(tmp_path_factory: pytest.TempPathFactory) -> Iterator[SimBoard]:
    with SimBoard(tmp_path_factory.mktemp("refused") / "arduino", board="arduino") as made:
        yield made


LAST_RUN_S = "the stop of the last run's board is written to {}"
BOARD_WRONG = {
    "a kind that does not exist": 'device.path = "{}"\nboard.kind = "ardiuno"\n',
    "a baud rate that is a text": 'device.path = "{}"\nboard.kind = "arduino"\nboard.baud = "57600"\n',
    "a CAN id that is a text": 'device.path = "{}"\nboard.kind = "vesc"\nboard.can_id = "one"\n',
    "a kind below another table": 'device.path = "{}"\n[device]\nboard.kind = "arduino"\n',
    "a port below another table": '[board]\nkind = "arduino"\ndevice.path = "{}"\n',
    "a folder that does not exist": 'device.path = "{}"\nboard.kind = "/nowhere/tank"\n',
}


@pytest.mark.claim("START-1")
@pytest.mark.parametrize("wrong", BOARD_WRONG)
def test_a_board_that_is_named_wrong_gets_the_stop_of_the_last_run_at_its_port(
    name: str, arduino: SimBoard, tmp_path: Path, wrong: str
) -> None:
    """Another board's bytes would mean nothing to it, and nobody would be warned."""
    own = board_of("arduino", 0.08, 0.0)
    last = instance.Last(arduino.link, "failstop run", (), "arduino", kept.pack_stop(own))
    instance.remember(instances.make_runtime_dir(name), last)
    turn_at(arduino, own, 2)
    file = tmp_path / "failstop.toml"
    file.write_text(BOARD_WRONG[wrong].format(arduino.link))
    assert LAST_RUN_S.format(arduino.link) in refused(arduino, *FAILSTOP, "run", "--name", name, "--config", str(file))


@pytest.mark.parametrize(("kind", "baud"), [("rcr", "0"), ("rrc", '"1"')], ids=["kind", "baud rate"])
def test_a_board_that_is_named_wrong_at_a_new_port_is_told_with_the_stop(
    name: str, board: SimBoard, tmp_path: Path, kind: str, baud: str
) -> None:
    last = instance.Last("/dev/ttyUSB7", "failstop run", (), "arduino", kept.pack_stop(board_of("arduino", 0.08, 0.0)))
    instance.remember(instances.make_runtime_dir(name), last)
    file = tmp_path / "failstop.toml"
    file.write_text(f'device.path = "{board.link}"\nboard.kind = "{kind}"\nboard.baud = {baud}\n')
    said = refused(board, *FAILSTOP, "run", "--name", name, "--config", str(file))
    assert NOBODY_KNOWS.format(board.link) in said


@pytest.mark.parametrize("text", ["nonsense", 'device.path = 7\nboard.kind = "arduino"\n'], ids=["no TOML", "no port"])
def test_another_device_at_the_port_of_the_last_run_gets_no_bytes(
    name: str, board: SimBoard, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, text: str
) -> None:
    """A lidar, for example, has taken the number of a board that is unplugged."""
    file = tmp_path / "failstop.toml"
    file.write_text(text)
    stop = kept.pack_stop(board_of("arduino", 0.08, 0.0))
    last = instance.Last(board.link, "failstop run", (), "arduino", stop, usb="2341|0043|A1|1.0|1-1")
    instance.remember(instances.make_runtime_dir(name), last)
    options = Namespace(name=name, config=str(file), device=None)
    first: list[str] = []
    for now in (last.usb, "10c4|ea60|0001|1.0|1-2"):
        monkeypatch.setattr(finder, "usb_text", lambda _, now=now: now)
        device, _, _, _, guessed = run._device(options)
        first.append(device)
        assert guessed == (device != board.link), "a port that nobody has named is looked at before it is opened"
    assert first == [board.link, "/dev/ttyACM0"]


def test_the_device_is_taken_from_settings_that_are_refused(name: str, board: SimBoard, tmp_path: Path) -> None:
    file = tmp_path / "failstop.toml"
    file.write_text(f'[device]\npath = "{board.link}"\n[gate]\nlease_s = 9.0\n')
    said = refused(board, *FAILSTOP, "run", "--name", name, "--config", str(file))
    assert "gate.lease_s = 9.0: it must be" in said
    assert f"the stop is written to {board.link}" in said


def test_a_bad_name(board: SimBoard) -> None:
    assert "use 1 to 32 of a-z" in refused(board, *service("no/slash", board))


def test_a_name_that_is_taken_by_a_service_on_another_port(trial: Trial, board: SimBoard) -> None:
    """The running service drives on; this port is nobody's, and its wheels turn."""
    trial.enable()
    goes_on(trial)
    said = refused(board, *service(trial.name, board))
    assert f"'{trial.name}' is already running (pid {trial.service.pids()['supervisor']})" in said
    assert f"the stop is written to {board.link}" in said
    goes_on(trial)
    result = failstop("run", "--name", trial.name, "--device", trial.link)
    assert (result.returncode, result.stderr.count("\n")) == (1, 1)
    assert result.stderr.endswith("): stop it first, or choose another --name\n")
    goes_on(trial)
    assert trial.robot.state.estop is None, "on its own port nobody stops it"


def test_a_full_pipe_for_its_words_does_not_hold_up_the_stop(name: str, board: SimBoard, tmp_path: Path) -> None:
    """Nobody reads what it says."""
    reading, writing = os.pipe()
    os.set_blocking(writing, False)
    with contextlib.suppress(BlockingIOError):
        while True:
            os.write(writing, bytes(4096))
    os.set_blocking(writing, True)
    file = tmp_path / "failstop.toml"
    file.write_text("nonsense")
    process = subprocess.Popen([*service(name, board), "--config", str(file)], stderr=writing)
    try:
        board.wait_wheels(turning=False, timeout_s=10.0)
    finally:
        process.send_signal(signal.SIGKILL)
        process.wait()
        os.close(reading)
        os.close(writing)


# What is no port, and limits that are too low for other commands.


@pytest.mark.parametrize("file", ["ttyNONE", "plain"])
def test_what_is_no_port_is_told_in_one_line(name: str, tmp_path: Path, file: str) -> None:
    (tmp_path / "plain").write_bytes(b"untouched")
    device = str(tmp_path / file)
    result = failstop("run", "--name", name, "--device", device)
    told = {"ttyNONE": f"failstop: no device {device}: plug the board in", "plain": "regular file, not a serial port"}
    assert (result.returncode, result.stderr.count("\n")) == (1, 1)
    assert told[file] in result.stderr
    assert (tmp_path / "plain").read_bytes() == b"untouched"
    assert failstop("status", "--name", name).returncode == 3


def test_the_service_needs_no_more_descriptors_than_it_asks_for(fresh: Trial) -> None:
    for number in range(MOST_SAVERS):
        fresh.robot.estop(f"number {number}")
        wait_for("the latch", lambda: fresh.robot.state.estop is not None)
        wait_for("a reset", fresh.reset)
    supervisor = psutil.Process(fresh.service.pids()["supervisor"])
    wait_for("the savers", lambda: len(supervisor.children()) == 4 + MOST_SAVERS)
    most = len(os.listdir(f"/proc/{supervisor.pid}/fd"))
    assert most + len(layout.PROCESS_NAMES) <= DESCRIPTORS, "with those of a dead run's segments"


@pytest.mark.parametrize(
    ("files", "word", "code", "told"),
    [
        (8, "status", 1, LACKING.format(8)),
        *((files, "enable", 1, LACKING.format(files)) for files in range(8, 14)),
        (40, "demo", 1, f"the service ended: {LACKING.format(40)}"),
        (8, "estop", 1, "look at the wheels"),  # it can't see whether the stop was written
    ],
)
def test_too_few_descriptors_are_one_line_and_enough_for_a_stop(
    trial: Trial, files: int, word: str, code: int, told: str
) -> None:
    words = [word] if word == "demo" else [word, "--name", trial.name]
    command = ["/bin/sh", "-c", f'ulimit -n {files}; exec "$@"', "sh", *FAILSTOP, *words]
    result = subprocess.run(command, capture_output=True, text=True, timeout=60, check=False)
    assert result.returncode == code
    assert told in result.stderr
    assert result.stderr.count("\n") == 1 or not code
    assert "Traceback" not in result.stderr
    assert str(trial.robot.state.estop).startswith("stop request") is (word == "estop")
