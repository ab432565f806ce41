"""`failstop stop` as systemd and people run it: where to, for how long, and what a bad file does to it."""

from __future__ import annotations

import os
import pty
import re
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
from failstop.board.interface import SUPERVISOR, Board
from failstop.board.kinds import board_of
from failstop.board.port import PortError
from failstop.board.rrc.board import BOARD
from failstop.cli import main as cli
from failstop.cli.commands import stop
from failstop.files import instance, root
from failstop.lab.machine.files import Directory
from failstop.lab.machine.kernel import Process
from failstop.lab.machine.port import Port
from failstop.lab.machine.robot import Robot
from failstop.policy.settings import BOARDS, Settings
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
    """As on a machine where no service runs and none is installed; the folder for installed files."""
    monkeypatch.setenv("XDG_RUNTIME_DIR", str(tmp_path / "run"))
    monkeypatch.setenv(root.VARIABLE, str(tmp_path))
    folder = Path(f"{tmp_path}{config.FOLDER}")
    folder.mkdir(parents=True)
    (tmp_path / "run").mkdir()
    return folder


# On a simulated machine: which port, and for how long.

FILE = "/root/failstop.toml"
PORTS = ("board", "other", "ttyACM0", "last", "left")


class Heard:
    """The board's side of a port."""

    def __init__(self) -> None:
        self.data = b""

    def receive(self, data: bytes) -> None:
        self.data += data


class Tool:
    """`failstop stop` on a machine without a service, with a board at each of PORTS or at none."""

    def __init__(self) -> None:
        self.lab = Robot()
        self.lab.unplug()
        self.machine = self.lab.machine
        self.failed: list[object] = []
        self.machine.told = lambda kind, process, what: self.failed.append(what) if kind == "failed" else None
        self.lab.join("test")
        self.boards: dict[str, Heard] = {}
        self.environ: dict[str, str] = {}

    def last_run(self, device: str, *servos: int, name: str = "failstop") -> None:
        """A service that somebody has started by hand, and that has died, was on this port."""
        load = self.lab.loader.load
        found = load("failstop.files.instance")
        found.remember(load("failstop.instances").make_runtime_dir(name), found.Last(device, "failstop run", servos))

    def run(self, *words: str) -> tuple[int, str, str]:
        return self.lab.command(("stop", *words), environ=self.environ)

    def plug(self, *names: str) -> None:
        """Boards at these ports below /dev."""
        folder = self.machine.root.names["dev"]
        assert isinstance(folder, Directory)
        for number, name in enumerate(names):
            port = Port(self.machine, number)
            port.board = self.boards[f"/dev/{name}"] = Heard()
            folder.put(name, port)

    def waits(self, *words: str) -> tuple[str, float]:
        """Where no board is: which port is tried, and for how many seconds."""
        begun_ns = self.machine.now_ns
        code, _, err = self.run(*words)
        found = re.fullmatch(r"failstop: no device (\S+?):? .*", err.splitlines()[-1])
        assert found, err
        assert code == 1
        return found[1], round((self.machine.now_ns - begun_ns) / 1e9, 1)

    def goes(self, *words: str) -> tuple[int, str, str, str]:
        """Where there are boards: the exit code, the one that has the burst, what is printed, errors."""
        self.plug(*PORTS)
        code, out, err = self.run(*words)
        assert self.failed == []
        (device,) = (device for device, heard in self.boards.items() if heard.data)
        assert self.boards[device].data == BURST
        return code, device, out, err


@pytest.fixture
def tool() -> Tool:
    return Tool()


@pytest.mark.parametrize(
    ("text", "words", "device", "wait_s"),
    [
        (None, "", "/dev/ttyACM0", 30.0),
        ('[device]\npath = "/dev/board"\n[stop]\nwait_s = 5\n', f"--config {FILE}", "/dev/board", 5.0),
        (
            '[device]\npath = "/dev/board"\n[stop]\nwait_s = 5\n',
            f"--config {FILE} --device /dev/other --wait 0.5",
            "/dev/other",
            0.5,
        ),
        (
            '[device]\npath = "/dev/board"\n[gate]\nlease_s = 99\nnonsense = 1\n',
            f"--config {FILE}",
            "/dev/board",
            30.0,
        ),
        (None, f"--config {FILE} --device /dev/board", "/dev/board", 30.0),
        (None, "--end-service --wait 3", "/dev/ttyACM0", 3.0),
        (None, "--end-service --device /dev/board", "/dev/board", 12.0),
    ],
    ids=["default", "file", "options before it", "a mistake elsewhere", "a bad file", "shorter", "at the end"],
)
def test_it_tries_the_port_that_is_named_for_as_long_as_is_said(
    tool: Tool, text: str | None, words: str, device: str, wait_s: float
) -> None:
    if text:
        tool.lab.write(FILE, text)
    if "--end-service" in words:
        in_service(tool)
    assert tool.waits(*words.split()) == (device, pytest.approx(wait_s, abs=0.1))
    assert tool.goes(*words.split())[:2] == (0, device)


