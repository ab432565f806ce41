"""`failstop stop` as systemd and people run it, on a simulated machine: which port it goes to, and for how long."""

from __future__ import annotations

import re

import pytest

from failstop import config
from failstop.board.rrc.arm import RrcArm
from failstop.board.rrc.board import BOARD
from failstop.board.rrc.burst import BURST
from failstop.cli import target
from failstop.policy.halted import MAY_TURN
from failstop.policy.layouts import BOARDS
from failstop_lab.machine.files import Directory
from failstop_lab.machine.kernel import Machine
from failstop_lab.machine.port import Port
from failstop_lab.machine.process import Process
from failstop_lab.machine.robot import BoardPort, Robot
from failstop_lab.machine.usb import LookAlike, Plug

FILE = "/root/failstop.toml"
PORTS = ("board", "other", "ttyACM0", "last", "left")


class Heard(BoardPort):
    """A board, and the bytes that it gets."""

    def __init__(self, machine: Machine, kind: str) -> None:
        super().__init__(machine, 0.0, kind)
        self.data = b""
        self.on_bytes = self._keep

    def _keep(self, data: bytes) -> None:
        self.data += data

    def without_pings(self) -> bytes:
        """The stops: what asks the board is left out."""
        found = self.data
        for ping in BOARD.pings:
            found = found.replace(ping, b"")
        return found


class Tool:
    """`failstop stop` on a machine without a service, with a board at each of PORTS or at none."""

    def __init__(self) -> None:
        self.lab = Robot()
        self.lab.unplug()
        self.machine = self.lab.machine
        self.failed: list[object] = []
        self.machine.on_event = lambda kind, process, what: self.failed.append(what) if kind == "failed" else None
        self.lab.join("test")
        self.boards: dict[str, Heard] = {}
        self.environ: dict[str, str] = {}

    def last_run(self, device: str, *servos: int, name: str = "failstop", kind: str = "rrc", usb: str = "") -> None:
        """A service that somebody has started by hand, and that has died, was on this port."""
        load = self.lab.loader.load
        found = load("failstop.files.instance")
        found.remember(
            load("failstop.instances").make_runtime_dir(name),
            found.Last(device, "failstop run", servos, kind, usb=usb),
        )

    def run(self, *words: str) -> tuple[int, str, str]:
        return self.lab.command(("stop", *words), environ=self.environ)

    def plug(self, *names: str, kind: str = "rrc", mute: bool = False) -> None:
        """Boards at these ports below /dev. `mute`: nothing that they say arrives."""
        folder = self.machine.root.names["dev"]
        assert isinstance(folder, Directory)
        for number, name in enumerate(names):
            port = Port(self.machine, number)
            port.board = self.boards[f"/dev/{name}"] = board = Heard(self.machine, kind)
            port.on_first_open = board.opened
            board.port = None if mute else port
            folder.put(name, port)

    def waits(self, *words: str) -> tuple[str, float]:
        """The port that is tried where no board is, and for how many seconds."""
        begun_ns = self.machine.now_ns
        code, _, err = self.run(*words)
        found = re.fullmatch(r"failstop: no device (\S+?):? .*", err.splitlines()[-1])
        assert found, err
        assert code == 1
        return found[1], round((self.machine.now_ns - begun_ns) / 1e9, 1)

    def goes(self, *words: str, servos: tuple[int, ...] = ()) -> tuple[int, str, str, str]:
        """The outcome where there are boards: the exit code, the one that has the burst, what is printed, errors."""
        self.plug(*PORTS)
        code, out, err = self.run(*words)
        assert self.failed == []
        (device,) = (device for device, heard in self.boards.items() if heard.data)
        assert self.boards[device].without_pings() == BURST + (BURST + RrcArm().stops(servos) if servos else b"")
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
    said = "failstop: stop.wait_s = 'long': it must be a number, 0 to 3600 s; stopping without it\n"
    assert (code, device, err) == (0, "/dev/board", said)


@pytest.mark.parametrize("text", [None, "[device\n", "[device]\npath = 7\n"])
def test_a_file_that_says_nothing_stops_the_default_port_and_says_so(tool: Tool, text: str | None) -> None:
    if text is not None:
        tool.lab.write(FILE, text)
    assert tool.waits("--config", FILE) == ("/dev/ttyACM0", pytest.approx(30.0, abs=0.1))
    code, device, _, err = tool.goes("--config", FILE)
    assert (code, device) == (1, "/dev/ttyACM0")
    first, last = err.splitlines()
    assert first.endswith("; stopping without it")
    assert (
        last
        == "failstop: the stop went to /dev/ttyACM0, the default. If that is not the board, name its port with --device"
    )


