"""The guard as a process: settings, links, users, a service that ends and comes back, and a run without a robot."""

from __future__ import annotations

import contextlib
import fcntl
import os
import select
import signal
import subprocess
import sys
import termios
import time
from collections.abc import Iterator
from pathlib import Path

import pytest

from bench.guard_scene import GuardScene, Process
from failstop import config, helpers
from failstop.api.errors import FailstopError
from failstop.api.snapshot import Block
from failstop.board.driver import language_of
from failstop.guard import command
from failstop.guard.door import Door
from failstop.guard.dry import Nothing
from failstop.guard.guard import Guard
from failstop.guard.news import Opener
from failstop.guard.pty import Pty
from failstop.guard.service import Service
from failstop.policy.layouts import BOARDS
from failstop.policy.settings import Settings
from failstop_lab.trial import Trial, wait_for, write_settings
from tests.support.boards import own_folder
from tests.support.commands import failstop
from tests.support.typist import Typist
from tests.support.waiting import until

RATE = "30"


def lines(driver: Process, count: int) -> list[str]:
    return [driver.line() for _ in range(count)]


@pytest.fixture
def scene(request: pytest.FixtureRequest, tmp_path: Path) -> Iterator[GuardScene]:
    """A service of the test's own, with the settings that it asks for."""
    with GuardScene(tmp_path, "arduino", **getattr(request, "param", {})) as made:
        yield made


@pytest.mark.slow
def test_a_service_that_is_started_again_takes_its_driver_again(scene: GuardScene, diffdrive: str) -> None:
    """The driver gets the last counts meanwhile, and drives after an enable only once it has let go."""
    scene.enable()
    driver = scene.driver(diffdrive, scene.path, "serial", "10", "10", RATE)
    driver.line()
    scene.moves()
    wait_for("counts", lambda: not driver.line().startswith("0 0"))
    scene.trial.leave()
    scene.trial.service.end()
    wait_for("the wheels to stand", lambda: not scene.trial.turning())
    # The last counts that answered the driver's own question are a little older than those of the service's.
    wait_for("its last counts", lambda: len({line.split("|")[0] for line in lines(driver, 20)}) == 1)
    counts = driver.newest().split("|")[0]
    assert {line.split("|")[0] for line in lines(driver, 10)} == {counts}
    scene.trial.service.start()
    wait_for("the driver to be known", lambda: "diffdrive" in scene.clients())
    wait_for("its command", lambda: driver.line() and bool(scene.trial.robot.state.clients))
    scene.trial.robot.enable()
    scene.trial.board.events()
    driver.newest()
    assert {line.split("|")[0] for line in lines(driver, 10)} == {counts}, "its odometry does not jump"
    assert scene.motion() == []


COMMANDS_ALL_THE_TIME = """
import os, select, signal, sys
port = os.open(sys.argv[1], os.O_RDWR | os.O_NOCTTY)
motion, wrong = map(bytes.fromhex, sys.argv[2:])
asked = []
signal.signal(signal.SIGUSR1, lambda *_: asked.append(1))
while True:
    os.write(port, wrong if asked else motion)
    print("wrong" if asked else "motion", flush=True)
    asked.clear()
    select.select([], [], [], 0.03)
    while select.select([port], [], [], 0)[0]:
        os.read(port, 4096)
"""


@pytest.mark.slow
@pytest.mark.claim("MOVE-1")
def test_what_is_refused_does_not_let_go_of_a_held_driver(scene: GuardScene) -> None:
    driver = scene.python(COMMANDS_ALL_THE_TIME, b"m 20 20\r".hex(), b"z\r".hex())
    driver.line()
    wait_for("its command", lambda: any(row.state == "drives" for row in scene.trial.robot.state.sources))
    scene.trial.robot.enable()
    wait_for("the hold", lambda: scene.trial.robot.state.block is Block.HELD)
    os.kill(driver.pid, signal.SIGUSR1)
    driver.until("wrong")
    assert scene.guard
    scene.guard.until("refused the command 'z'")
    for _ in range(20):
        driver.until("motion")
    assert scene.trial.robot.state.block is Block.HELD
    assert scene.motion() == []


