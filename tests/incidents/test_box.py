"""The rings' payloads, and that whoever writes them can't fall over what it writes."""

from __future__ import annotations

import mmap
import os
from math import isnan, nan
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.board.rrc.board import BOARD
from failstop.messages import box, layout, records
from failstop.policy import causes
from failstop.procs.gate.core import GateCore
from failstop.procs.gate.rings import GateBox
from failstop.procs.gate.sources import Command
from failstop.procs.port_owner.port_writer import PortWriter
from failstop.shm.cell import RingReader, RingWriter, cell_bytes
from tests.support.incident_parts import KeptRing, Recorder, at, drive_and_die


def ring(capacity: int, cells: int) -> tuple[RingWriter, RingReader]:
    memory = mmap.mmap(-1, cell_bytes(capacity) * cells)
    reader = RingReader(memory, 0, capacity, cells, 1)  # type: ignore[arg-type]
    return RingWriter(memory, 0, capacity, cells, 1), reader  # type: ignore[arg-type]


def test_a_tick_tells_the_command_and_what_became_of_it() -> None:
    made = drive_and_die()
    last = made.incident().ticks[-1]
    assert last.block == "driving"
    assert last.enabled
    assert last.drives
    assert last.command == pytest.approx((0.2, 0, 0))
    assert last.velocity == pytest.approx((0.2, 0, 0))
    assert last.wheels_rps == pytest.approx((0.796, 0.796, -0.796, -0.796), abs=1e-3)
    assert (last.source, last.who, last.commands, last.epoch) == ("cmd_vel", "nav (pid 77)", 1, 7)
    assert last.age_us == 1000


@pytest.mark.parametrize(
    ("block", "wanted"),
    [("disabled", "disabled"), ("latched", "estop"), ("silent", "cmd timeout"), ("scan", "no scan")],
)
def test_every_decision_has_its_word(block: str, wanted: str) -> None:
    made = Recorder()
    if block != "disabled":
        made.core.enable(7, "", at(0))
    if block == "latched":
        made.core.stop(causes.KEY(1), 7)
    if block == "scan":
        made.command(1, (0.1, 0, 0))
    made.tick(2)
    last = made.incident().ticks[-1]
    assert last.block == wanted
    assert last.enabled == made.core.enabled


def test_the_commands_since_the_tick_before_are_counted() -> None:
    made = Recorder()
    counts = (0, 1, 2, 0, 300)
    for turn, count in enumerate(counts):
        for _ in range(count):
            made.command(turn, (0.1, 0, 0))
        made.tick(turn)
    assert [tick.commands for tick in made.incident().ticks] == [0, 1, 2, 0, 255]


any_float = st.floats(width=64)


@given(velocity=st.tuples(any_float, any_float, any_float), who=st.text(max_size=80), source=st.text(max_size=20))
def test_no_command_is_too_strange_to_be_recorded(velocity: tuple[float, float, float], who: str, source: str) -> None:
    made = Recorder()
    writer, reader = ring(box.TICK.most, 8)
    gate = GateBox(writer)
    gate.command(Command(1, who, at(0), velocity, source=source))
    gate.tick(at(5), made.core, 2**70)
    entry = reader.next()
    assert entry is not None
    found = box.unpack_gate(entry[2])
    for wanted, seen in zip(velocity, found["command"], strict=True):
        assert isnan(seen) if isnan(wanted) else seen == pytest.approx(max(-3e38, min(3e38, wanted)), rel=1e-6)


def test_the_wire_is_recorded_after_it_was_written() -> None:
    reads, writes = os.pipe()
    os.set_blocking(writes, False)

    class Watched(KeptRing):
        def put(self, payload: bytes, t_ns: int | None = None) -> int:
            seen.append(os.read(reads, 4096) if payload[0] == box.WIRE_BURST else b"")
            return super().put(payload, 0)

    seen: list[bytes] = []
    kept = Watched()
    wire = PortWriter(writes, BOARD)
    wire.burst()
    wire.keep(kept)  # type: ignore[arg-type]
    wire.burst()
    assert seen == [BOARD.burst, BOARD.burst], "the bytes were out before the record was made"
    for _, _, payload in kept.entries:
        assert box.WIRE.unpack(payload) == (box.WIRE_BURST, len(BOARD.burst), len(BOARD.burst), b"")
    assert len(kept.entries) == 2, "the one before the ring was there, too"
    for fd in (reads, writes):
        os.close(fd)


def test_the_longest_payloads_fit_their_rings() -> None:
    assert len(box.pack_wire(box.WIRE_FRAME, bytes(300), 300)) <= box.WIRE.most
    assert len(box.pack_board(box.IMU_KIND, *(1.0,) * 6)) <= box.BOARD_BYTES
    assert len(box.pack_board(box.PAD_KIND, 0xFFFF, 255, -128, 127, 0, 0, 1)) <= box.BOARD_BYTES
    assert len(box.pack_beats([2**40] * 5, [0] * 5)) <= box.OF_BEATS.most
    packed = box.pack_beats([2**40, -1, 0, 1, 2], [5, 6, 7, 8, 9])
    assert box.unpack_beats(packed) == ((box.MOST_U32, 5), (0, 6), (0, 7), (1, 8), (2, 9))