def test_the_installed_file_counts_where_none_is_named(tool: Tool) -> None:
    tool.lab.write(f"{config.FOLDER}/failstop.toml", 'device.path = "/dev/board"\nstop.wait_s = 5\n')
    assert tool.waits() == ("/dev/board", pytest.approx(5.0, abs=0.1))
    assert tool.goes()[:2] == (0, "/dev/board")


def test_of_another_name_the_default_is_a_guess(tool: Tool) -> None:
    code, device, _, err = tool.goes("--name", "left")
    assert (code, device) == (1, "/dev/ttyACM0")
    assert "If that is not the board, name its port with --device" in err
    tool.lab.write(f"{config.FOLDER}/left.toml", 'device.path = "/dev/left"\n')
    assert Tool.run(tool, "--name", "left")[0] == 0
    assert tool.boards["/dev/left"].without_pings() == BURST


@pytest.mark.parametrize("name", ["no/slash", ""])
def test_what_can_be_no_name_stops_all_the_same(tool: Tool, name: str) -> None:
    assert tool.goes("--name", name)[:2] == (1, "/dev/ttyACM0")


@pytest.mark.parametrize("wait", ["nan", "inf", "-1", "3601"])
def test_a_wait_without_an_end_is_refused(tool: Tool, wait: str) -> None:
    tool.plug(*PORTS)
    said = f"failstop: --wait = {float(wait)!r}: it must be 0 to 3600 s\n"
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
    assert "no service could be asked (a defect); writing the stop to the port instead" in err


@pytest.mark.parametrize(
    ("last", "words", "device", "err"),
    [
        ("/dev/last", "", "/dev/last", ""),
        ("/dev/last", f"--config {FILE}", "/dev/board", ""),
        ("/dev/last", "--device /dev/other", "/dev/other", ""),
        (
            "/dev/gone",
            "",
            "/dev/board",
            "failstop: /dev/gone, the port of the last run, does not exist, so the stop went to /dev/board. ",
        ),
    ],
)
def test_the_last_run_s_port_goes_before_the_installed_file_s(
    tool: Tool, last: str, words: str, device: str, err: str
) -> None:
    for file in (FILE, f"{config.FOLDER}/failstop.toml"):
        tool.lab.write(file, 'device.path = "/dev/board"\n')
    tool.last_run(last, 1, 10)
    code, found, _, said = tool.goes(*words.split(), servos=(1, 10) if device == "/dev/last" else ())
    assert (code, found) == (1 if err else 0, device)
    assert said == (f"{err}If that is not the board, name its port with --device\n" if err else "")


@pytest.mark.parametrize("words", ["--end-service", "--last-port"])
@pytest.mark.parametrize(("last", "device"), [("/dev/last", "/dev/last"), ("/dev/gone", "/dev/board")])
def test_for_systemd_the_port_of_the_dead_run_goes_before_the_file_s(
    tool: Tool, last: str, device: str, words: str
) -> None:
    """Somebody may have edited the file since the run was started."""
    tool.lab.write(FILE, 'device.path = "/dev/board"\n')
    tool.last_run(last)
    in_service(tool)
    assert tool.goes(*words.split(), "--config", FILE)[:2] == (0, device)


def test_for_systemd_the_port_of_the_dead_run_is_tried_until_it_is_back(tool: Tool) -> None:
    tool.lab.write(FILE, 'device.path = "/dev/board"\n')
    tool.last_run("/dev/last")
    in_service(tool)
    tool.machine.at(tool.machine.now_ns + 3_000_000_000, lambda: tool.plug("last"))
    code, out, _ = tool.run("--end-service", "--config", FILE)
    assert (code, out.startswith("stop frame sent (after 3.0 s)")) == (0, True)
    assert tool.boards["/dev/last"].without_pings() == BURST