def test_a_wait_that_is_not_allowed_costs_the_wait_alone(tool: Tool) -> None:
    tool.lab.write(FILE, '[device]\npath = "/dev/board"\n[stop]\nwait_s = "long"\n')
    assert tool.waits("--config", FILE) == ("/dev/board", pytest.approx(30.0, abs=0.1))
    code, device, _, err = tool.goes("--config", FILE)
    said = "failstop: stop.wait_s = 'long': a number is expected, 0 to 3600 s; going on without it\n"
    assert (code, device, err) == (0, "/dev/board", said)


@pytest.mark.parametrize("text", [None, "[device\n", "[device]\npath = 7\n"])
def test_a_file_that_says_nothing_stops_the_default_port_and_says_so(tool: Tool, text: str | None) -> None:
    if text is not None:
        tool.lab.write(FILE, text)
    assert tool.waits("--config", FILE) == ("/dev/ttyACM0", pytest.approx(30.0, abs=0.1))
    code, device, _, err = tool.goes("--config", FILE)
    assert (code, device) == (1, "/dev/ttyACM0")
    first, last = err.splitlines()
    assert first.endswith("; going on without it")
    assert last == "failstop: it went to /dev/ttyACM0, the default: is this the board? Name it with --device"


def test_the_installed_file_counts_where_none_is_named(tool: Tool) -> None:
    tool.lab.write(f"{config.FOLDER}/failstop.toml", 'device.path = "/dev/board"\nstop.wait_s = 5\n')
    assert tool.waits() == ("/dev/board", pytest.approx(5.0, abs=0.1))
    assert tool.goes()[:2] == (0, "/dev/board")


def test_of_another_name_the_default_is_a_guess(tool: Tool) -> None:
    code, device, _, err = tool.goes("--name", "left")
    assert (code, device) == (1, "/dev/ttyACM0")
    assert "is this the board? Name it with --device" in err
    tool.lab.write(f"{config.FOLDER}/left.toml", 'device.path = "/dev/left"\n')
    assert Tool.run(tool, "--name", "left")[0] == 0
    assert tool.boards["/dev/left"].data == BURST


@pytest.mark.parametrize("name", ["no/slash", ""])
def test_what_can_be_no_name_stops_all_the_same(tool: Tool, name: str) -> None:
    assert tool.goes("--name", name)[:2] == (1, "/dev/ttyACM0")


@pytest.mark.parametrize("wait", ["nan", "inf", "-1", "3601"])
def test_a_wait_without_an_end_is_refused(tool: Tool, wait: str) -> None:
    tool.plug(*PORTS)
    said = f"failstop: --wait = {float(wait)!r}: allowed is 0 to 3600 s\n"
    assert tool.run(f"--wait={wait}") == (1, "", said)
    assert not any(heard.data for heard in tool.boards.values())


def test_whatever_goes_wrong_with_a_service_the_port_is_written_to(tool: Tool) -> None:
    def fail(thread: object, call: str, about: tuple[object, ...]) -> None:
        if str(about[:1]).startswith("('/run/failstop"):
            tool.machine.at_seam = None
            raise ZeroDivisionError("a defect")

    tool.machine.at_seam = fail
    code, device, _, err = tool.goes()
    assert (code, device) == (0, "/dev/ttyACM0")
    assert "no service can be asked (a defect): writing to the port itself" in err


def test_the_last_run_s_port_goes_before_what_a_file_says(tool: Tool) -> None:
    tool.lab.write(f"{config.FOLDER}/failstop.toml", 'device.path = "/dev/board"\nstop.wait_s = 5\n')
    tool.last_run("/dev/last")
    assert tool.goes()[:2] == (0, "/dev/last")


@pytest.mark.parametrize(("words", "device"), [(f"--config {FILE}", "board"), ("--device /dev/other", "other")])
def test_what_is_named_goes_before_the_last_run_s_port(tool: Tool, words: str, device: str) -> None:
    tool.last_run("/dev/last")
    tool.lab.write(FILE, 'device.path = "/dev/board"\n')
    assert tool.goes(*words.split())[:2] == (0, f"/dev/{device}")


