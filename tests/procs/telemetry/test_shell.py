"""Telemetry, turn by turn: what the board and the gate say, and what comes of it."""

from __future__ import annotations

import math

import msgpack
import pytest

from failstop.board.rrc import framing
from failstop.board.rrc.decoder import KEY_EVENTS
from failstop.messages import records
from failstop.policy import causes
from failstop.procs.telemetry import pad
from failstop.procs.telemetry.battery import LOW_READINGS
from failstop.procs.telemetry.main import GateState
from tests.support.stage import MS
from tests.support.telemetry_scene import FOLDER, S, Scene

MODE = 0x2000
X = 0x0100
RELEASES = (0x08, 0x10)


def test_a_sample_is_published_in_its_units_and_telemetry_beats(scene: Scene) -> None:
    scene.imu(0.0, -1.0, 1.0, 0.0, 90.0, -180.0)
    found = scene.latest("imu")
    assert found == pytest.approx((0.0, -9.80665, 9.80665, 0.0, math.pi / 2, -math.pi), rel=1e-6)
    assert scene.own.word("beat_ns").get() == scene.clock()


def test_the_bias_is_found_in_3_s_told_tracked_and_inherited(scene: Scene) -> None:
    scene.stand(3.1)
    (note,) = scene.notes()
    assert note.startswith("gyro bias [0.0000 0.0000 0.2500] deg/s from 33")
    assert scene.rung("supervisor_bell")
    bias, _, calibrated = scene.bias()
    assert bias == pytest.approx((0.0, 0.0, math.radians(0.25)))
    assert calibrated
    assert scene.latest("imu")[5] == pytest.approx(0.0, abs=1e-9)

    scene.stand(0.4)
    assert scene.bias()[1]
    scene.gate["body_vel"] = [0.1, 0.0, 0.0]
    scene.stand(0.1)
    assert not scene.bias()[1]
    scene.gate["body_vel"] = [0.0, 0.0, 0.0]
    scene.stand(0.9)
    assert not scene.bias()[1]
    scene.stand(0.2)
    assert scene.bias()[1]

    scene.start_telemetry()
    assert scene.bias()[2], "a successor goes on with it"
    scene.imu(0.0, 0.0, 1.0, 0.0, 0.0, 0.25)
    assert scene.latest("imu")[5] == pytest.approx(0.0, abs=1e-9)
    scene.stand(3.5, z_dps=0.3)
    assert scene.notes()[0].startswith("gyro bias"), "and calibrates anew at rest"
    assert scene.bias()[0] == pytest.approx((0.0, 0.0, math.radians(0.3)), rel=1e-3)

    scene.gate.update(enabled=True, body_vel=[0.0, 0.0, 0.5])
    scene.turn()
    scene.start_telemetry()
    scene.stand(0.1, z_dps=28.0)
    (note,) = scene.notes()
    assert note.startswith("robot not stationary during gyro calibration"), "but not while the wheels turn"
    scene.stand(3.9, z_dps=28.0)
    bias, _, calibrated = scene.bias()
    assert bias == pytest.approx((0.0, 0.0, math.radians(0.3)), rel=1e-3)
    assert calibrated
    assert scene.notes() == []


def test_a_sample_that_cannot_be_is_not_published_and_is_logged_once(scene: Scene) -> None:
    huge = 3.4e38
    odd = (huge, 0.0, 1.0, 0.0, 0.0, 0.0), (-huge, huge, huge, huge, -huge, huge), (math.nan, 0.0, 1.0, 0.0, 0.0, 0.0)
    for raw in odd:
        scene.imu(*raw)
        assert scene.latest("imu") == ()
    scene.imu(0.0, 0.0, 1.0, 0.0, 0.0, 0.0)
    assert scene.latest("imu")[2] == pytest.approx(9.80665, rel=1e-6)
    told = "3.3999999521443642e+38, 0.0, 1.0, 0.0, 0.0, 0.0: no such value is possible, so it counts as not reported"
    assert [text for text in scene.notes() if "IMU" in text] == [f"the board reports IMU as {told}"]


