"""`failstop stop` as systemd and people run it: where to, for how long, and what a bad file does to it."""

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
from failstop.board.interface import BOARD
from failstop.board.port import PortError
from failstop.cli import main as cli
from failstop.cli.commands import stop
from failstop.shm import instance, root
from tests.support.commands import FAILSTOP, failstop

Waits = list[tuple[str, float]]


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
    monkeypatch.setattr(instance, "bases", lambda: [str(tmp_path / "run")])
    monkeypatch.setenv(root.VARIABLE, str(tmp_path))
    folder = Path(f"{tmp_path}{config.FOLDER}")
    folder.mkdir(parents=True)
    return folder


@pytest.fixture
def asked(monkeypatch: pytest.MonkeyPatch) -> Waits:
    """What the tool is asked for: (device, seconds)."""
    found: Waits = []

    def stopped(path: str, wait: Callable[[PortError], float], *_: object) -> float:
        found.append((path, wait(PortError("absent", f"no device {path}"))))
        return 0.0

    monkeypatch.setattr(stopping, "stop", stopped)
    return found


def test_by_default_30_s_for_the_default_port(asked: Waits) -> None:
    assert cli.main(["stop"]) == 0
    assert asked == [("/dev/ttyACM0", 30.0)]


def test_the_file_s_settings_are_taken(asked: Waits, file: Path) -> None:
    file.write_text('[device]\npath = "/dev/board"\n[stop]\nwait_s = 5\n')
    assert cli.main(["stop", "--config", str(file)]) == 0
    assert asked == [("/dev/board", 5.0)]


def test_options_go_before_the_file(asked: Waits, file: Path) -> None:
    file.write_text('[device]\npath = "/dev/board"\n[stop]\nwait_s = 5\n')
    assert cli.main(["stop", "--config", str(file), "--device", "/dev/other", "--wait", "0.5"]) == 0
    assert asked == [("/dev/other", 0.5)]


def test_a_mistake_elsewhere_in_the_file_does_not_keep_the_wheels_turning(asked: Waits, file: Path) -> None:
    file.write_text('[device]\npath = "/dev/board"\n[gate]\nlease_s = 99\nnonsense = 1\n')
    assert cli.main(["stop", "--config", str(file)]) == 0
    assert asked == [("/dev/board", 30.0)]