@pytest.mark.parametrize("words", ["--end-service", "--last-port --wait 12"])
def test_for_systemd_a_port_of_the_settings_that_is_not_there_is_waited_for_too(tool: Tool, words: str) -> None:
    """Without it the service does not start. If the tool ended at once, systemd would soon give up."""
    tool.lab.write(FILE, 'device.path = "/dev/board"\n')
    tool.last_run("/dev/last")
    in_service(tool)
    tool.plug("last")
    begun_ns = tool.machine.now_ns
    code, out, err = tool.run(*words.split(), "--config", FILE)
    assert code == ("--last-port" in words), "a unit that has stopped its board has not failed"
    assert out.startswith("stop frame sent (after 0.0 s)") or "--last-port" in words
    assert err.splitlines()[-1].startswith("failstop: no device /dev/board")
    assert err.endswith("; the stop went only to /dev/last, where the last run had the board\n")
    assert (tool.machine.now_ns - begun_ns) / 1e9 == pytest.approx(12.0, abs=0.4)
    tool.boards["/dev/last"].data = b""
    tool.machine.at(tool.machine.now_ns + 3_000_000_000, lambda: tool.plug("board"))
    code, out, _ = tool.run(*words.split(), "--config", FILE)
    assert (code, out.splitlines()[-1]) == (0, "stop frame sent to /dev/board too, the port in the settings")
    assert [tool.boards[f"/dev/{name}"].without_pings() for name in ("last", "board")] == [BURST] * 2


@pytest.mark.parametrize("kind", ["vesc", "nonsense"])
def test_what_is_wrong_with_the_settings_port_makes_no_failure_of_a_stop(tool: Tool, kind: str) -> None:
    tool.lab.write(FILE, f'device.path = "/dev/board"\nboard.kind = "{kind}"\nstop.wait_s = 0\n')
    tool.last_run("/dev/last")
    in_service(tool)
    tool.plug("last")
    assert tool.run("--end-service", "--config", FILE)[0] == 0
    assert tool.boards["/dev/last"].without_pings() == BURST


def test_for_systemd_the_default_port_counts_where_the_file_names_none(tool: Tool) -> None:
    """The board was at another number, and comes back at the default one."""
    tool.lab.write(FILE, "")
    tool.last_run("/dev/gone")
    in_service(tool)
    assert tool.goes("--end-service", "--config", FILE)[:2] == (0, "/dev/ttyACM0")


def test_a_last_run_s_port_that_fails_is_no_reason_to_write_to_another(tool: Tool) -> None:
    tool.lab.write("/dev/no-tty", "")
    tool.last_run("/dev/no-tty")
    tool.plug(*PORTS)
    code, _, err = tool.run("--wait", "0")
    assert (code, "/dev/no-tty" in err) == (1, True)
    assert not any(heard.data for heard in tool.boards.values())


def test_two_ports_that_are_not_there_are_both_named(tool: Tool) -> None:
    tool.last_run("/dev/gone")
    tool.lab.write(f"{config.FOLDER}/failstop.toml", 'device.path = "/dev/nor-this"\n')
    code, _, err = tool.run("--wait", "0")
    assert (code, err.count("\n")) == (1, 1)
    assert err.startswith("failstop: no device /dev/gone: ")
    assert err.endswith(f" (the last run used it; /dev/nor-this does not exist either); {MAY_TURN}\n")


def test_the_last_run_of_another_name_is_no_guess_at_all(tool: Tool) -> None:
    tool.last_run("/dev/left", name="left")
    sent = "stop frame sent (after 0.0 s), directly to"
    assert tool.goes("--name", "left")[:3] == (
        0,
        "/dev/left",
        f"{sent} /dev/left, the port of the last run (no service 'left' runs)\nthe board at /dev/left answers\n",
    )
    out = (
        f"stop frame for {BOARD.name} sent (after 0.0 s), directly to /dev/ttyACM0 (no service 'failstop' runs); "
        "no settings name another board\nthe board at /dev/ttyACM0 answers\n"
    )
    assert tool.run() == (0, out, "")


STRANGER = Plug("", "1-1.2", "0483", "5740")
"""Another device at the default port, such as a VESC that another program drives."""