@pytest.mark.slow
def test_a_dead_service_is_reported_as_dead_and_not_taken_for_the_next_one(scene: GuardScene) -> None:
    service = Service(scene.trial.name)
    assert service.look(time.monotonic_ns())
    scene.trial.service.pids()
    scene.trial.leave()
    scene.trial.service.kill()
    wait_for("every process to be gone", scene.trial.service.gone)
    service.join("a driver", None)
    ended = f"the service {scene.trial.name!r} has ended; the guard waits until it is started again"
    assert service.note == ended
    assert not service.look(time.monotonic_ns())
    assert service.runs == 1
    assert scene.guard
    assert "is ending" not in scene.guard.until("service")


@pytest.mark.slow
@pytest.mark.parametrize("scene", [{"guard.hang_up": "on"}], indirect=True)
def test_a_driver_that_wants_to_move_while_motion_is_disabled_is_hung_up_on(scene: GuardScene, diffdrive: str) -> None:
    still = scene.driver(diffdrive, scene.path, "serial", "0", "0", RATE)
    lines(still, 10)
    still.kill()
    scene.rest()
    driver = scene.driver(diffdrive, scene.path, "serial", "10", "10", RATE)
    assert driver.until("error").startswith("error")
    assert scene.guard
    scene.guard.until("wants to move while motion is disabled, so its port was closed (guard.hang_up)")
    scene.enable()
    again = scene.driver(diffdrive, scene.path, "serial", "10", "10", RATE)
    assert again.line() == "start Invalid Command|OK"
    scene.moves()
    scene.trial.robot.estop("a test")
    assert again.until("error").startswith("error")


@pytest.mark.slow
@pytest.mark.parametrize("scene", [{"guard.timeout_s": 1.5, "sources.guard.priority": 10}], indirect=True)
def test_a_longer_timeout_keeps_a_slow_driver_going_and_a_hung_guard_does_not(
    scene: GuardScene, diffdrive: str
) -> None:
    scene.enable()
    driver = scene.driver(diffdrive, scene.path, "serial", "10", "10", "1")
    driver.line()
    scene.moves()
    scene.trial.board.events()
    lines(driver, 3)
    assert all(any(event.speeds) for event in scene.trial.board.events()), "it wrote once a second"
    assert [source.source for source in scene.trial.robot.state.sources] == ["guard"]
    assert scene.guard
    os.kill(scene.guard.pid, 19)
    try:
        scene.stands()
    finally:
        os.kill(scene.guard.pid, 18)


@pytest.mark.parametrize(
    ("confirmed", "gets"),
    [
        (114.5, "and gets at most 0.2, which the setting limits.vx_mps allows"),
        (
            0,
            "gets at most 0.05, because nobody has confirmed the scale of the wheels (board.per_rps); `failstop setup`",
        ),
    ],
)
def test_without_a_robot_it_prints_what_a_driver_would_get(
    tmp_path: Path, diffdrive: str, confirmed: float, gets: str
) -> None:
    settings = tmp_path / "settings.toml"
    told = {"board.kind": "arduino", "board.per_rps": 114.5, "board.per_rps_confirmed": confirmed}
    write_settings(str(settings), {key: value for key, value in told.items() if value})
    port = str(tmp_path / "port")
    guard = Process(*helpers.python("failstop", "guard", "--dry-run", "--config", str(settings), "--path", port))
    driver = None
    try:
        guard.until("your driver opens")
        driver = Process(diffdrive, port, "serial", "900", "900", RATE)
        assert driver.line() == "start Invalid Command|OK"
        assert f"diffdrive (pid {driver.pid}) has the port open" in guard.line()
        assert "PID gains (u)" in guard.line()
        guard.until("motion: wheels 900 900")  # a question may have come before it
        guard.until(gets)
        driver.kill()
        guard.until("has ended or died, and the last speed that it wrote was not zero")
    finally:
        guard.close()
        if driver:
            driver.close()


def test_a_dry_run_plays_the_board_that_is_asked_for_and_needs_no_settings(tmp_path: Path) -> None:
    port = str(tmp_path / "port")
    guard = Process(*helpers.python("failstop", "guard", "--dry-run", "--board", "ugv", "--path", port))
    try:
        assert guard.line() == "a dry run, as the board ugv: nothing moves"
        guard.until("your driver opens")
        driver = os.open(port, os.O_RDWR | os.O_NOCTTY)
        os.write(driver, b'{"T":1,"L":0.1,"R":0.1}\n')
        guard.until("motion: wheels 0.1 0.1")
        os.close(driver)
    finally:
        guard.close()


