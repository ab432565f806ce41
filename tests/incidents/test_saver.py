"""The saver alone: a process with descriptors of segments, a file as its result."""

from __future__ import annotations

import contextlib
import itertools
import os
import subprocess
import sys
import time
from collections.abc import Iterator
from pathlib import Path

import msgpack
import psutil
import pytest

import failstop
from failstop.board.rrc.board import BOARD
from failstop.incidents import files, saver
from failstop.incidents.incident import Incident
from failstop.messages import box, layout, records, segments
from failstop.messages.packing import pack
from failstop.policy import causes
from failstop.policy.causes import Cause
from failstop.policy.settings import Settings
from failstop.shm.heartbeat import BEAT_RUNNING, BEAT_STARTING
from failstop_lab.trial import wait_for
from tests.support.incident_parts import drive_and_die

_numbers = itertools.count()
SCRIPT = Path(failstop.__file__).parent / "incidents" / "saver.py"
ROOT = str(Path(failstop.__file__).resolve().parent.parent)
RUN = 0x77
SAID = causes.REQUESTED("a = b, and so on", "nav", 7)


class Saving:
    """Segments of a run, and a saver for them."""

    def __init__(self, state: Path) -> None:
        self.name = f"saver{os.getpid()}x{next(_numbers)}"
        self.state = state
        for process in layout.PROCESS_NAMES:
            segments.create(self.name, process, RUN).close()
        self.supervisor = segments.attach(self.name, layout.SUPERVISOR, RUN, write=True)
        self.port_owner = segments.attach(self.name, layout.PORT_OWNER, RUN, write=True)
        self.fds = segments.open_all(self.name)
        self.result, self.told = os.pipe()
        self.wait, self.hurry = os.pipe()

    def start(self, **words: object) -> subprocess.Popen[bytes]:
        passed = [*self.fds.values(), self.told, self.wait]
        listed = ",".join(f"{which}:{fd}" for which, fd in self.fds.items())
        words = {"name": self.name, "keep": 9, "max_mb": 9, "until_ns": 0, **words}
        words |= {"fds": listed, "result": self.told, "hurry": self.wait}
        search = [ROOT, *(entry for entry in sys.path if os.path.isabs(entry))]
        environment = {
            "FAILSTOP_PATH": os.pathsep.join(search),
            "FAILSTOP_SETTINGS": Settings().lines(),
            "STATE_DIRECTORY": str(self.state),
        }
        command = [sys.executable, "-I", "-S", str(SCRIPT), *(f"{key}={value}" for key, value in words.items())]
        return subprocess.Popen(command, env=environment, pass_fds=passed)

    def save(self, **words: object) -> dict[str, object]:
        self.start(**words).wait(30)
        told: dict[str, object] = msgpack.unpackb(os.read(self.result, 4096))
        return told

    def live(self, **words: object) -> dict[str, object]:
        now_ns = time.monotonic_ns()
        known = {"cause_ns": now_ns, "epoch": 2, "cause": SAID.pack().hex(), "until_ns": now_ns}
        return {**known, "offset_ns": time.time_ns() - now_ns, **words}

    def newest(self) -> Incident:
        return Incident.read(files.find("last", self.name, {"STATE_DIRECTORY": str(self.state)}))


def asleep(pid: int) -> bool:
    """Wait until it sleeps at twenty looks in a row: a process that starts has work to do, or waits for the disk."""
    looks = (psutil.Process(pid).status() for _ in range(20) if not time.sleep(0.005))
    return all(status == psutil.STATUS_SLEEPING for status in looks)


@pytest.fixture
def saving(tmp_path: Path) -> Iterator[Saving]:
    made = Saving(tmp_path / "state")
    yield made
    segments.unlink_all(made.name)
    for fd in (*made.fds.values(), made.result, made.told, made.wait, made.hurry):
        os.close(fd)