def test_a_wait_that_is_not_allowed_costs_the_wait_alone(
    asked: Waits, file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file.write_text('[device]\npath = "/dev/board"\n[stop]\nwait_s = "long"\n')
    assert cli.main(["stop", "--config", str(file)]) == 0
    assert asked == [("/dev/board", 30.0)]
    assert capsys.readouterr().err == (
        "failstop: stop.wait_s = 'long': a number is expected, 0 to 3600 s; going on without it\n"
    )


@pytest.mark.parametrize("text", [None, "[device\n", "[device]\npath = 7\n"])
def test_a_file_that_says_nothing_stops_the_default_port_and_says_so(
    text: str | None, asked: Waits, file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    if text is not None:
        file.write_text(text)
    assert cli.main(["stop", "--config", str(file)]) == 1
    assert asked == [("/dev/ttyACM0", 30.0)]
    first, last = capsys.readouterr().err.splitlines()
    assert first.endswith("; going on without it")
    assert last == "failstop: it went to /dev/ttyACM0, the default: is this the board? Name it with --device"


def test_the_installed_file_counts_where_none_is_named(asked: Waits, alone: Path) -> None:
    (alone / "failstop.toml").write_text('device.path = "/dev/board"\nstop.wait_s = 5\n')
    assert cli.main(["stop"]) == 0
    assert asked == [("/dev/board", 5.0)]


def test_of_another_name_the_default_is_a_guess(asked: Waits, alone: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["stop", "--name", "left"]) == 1
    assert asked == [("/dev/ttyACM0", 30.0)]
    assert "is this the board? Name it with --device" in capsys.readouterr().err
    (alone / "left.toml").write_text('device.path = "/dev/left"\n')
    assert cli.main(["stop", "--name", "left"]) == 0


def last_run(device: str, *servos: int, name: str = "failstop") -> None:
    """A service that somebody has started by hand, and that has died, was on this port."""
    instance.remember(instances.make_runtime_dir(name), instance.Last(device, "failstop run", servos))


def test_the_last_run_s_port_goes_before_what_a_file_says(asked: Waits, alone: Path) -> None:
    (alone / "failstop.toml").write_text('device.path = "/dev/board"\nstop.wait_s = 5\n')
    last_run("/dev/last")
    assert cli.main(["stop"]) == 0
    assert asked == [("/dev/last", 5.0)]


def test_what_is_named_goes_before_the_last_run_s_port(asked: Waits, file: Path) -> None:
    last_run("/dev/last")
    file.write_text('device.path = "/dev/board"\n')
    assert cli.main(["stop", "--config", str(file)]) == 0
    assert cli.main(["stop", "--device", "/dev/other"]) == 0
    assert [device for device, _ in asked] == ["/dev/board", "/dev/other"]


def test_the_last_run_of_another_name_is_no_guess_at_all(asked: Waits, capsys: pytest.CaptureFixture[str]) -> None:
    last_run("/dev/left", name="left")
    assert cli.main(["stop", "--name", "left"]) == 0
    assert cli.main(["stop"]) == 0
    assert [device for device, _ in asked] == ["/dev/left", "/dev/ttyACM0"]
    assert capsys.readouterr().out == (
        "stop frame sent (after 0.0 s), directly to /dev/left, the port of the last run (no service 'left' runs)\n"
        "stop frame sent (after 0.0 s), directly to /dev/ttyACM0 (no service 'failstop' runs)\n"
    )


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


def test_a_port_of_the_last_run_that_is_there_and_fails_is_no_reason_to_write_to_another(
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

    def busy(path: str, servos: tuple[int, ...] = ()) -> None:
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


@pytest.mark.parametrize("name", ["no/slash", ""])
def test_what_can_be_no_name_stops_all_the_same(name: str, asked: Waits) -> None:
    assert cli.main(["stop", "--name", name]) == 1
    assert asked == [("/dev/ttyACM0", 30.0)]


def test_whatever_goes_wrong_with_a_service_the_port_is_written_to(
    asked: Waits, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(_: str) -> bool:
        raise ZeroDivisionError("a defect")

    monkeypatch.setattr(instances, "listens", fails)
    assert cli.main(["stop"]) == 0
    assert len(asked) == 1
    assert "no service can be asked (a defect): writing to the port itself" in capsys.readouterr().err


def test_with_the_port_named_a_bad_file_is_only_told(asked: Waits, file: Path) -> None:
    assert cli.main(["stop", "--config", str(file), "--device", "/dev/board"]) == 0
    assert asked == [("/dev/board", 30.0)]


@pytest.mark.parametrize("wait", ["nan", "inf", "-1", "3601"])
def test_a_wait_without_an_end_is_refused(wait: str, asked: Waits, capsys: pytest.CaptureFixture[str]) -> None:
    assert cli.main(["stop", f"--wait={wait}"]) == 1
    assert asked == []
    assert capsys.readouterr().err == f"failstop: --wait = {float(wait)!r}: allowed is 0 to 3600 s\n"


@pytest.fixture
def service(monkeypatch: pytest.MonkeyPatch, asked: Waits) -> list[object]:
    """As if systemd ran it, after the service; what is done, in order. What was killed is what `left` says."""
    done: list[object] = []

    def kill(timeout_s: float) -> tuple[int, int]:
        done.append("killed")
        assert asked == [], "the port is not touched before"
        return 2, 0

    monkeypatch.setenv("SERVICE_RESULT", "watchdog")
    monkeypatch.setattr(stopping, "of_a_service", lambda: True)
    monkeypatch.setattr(stopping, "kill_rest", kill)
    return done


def test_the_end_of_the_service_kills_the_rest_first(
    service: list[object], asked: Waits, capsys: pytest.CaptureFixture[str]
) -> None:
    assert cli.main(["stop", "--end-service"]) == 0
    assert service == ["killed"]
    assert capsys.readouterr().err == "failstop: killed what was left of the service: 2 processes\n"


def test_the_end_of_the_service_has_its_own_deadline(service: list[object], asked: Waits) -> None:
    assert cli.main(["stop", "--end-service", "--device", "/dev/board"]) == 0
    [(device, wait_s)] = asked
    assert device == "/dev/board"
    assert stop.END_SERVICE_S - 1.0 < wait_s <= stop.END_SERVICE_S


def test_at_the_end_of_the_service_a_port_that_takes_nothing_is_left_to_another_unit(
    service: list[object], monkeypatch: pytest.MonkeyPatch
) -> None:
    waits: list[float] = []

    def stalled(path: str, wait: Callable[[PortError], float], *_: object) -> float:
        waits.append(wait(PortError("io", f"{path} takes no bytes")))
        return 0.0

    monkeypatch.setattr(stopping, "stop", stalled)
    assert cli.main(["stop", "--end-service", "--device", "/dev/board"]) == 0
    assert cli.main(["stop", "--device", "/dev/board", "--wait", "3600"]) == 0
    assert waits == [stop.STALLED_S, 3600.0], "that unit goes on for as long as it is told to"


def test_a_shorter_wait_stays(service: list[object], asked: Waits) -> None:
    assert cli.main(["stop", "--end-service", "--wait", "3"]) == 0
    assert asked == [("/dev/ttyACM0", 3.0)]


def test_what_does_not_end_is_said(
    service: list[object], asked: Waits, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(stopping, "kill_rest", lambda timeout_s: (3, 1))
    assert cli.main(["stop", "--end-service"]) == 0
    assert "1 of them have not ended within 1 s" in capsys.readouterr().err
    assert len(asked) == 1, "the stop is tried all the same"


def test_a_group_that_cannot_be_read_costs_no_stop(
    service: list[object], asked: Waits, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    def fails(*_: object) -> tuple[int, int]:
        raise PermissionError(13, "Permission denied", "/proc/self/cgroup")

    monkeypatch.setattr(stopping, "kill_rest", fails)
    assert cli.main(["stop", "--end-service"]) == 0
    assert "cannot kill what is left of the service" in capsys.readouterr().err
    assert len(asked) == 1


@pytest.mark.parametrize(("result", "in_service"), [(None, True), ("success", False)])
def test_by_hand_it_ends_nothing(
    result: str | None,
    in_service: bool,
    service: list[object],
    asked: Waits,
    capsys: pytest.CaptureFixture[str],
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    """It would kill the caller's whole login."""
    if result is None:
        monkeypatch.delenv("SERVICE_RESULT")
    monkeypatch.setattr(stopping, "of_a_service", lambda: in_service)
    assert cli.main(["stop", "--end-service"]) == 1
    assert (service, len(asked)) == ([], 1), "nothing killed, and stopped all the same"
    assert "by hand use `failstop stop` without it" in capsys.readouterr().err


def test_the_setting_is_declared_once() -> None:
    assert stop.DEFAULTS == {"device.path": "/dev/ttyACM0", "stop.wait_s": 30.0}


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
    """Named with --device, the port is written to before the file is looked at."""
    link, master = board
    BAD_FILES[bad](file)
    result = failstop("stop", "--config", str(file), "--device", link)
    assert (result.returncode, result.stderr) == (0, "")
    assert os.read(master, 4096) == BURST


@pytest.mark.parametrize("bad", BAD_FILES)
@pytest.mark.timeout(20)
def test_no_file_keeps_the_stop_from_the_default_port(
    bad: str, asked: Waits, file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    BAD_FILES[bad](file)
    assert cli.main(["stop", "--config", str(file)]) == 1
    assert asked == [("/dev/ttyACM0", 30.0)]
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
def test_no_bytes_of_a_file_keep_the_stop_from_the_wire(
    content: bytes, board: tuple[str, int], file: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    link, master = board
    monkeypatch.setitem(stop.DEFAULTS, stop.DEVICE, link)
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