def test_its_lines_are_wrapped_at_words_on_a_terminal(tmp_path: Path) -> None:
    port = str(tmp_path / "port")
    with Typist.failstop("guard", "--dry-run", "--board", "ugv", "--path", port) as typist:
        until(lambda: "Ctrl-C" in typist.look(0.1), "the guard to be ready")
        driver = os.open(port, os.O_RDWR | os.O_NOCTTY)
        os.write(driver, b"hello\n")
        until(lambda: "for this board?" in typist.look(0.1), "the refusal")
        os.close(driver)
        rows = typist.raw.replace("\r\n", "\n").split("\n")
    said = next(at for at, row in enumerate(rows) if "refused" in row)
    assert rows[said + 1].startswith("  "), rows
    assert max(len(row) for row in rows if port not in row) <= 80


@pytest.mark.parametrize("option", ["--board", "--config"])
def test_what_a_dry_run_alone_takes_is_refused_with_a_service(option: str) -> None:
    done = failstop("guard", option, "ugv")
    assert done.returncode == 1
    assert done.stderr.startswith(f"failstop: {option} goes with --dry-run: a guard has the settings of the service")


def test_a_guard_whose_words_nobody_reads_still_answers_its_driver(tmp_path: Path) -> None:
    settings = tmp_path / "settings.toml"
    write_settings(str(settings), {"board.kind": "arduino"})
    path = tmp_path / "port"
    words = ("guard", "--dry-run", "--config", str(settings), "--path", str(path))
    guard = Process(*helpers.python("failstop", *words), errors=True)
    try:
        guard.until("your driver opens")
        assert guard.child.stdout
        fcntl.fcntl(guard.child.stdout, fcntl.F_SETPIPE_SZ, 4096)
        driver = os.open(path, os.O_RDWR | os.O_NOCTTY)
        try:
            for speed in range(1, 200):  # each of which it prints
                os.write(driver, b"m %d %d\r" % (speed, speed))
                assert select.select([driver], [], [], 10)[0], f"no answer to line {speed}"
                assert os.read(driver, 64) == b"OK\r\n"
        finally:
            os.close(driver)
    finally:
        guard.close()


