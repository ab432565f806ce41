"""Telemetry, turn by turn: what the board and the gate say, and what comes of it."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import msgpack
import pytest

from failstop.board import framing
from failstop.board.decoder import KEY_EVENTS
from failstop.policy import causes
from failstop.procs.telemetry import pad
from failstop.procs.telemetry.battery import LOW_READINGS
from failstop.shm import records
from tests.support.telemetry_scene import MS, Scene
from tests.support.waiting import until

MODE = 0x2000
X = 0x0100
STOPPING_EVENTS = {"pressed", "long", "long-repeat", "click", "double", "triple"}


@pytest.fixture
def changed() -> dict[str, object]:
    """Settings that are not the defaults."""
    return {}


@pytest.fixture
def scene(tmp_path: Path, monkeypatch: pytest.MonkeyPatch, changed: dict[str, object]) -> Iterator[Scene]:
    made = Scene(tmp_path, monkeypatch, **changed)
    yield made
    made.close()


@pytest.fixture
def sounding(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[Scene]:
    made = Scene(tmp_path, monkeypatch, **{"buzzer.tones": "on"})
    yield made
    made.close()


def test_a_sample_is_published_in_its_units(scene: Scene) -> None:
    scene.imu(0.0, -1.0, 1.0, 0.0, 90.0, -180.0)
    found = records.IMU.unpack(scene.latest("imu") or b"")
    assert found == pytest.approx((0.0, -9.80665, 9.80665, 0.0, math.pi / 2, -math.pi), rel=1e-6)


def test_after_3_s_the_rate_is_free_of_its_bias_and_the_journal_says_so(scene: Scene) -> None:
    scene.stand(3.1)
    (note,) = scene.notes()
    assert note.startswith("gyro bias [0.0000 0.0000 0.2500] deg/s from 33")
    assert scene.rung("supervisor_bell")
    bias, _, calibrated = scene.bias()
    assert bias == pytest.approx((0.0, 0.0, math.radians(0.25)))
    assert calibrated
    assert records.IMU.unpack(scene.latest("imu") or b"")[5] == pytest.approx(0.0, abs=1e-9)


def test_it_says_whether_the_bias_is_tracking(scene: Scene) -> None:
    scene.stand(3.5)
    assert scene.bias()[1]
    scene.gate["body_vel"] = [0.1, 0.0, 0.0]
    scene.stand(0.1)
    assert not scene.bias()[1]
    scene.gate["body_vel"] = [0.0, 0.0, 0.0]
    scene.stand(0.9)
    assert not scene.bias()[1]
    scene.stand(0.2)
    assert scene.bias()[1]


def test_a_successor_goes_on_with_the_bias_and_calibrates_anew_at_rest(scene: Scene) -> None:
    scene.stand(3.5)
    scene.notes()
    scene.start()
    assert scene.bias()[2]
    scene.imu(0.0, 0.0, 1.0, 0.0, 0.0, 0.25)
    assert records.IMU.unpack(scene.latest("imu") or b"")[5] == pytest.approx(0.0, abs=1e-9)
    scene.stand(3.5, z_dps=0.3)
    assert scene.notes()[0].startswith("gyro bias")
    assert scene.bias()[0] == pytest.approx((0.0, 0.0, math.radians(0.3)), rel=1e-3)


def test_a_value_of_any_size_is_no_end(scene: Scene) -> None:
    """The frame's check byte is one of 256: a wild frame passes for a sample at times."""
    huge = 3.4e38
    for raw in ((huge, 0.0, 1.0, 0.0, 0.0, 0.0), (-huge, huge, huge, huge, -huge, huge)):
        scene.imu(*raw)
        assert records.IMU.unpack(scene.latest("imu") or b"")[0] == pytest.approx(raw[0] * 9.80665, rel=1e-6)
    scene.imu(0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    assert records.IMU.unpack(scene.latest("imu") or b"")[2] == pytest.approx(9.80665, rel=1e-6)


def test_a_successor_calibrates_only_if_the_wheels_stand(scene: Scene) -> None:
    scene.stand(3.5)
    scene.notes()
    scene.gate.update(enabled=True, body_vel=[0.0, 0.0, 0.5])
    scene.turn()
    scene.start()
    scene.stand(4.0, z_dps=28.0)
    (note,) = scene.notes()
    assert note.startswith("robot not stationary during gyro calibration")
    bias, _, calibrated = scene.bias()
    assert bias == pytest.approx((0.0, 0.0, math.radians(0.25)), rel=1e-3)
    assert calibrated


def test_odometry_follows_the_gate(scene: Scene) -> None:
    scene.gate.update(enabled=True, body_vel=[0.2, 0.0, 0.0])
    scene.turn()
    for _ in range(50):
        scene.turn(elapsed_ns=20 * MS)
    found = records.ODOMETRY.unpack(scene.latest("odometry") or b"")
    assert found[:3] == pytest.approx((0.2, 0.0, 0.0))
    assert found[3:6] == (0.2, 0.0, 0.0)
    assert found[6:] == (0.05, 0.2), "the standard deviation of the twist"
    scene.start()
    scene.turn(elapsed_ns=20 * MS)
    assert records.ODOMETRY.unpack(scene.latest("odometry") or b"")[0] >= 0.2 - 1e-9, "a successor goes on from there"


def test_odometry_stands_when_the_gate_is_silent(scene: Scene) -> None:
    scene.gate.update(enabled=True, body_vel=[0.2, 0.0, 0.0])
    scene.turn()
    for _ in range(100):
        scene.turn(elapsed_ns=20 * MS, gate=False)
    found = records.ODOMETRY.unpack(scene.latest("odometry") or b"")
    assert found[0] == pytest.approx(0.2 * 0.26)
    assert found[3:6] == (0.0, 0.0, 0.0)


def test_a_button_stops_and_its_raw_frames_are_in_the_log(scene: Scene) -> None:
    scene.pad(ly=5)
    scene.pad(X)
    assert scene.told("causes") == [causes.BUTTON(0x0100).pack()]
    assert scene.rung("port_owner_bell")
    assert scene.notes() == ["gamepad button 0x0100; last frames: 00000000050000 (-50 ms), 00010000000000 (-0 ms)"]
    assert [msgpack.unpackb(event) for event in scene.told("buttons")] == [
        {"kind": "pad", "buttons": X, "raw": "00010000000000"}
    ]


@pytest.mark.parametrize("event", [0x01, 0x02, 0x04, 0x20, 0x40, 0x80])
def test_key_1_s_presses_trip(scene: Scene, event: int) -> None:
    scene.key(1, event)
    assert scene.told("causes") == [causes.KEY(1).pack()]


@pytest.mark.parametrize(("key", "event"), [(1, 0x08), (1, 0x10), (2, 0x01)])
def test_other_keys_and_releases_do_not(scene: Scene, key: int, event: int) -> None:
    scene.key(key, event)
    assert scene.told("causes") == []
    assert len(scene.told("buttons")) == 1


def test_the_pad_s_frame_and_mode_are_published(scene: Scene) -> None:
    scene.pad(lx=-3, ly=4, rx=5)
    assert records.PAD.unpack(scene.latest("pad") or b"") == (0, 0, -3, 4, 5, 0, 0)
    scene.pad(MODE)
    assert records.PAD.unpack(scene.latest("pad") or b"") == (MODE, 0, 0, 0, 0, 0, 1)


def test_in_drive_mode_each_frame_is_a_command_and_rings_the_gate(scene: Scene) -> None:
    scene.pad(ly=127)
    assert scene.commands() == 0
    scene.pad(MODE)
    written = scene.commands()
    assert scene.rung("gate_bell")
    for i in range(1, 4):
        scene.pad(ly=127, rx=-127)
        assert scene.commands() == written + i
        assert scene.rung("gate_bell")
    assert records.PAD_COMMAND.unpack(scene.latest("pad_command") or b"") == pytest.approx((0.2, 0.0, 1.0))


def test_a_latch_ends_drive_mode(scene: Scene) -> None:
    scene.pad(MODE)
    scene.gate["estop"] = causes.KEY(1).pack()
    scene.pad(ly=127)
    written = scene.commands()
    scene.pad(ly=127)
    assert scene.commands() == written == 1
    assert records.PAD.unpack(scene.latest("pad") or b"")[6] == 0


def test_a_latch_that_came_and_went_unseen_ends_drive_mode_too(scene: Scene) -> None:
    scene.pad(MODE)
    written = scene.commands()
    scene.gate["epoch"] += 1
    scene.pad(ly=127)
    assert scene.commands() == written
    assert records.PAD.unpack(scene.latest("pad") or b"")[6] == 0


def test_mode_held_since_before_a_newer_stop_resets_nothing(scene: Scene) -> None:
    scene.gate["estop"] = causes.KEY(1).pack()
    for _ in range(38):
        scene.pad(MODE)
    scene.gate["epoch"] += 1
    for _ in range(38):
        scene.pad(MODE)
    assert scene.told("pad_requests") == []
    for _ in range(4):
        scene.pad(MODE)
    assert [records.PAD_REQUEST.unpack(request)[0] for request in scene.told("pad_requests")] == [records.PAD_RESET]


def test_mode_held_for_2_s_while_latched_requests_one_reset(scene: Scene) -> None:
    scene.gate["estop"] = causes.KEY(1).pack()
    for _ in range(60):
        scene.pad(MODE)
    assert [records.PAD_REQUEST.unpack(request) for request in scene.told("pad_requests")] == [(records.PAD_RESET, b"")]
    assert scene.rung("gate_bell")
    assert scene.notes() == ["gamepad: MODE was held, reset requested"]


def test_tones_are_requests_for_frames_that_are_not_motion(sounding: Scene) -> None:
    sounding.pad(MODE)
    sounding.gate["estop"] = causes.KEY(1).pack()
    sounding.turn(elapsed_ns=20 * MS)
    requests = [records.PAD_REQUEST.unpack(request) for request in sounding.told("pad_requests")]
    assert requests == [(records.PAD_FRAME, pad.MODES[1]), (records.PAD_FRAME, pad.LATCH)]
    assert all(frame[2] == framing.BUZZER for _, frame in requests)
    assert sounding.rung("gate_bell")


def test_off_by_default_nothing_sounds(scene: Scene) -> None:
    scene.pad(MODE)
    scene.gate["estop"] = causes.KEY(1).pack()
    scene.turn(elapsed_ns=20 * MS)
    assert scene.told("pad_requests") == []


@pytest.mark.parametrize(("event", "name"), KEY_EVENTS.items(), ids=KEY_EVENTS.values())
def test_the_stop_key_s_presses_stop_and_its_releases_do_not(scene: Scene, event: int, name: str) -> None:
    scene.key(1, event)
    assert scene.told("causes") == ([causes.KEY(1).pack()] if name in STOPPING_EVENTS else [])


def test_other_keys_do_not_stop(scene: Scene) -> None:
    for key in (0, 2, 255):
        for event in KEY_EVENTS:
            scene.key(key, event)
    assert scene.told("causes") == []


@pytest.mark.parametrize("changed", [{"key.stop": 2}])
def test_the_stop_key_is_the_setting_s(scene: Scene) -> None:
    scene.key(1, 0x01)
    scene.key(2, 0x01)
    assert scene.told("causes") == [causes.KEY(2).pack()]


def test_the_charger_is_seen_told_and_remembered(scene: Scene) -> None:
    scene.battery(*[11_800] * 8)
    assert records.BATTERY.unpack(scene.latest("battery") or b"") == (11_800, 0)
    scene.battery(12_049)
    assert records.BATTERY.unpack(scene.latest("battery") or b"") == (12_049, 1)
    assert scene.notes() == ["charger plugged: the battery stepped to 12049 mV"]
    until((scene.folder / "charger").exists, "the file")
    assert (scene.folder / "charger").read_text() == "plugged\n"
    scene.start()
    scene.battery(12_049)
    assert records.BATTERY.unpack(scene.latest("battery") or b"") == (12_049, 1)


@pytest.mark.parametrize("content", ["", "nonsense", "\xff\x00"])
def test_a_damaged_charger_file_is_unknown(scene: Scene, content: str) -> None:
    scene.folder.mkdir()
    (scene.folder / "charger").write_text(content)
    scene.start()
    scene.battery(11_800)
    assert records.BATTERY.unpack(scene.latest("battery") or b"") == (11_800, 0)


def test_a_low_battery_stops_where_the_settings_say_so(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    scene = Scene(tmp_path, monkeypatch, **{"battery.stop_mv": 10_500})
    scene.battery(*[10_400] * LOW_READINGS)
    assert scene.told("causes") == [causes.BATTERY(10.4).pack()]
    scene.close()


def test_the_battery_log_is_written(scene: Scene) -> None:
    log = scene.folder / "battery-2026-03-16.csv"
    scene.battery(*[11_800] * 5)
    scene.gate["enabled"] = True
    scene.battery(*[11_700] * 8)
    until(lambda: log.exists() and log.read_text().count("\n") >= 3, "two lines")
    assert log.read_text() == "unix_s,battery_mv,enabled\n1773662400.0,11800,0\n1773662400.0,11700,1\n"


def test_a_directory_that_can_t_be_made_is_a_line_in_the_journal(scene: Scene) -> None:
    scene.folder.write_text("a file is in the way")
    notes: list[str] = []

    def said() -> bool:
        scene.battery(11_800)
        notes.extend(scene.notes())
        return bool(notes)

    until(said, "the note")
    assert notes[0].startswith("battery log can't be written: ")
    assert len(notes) == 1
    assert records.BATTERY.unpack(scene.latest("battery") or b"") == (11_800, 0)


def test_what_people_are_told_is_at_most_280_bytes(scene: Scene) -> None:
    scene.telemetry._note("note", "é" * 500, {"reason": "x" * 5000})
    (text,) = scene.notes()
    assert len(text.encode()) == 280
    assert set(text) == {"é"}


def test_frames_that_make_no_sense_are_not_passed_on(scene: Scene) -> None:
    scene.turn((framing.IMU, b"short"), (framing.SYS, b"\x04"), (framing.GAMEPAD, b"1"), (framing.KEY, b"\x01\x03"))
    scene.turn((framing.SBUS, bytes(36)))
    assert [scene.latest(name) for name in ("imu", "battery", "pad")] == [None] * 3
    assert scene.told("causes") == []


def test_it_beats(scene: Scene) -> None:
    scene.turn(elapsed_ns=20 * MS)
    assert scene.own.word("beat_ns").get() == scene.now_ns