def test_one_file_with_everything(saving: Saving) -> None:
    saving.supervisor.word("epoch").set(2)
    told = saving.save(**saving.live())
    incident = saving.newest()
    at = round(incident.head["t"], 3)
    assert told == {"id": incident.id, "at": at, "reason": str(SAID), "run": "this"}
    assert incident.id.endswith("-requested")
    assert (incident.reason, incident.cause) == (str(SAID), SAID)
    assert incident.words(layout.SUPERVISOR)["epoch"] == 2
    assert incident.settings == dict(line.split("=", 1) for line in Settings().lines().splitlines())
    assert incident.head["versions"]["failstop"]
    assert incident.machine["cores"] == os.cpu_count()
    assert abs(incident.head["t"] - time.time()) < 60
    assert saving.save(**saving.live(keep=1))["id"] != incident.id
    assert [path.stem for path in (saving.state / "incidents").iterdir()] == [saving.newest().id], "as many as are kept"


def test_a_stop_is_kept_though_the_clock_says_that_others_are_newer(saving: Saving) -> None:
    """A computer without a battery-backed clock, with three incidents of days when it knew the date."""
    folder = saving.state / "incidents"
    later = [drive_and_die().head(saving.name, unix_ns=(4_000_000_000 + day) * 10**9) for day in range(3)]
    for head in later:
        files.write(str(folder), "20961002-090640-gate-died", files.build(head, {}))
    told = saving.save(**saving.live(keep=3))
    assert saving.newest().id == told["id"]
    assert len(list(folder.iterdir())) == 3
    [*_, last] = files.heads(saving.name, [str(folder)])[0]
    assert files.jumped(last).startswith("before this incident the clock was set back by ")


def test_many_savers_of_one_second_and_cause_each_leave_a_file(tmp_path: Path) -> None:
    """Processes of their own, let go together."""
    savers, made = 40, files.build({"name": "x"}, {})
    begin, go = os.pipe()
    pids = []
    for _ in range(savers):
        if not (pid := os.fork()):
            os.close(go)
            os.read(begin, 1)
            code = 1
            with contextlib.suppress(OSError):
                files.write(str(tmp_path / "incidents"), "20260101-000000-x", made)
                code = 0
            os._exit(code)
        pids.append(pid)
    os.close(begin)
    os.close(go)
    assert [os.waitpid(pid, 0)[1] for pid in pids] == [0] * savers
    found = sorted(os.listdir(tmp_path / "incidents"))
    assert len({files.number_of(name) for name in found} - {0}) == savers
    assert all(files.read(str(tmp_path / "incidents" / name)) == ({"name": "x"}, {}) for name in found)


def test_it_copies_at_its_time_or_when_the_supervisor_ends(saving: Saving) -> None:
    process = saving.start(**saving.live(until_ns=time.monotonic_ns() + 10**12))
    wait_for("the saver to wait", lambda: asleep(process.pid), 30.0)
    saving.port_owner.ring_writer("received").put(b"after", 100)
    saving.supervisor.word("epoch").set(99)
    os.close(saving.hurry)
    saving.hurry = os.dup(saving.result)
    assert process.wait(30) == 0
    incident = saving.newest()
    assert incident.words(layout.SUPERVISOR)["epoch"] == 99, "copied after the wait"
    assert incident.received == [(100, b"after")]


def test_a_dead_run_that_was_ready_once_is_saved_and_another_is_not(saving: Saving) -> None:
    for state in (0, BEAT_STARTING):
        saving.supervisor.word("beat_state").set(state)
        assert saving.save() == {}
        assert not saving.state.exists()
    saving.supervisor.word("beat_state").set(BEAT_RUNNING)
    assert saving.save()["run"] == "before"
    assert saving.newest().reason == "the whole service died"


def test_the_time_of_an_incident_is_that_of_the_stop_though_the_machine_has_slept_since(saving: Saving) -> None:
    """The wall clock goes on while the machine sleeps, and the monotonic clock does not."""
    slept_s = 8 * 3600
    words = saving.live()
    saving.save(**{**words, "offset_ns": int(str(words["offset_ns"])) - slept_s * 10**9})
    assert abs(saving.newest().head["t"] - (time.time() - slept_s)) < 60
    saving.supervisor.word("beat_state").set(BEAT_RUNNING)
    event = {"t": time.time() - slept_s, "ns": time.monotonic_ns(), "kind": "ready", "text": ""}
    saving.supervisor.word("beat_ns").set(time.monotonic_ns())
    saving.supervisor.ring_writer("events").put(pack(event))
    assert saving.save()["run"] == "before"
    assert abs(saving.newest().head["t"] - (time.time() - slept_s)) < 60


