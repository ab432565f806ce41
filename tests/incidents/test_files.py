"""The file: whole or not there, and damage is told in one line, never a traceback."""

from __future__ import annotations

import os
import re
from itertools import count
from pathlib import Path

import pytest

from failstop.cli.screen import incident as screen
from failstop.incidents import export, files, plot, story
from failstop.incidents.files import IncidentError, prune
from failstop.incidents.incident import Incident
from failstop_lab.machine.kernel import Machine
from failstop_lab.machine.loading import Loader
from failstop_lab.machine.process import Thread
from tests.support.imports import FORBIDDEN, imported
from tests.support.incident_parts import drive_and_die, printed

HEAD = {"name": "failstop", "t": 1.5}
KEPT = Path(__file__).parent / "kept" / "0.1.0-gate-died.incident"
BODY = {"segments": {"gate": {"rings": {"box": [[1, 2, b"\0\xff"]]}}}}


@pytest.fixture
def path(tmp_path: Path) -> str:
    return files.write(str(tmp_path / "incidents"), "20260101-000000-x", files.build(HEAD, BODY))


def test_what_is_written_is_read(path: str) -> None:
    assert files.read(path) == (HEAD, BODY)
    assert files.read(path, with_body=False)[0] == HEAD


def test_two_of_one_name_are_both_kept(path: str) -> None:
    folder = os.path.dirname(path)
    other = files.write(folder, "20260101-000000-x", files.build({"name": "other"}, {}))
    names = [f"00000{number}-20260101-000000-x.incident" for number in (1, 2)]
    assert (os.path.basename(path), os.path.basename(other)) == tuple(names)
    assert files.read(path, with_body=False)[0] == HEAD


def test_a_file_that_is_cut_anywhere_says_so(path: str) -> None:
    whole = Path(path).read_bytes()
    for size in range(len(whole)):
        Path(path).write_bytes(whole[:size])
        with pytest.raises(IncidentError, match=r"cut short: \d+ of \d+ bytes|is not an incident"):
            files.read(path)


def test_a_changed_byte_is_found_wherever_it_is(path: str) -> None:
    whole = Path(path).read_bytes()
    unused = range(len(files.MAGIC) + 2, len(files.MAGIC) + 4)
    for at in set(range(len(whole))) - set(unused):
        Path(path).write_bytes(whole[:at] + bytes((whole[at] ^ 0x41,)) + whole[at + 1 :])
        with pytest.raises(IncidentError, match=r"damaged|cut short|not an incident|of format"):
            files.read(path)


def test_a_file_that_unpacks_to_no_end_is_refused(path: str) -> None:
    Path(path).write_bytes(files.build(HEAD, {"zeros": bytes(files.LONGEST_BODY)}))
    with pytest.raises(IncidentError, match="its body can't be decoded"):
        files.read(path)


@pytest.mark.timeout(20)
def test_a_pipe_among_the_incidents_is_not_waited_for(path: str) -> None:
    os.mkfifo(planted := os.path.join(os.path.dirname(path), f"a{files.SUFFIX}"))
    with pytest.raises(IncidentError, match="a FIFO, not a regular file"):
        files.read(planted, with_body=False)[0]
    prune(os.path.dirname(path), "failstop", 1, 1)
    assert os.path.exists(planted)


def test_what_a_person_writes_goes_through_no_link(tmp_path: Path) -> None:
    victim = tmp_path / "victim"
    victim.write_text("precious\n")
    (tmp_path / "a.png.part").symlink_to(victim)
    files.write_as(str(tmp_path / "a.png"), b"picture")
    assert (victim.read_text(), (tmp_path / "a.png").read_bytes()) == ("precious\n", b"picture")
    assert sorted(os.listdir(tmp_path)) == ["a.png", "a.png.part", "victim"], "and another's file stays"


def test_what_a_person_writes_replaces_a_file_but_neither_a_link_nor_a_device(tmp_path: Path) -> None:
    (file := tmp_path / "a.json").write_text("old")
    (link := tmp_path / "link.json").symlink_to(file)
    os.mkfifo(pipe := tmp_path / "pipe")
    for path, what in ((link, "a link"), (pipe, "a FIFO"), (tmp_path, "a directory")):
        with pytest.raises(IncidentError, match=f"{path} can't be written: {what}, not a regular file"):
            files.write_as(str(path), b"new")
    with pytest.raises(IncidentError, match="/dev/null can't be written: a device, not a regular file"):
        files.write_as("/dev/null", b"new")
    assert file.read_text() == "old"
    files.write_as(str(file), b"new")
    assert file.read_text() == "new"
    assert sorted(os.listdir(tmp_path)) == ["a.json", "link.json", "pipe"]


def test_records_that_make_no_sense_are_left_out_and_counted() -> None:
    made = drive_and_die()
    ticks = len(made.incident().ticks)
    made.ring("gate", "box").put(b"nonsense", 5)
    made.ring("supervisor", "events").put(b"\xc1", 5)
    made.ring("telemetry", "box").put(b"\x77", 5)
    incident = made.incident()
    assert len(incident.ticks) == ticks
    assert len(incident.events) == 3
    assert len(incident.imu) > 100
    assert incident.undecoded == 3