def test_a_line_that_the_output_has_no_characters_for_is_dropped(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    path = tmp_path / "output"
    with path.open("w", encoding="ascii") as output:
        monkeypatch.setattr(sys, "stdout", output)
        for line in ("one", "f\xe4hrt", "two"):
            command._print_line(line)
        monkeypatch.undo()
    assert path.read_text() == "one\ntwo\n"


def test_a_driver_whose_name_is_not_text_is_shown(tmp_path: Path) -> None:
    port = str(tmp_path / "port")
    guard = Process(
        *helpers.python("failstop", "guard", "--dry-run", "--board", "arduino", "--path", port), errors=True
    )
    try:
        guard.until("your driver opens")
        name = os.fsencode(tmp_path) + b"/\xff\xfe"
        os.symlink(sys.executable, name)
        code = "import os, sys; port = os.open(sys.argv[1], os.O_RDWR); os.write(port, b'm 7 7\\r'); os.read(port, 9)"
        subprocess.run([name, "-c", code, port], check=True, timeout=20)
        guard.until("\ufffd\ufffd (pid ")
        guard.until("motion: wheels 7 7")
    finally:
        guard.close()


def test_a_board_that_nobody_has_described_drivers_of_says_so(tmp_path: Path) -> None:
    kind = own_folder(tmp_path / "tank")
    wire = tmp_path / "tank" / "wire.py"
    wire.write_text(wire.read_text().replace("    driver=_driver,\n", ""))
    settings = tmp_path / "settings.toml"
    write_settings(str(settings), {"board.kind": kind})
    done = failstop("guard", "--dry-run", "--config", str(settings), "--path", str(tmp_path / "port"))
    assert done.returncode == 1
    assert f"{kind}/wire.py does not say what a driver program may write to this board: add `driver`" in done.stderr


@pytest.mark.parametrize("kind", BOARDS)
def test_every_board_of_failstop_s_has_a_guard_port(kind: str) -> None:
    assert language_of(kind, Settings({"board.kind": kind}).flat()) is not None


def test_a_board_whose_description_of_drivers_is_not_there_says_so(tmp_path: Path) -> None:
    kind = own_folder(tmp_path / "tank")
    (tmp_path / "tank" / "driver.py").unlink()
    settings = tmp_path / "settings.toml"
    write_settings(str(settings), {"board.kind": kind})
    done = failstop("guard", "--dry-run", "--config", str(settings), "--path", str(tmp_path / "port"))
    assert done.returncode == 1
    assert done.stderr.startswith(f"failstop: {kind}/wire.py: its `driver` raises ImportError: cannot import")
    assert "or take `driver` out of its Wire" in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize("dry", [True, False], ids=["dry run", "service"])
def test_a_pin_that_drives_a_motor_is_named_before_a_driver_can_open_the_port(tmp_path: Path, dry: bool) -> None:
    settings = tmp_path / "settings.toml"
    write_settings(str(settings), {"board.kind": "arduino", "guard.pins": "13"})
    path = str(tmp_path / "port")
    if dry:
        done = failstop("guard", "--dry-run", "--config", str(settings), "--path", path)
    else:
        with Trial(f"guard-pins-{os.getpid()}", ("--config", str(settings)), kind="arduino") as trial:
            done = failstop("guard", "--name", trial.name, "--path", path)
    assert done.returncode == 1
    assert "guard.pins: 13, must be among 11, 14, 15" in done.stderr
    assert "Traceback" not in done.stderr
    assert not os.path.lexists(path)


@pytest.mark.parametrize(
    ("first", "then", "answered"),
    [
        pytest.param(b"", b"e\r", b"0 0\r\n", id="it opens the port twice and asks"),
        pytest.param(b"m 10 10\r", b"", b"", id="the one before would have moved the wheels"),
        pytest.param(b"m 10 10\r", b"e\r", b"", id="nobody knows who asked"),
    ],
)
def test_what_was_written_before_it_is_known_by_whom_is_answered_and_moves_nothing(
    tmp_path: Path, first: bytes, then: bytes, answered: bytes
) -> None:
    """Feetech's SDK opens the port, closes it and opens it again, and asks within a millisecond."""
    lines: list[str] = []
    settings = config.load(None, {"board.kind": "arduino"})
    pty = Pty(str(tmp_path / "port"))
    guard = Guard(Nothing(settings, lines.append), pty, Door(pty), lines.append)
    driver = subprocess.Popen(
        [sys.executable, "-c", TWICE, pty.name, first.hex(), then.hex()], stdin=subprocess.PIPE, stdout=subprocess.PIPE
    )
    assert driver.stdin
    assert driver.stdout
    try:
        assert driver.stdout.readline() == b"written\n"
        for _ in range(4):
            guard.turn()
        assert not any("motion:" in line for line in lines)
        driver.stdin.write(b"\n")
        driver.stdin.flush()
        assert driver.stdout.readline() == answered.hex().encode() + b"\n"
        guard.turn()
        assert any("motion: wheels 7 7" in line for line in lines), "from now on it drives"
    finally:
        driver.kill()
        driver.communicate()
        guard.close()
        pty.close()


@pytest.mark.parametrize(
    ("death", "then"),
    [("disable", "motion is disabled"), ("latch", "a stop is latched"), ("stay", "motion stays enabled")],
)
def test_a_dry_run_says_what_the_settings_do_when_a_driver_dies(death: str, then: str) -> None:
    lines: list[str] = []
    dry = Nothing(config.load(None, {"board.kind": "arduino", "gate.driver_death": death}), lines.append)
    dry.leave(in_order=False)
    assert [then in line for line in lines] == [True]


def test_a_service_that_comes_back_with_wrong_settings_ends_the_guard_with_the_reason(tmp_path: Path) -> None:
    pty = Pty(str(tmp_path / "port"))
    board = Nothing(config.load(None, {"board.kind": "arduino"}), print)
    guard = Guard(board, pty, Door(pty), print)
    board.settings = config.load(None, {"board.kind": "arduino", "guard.pins": "13"})
    board.runs += 1
    try:
        with pytest.raises(FailstopError, match="pins: 13, must be among 11, 14, 15"):
            guard.turn()
    finally:
        guard.close()
        pty.close()


def test_what_was_written_by_nobody_who_is_there_is_thrown_away(tmp_path: Path) -> None:
    """Else the guard would never sleep again, and the next driver would be taken for its writer."""
    lines: list[str] = []
    pty = Pty(str(tmp_path / "port"))
    door = Door(pty)
    guard = Guard(Nothing(config.load(None, {"board.kind": "arduino"}), lines.append), pty, door, lines.append)
    try:
        os.write(pty.slave, b"m 10 10\r")
        guard.turn()
        assert pty.master not in door.wait(0)
        assert not any("motion:" in line for line in lines)
    finally:
        guard.close()
        pty.close()


def test_a_program_whose_descriptors_cannot_be_seen_has_not_closed_the_port(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """A program that has changed its user hides its descriptors, also from the search before it ends."""
    pty = Pty(str(tmp_path / "port"))
    door = Door(pty)
    gone, hidden = 1001, 1002
    named = Opener(gone, "driver", 1)

    def holds(pid: int, wanted: object) -> list[int]:
        if pid == hidden:
            raise PermissionError(pid)
        return []

    monkeypatch.setattr("failstop.guard.door.holds", holds)
    try:
        door.seen = {gone: named, hidden: named}
        assert door.abandoned() == []
        assert door.abandoned() == [named], "the program that has closed it, although another one hides its own"
        door.seen = {hidden: named}
        assert door.abandoned() == []
        assert door.abandoned() == []
    finally:
        door.close()
        pty.close()


TWICE = """
import os, sys
path, first, then = sys.argv[1], bytes.fromhex(sys.argv[2]), bytes.fromhex(sys.argv[3])
port = os.open(path, os.O_RDWR | os.O_NOCTTY)
os.write(port, first)
os.close(port)
port = os.open(path, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
os.write(port, then)
print("written", flush=True)
sys.stdin.readline()
try:
    found = os.read(port, 100)
except BlockingIOError:
    found = b""
os.write(port, b"m 7 7" + bytes([13]))
print(found.hex(), flush=True)
sys.stdin.readline()
"""
"""A program that opens the port twice; by the second line it has said what it got, and drives."""


@pytest.mark.parametrize("alone", [True, False], ids=["as a service", "in a terminal"])
def test_a_guard_that_has_a_session_to_itself_goes_before_all_others(tmp_path: Path, alone: bool) -> None:
    """A nice value counts only within a session, and a terminal's session is other programs' too."""
    shared = Path("/proc/sys/kernel/sched_autogroup_enabled")
    if not shared.exists() or os.geteuid() != 0:
        pytest.skip("no autogroup here, or not the right to a better nice value")
    ours = Path("/proc/self/autogroup").read_text()  # empty where this session began while the sharing was off
    shares = shared.read_text().strip() == "1"
    port = tmp_path / "port"
    words = ("guard", "--dry-run", "--board", "arduino", "--path", str(port))
    guard = subprocess.Popen(
        helpers.python("failstop", *words), stdout=subprocess.PIPE, text=True, start_new_session=alone
    )
    try:
        assert guard.stdout
        while "your driver opens" not in guard.stdout.readline():
            pass
        driver = os.open(port, os.O_RDWR | os.O_NOCTTY)
        os.write(driver, b"b\r")
        assert os.read(driver, 100) == b"57600\r\n", "it is at its work"
        os.close(driver)
        assert os.getpriority(os.PRIO_PROCESS, guard.pid) == -10
        group = Path(f"/proc/{guard.pid}/autogroup").read_text()
        assert group == ours if not alone else group.endswith(" nice -10\n") if shares else not group
    finally:
        guard.kill()
        guard.communicate()


# The pseudo-terminal.


def test_a_link_that_is_there_is_replaced_only_where_it_is_a_link(tmp_path: Path) -> None:
    path = tmp_path / "port"
    path.write_text("mine")
    with pytest.raises(FailstopError, match="exists already and is not a link"):
        Pty(str(path))
    assert path.read_text() == "mine"
    path.unlink()
    path.symlink_to("/dev/pts/nowhere")
    pty = Pty(str(path))
    assert os.readlink(path) == pty.name
    with pytest.raises(FailstopError, match="another guard is running"):
        Pty(str(path))
    path.unlink()
    assert not pty.linked()
    pty.link_again()
    assert pty.linked()
    pty.close()
    assert os.listdir(tmp_path) == ["port.lock"]


def test_a_link_that_leads_to_something_else_than_a_terminal_is_left(tmp_path: Path) -> None:
    """As the vendor's /dev/rrc, which a udev rule makes, and which may be how failstop finds the board."""
    path = tmp_path / "rrc"
    for leads_to in ("ttyACM0", "/dev/ttyACM0", str(tmp_path)):
        path.symlink_to(leads_to)
        with pytest.raises(FailstopError, match=f"{path} leads to {leads_to}: choose another --path"):
            Pty(str(path))
        assert os.readlink(path) == leads_to
        path.unlink()
    pty = Pty(str(path))
    path.unlink()
    path.symlink_to("ttyACM0")
    with pytest.raises(FailstopError, match="leads to ttyACM0"):
        pty.link_again()
    pty.close()
    assert os.readlink(path) == "ttyACM0"


def test_the_owner_and_the_group_may_open_it_and_nobody_else(tmp_path: Path) -> None:
    pty = Pty(str(tmp_path / "port"))
    try:
        assert os.stat(pty.name).st_mode & 0o7 == 0
        assert os.stat(pty.name).st_uid == os.geteuid()
    finally:
        pty.close()


def test_it_never_echoes_and_begins_anew_for_the_next_driver(tmp_path: Path) -> None:
    pty = Pty(str(tmp_path / "port"))
    try:
        pty.write(b"OK\r\n")
        assert pty.read() == (b"", True), "an echo would come back as the driver's command"
        slave = os.open(pty.name, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        changed = termios.tcgetattr(slave)
        changed[3] |= termios.ECHO | termios.ICANON
        termios.tcsetattr(slave, termios.TCSANOW, changed)
        os.write(slave, b"m 10 10\r\n")
        os.close(slave)
        assert b"m 10 10" in pty.clean()
        slave = os.open(pty.name, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
        assert not termios.tcgetattr(slave)[3] & (termios.ECHO | termios.ICANON)
        with pytest.raises(BlockingIOError):
            os.read(slave, 100)
        os.close(slave)
    finally:
        pty.close()


def test_an_answer_is_written_whole_or_not_at_all(tmp_path: Path) -> None:
    """The driver does not read for a while: it then finds whole answers, in order, and the newest are missing."""
    pty = Pty(str(tmp_path / "port"))
    slave = os.open(pty.name, os.O_RDWR | os.O_NOCTTY | os.O_NONBLOCK)
    try:
        given = [number for number in range(20_000) if pty.write(b"%06d abcdefghijklmnopqrstuvwxyz\r\n" % number)]
        assert 0 < len(given) < 20_000
        found = bytearray()

        def read_all() -> bool:
            with contextlib.suppress(BlockingIOError):
                while part := os.read(slave, 65536):
                    found.extend(part)
            pty.write(b"")  # the rest of the answer that the driver has begun to get
            return found.count(b"\n") >= len(given)

        until(read_all, "the driver has read all of it")
        assert [int(line[:6]) for line in found.splitlines()] == given
        assert {len(line) for line in found.splitlines()} == {33}
    finally:
        os.close(slave)
        pty.close()


def test_a_driver_that_opens_the_link_as_soon_as_it_is_there_is_seen(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    """Also after the guard has hung up, when a driver opens its port again at once."""
    opened: list[int] = []
    link = Pty._link

    def link_and_open(pty: Pty) -> None:
        link(pty)
        opened.append(os.open(pty.path, os.O_RDWR | os.O_NOCTTY))

    monkeypatch.setattr(Pty, "_link", link_and_open)
    pty = Pty(str(tmp_path / "port"))
    door = Door(pty)
    try:
        for hung_up in (False, True):
            if hung_up:
                door.hang_up()
            assert not door.vacant
            assert door.look(door.wait(0)).any
            assert door.count == 1
            os.close(opened.pop())
    finally:
        door.close()
        pty.close()
