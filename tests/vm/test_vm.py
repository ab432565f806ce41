"""Parts of `make vm` that need no virtual machine: its table, its agent, its names."""

from __future__ import annotations

import json
import os
import pty
import shutil
import socket
import subprocess
import sys
import tty
from collections.abc import Iterator
from pathlib import Path

import pytest

from tests.vm import __main__ as vm
from tests.vm import guest, image, initrd, inside, outside, payload, table
from tests.vm.guest import GuestError
from tests.vm.image import Image
from tests.vm.patience import Patience, ran
from tests.vm.table import INSIDE, OUTSIDE, Result

AGENT = Path(image.HERE, "agent.py")


# The table.


def test_every_trial_is_one_that_can_be_run() -> None:
    for where, do in ((INSIDE, inside.DO), (OUTSIDE, outside.DO)):
        assert {trial.name for trial in table.TRIALS if trial.where == where} == set(do)
    assert len(table.TRIAL_BY_NAME) == len(table.TRIALS)
    assert next(iter(table.TRIAL_BY_NAME)) == "install", "the others need it"


@pytest.mark.parametrize(
    "words", [("packaging/deb/build.py", "--help"), ("-c", "import tests.vm.inside, tests.vm.floor, tests.vm.client")]
)
def test_the_guest_gets_all_that_it_runs(words: tuple[str, ...], tmp_path: Path) -> None:
    for name in payload.TRIALS:
        copy = shutil.copytree if (image.ROOT / name).is_dir() else shutil.copy
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        copy(image.ROOT / name, tmp_path / name)
    done = subprocess.run((sys.executable, *words), cwd=tmp_path, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stderr


def test_a_trial_that_wants_a_guest_of_its_own_has_one() -> None:
    assert table.lives(["sleep", "sleep_lost", "reboot"]) == [["sleep"], ["sleep_lost", "reboot"]]
    assert table.lives(["sleep_lost"]) == [["sleep_lost"]]
    assert table.lives([]) == []


def row(name: str, *results: Result, floor_ms: float = 5.0) -> table.Row:
    floor = Result(table.FLOORS[table.TRIAL_BY_NAME[name].where], ms=floor_ms)
    [found] = table.rows([floor, *results], [name])
    return found


def test_a_row_is_met_when_nothing_is_wrong() -> None:
    assert row("replug", Result("replug", ms=20.0), Result("replug", ms=30.0)).problems == []


@pytest.mark.parametrize(
    ("result", "problem"),
    [
        (Result("replug", ms=20.0, missed=1), "1 stops missed"),
        (Result("replug", ms=20.0, after=2), "2 motion frames after the stop"),
        (Result("replug", ms=101.0), "later than 100 ms"),
        (Result("replug", ms=20.0, wrong=["the wheels turn at the end"]), "the wheels turn at the end"),
    ],
)
def test_a_row_is_missed(result: Result, problem: str) -> None:
    found = row("replug", Result("replug", ms=20.0), result)
    assert found.problems == [problem]
    assert f"| **missed**: {problem} |" in table.markdown([found])


def test_a_kill_is_held_against_the_floor_of_its_guest() -> None:
    assert row("kill_gate", Result("kill_gate", ms=14.9)).problems == []
    assert row("kill_gate", Result("kill_gate", ms=15.1)).problems == ["later than 3 floors"]


def test_a_trial_without_a_result_is_missed() -> None:
    assert row("boot").problems == ["not run"]


def test_a_result_survives_its_way_out_of_the_guest() -> None:
    found = Result("replug", ms=1.5, wrong=["x"])
    assert table.result(json.loads(json.dumps(found.__dict__))) == found
    with pytest.raises(TypeError):
        table.result({"board": {}})


# The agent.


@pytest.fixture
def agent() -> Iterator[int]:
    """The agent with a terminal for its virtio port; yields the machine's end."""
    machine, guests = pty.openpty()
    tty.setraw(guests)
    process = subprocess.Popen([sys.executable, str(AGENT), os.ttyname(guests)])
    try:
        yield machine
    finally:
        os.close(guests)
        os.close(machine)
        process.kill()
        process.wait()


def lines(machine: int) -> Iterator[dict[str, object]]:
    waiting = b""
    while True:
        while b"\n" not in waiting:
            waiting += os.read(machine, 4096)
        line, _, waiting = waiting.partition(b"\n")
        yield json.loads(line)


def test_the_agent_greets_runs_and_passes_on(agent: int) -> None:
    heard = lines(agent)
    boot_id = Path("/proc/sys/kernel/random/boot_id").read_text().strip()
    assert next(heard) == {"hello": boot_id}
    for number, command in ((1, "echo one; echo two >&2; exit 3"), (2, "true")):
        message = {"id": number, "run": ["sh", "-c", command], "timeout_s": 30}
        os.write(agent, json.dumps(message).encode() + b"\n")
        if number == 1:
            assert [next(heard) for _ in range(2)] == [{"id": 1, "line": "one"}, {"id": 1, "line": "two"}]
        assert next(heard) == {"id": number, "code": 3 if number == 1 else 0}


def test_the_agent_ends_what_takes_too_long_and_lives_on(agent: int) -> None:
    heard = lines(agent)
    next(heard)
    for number, words, code in ((1, ["sleep", "60"], -9), (2, ["/nonexistent"], -1)):
        os.write(agent, json.dumps({"id": number, "run": words, "timeout_s": 0.1}).encode() + b"\n")
        assert next(answer for answer in heard if "code" in answer) == {"id": number, "code": code}


# Patience.


class Host:
    """A clock, and a qemu that runs or waits for a processor."""

    def __init__(self) -> None:
        self.now_s = 1000.0
        self.ran = (50.0, 7.0)
        self.patience = Patience(10.0, lambda: self.ran, lambda: self.now_s)

    def passes(self, ran_s: float, held_s: float, idle_s: float = 0.0) -> None:
        self.now_s += ran_s + held_s + idle_s
        self.ran = (self.ran[0] + ran_s, self.ran[1] + held_s)


def test_a_host_that_does_not_run_the_guest_takes_no_patience() -> None:
    host = Host()
    host.passes(ran_s=4.0, held_s=20.0)
    assert host.patience.left_s() == 6.0
    host.passes(ran_s=5.0, held_s=0.0, idle_s=1.0)
    assert host.patience.left_s() == 0.0


@pytest.mark.parametrize(
    ("ran_s", "held_s", "idle_s", "why"),
    [
        (2.0, 38.0, 0.0, "in 40 s qemu ran for 2 s and waited 38 s for a processor: the host is too busy"),
        (0.0, 0.0, 10.0, "in 10 s qemu ran for 0 s and waited 0 s for a processor: the guest is dead, or sleeps"),
        (9.0, 0.0, 1.0, "in 10 s qemu ran for 9 s and waited 0 s for a processor: the guest hangs, or is slower"),
    ],
)
def test_a_slow_host_is_told_from_a_dead_guest(ran_s: float, held_s: float, idle_s: float, why: str) -> None:
    host = Host()
    host.passes(ran_s, held_s, idle_s)
    assert host.patience.left_s() == 0.0
    assert host.patience.why().startswith(why)


def test_the_kernel_says_what_a_process_had() -> None:
    before_s, _ = ran(os.getpid())
    while ran(os.getpid())[0] <= before_s:
        pass  # this is what it had
    with subprocess.Popen(["true"]) as ended:
        ended.wait()
    assert ran(ended.pid) == (0.0, 0.0)


@pytest.fixture
def silent(tmp_path: Path) -> Iterator[tuple[guest.Guest, socket.socket]]:
    """A guest that says nothing, and its agent's end of the line."""
    nowhere = Path("-")
    made = guest.Guest(Image("", nowhere, nowhere, nowhere), tmp_path / "disks", tmp_path / "logs", nowhere)
    (made.logs / guest.CONSOLE).write_text("Kernel panic")
    ours, theirs = socket.socketpair()
    with ours, theirs:
        made.agent = ours
        yield made, theirs


def test_what_a_silent_guest_points_to_outlives_it(silent: tuple[guest.Guest, socket.socket]) -> None:
    made, _ = silent
    with pytest.raises(GuestError, match="the guest says nothing any more: in 0 s qemu ran") as error:
        made.run("true", wait_s=0.0)
    made.close()
    shutil.rmtree(made.place)
    assert Path(str(error.value).rpartition(" see ")[2]).read_text() == "Kernel panic"


def test_what_a_guest_that_has_ended_points_to_is_there(silent: tuple[guest.Guest, socket.socket]) -> None:
    made, agent = silent
    agent.close()
    with pytest.raises(GuestError, match=f"the guest has ended: see {made.logs}/qemu.log and {made.logs}/console.log"):
        made.greeted()


def test_the_console_is_written_where_it_stays() -> None:
    nowhere = Path("-")
    words = guest.command(Image("", nowhere, nowhere, nowhere), nowhere, nowhere, nowhere, guest.WAITS, "", Path("/l"))
    assert "file,id=console,path=/l/console.log,append=on" in words


# Names.


def test_a_state_is_of_one_machine() -> None:
    nowhere = Path("-")
    words = guest.command(Image("", nowhere, nowhere, nowhere), nowhere, nowhere, nowhere, guest.WAITS, "", nowhere)
    assert image.key(*words) == image.key(*words)
    assert image.key(*words) != image.key(*words, "-device", "another")
    assert image.key("a", "b") != image.key("ab")


def test_what_is_missing_is_named_with_its_package(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    with pytest.raises(image.ImageError, match=r"apt-get install .*mmdebstrap .*qemu-system-x86"):
        image.check()


def test_the_cache_is_where_one_wants_it(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("FAILSTOP_VM_CACHE", str(tmp_path))
    assert image.cache() == tmp_path


def test_the_guest_has_what_failstop_needs() -> None:
    found = image.dependencies()
    assert any(one.startswith("msgpack") for one in found)
    assert any(one.startswith("setuptools") for one in found)
    assert any(one.startswith("shtab") for one in found), "the package is built in there"
    assert not any(one.startswith("failstop") for one in found)
    assert not any("python_version" in one for one in found)


# The initrd.

DEPENDENCIES = """\
kernel/lib/crc16.ko:
kernel/fs/jbd2/jbd2.ko:
kernel/fs/ext4/ext4.ko: kernel/lib/crc16.ko kernel/fs/jbd2/jbd2.ko
kernel/virtio/virtio-pci.ko: kernel/virtio/virtio.ko kernel/virtio/virtio_ring.ko
kernel/virtio/virtio.ko: kernel/virtio/virtio_ring.ko
kernel/virtio/virtio_ring.ko:
"""


def test_a_module_is_loaded_after_what_it_needs() -> None:
    found = initrd.order(DEPENDENCIES, ("virtio_pci", "ext4"))
    names = [Path(path).stem for path in found]
    assert names == ["virtio_ring", "virtio", "virtio-pci", "jbd2", "crc16", "ext4"]


def entries(archive: bytes) -> dict[str, tuple[int, bytes]]:
    """Mode and content by name, as cpio(5) says that newc is read."""
    found, at = {}, 0
    while "TRAILER!!!" not in found:
        assert archive[at : at + 6] == b"070701"
        fields = [int(archive[at + 6 + 8 * n : at + 14 + 8 * n], 16) for n in range(13)]
        name_at, size = at + 110, fields[6]
        name = archive[name_at : name_at + fields[11] - 1].decode()
        data_at = (name_at + fields[11] + 3) // 4 * 4
        found[name] = (fields[1], archive[data_at : data_at + size])
        at = (data_at + size + 3) // 4 * 4
    assert at == len(archive)
    return found


def test_the_initrd_is_an_archive_that_loads_mounts_and_hands_over(tmp_path: Path) -> None:
    kernel = tmp_path / "lib/modules/6.1"
    dependencies = "".join(f"{name}.ko:\n" for name in initrd.MODULES)
    contents = {f"usr/lib/klibc/bin/{name}": name * 3 for name in initrd.PROGRAMS}
    contents |= {f"lib/modules/6.1/{name}.ko": f"module {name}" for name in initrd.MODULES}
    contents |= {"usr/lib/klibc-x.so": "so", "lib/modules/6.1/modules.dep": dependencies}
    for name, content in contents.items():
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_text(content)
    assert kernel.is_dir()
    found = entries(initrd.make(tmp_path))
    assert found["modules/ext4.ko"] == (0o100755, b"module ext4")
    assert found["bin/run-init"] == (0o100755, b"run-init" * 3)
    assert found["dev/console"][0] == 0o20600
    script = found["init"][1].decode().splitlines()
    assert script[:2] == ["#!/bin/sh", "insmod /modules/virtio_pci.ko"]
    assert script[-1].startswith("exec run-init /root /sbin/init ")


# The outside of a guest.


STOP_WORDS = (
    "'failstop' is ready: it has told the wheels to stop, and motion is disabled",
    "stop frame sent (after 0.0 s), directly to it",
)


class Booting:
    """A guest whose journal gets its line late: each command is run here, with a journal of this folder."""

    def __init__(self, folder: Path, words: str, looks: int) -> None:
        self.folder, self.words, self.looks = folder, words, looks
        for name, lines in (("dmesg", "[    3.500000] cdc_acm 1-1:1.0: ttyACM0: USB ACM device"), ("journalctl", "")):
            self.program(name, lines)

    def program(self, name: str, lines: str) -> None:
        path = self.folder / name
        path.write_text(f"#!/bin/sh\ncat <<'END'\n{lines}\nEND\n")
        path.chmod(0o755)

    def must(self, *words: str) -> list[str]:
        self.looks -= 1
        if self.looks == 0:
            self.program("journalctl", f"[    4.250000] guest failstop[77]: {self.words}")
        environment = {**os.environ, "PATH": f"{self.folder}:{os.environ['PATH']}"}
        done = subprocess.run(words, env=environment, capture_output=True, text=True, check=True)
        return done.stdout.splitlines()

    def patience(self, _wait_s: float) -> Patience:
        times = iter((0.0, 0.0, *(1.0 for _ in range(8)), *(1000.0 for _ in range(9))))
        return Patience(60.0, lambda: (1.0, 0.0), lambda: next(times))


def rebooted(machine: Booting, monkeypatch: pytest.MonkeyPatch) -> tuple[str, Result]:
    monkeypatch.setattr(outside, "LOOK_S", 0.0)
    scene, found = outside.Scene.__new__(outside.Scene), Result("reboot")
    scene.machine = machine  # type: ignore[assignment]
    known = {"ActiveState": "active", "ActiveEnterTimestampMonotonic": "5000000", "NRestarts": "0"}
    monkeypatch.setattr(outside.Scene, "shown", lambda _, name: known[name])
    return outside._readiness(scene, found), found


@pytest.mark.parametrize("words", STOP_WORDS)
def test_a_line_of_the_journal_that_comes_late_is_waited_for(
    words: str, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    note, found = rebooted(Booting(tmp_path, words, looks=4), monkeypatch)
    assert (note, found.wrong) == ("next boot: told of a stop 0.8 s after the node, ready 1.5 s, try 1", [])


def test_a_line_that_never_comes_is_what_is_wrong(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    note, found = rebooted(Booting(tmp_path, "nothing of interest", looks=1), monkeypatch)
    assert note == ""
    assert found.wrong[0].startswith("waited 60 s for the word of a stop in the journal: ")


@pytest.mark.parametrize("error", [IndexError("list index out of range"), GuestError("it is dead"), ValueError("odd")])
def test_a_trial_that_breaks_is_reported_by_itself(error: Exception) -> None:
    def breaks() -> Result:
        raise error

    [found] = vm.judged("reboot", breaks)
    assert found.trial == "reboot"
    assert str(error) in found.wrong[0]
    assert vm.judged("boot", lambda: Result("boot", ms=3.0)) == [Result("boot", ms=3.0)]