def test_odometry_follows_the_gate_and_stands_when_that_is_silent(scene: Scene) -> None:
    scene.gate.update(enabled=True, body_vel=[0.2, 0.0, 0.0])
    scene.turn()
    for _ in range(50):
        scene.turn(elapsed_ns=20 * MS)
    found = scene.latest("odometry")
    assert found[:3] == pytest.approx((0.2, 0.0, 0.0))
    assert found[3:8] == (0.2, 0.0, 0.0, 0.05, 0.2), "the velocity, and the standard deviation of the twist"
    assert found[8:] == (records.BY_COMMANDS, 1e3, 0.0, 0.0, 1e3, 0.0, 1e3)
    scene.start_telemetry()
    scene.turn(elapsed_ns=20 * MS)
    begun_m = scene.latest("odometry")[0]
    assert begun_m >= 0.2 - 1e-9, "a successor goes on from there"
    for _ in range(100):
        scene.turn(elapsed_ns=20 * MS, gate=False)
    found = scene.latest("odometry")
    assert found[0] - begun_m == pytest.approx(0.2 * 0.26)
    assert found[3:6] == (0.0, 0.0, 0.0)


def test_a_button_stops_and_its_raw_frames_are_in_the_log(scene: Scene) -> None:
    scene.pad(ly=5)
    scene.pad(X)
    assert scene.told("causes") == [causes.BUTTON(0x0100).pack()]
    assert scene.rung("port_owner_bell")
    assert scene.notes() == ["gamepad button 0x0100; last frames: 00000000050000 (-50 ms), 00010000000000 (-0 ms)"]


@pytest.mark.parametrize("stop_key", [1, 2])
def test_the_presses_of_the_stop_key_stop_and_nothing_else_of_a_key(stop_key: int) -> None:
    scene = Scene(**{"key.stop": stop_key})
    for key in (0, 1, 2, 255):
        for event in KEY_EVENTS:
            scene.key(key, event)
            stops = key == stop_key and event not in RELEASES
            assert scene.told("causes") == ([causes.KEY(key).pack()] if stops else [])


def test_the_pad_s_frame_and_mode_are_published(scene: Scene) -> None:
    scene.pad(lx=-3, ly=4, rx=5)
    assert scene.latest("pad") == (0, 0, -3, 4, 5, 0, 0)
    scene.pad(MODE)
    assert scene.latest("pad") == (MODE, 0, 0, 0, 0, 0, 1)


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
    assert scene.latest("pad_command") == pytest.approx((0.2, 0.0, 1.0))


def test_a_pad_that_repeats_a_pushed_stick_is_reported_and_commands_zero_once(scene: Scene) -> None:
    scene.pad(MODE)
    scene.pad(ly=127, times=301)
    assert scene.latest("pad_command") == (0.0, 0.0, 0.0)
    assert scene.latest("pad")[6] == 0
    assert [note for note in scene.notes() if "frozen" in note or "out of reach" in note] == [
        "gamepad locked: a stick is pushed and no byte has changed for 15 s, so it may be out of reach"
    ]
    written = scene.commands()
    scene.pad(ly=127, times=20)
    assert scene.commands() == written


@pytest.mark.parametrize("seen", [True, False])
def test_a_latch_ends_drive_mode_also_one_that_came_and_went_unseen(scene: Scene, seen: bool) -> None:
    scene.pad(MODE)
    written = scene.commands()
    if seen:
        scene.gate["estop"] = causes.KEY(1).pack()
    else:
        scene.gate["epoch"] += 1
    scene.pad(ly=127, times=2)
    assert scene.commands() == written == 1
    assert scene.latest("pad")[6] == 0


@pytest.mark.parametrize("how", ["a stop", "telemetry was restarted"])
def test_a_pad_that_is_silent_is_published_as_locked_once_it_is(scene: Scene, how: str) -> None:
    scene.pad(MODE)
    scene.pad(ly=127)
    assert scene.latest("pad") == (0, 0, 0, 127, 0, 0, 1)
    if how == "a stop":
        scene.gate["estop"] = causes.KEY(1).pack()
        scene.turn(elapsed_ns=20 * MS)
    else:
        scene.start_telemetry()
    assert scene.latest("pad")[6] == 0