def test_an_incident_of_another_layout_tells_what_was_told(tmp_path: Path) -> None:
    """Records of another layout are not guessed at, though some might decode to numbers."""
    made = drive_and_die()
    other = {"layout": 1, "reason": "the mast fell", "cause": {"name": "MAST_FELL"}}
    path = files.write(str(tmp_path), "old", files.build({**made.head(), **other}, made.body()))
    found = Incident.read(path)
    assert (found.ticks, found.writes, found.imu, found.beats, found.stops, found.undecoded) == ([], [], [], [], [], 0)
    assert [event.kind for event in found.events] == ["enabled", "stop", "died"]
    for whole in (False, True):
        text = printed(screen.text(found, 200, found.head["t"], whole=whole))
        assert re.search(r"^  why +the mast fell$", text, re.M)
        assert "Saved by failstop 0.1.0, which stored its records differently" in text
        assert "gate (pid 102) was killed by SIGKILL" in text
    assert story.as_dict(found)["reason"] == "the mast fell"
    for save in (lambda name: plot.save(found, name, 5.0), lambda name: export.save(found, name)):
        with pytest.raises(IncidentError, match=r"by failstop 0\.1\.0, which stored its records differently: use that"):
            save(str(tmp_path / "x.png"))
    assert os.listdir(tmp_path) == ["000001-old.incident"]


def test_the_incident_of_an_earlier_version_reads_as_it_did() -> None:
    """The file is that of drive_and_die(), as failstop 0.1.0 packs it. It stays as it is: who changes what a record
    holds raises LAYOUT_VERSION, and then reads what was told."""
    found = Incident.read(str(KEPT))
    told = [(line.what, line.text) for line in story.brief(found)]
    by_events = [("enabled", "motion enabled by nav (pid 77)"), ("died", "! gate (pid 102) was killed by SIGKILL")]
    assert set(told) >= {*by_events, (story.CAUSE, "gate died")}
    if not found.foreign:
        assert (len(found.ticks), len(found.writes), len(found.imu), found.undecoded) == (150, 174, 578, 0)
        assert {("wire", "STOP BURST by the port owner"), ("beat", "last beat of the gate for 190 ms")} <= set(told)
        assert found.ticks[-1].velocity == pytest.approx((0.2, 0.0, 0.0))
        assert found.imu[0].acceleration_mps2 == pytest.approx((0.1, 0.2, 9.8))


def test_a_whole_file_of_something_else_is_refused_in_one_line(path: str) -> None:
    with pytest.raises(IncidentError, match=r"no incident as failstop writes them \(KeyError\('cause_ns'\)\)"):
        Incident.read(path)


def test_drafts_of_the_dead_are_cleared_and_those_of_the_living_are_not(path: str) -> None:
    folder = Path(path).parent
    dead = [folder / f"{files.DRAFT}{rest}" for rest in ("000007", "4711")]
    for draft in dead:
        draft.write_bytes(b"half")
    alive = files.begin(str(folder))
    assert not any(draft.exists() for draft in dead)
    names = [os.path.basename(files.write(str(folder), "20260101-000001-x", files.build(HEAD, BODY))) for _ in range(2)]
    assert names == ["000003-20260101-000001-x.incident", "000004-20260101-000001-x.incident"]
    assert os.path.basename(alive.write("20260101-000000-y", b"late")) == "000002-20260101-000000-y.incident"
    assert not list(folder.glob(".draft*"))


def test_the_saver_imports_little() -> None:
    """The saver starts just after a stop, on the robot's own processor."""
    assert sorted(imported("failstop.incidents.saver") & FORBIDDEN) == []


def test_a_writer_that_dies_at_any_call_leaves_a_whole_file_or_none_of_that_name() -> None:
    left = [names for names in map(left_at, range(100)) if names is not None]
    assert left[0] == []
    assert left[-1] == [f"000001-x{files.SUFFIX}"]
    assert 10 < len(left) < 100


def left_at(dies_at: int) -> list[str] | None:
    """The whole files that a writer leaves that dies at this call of the system; None: it made fewer."""
    machine, calls = Machine(), count()
    machine.join("test")
    module = Loader(machine).load("failstop.incidents.files")

    def die(thread: Thread, call: str, about: object) -> None:
        if thread.process is writer and next(calls) == dies_at:
            machine.die(writer, -9)

    writer = machine.process("writer", lambda _: module.write("/folder", "x", module.build(HEAD, BODY)))
    machine.at_seam = die
    machine.run(lambda: writer.code is not None, 10**9)
    names = [name for name in machine.root.folder("/folder").names if name.endswith(files.SUFFIX)]
    assert all(module.read(f"/folder/{name}") == (HEAD, BODY) for name in names)
    return names if writer.code else None