@pytest.mark.parametrize("setting", ["", 'board.kind = "vesc"\n', 'device.path = "/dev/ttyACM0"\n'])
@pytest.mark.parametrize("words", ["run", "stop --wait 0", "stop --end-service --wait 0"])
def test_the_default_port_is_left_alone_where_it_is_certainly_another_device(words: str, setting: str) -> None:
    lab = Robot(usb=STRANGER)
    lab.join("test")
    heard = b""

    def hear(data: bytes) -> None:
        nonlocal heard
        heard += data

    lab.board.on_bytes = hear
    lab.write(FILE, f"gate.lease_s = 99\n{setting}")  # so that `run` ends after its stop
    code, _, err = lab.command((*words.split(), "--config", FILE, "--name", "left"))
    if setting:
        assert heard, "somebody has named it"
        return
    assert (code, heard) == (1, b"")
    assert "/dev/ttyACM0 is USB 0483:5740, not the board, so it was not opened: set device.path and board.kind" in err


ANOTHER, MOVED, SPARE = "1a86|55d4||1.0|1-1.2", "0483|5740||1.0|1-1.4", "0483|5740|A|1.0|1-1.2"
"""The board of the last run: certainly not STRANGER, perhaps in another socket, perhaps the one before."""


@pytest.mark.parametrize("last", ["/dev/ttyACM0", "/dev/gone"])
@pytest.mark.parametrize("words", ["", "--end-service", "--last-port"])
def test_after_a_run_the_default_port_is_left_alone_too(tool: Tool, words: str, last: str) -> None:
    tool.lab.write(FILE, "")
    stranger = LookAlike()
    tool.lab.plug_usb("ttyACM0", STRANGER, stranger)
    tool.last_run(last, usb=ANOTHER)
    in_service(tool)
    code, _, err = tool.run(*words.split(), "--wait", "0", "--config", FILE)
    assert (code, bytes(stranger.heard)) == (1, b"")
    assert "does not exist either" not in err


def test_a_stranger_at_the_default_port_is_not_written_after_the_last_run_s(tool: Tool) -> None:
    tool.lab.write(FILE, "")
    stranger = LookAlike()
    tool.plug("last")
    tool.lab.plug_usb("ttyACM1", STRANGER, stranger)
    folder = tool.machine.root.names["dev"]
    assert isinstance(folder, Directory)
    folder.put("ttyACM0", folder.names["ttyACM1"])
    tool.last_run("/dev/last")
    in_service(tool)
    code, _, err = tool.run("--end-service", "--wait", "2", "--config", FILE)
    assert (code, bytes(stranger.heard)) == (0, b"")
    assert "/dev/ttyACM0 is USB 0483:5740, not the board" in err, "the service would not open it either"
    assert tool.boards["/dev/last"].without_pings() == BURST


@pytest.mark.parametrize(
    ("usb", "device"), [(ANOTHER, "board"), (MOVED, "ttyACM1"), (SPARE, "ttyACM1"), ("", "ttyACM1")]
)
def test_a_stop_by_hand_goes_to_no_other_device_at_the_last_run_s_port(tool: Tool, usb: str, device: str) -> None:
    tool.lab.write(f"{config.FOLDER}/failstop.toml", 'device.path = "/dev/board"\n')
    tool.plug("board")
    at_last = LookAlike()
    tool.lab.plug_usb("ttyACM1", STRANGER, at_last)
    tool.last_run("/dev/ttyACM1", usb=usb)
    code, _, err = tool.run("--wait", "0")
    assert code == 1
    heard = {"ttyACM1": bytes(at_last.heard), "board": tool.boards["/dev/board"].data}
    assert [name for name, data in heard.items() if BURST in data] == [device]
    told = "another device is at /dev/ttyACM1, the port of the last run, so the stop went to /dev/board. If that"
    assert (told in err) == (device == "board")


# What the board says to it.


@pytest.mark.parametrize("mute", [False, True])
@pytest.mark.parametrize("kind", BOARDS)
def test_it_says_whether_the_board_answers(tool: Tool, kind: str, mute: bool) -> None:
    tool.lab.write(FILE, f'board.kind = "{kind}"\ndevice.path = "/dev/board"\n')
    tool.plug("board", kind=kind, mute=mute)
    code, out, err = tool.run("--config", FILE)
    sent, *answer = out.splitlines()
    assert sent == "stop frame sent (after 0.0 s), directly to /dev/board"
    assert tool.boards["/dev/board"].data
    if mute:
        assert (code, answer) == (1, [])
        assert err.startswith("failstop: nothing at /dev/board answers as ")
        assert "so the wheels may turn: use the POWER SWITCH" in err
    else:
        how = "reports zero speed" if kind == "hoverboard" else "answers"
        assert (code, answer, err) == (0, [f"the board at /dev/board {how}"], "")