def test_a_pad_that_was_never_heard_is_not_published(scene: Scene) -> None:
    scene.start_telemetry()
    scene.gate["estop"] = causes.KEY(1).pack()
    scene.turn(elapsed_ns=20 * MS)
    assert scene.latest("pad") == ()


@pytest.mark.parametrize("newer", [True, False])
def test_mode_held_for_2_s_since_the_newest_stop_requests_one_reset(scene: Scene, newer: bool) -> None:
    scene.gate["estop"] = causes.KEY(1).pack()
    scene.pad(MODE, times=38)
    scene.gate["epoch"] += newer
    scene.pad(MODE, times=38)
    assert len(scene.requests()) == (not newer)
    scene.pad(MODE, times=4)
    assert scene.requests() == [(records.PAD_RESET, b"")] * newer
    assert scene.rung("gate_bell")
    assert scene.notes() == ["gamepad: MODE was held, reset requested"]


@pytest.mark.parametrize("on", [True, False])
def test_tones_are_requests_for_frames_that_are_not_motion_and_off_by_default(on: bool) -> None:
    scene = Scene(**({"buzzer.tones": "on"} if on else {}))
    scene.pad(MODE)
    scene.gate["estop"] = causes.KEY(1).pack()
    scene.turn(elapsed_ns=20 * MS)
    requests = scene.requests()
    sounds = (pad.MODE_SOUNDS[1], pad.LATCH_SOUND)
    assert requests == [(records.PAD_FRAME, scene.board.buzzer(*sound)) for sound in sounds] * on
    assert all(frame[2] == framing.BUZZER for _, frame in requests)
    assert scene.rung("gate_bell")


def test_a_gyro_that_fell_silent_is_compared_with_no_command(scene: Scene) -> None:
    scene.stand(3.1)
    scene.gate |= {"enabled": True, "body_vel": [0.0, 0.0, 1.0]}
    scene.stand(1.0, z_dps=0.25 + math.degrees(1.0))
    scene.notes()
    scene.gate["body_vel"] = [0.0, 0.0, 0.3]
    scene.turn(elapsed_ns=5 * S)
    assert scene.notes() == [], "its last turn rate fits the command before"
    scene.gate["body_vel"] = [0.0, 0.0, 1.0]
    scene.stand(2.0, z_dps=0.25 + math.degrees(3.0))
    assert any("as the gyro measures it" in note for note in scene.notes()), "it is heard again"


def test_the_charger_is_seen_told_and_known_to_a_successor(scene: Scene) -> None:
    scene.battery(*[11_800] * 8)
    assert scene.latest("battery") == (11_800, 0)
    scene.battery(12_049)
    assert scene.latest("battery") == (12_049, 1)
    assert scene.notes() == ["charger plugged: the battery's voltage jumped to 12049 mV"]
    scene.start_telemetry()
    scene.battery(12_049)
    assert scene.latest("battery") == (12_049, 1)


def test_the_charger_of_an_earlier_run_is_not_known(scene: Scene) -> None:
    """Such a file was written once, and believed after the robot was unplugged and switched on again."""
    scene.os.mkdir(FOLDER)
    scene.write_text(f"{FOLDER}/charger", "plugged\n")
    scene.start_telemetry()
    scene.battery(12_049)
    assert scene.latest("battery") == (12_049, 0)


def test_a_low_battery_stops_where_the_settings_say_so() -> None:
    scene = Scene(**{"battery.stop_mv": 10_500})
    scene.battery(*[10_400] * (LOW_READINGS + 1))
    assert scene.told("causes") == [causes.BATTERY(10.4).pack()]
    scene.battery(*[11_000] * 20, *[10_400] * 20)
    assert scene.told("causes") == [], "once per charge"