def test_the_last_run_of_another_name_is_no_guess_at_all(tool: Tool) -> None:
    tool.last_run("/dev/left", name="left")
    sent = "stop frame sent (after 0.0 s), directly to"
    assert tool.goes("--name", "left")[:3] == (
        0,
        "/dev/left",
        f"{sent} /dev/left, the port of the last run (no service 'left' runs)\n",
    )
    assert tool.run() == (0, f"{sent} /dev/ttyACM0 (no service 'failstop' runs)\n", "")


# At the end of the service.


def in_service(tool: Tool, *others: int, group: str = "0::/system.slice/failstop.service\n") -> None:
    """As systemd runs it, after the service, with these processes in its control group."""
    tool.environ["SERVICE_RESULT"] = "watchdog"
    for pid in ("self", *others):
        tool.lab.write(f"/proc/{pid}/cgroup", group)


def rest(tool: Tool) -> list[Process]:
    """What is left of the service: two processes."""
    return [tool.machine.process("left", lambda _: tool.machine.block()) for _ in range(2)]


def test_the_end_of_the_service_kills_the_rest_first(tool: Tool) -> None:
    left = rest(tool)
    in_service(tool, *(each.pid for each in left))

    def look(thread: object, call: str, about: tuple[object, ...]) -> None:
        assert all(each.dead for each in left) or about[:1] != ("/dev/ttyACM0",), "the port is not touched before"

    tool.machine.at_seam = look
    code, device, _, err = tool.goes("--end-service")
    assert (code, device, err) == (0, "/dev/ttyACM0", "failstop: killed what was left of the service: 2 processes\n")
    assert all(each.dead for each in left)


def test_what_does_not_end_is_said_and_the_stop_is_tried_all_the_same(tool: Tool) -> None:
    in_service(tool, *(each.pid for each in rest(tool)))

    def refuse(thread: object, call: str, about: tuple[object, ...]) -> None:
        if call == "kill":
            raise PermissionError(1, "Operation not permitted")

    tool.machine.at_seam = refuse
    code, device, _, err = tool.goes("--end-service")
    assert (code, device) == (0, "/dev/ttyACM0")
    assert "2 of them have not ended within 1 s" in err


def test_a_group_that_cannot_be_read_costs_no_stop(tool: Tool) -> None:
    in_service(tool)

    def refuse(thread: object, call: str, about: tuple[object, ...]) -> None:
        if about[:1] == ("/proc/self/cgroup",):
            raise PermissionError(13, "Permission denied", "/proc/self/cgroup")

    tool.machine.at_seam = refuse
    code, device, _, err = tool.goes("--end-service")
    assert (code, device) == (0, "/dev/ttyACM0")
    assert "cannot kill what is left of the service" in err


@pytest.mark.parametrize("why", ["not after a service", "of a login"])
def test_by_hand_it_ends_nothing(tool: Tool, why: str) -> None:
    """It would kill the caller's whole login."""
    left = rest(tool)
    groups = {"not after a service": "0::/system.slice/failstop.service\n", "of a login": "0::/user.slice/a.scope\n"}
    in_service(tool, *(each.pid for each in left), group=groups[why])
    if why == "not after a service":
        del tool.environ["SERVICE_RESULT"]
    code, device, _, err = tool.goes("--end-service")
    assert (code, device) == (1, "/dev/ttyACM0"), "stopped all the same"
    assert not any(each.dead for each in left)
    assert "by hand use `failstop stop` without it" in err


def test_at_the_end_of_the_service_a_port_that_takes_nothing_is_left_to_another_unit(tool: Tool) -> None:
    in_service(tool)
    tool.plug(*PORTS)
    folder = tool.machine.root.names["dev"]
    assert isinstance(folder, Directory)
    port = folder.names["board"]
    assert isinstance(port, Port)
    port.drains = False
    for words, least_s in (("--end-service", stop.STALLED_S), ("--wait 5", 5.0)):
        begun_ns = tool.machine.now_ns
        code, _, err = tool.run(*words.split(), "--device", "/dev/board")
        assert code == 1
        assert "takes no bytes" in err
        took_s = (tool.machine.now_ns - begun_ns) / 1e9
        assert least_s <= took_s <= least_s + 1.0, "the other unit goes on for as long as it is told to"


# On ptys and files of the machine that there is.


def last_run(device: str, *servos: int, name: str = "failstop") -> None:
    """A service that somebody has started by hand, and that has died, was on this port."""
    instance.remember(instances.make_runtime_dir(name), instance.Last(device, "failstop run", servos))