@pytest.mark.parametrize("kind", ["arduino", "ugv"])
@pytest.mark.parametrize("by", ["nothing", "the file", "the last run"])
def test_another_board_whose_kind_nothing_names_is_not_called_stopped(tool: Tool, kind: str, by: str) -> None:
    """The person has named the port, so what is missing is the kind of board."""
    tool.plug("board", kind=kind)
    words = ["--device", "/dev/board"]
    if by == "the file":
        tool.lab.write(FILE, f'board.kind = "{kind}"\n')
        words += ["--config", FILE]
    elif by == "the last run":
        tool.last_run("/dev/board", kind=kind)
    code, out, err = tool.run(*words)
    if by != "nothing":
        sent = "stop frame sent (after 0.0 s), directly to /dev/board\nthe board at /dev/board answers\n"
        assert (code, out, err) == (0, sent, "")
        return
    assert (code, tool.boards["/dev/board"].without_pings().startswith(BURST)) == (1, True)
    assert out == (
        f"stop frame for {BOARD.name} sent (after 0.0 s), directly to /dev/board; no settings name another board\n"
    )
    assert err == (
        f"failstop: nothing at /dev/board answers as {BOARD.name} does, so the wheels may turn: use the POWER SWITCH. "
        "Without settings failstop takes every board for Hiwonder's: for another board give --config FILE with its "
        "board.kind, or run `failstop setup` first. If the board is at another port, name that port with --device\n"
    )


def test_at_the_end_of_the_service_it_says_so_and_the_unit_has_not_failed(tool: Tool) -> None:
    in_service(tool)
    tool.plug("board", mute=True)
    code, _, err = tool.run("--end-service", "--device", "/dev/board")
    assert code == 0
    assert "nothing at /dev/board answers" in err


def test_an_answer_to_an_older_question_is_none(tool: Tool) -> None:
    tool.plug("board")
    board = tool.boards["/dev/board"]
    port = board.port
    assert port

    def old(data: bytes) -> None:
        board.on_bytes = lambda data: None
        for ping in BOARD.pings:
            board.model.receive(ping, tool.machine.now_ns)
        board.catch_up()
        board.model.deaf = True

    board.on_bytes = old
    code, _, err = tool.run("--device", "/dev/board")
    assert (code, "nothing at /dev/board answers" in err) == (1, True)


# At the end of the service.


def in_service(tool: Tool, *others: int, group: str = "0::/system.slice/failstop.service\n") -> None:
    """Run it as systemd does, after the service, with these processes in its control group."""
    tool.environ["SERVICE_RESULT"] = "watchdog"
    for pid in ("self", *others):
        tool.lab.write(f"/proc/{pid}/cgroup", group)


def rest(tool: Tool) -> list[Process]:
    """Two processes that are left of the service."""
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


@pytest.mark.parametrize(
    ("refused", "told"),
    [("kill", "2 of them have not ended within 1 s"), ("open", "cannot kill what is left of the service")],
)
def test_what_can_not_be_killed_costs_no_stop(tool: Tool, refused: str, told: str) -> None:
    in_service(tool, *(each.pid for each in rest(tool)))

    def refuse(thread: object, call: str, about: tuple[object, ...]) -> None:
        if call == refused and (call == "kill" or about[:1] == ("/proc/self/cgroup",)):
            raise PermissionError(1, "Operation not permitted")

    tool.machine.at_seam = refuse
    code, device, _, err = tool.goes("--end-service")
    assert (code, device) == (0, "/dev/ttyACM0")
    assert told in err


@pytest.mark.parametrize("why", ["not after a service", "of a login"])
def test_by_hand_it_ends_nothing(tool: Tool, why: str) -> None:
    """Otherwise it would kill the caller's whole login."""
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
    for words, least_s in (("--end-service", target.STALLED_S), ("--wait 5", 5.0)):
        begun_ns = tool.machine.now_ns
        code, _, err = tool.run(*words.split(), "--device", "/dev/board")
        assert code == 1
        assert "takes no bytes" in err
        took_s = (tool.machine.now_ns - begun_ns) / 1e9
        assert least_s <= took_s <= least_s + 1.0, "the other unit goes on for as long as it is told to"