def test_the_battery_log_is_written(scene: Scene) -> None:
    scene.battery(*[11_800] * 5)
    scene.gate["enabled"] = True
    scene.battery(*[11_700] * 8)
    found = scene.read_text(f"{FOLDER}/battery-2026-03-16.csv")
    assert found == "unix_s,battery_mv,enabled\n1773662401.0,11800,0\n1773662411.5,11700,1\n"


@pytest.mark.parametrize(("directory", "readings"), [(FOLDER, 20), ("/way/" + "é" * 200, 2)])
def test_a_directory_that_can_t_be_made_is_a_note_of_at_most_280_bytes(directory: str, readings: int) -> None:
    scene = Scene(**{"battery.directory": directory})
    scene.write_text("/" + directory.split("/")[1], "a file is in the way")
    scene.battery(*[11_800] * readings)
    (note,) = scene.notes()
    assert note.startswith("battery log can't be written: ")
    assert readings == 20 or (len(note.encode()), note[-100:]) == (280, "é" * 100)
    assert scene.latest("battery") == (11_800, 0)


def test_frames_that_make_no_sense_are_not_passed_on(scene: Scene) -> None:
    scene.turn(
        (framing.IMU_FUNC, b"short"), (framing.SYS, b"\x04"), (framing.GAMEPAD, b"1"), (framing.KEY_FUNC, b"\x01\x03")
    )
    scene.turn((framing.SBUS, bytes(36)))
    assert [scene.latest(name) for name in ("imu", "battery", "pad")] == [()] * 3
    assert scene.told("causes") == []


class Published:
    """A stand-in for the gate's record."""

    def __init__(self) -> None:
        self.entry: tuple[int, int, bytes] | None = None

    def read(self) -> tuple[int, int, bytes] | None:
        return self.entry

    def put(self, t_ns: int, **changed: object) -> None:
        state = {"enabled": True, "estop": None, "blocked": None, "epoch": 7, "body_vel": [0.1, 0.0, -0.5], **changed}
        state.setdefault("wheels_rps", [0.4, 0.4])
        self.raw(t_ns, msgpack.packb(state))

    def raw(self, t_ns: int, payload: bytes) -> None:
        self.entry = ((self.entry[0] if self.entry else 0) + 1, t_ns, payload)


@pytest.fixture
def published() -> Published:
    return Published()


@pytest.fixture
def gate(published: Published) -> GateState:
    return GateState(published)  # type: ignore[arg-type]


def test_a_state_of_the_gate_is_news_once_and_until_then_nothing_moves(gate: GateState, published: Published) -> None:
    assert not gate.read(10_000 * MS)
    assert (gate.enabled, gate.latched, gate.commanded) == (False, False, False)
    published.put(100 * MS)
    assert gate.read(101 * MS)
    assert (gate.enabled, gate.latched, gate.velocity, gate.since_ns) == (True, False, (0.1, 0.0, -0.5), 100 * MS)
    assert gate.commanded
    for payload in (None, b"", b"\xc1", msgpack.packb(7), msgpack.packb({"enabled": True})):
        if payload is not None:
            published.raw(110 * MS, payload)
        assert not gate.read(110 * MS), "a payload that is no state changes nothing"
        assert gate.commanded
    published.put(111 * MS, estop="", body_vel=[0, 0, 0])
    assert gate.read(111 * MS)
    assert (gate.latched, gate.commanded) == (True, False), "a latch is any reason"
    published.put(112 * MS)
    assert gate.read(900 * MS), "the state of a dead gate is old at once"
    assert not gate.commanded


@pytest.mark.parametrize("velocity", [[0.1, 0.0, -0.5], [0, 0, 0]])
def test_a_gate_silent_for_250_ms_moves_nothing(gate: GateState, published: Published, velocity: list[float]) -> None:
    published.put(100 * MS, body_vel=velocity)
    gate.read(100 * MS)
    assert gate.enabled
    assert not gate.read(350 * MS)
    assert gate.read(350 * MS + 1)
    assert (gate.commanded, gate.enabled, gate.since_ns) == (False, False, 350 * MS + 1)
    assert not gate.read(400 * MS), "told once"
    published.put(500 * MS)
    assert gate.read(500 * MS)
    assert gate.commanded