def test_the_last_run_s_port_is_written_to_at_once(board: tuple[str, int], capsys: pytest.CaptureFixture[str]) -> None:
    link, master = board
    last_run(link, 1, 10)
    assert cli.main(["stop"]) == 0
    expected = BURST + burst_with((1, 10))
    found = b""
    while len(found) < len(expected):
        found += os.read(master, 4096)
    assert found == expected
    assert f"directly to {link}, the port of the last run (" in capsys.readouterr().out


def test_where_the_last_run_s_port_has_gone_the_other_is_written_to_and_doubted(
    board: tuple[str, int], alone: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    link, master = board
    last_run("/dev/gone", 1)
    (alone / "failstop.toml").write_text(f'device.path = "{link}"\n')
    assert cli.main(["stop"]) == 1
    assert os.read(master, 4096) == BURST
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
    """It has the port before it can be asked."""
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


def test_the_burst_goes_to_the_port_of_the_file(board: tuple[str, int], file: Path) -> None:
    link, master = board
    file.write_text(f'[device]\npath = "{link}"\n')
    result = failstop("stop", "--config", str(file))
    sent = f"stop frame sent (after 0.0 s), directly to {link}\n"
    assert (result.returncode, result.stdout, result.stderr) == (0, sent, "")
    assert os.read(master, 4096) == BURST


@pytest.mark.parametrize("named", [True, False], ids=["port named", "port of the file"])
def test_the_arm_is_stopped_after_the_wheels_with_the_servos_that_can_be(
    named: bool, board: tuple[str, int], file: Path
) -> None:
    link, master = board
    servos = {"a": "3", "b": "1", "c": "0", "d": "[2]", "e": "1.5", "f": "true", "g": "3"}
    lines = [f'device.path = "{link}"', *(f"joints.{name}.servo = {value}" for name, value in servos.items())]
    file.write_text("\n".join(lines))
    result = failstop("stop", "--config", str(file), *(["--device", link] if named else []))
    assert (result.returncode, result.stderr) == (0, "")
    assert os.read(master, 4096) == BURST + BOARD.burst_with((1, 3))


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
def test_no_file_keeps_the_stop_from_the_wire(bad: str, board: tuple[str, int], file: Path) -> None:
    """The file says which board it is that is named with --device; a bad one keeps nothing back."""
    link, master = board
    BAD_FILES[bad](file)
    result = failstop("stop", "--config", str(file), "--device", link)
    assert result.returncode == 0
    assert result.stderr.startswith(f"failstop: configuration {file}")
    assert result.stderr.endswith("; going on without it\n")
    assert result.stderr.count("\n") == 1
    assert os.read(master, 4096) == BURST


@pytest.mark.parametrize("kind", BOARDS)
def test_the_stop_is_the_one_of_the_file_s_board(kind: str, board: tuple[str, int], file: Path) -> None:
    link, master = board
    file.write_text(f'board.kind = "{kind}"\n')
    assert failstop("stop", "--config", str(file), "--device", link).returncode == 0
    own = board_of(*Settings({"board.kind": kind}).board())
    assert os.read(master, 4096) == own.burst * (1 + len(own.repeats_ns[SUPERVISOR]))


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


FRAGMENTS = st.sampled_from(
    [
        "[device]\n",
        "[stop]\n",
        "path",
        "wait_s",
        " = ",
        "0x",
        "f" * 500,
        "[" * 40,
        "{a=",
        "'",
        '"""',
        "\n",
        "\ufeff",
        "é",
    ]
)
FILES = st.binary() | st.text().map(str.encode) | st.lists(FRAGMENTS).map(lambda parts: "".join(parts).encode())


@given(content=FILES)
@settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=300)
def test_no_bytes_of_a_file_keep_the_stop_from_the_wire(content: bytes, board: tuple[str, int], file: Path) -> None:
    link, master = board
    last_run(link)
    file.write_bytes(content)
    cli.main(["stop", "--config", str(file), "--wait", "0"])
    assert os.read(master, 4096) == BURST


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
    assert os.read(master, 4096) == BURST


def test_what_is_to_be_said_before_holds_no_stop_up(board: tuple[str, int], file: Path) -> None:
    """A file that is wrong is told of on a full disk."""
    link, master = board
    file.write_text(f'device.path = "{link}"\nstop.wait_s = "long"\n')
    with open("/dev/full", "w") as full:
        command = [*FAILSTOP, "stop", "--config", str(file)]
        assert subprocess.run(command, stdout=full, stderr=full, timeout=20, check=False).returncode == 0
    assert os.read(master, 4096) == BURST


def test_after_the_wait_exit_code_1_and_a_clear_message(tmp_path: Path, file: Path) -> None:
    """It warned after 1 s, once."""
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