def test_all_rings_together_stay_within_two_and_a_half_megabytes() -> None:
    taken = sum(spec.records["box"].size() for spec in layout.SEGMENTS if "box" in spec.records)
    assert 0 < taken < 2_500_000
    assert [spec.name for spec in layout.SEGMENTS if "box" in spec.records] == [
        layout.SUPERVISOR,
        layout.PORT_OWNER,
        layout.GATE,
        layout.TELEMETRY,
    ]


@pytest.mark.parametrize("payload", [b"", b"\0", b"\x09" * 30, bytes(104)])
def test_what_is_no_record_is_refused(payload: bytes) -> None:
    for unpack in (box.unpack_board, box.unpack_beats):
        with pytest.raises(ValueError, match=r"record|payload"):
            unpack(payload)
    if len(payload) < 40:
        with pytest.raises(ValueError, match=r"record|payload"):
            box.unpack_gate(payload)
    if len(payload) < 5:
        with pytest.raises(ValueError, match=r"record|payload"):
            box.WIRE.unpack(payload)


def told(gate: GateBox, reader: RingReader, core: GateCore, now_ns: int) -> dict[str, Any]:
    gate.tick(now_ns, core, 7)
    entry = reader.next()
    assert entry is not None
    return box.unpack_gate(entry[2])


def test_a_tick_tells_whether_the_newest_command_is_the_one_that_drives() -> None:
    core = Recorder().core
    writer, reader = ring(box.TICK.most, 8)
    gate = GateBox(writer)
    none = told(gate, reader, core, at(0))
    assert (none["command"], none["age_us"], none["source"], none["who"]) == ((0, 0, 0), None, "", "")
    assert not none["drives"]
    for number, (taken, manual) in enumerate([(True, False), (False, False), (True, True), (False, True)]):
        source = "cmd_vel" if taken else "cmd_vel_and_much_more"
        command = Command(1, "nav \udcff" + "x" * 60, at(number), (0.1, 0, 0), source, records.BY_HAND if manual else 0)
        if taken:
            core.sources.put(command, at(number))
        gate.command(command)
        found = told(gate, reader, core, at(number))
        assert (found["drives"], found["manual"], found["enabled"]) == (taken, manual, False)
        assert (found["source"], found["age_us"]) == (source[:16], 0)
        assert found["who"] == "nav ?" + "x" * 31


TELEOP: dict[str, object] = {"sources.teleop.priority": 90, "sources.teleop.timeout_s": 0.5}
"""A source with a higher priority than cmd_vel."""


def two_send(*senders: str) -> list[tuple[str, bool, int]]:
    """The source of each tick's command, whether it drives, and how many commands the tick counts. Each of `senders`
    has the first letters of the sources that send before a tick, in this order."""
    made = Recorder(settings=TELEOP)
    for turn, letters in enumerate(senders):
        for letter in letters:
            source, session = {"t": ("teleop", 2), "c": ("cmd_vel", 1)}[letter]
            made.command(turn * 20, (0.1, 0, 0), source, source, session)
        made.tick(turn * 20)
    return [(tick.source, tick.drives, tick.commands) for tick in made.incident().ticks]


def test_a_command_that_drives_has_a_tick_though_another_source_sent_the_newest() -> None:
    assert two_send("tc", "", "tc", "tc", "", "c") == [
        ("teleop", True, 1),
        ("cmd_vel", False, 1),
        ("teleop", True, 1),
        ("cmd_vel", False, 3),
        ("teleop", True, 0),
        ("cmd_vel", False, 1),
    ]


def test_of_two_sources_that_send_in_every_tick_both_are_recorded() -> None:
    assert [source for source, _, _ in two_send(*["tc"] * 6)] == ["teleop", "cmd_vel"] * 3


def test_a_command_that_drives_only_since_another_source_fell_silent_has_a_tick() -> None:
    """The newest command is that of a third source, and has its own tick before."""
    made = Recorder(
        settings=TELEOP | {"sources.cmd_vel.priority": 10, "sources.slow.priority": 5, "sources.slow.timeout_s": 2.0}
    )
    made.command(0, (0.1, 0, 0), "teleop", "teleop", 3)
    made.tick(0)
    made.command(400, (0.1, 0, 0))
    made.tick(400)
    made.command(410, (0.1, 0, 0), "slow", "slow", 2)
    for ms in (420, 520):
        made.tick(ms)
    ticks = [(tick.source, tick.drives, tick.commands) for tick in made.incident().ticks]
    assert ticks == [("teleop", True, 1), ("cmd_vel", False, 1), ("slow", False, 1), ("cmd_vel", True, 0)]