def test_a_dead_run_that_can_not_be_saved_is_named_all_the_same(saving: Saving) -> None:
    saving.supervisor.word("beat_state").set(BEAT_RUNNING)
    saving.state.write_text("not a folder", encoding="ascii")
    told = saving.save()
    assert told["ended"] == "the whole service died"
    assert told["wrong"]


def lose_port(saving: Saving, state: int) -> None:
    saving.port_owner.latest_writer("port").write(records.PORT.pack(1, time.monotonic_ns(), state, "/dev/ttyACM0"))


def test_a_lost_port_is_waited_for_and_its_stop_is_the_one_that_was_written_at_last(saving: Saving) -> None:
    lost = causes.DEVICE_LOST()
    fields = {"reason": str(lost), "cause": "device_lost", "epoch": 2, "written_by": None, "latency_us": None}
    told = {"kind": "stop", "fields": fields}
    saving.supervisor.ring_writer("events").put(msgpack.packb(told), 1)
    lose_port(saving, records.PORT_LOST)
    words = saving.live(cause=lost.pack().hex())
    cause_ns = int(str(words["cause_ns"]))
    process = saving.start(**words)
    wait_for("the saver to wait", lambda: asleep(process.pid), 30.0)
    size = len(BOARD.burst)
    saving.port_owner.ring_writer("box").put(box.pack_wire(box.WIRE_BURST, BOARD.burst, size), cause_ns + 3_000_000_000)
    lose_port(saving, records.PORT_OPEN)
    assert process.wait(30) == 0
    stop = saving.newest().head["stop"]
    assert (stop["written_by"], stop["written_us"]) == ("port owner", 3e6)


def test_a_service_that_ends_waits_for_no_port(saving: Saving) -> None:
    lose_port(saving, records.PORT_LOST)
    process = saving.start(**saving.live())
    wait_for("the saver to wait", lambda: asleep(process.pid), 30.0)
    os.close(saving.hurry)
    saving.hurry = os.dup(saving.result)
    before_s = time.monotonic()
    assert process.wait(30) == 0
    assert time.monotonic() - before_s < saver.RETURN_NS / 2e9
    assert saving.newest().head["stop"] is None


def test_a_state_directory_that_is_none_is_said_in_one_line(saving: Saving) -> None:
    saving.state.write_text("in the way")
    assert saving.save(**saving.live()) == {"wrong": f"[Errno 20] Not a directory: '{saving.state}/incidents'"}


def test_a_segment_of_another_version_is_said_in_one_line(saving: Saving) -> None:
    path = f"/dev/shm/failstop.{saving.name}.gate"
    with open(path, "r+b") as file:
        file.write(bytes(128))
    assert str(saving.save(**saving.live())["wrong"]).endswith("has an incomplete header: restart the service")


@pytest.mark.parametrize(
    ("cause", "slug"),
    [
        (causes.DIED("gate"), "gate-died"),
        (causes.HANGS("gate", 60), "gate-hangs"),
        (causes.DEAF(), "deaf"),
        (causes.REQUESTED("hand near (the) wheel", "failstop estop", 7571), "requested"),
        (causes.PIPED("../../etc/passwd"), "piped"),
        (causes.FLEET("smoke in hall 2", "ann"), "fleet"),
        (causes.NOT_FINITE("nav (pid 77)"), "not-finite"),
        (causes.DIED("../x"), "died"),
        (causes.DIED("port_owner"), "port-owner-died"),
    ],
    ids=repr,
)
def test_a_cause_as_a_file_name(cause: Cause, slug: str) -> None:
    assert saver.slug(cause) == slug