def test_a_command_that_stops_the_robot_is_never_left_for_later() -> None:
    made = Recorder(settings=TELEOP)
    made.command(0, (0.1, 0, 0), "teleop", "teleop", 2)
    made.command(1, (nan, 0, 0))
    made.tick(2)
    (tick,) = made.incident().ticks
    assert (tick.source, tick.commands) == ("cmd_vel", 2)


def test_a_decision_of_another_version_is_shown_by_its_number() -> None:
    made = Recorder()
    writer, reader = ring(box.TICK.most, 8)
    GateBox(writer).tick(at(0), made.core, 7)
    entry = reader.next()
    assert entry is not None
    for number in (len(box.DECISIONS), 200):
        assert box.unpack_gate(entry[2][:4] + bytes([number]) + entry[2][5:])["block"] == f"unknown {number}"


def test_of_what_was_written_a_frame_s_first_bytes_are_kept() -> None:
    data = bytes(range(100))
    assert box.WIRE.unpack(box.pack_wire(box.WIRE_FRAME, data, 7)) == (box.WIRE_FRAME, 100, 7, data[: box.WIRE_HEAD])
    assert box.WIRE.unpack(box.pack_wire(box.WIRE_REST, data, 0)) == (box.WIRE_REST, 100, 0, b"")
    assert box.WIRE.unpack(box.pack_wire(box.WIRE_REST, bytes(70_000), 70_000)) == (box.WIRE_REST, 65_535, 65_535, b"")


def test_what_the_board_sent_comes_back_as_what_it_was() -> None:
    imu = box.pack_board(box.IMU_KIND, 1.0, 2.0, 3.0, 4.0, 5.0, 6.0)
    assert box.unpack_board(imu) == (box.IMU_KIND, (1.0, 2.0, 3.0, 4.0, 5.0, 6.0))
    assert box.unpack_board(box.pack_board(box.BATTERY_KIND, 12_345, 2)) == (box.BATTERY_KIND, (12_345, 2))
    pad = box.pack_board(box.PAD_KIND, 0xFFFF, 255, -128, 127, 0, 1, 1)
    assert box.unpack_board(pad) == (box.PAD_KIND, (0xFFFF, 255, -128, 127, 0, 1, 1))
    for wrong in (imu[:-1], imu + b"x", bytes([box.PAD_KIND]) + imu[1:]):
        with pytest.raises(ValueError, match="payload of"):
            box.unpack_board(wrong)


@given(
    mode=st.sampled_from(box.ARM_MODES),
    who=st.text(max_size=60),
    aims=st.lists(
        st.tuples(st.integers(1, 253), st.floats(-1000, 1000, width=32)), max_size=12, unique_by=lambda a: a[0]
    ),
)
def test_what_the_arm_is_to_do_fits_its_ring(mode: str, who: str, aims: list[tuple[int, float]]) -> None:
    writer, reader = ring(box.ARM_BYTES, 8)
    writer.put(box.pack_arm(mode, who, aims))
    entry = reader.next()
    assert entry
    assert box.unpack_arm(entry[2])[0] == mode
    assert box.unpack_arm(entry[2])[2] == dict(aims[: records.MOST_JOINTS])
    assert who.startswith(box.unpack_arm(entry[2])[1].rstrip("\ufffd"))


def test_a_name_that_is_too_long_or_no_utf_8_fills_the_rest_of_the_record_of_the_arm() -> None:
    aims = [(servo, 500.0) for servo in range(1, records.MOST_JOINTS + 1)]
    packed = box.pack_arm("jog", "\udcff" + "\u00e9" * 80, aims)
    assert len(packed) == box.ARM_BYTES
    assert box.unpack_arm(packed) == ("jog", "?" + "\u00e9" * 18 + "\ufffd", dict(aims))


def test_a_record_of_beats_of_another_version_is_told_by_its_kind() -> None:
    with pytest.raises(ValueError, match=r"^a record of beats of the kind 3$"):
        box.unpack_beats(box.OF_BEATS.pack(3, *range(10)))


@pytest.mark.parametrize("payload", [b"", b"\x01", b"\x04\x00", b"\x09\x00", b"\x01\x02" + bytes(9)])
def test_what_is_none_of_it_is_refused(payload: bytes) -> None:
    with pytest.raises(ValueError, match="a record of the arm"):
        box.unpack_arm(payload)


@pytest.mark.parametrize("value", [None, 0, 500, -3, 12_000])
def test_a_servo_s_answer(value: int | None) -> None:
    packed = box.pack_board(box.SERVO_KIND, 10, 5, value)
    assert len(packed) <= box.BOARD_BYTES
    assert box.unpack_board(packed) == (box.SERVO_KIND, (10, 5, value))
