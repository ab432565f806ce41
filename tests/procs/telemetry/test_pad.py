"""The gamepad: stops, modes, sticks, the hold that resets, and the tones of its modes and of trips."""

from __future__ import annotations

import struct

import pytest
from hypothesis import given
from hypothesis import strategies as st

from failstop.board.interface import BUTTONS
from failstop.board.rrc.board import BOARD
from failstop.board.rrc.framing import BUZZER
from failstop.messages import records
from failstop.policy import causes
from failstop.policy.settings import Settings
from failstop.procs.telemetry import pad
from failstop.procs.telemetry.pad import DRIVING, JOINT, LOCKED, Pad, PadNews, Tones

MS = 1_000_000
FRAME_MS = 50
MODE = 0x2000
X = 0x0100


class Held:
    """A pad in somebody's hands: frames, 20 a second."""

    def __init__(self, **changed: object) -> None:
        self.pad = Pad(Settings(dict(changed)))
        self.now_ns = 1_000_000 * MS

    def frame(self, buttons: int = 0, lx: int = 0, ly: int = 0, rx: int = 0, ry: int = 0) -> PadNews:
        self.now_ns += FRAME_MS * MS
        raw = bytes((buttons & 0xFF, buttons >> 8, 0, lx & 0xFF, ly & 0xFF, rx & 0xFF, ry & 0xFF))
        return self.pad.add((buttons, 0, lx, ly, rx, ry), raw, self.now_ns)

    def frames(self, count: int, buttons: int = 0) -> list[PadNews]:
        return [self.frame(buttons) for _ in range(count)]

    def resets(self, count: int, buttons: int = MODE) -> list[int]:
        """Indices of those of so many frames that asked for a reset."""
        return [at for at, news in enumerate(self.frames(count, buttons)) if news.reset]

    def tap(self, buttons: int = MODE) -> PadNews:
        """One frame, as real taps are, and rest enough for the next."""
        news = self.frame(buttons)
        self.frames(12)
        return news

    def silence(self, ms: int) -> None:
        """`ms` from the last frame to the next."""
        self.now_ns += (ms - FRAME_MS) * MS

    def latch(self, latched: bool = True) -> None:
        self.pad.follow(latched, self.now_ns)


@pytest.fixture
def held() -> Held:
    made = Held()
    made.frame()
    return made


@pytest.fixture
def driving(held: Held) -> Held:
    held.tap()
    assert held.pad.mode == DRIVING
    return held


@pytest.mark.parametrize("mode", [MODE, 0x0008])
def test_any_button_but_mode_stops_on_its_first_frame_also_the_first_of_all(mode: int) -> None:
    held = Held(**{"pad.mode_button": mode})
    held.frame()
    for bit in {1 << bit for bit in range(16)} - {mode}:
        told = f"gamepad button 0x{bit:04X}"
        assert str(Held(**{"pad.mode_button": mode}).frame(bit).cause) == told
        assert str(held.tap(bit).cause) == str(held.tap(mode | bit).cause) == told
    assert held.tap(mode).cause is None
    assert held.pad.mode == DRIVING
    assert set(BUTTONS.values()) <= {1 << bit for bit in range(16)}


def test_each_tap_is_a_request_and_a_held_button_one_and_another_while_it_is_held(held: Held) -> None:
    taps = [bool(held.frame(buttons).cause) for buttons in (1, 1, 1, 0, 1, 0, 1)]
    assert taps == [True, False, False, False, True, False, True]
    held.frame()
    told = [held.frame(buttons).cause for buttons in (X, X | 0x0002, 0x0002)]
    assert told == [causes.BUTTON(X), causes.BUTTON(0x0002), None]


def test_the_last_raw_frames_are_kept_for_the_log(held: Held) -> None:
    for ly in range(1, 10):
        held.frame(ly=ly)
    held.frame(X, ly=10)
    assert held.pad.recent() == (
        "00000000050000 (-250 ms), 00000000060000 (-200 ms), 00000000070000 (-150 ms), "
        "00000000080000 (-100 ms), 00000000090000 (-50 ms), 000100000a0000 (-0 ms)"
    )


def test_mode_cycles_locked_and_drive_and_held_changes_it_once(held: Held) -> None:
    seen = [held.pad.mode]
    for _ in range(4):
        held.tap()
        seen.append(held.pad.mode)
    assert [records.PAD_MODES[mode] for mode in seen] == ["locked", "drive", "locked", "drive", "locked"]
    held.frames(100, MODE)
    assert held.pad.mode == DRIVING


@pytest.mark.parametrize(("between", "mode"), [(10, DRIVING), (11, LOCKED)])
def test_mode_has_a_lockout_of_0_6_s_that_a_press_does_not_prolong(held: Held, between: int, mode: int) -> None:
    held.frame(MODE)
    held.frames(between)
    held.frame(MODE)
    assert held.pad.mode == mode
    held.frames(3)
    held.frame(MODE)
    assert held.pad.mode == LOCKED, "0.75 s, or still locked out"


def test_in_drive_the_sticks_command_times_the_limits(held: Held) -> None:
    """Forward = ly, left = -lx, turn = -rx; the limits are 0.2 m/s, 0.2 m/s, 1.0 rad/s. An axis is raw over 127, at
    most 1, and 0 within 0.1."""
    news = held.frame(lx=127, ly=-128)
    assert (news.cause, news.command) == (None, None), "locked they neither command nor stop"
    held.tap()
    for sticks, command in (
        ({"ly": 127}, (0.2, 0.0, 0.0)),
        ({"lx": 127}, (0.0, -0.2, 0.0)),
        ({"rx": 127}, (0.0, 0.0, -1.0)),
        ({"ry": 127}, (0.0, 0.0, 0.0)),
        ({"lx": -64, "ly": -64, "rx": -64}, (-0.2 * 64 / 127, 0.2 * 64 / 127, 64 / 127)),
        ({"lx": -128, "ly": -128, "rx": -128}, (-0.2, 0.2, 1.0)),
        ({"lx": -12, "ly": 12, "rx": 12}, (0.0, 0.0, 0.0)),  # 12/127 is 0.094
        ({"ly": 13}, (0.2 * 13 / 127, 0.0, 0.0)),
    ):
        assert held.frame(**sticks).command == pytest.approx(command)
    held.silence(10_000)
    assert held.frame(ly=127).command == pytest.approx((0.2, 0.0, 0.0)), "the command timeout stops, the pad goes on"
    assert held.frame(MODE, ly=127).command == (0.0, 0.0, 0.0), "leaving it commands a standstill once"
    assert held.frame(ly=127).command is None
    other = Held(**{"limits.vx_mps": 0.35, "limits.vy_mps": 0.3, "limits.wz_radps": 2.0})
    other.tap()
    assert other.frame(lx=-127, ly=127, rx=-127).command == pytest.approx((0.35, 0.3, 2.0))


def test_any_latch_drops_the_pad_to_locked_and_its_own_stop_at_once(driving: Held) -> None:
    driving.latch()
    driving.tap()
    assert driving.pad.mode == LOCKED, "MODE changes nothing while latched"
    driving.latch(False)
    assert driving.frame(ly=127).command is None, "so it stays until MODE"
    driving.tap()
    assert driving.pad.mode == DRIVING
    assert driving.frame(X, ly=127).command is None
    assert driving.pad.mode == LOCKED


@pytest.mark.parametrize(("hold_s", "at"), [(2.0, 40), (1.0, 20)])
def test_mode_held_while_latched_resets_once_a_hold(hold_s: float, at: int) -> None:
    """Twenty frames after the first are 1 s; 2 s are the default."""
    held = Held(**({} if hold_s == 2.0 else {"pad.reset_hold_s": hold_s}))
    held.latch()
    assert held.resets(at + 1) == [at]
    held.latch(False)
    held.frames(20, MODE)
    assert held.pad.mode == LOCKED, "it changes no mode"
    held.latch()
    assert held.resets(200) == []
    held.frames(3)
    assert held.resets(50) == [at]


@pytest.mark.parametrize(("frames", "resets"), [(-1, True), (0, False)])
def test_a_mode_button_that_was_stuck_for_pad_frozen_s_before_the_stop_resets_nothing(
    held: Held, frames: int, resets: bool
) -> None:
    """A receiver may repeat the last frame of a pad that is away, and that frame may have MODE in it."""
    held.frames(1 + round(Settings()["pad.frozen_s"] * 1000) // FRAME_MS + frames, MODE)
    held.latch()
    assert bool(held.resets(100)) is resets


def test_3_frames_without_mode_or_a_silence_end_a_hold_and_2_frames_do_not(held: Held) -> None:
    held.frames(200, MODE)
    held.latch()
    assert held.resets(40) == [39], "one from before the latch counts from the latch"
    held.frames(3)
    held.frames(30, MODE)
    held.frames(2)
    assert held.resets(20) == [8]
    for frames, silence_ms in ((3, FRAME_MS), (0, 3_000)):
        held.frames(3)
        held.frames(30, MODE)
        held.frames(frames)
        held.silence(silence_ms)
        assert held.resets(20) == []


@pytest.mark.parametrize(("latched", "buttons"), [(False, MODE), (True, MODE | X)])
def test_unlatched_or_with_another_button_down_nothing_is_reset(held: Held, latched: bool, buttons: int) -> None:
    held.latch(latched)
    assert held.resets(200, buttons) == []


@pytest.mark.parametrize(("ns", "again"), [(0, False), (1, True)])
def test_more_than_0_5_s_of_silence_end_what_is_held(held: Held, ns: int, again: bool) -> None:
    held.frame(X | 0x0001)
    held.silence(500)
    held.now_ns += ns
    assert held.frame(X | 0x0001).cause == (causes.BUTTON(X | 0x0001) if again else None)


STILL_FRAMES = 15_000 // FRAME_MS


@pytest.mark.parametrize("stick", [{"ly": 127}, {"lx": -60}, {"rx": 20}])
def test_a_pad_that_repeats_a_pushed_stick_is_locked_and_stops_the_wheels(driving: Held, stick: dict[str, int]) -> None:
    news = [driving.frame(**stick) for _ in range(STILL_FRAMES)]
    assert all(each.command and any(each.command) and not each.frozen for each in news)
    last = driving.frame(**stick)
    assert (last.frozen, last.command, driving.pad.mode) == (True, (0.0, 0.0, 0.0), LOCKED)
    after = [driving.frame(**stick) for _ in range(1000)]
    assert not any(each.command or each.frozen or each.cause for each in after)
    driving.tap()
    assert driving.pad.mode == DRIVING, "MODE is a new byte: somebody is there"
    assert driving.frame(**stick).command not in (None, (0.0, 0.0, 0.0))


def test_a_stick_that_changes_or_rests_is_not_frozen(driving: Held) -> None:
    for at in range(3 * STILL_FRAMES):
        assert driving.frame(ly=100 + (at // (STILL_FRAMES - 1)) % 2).command
    for _ in range(3 * STILL_FRAMES):
        assert driving.frame(ly=5).command == (0.0, 0.0, 0.0)
    assert driving.pad.mode == DRIVING


def test_a_pad_that_repeats_mode_resets_nothing(held: Held) -> None:
    held.frames(STILL_FRAMES + 2000 // FRAME_MS + 1, MODE)
    held.latch()
    assert held.resets(200) == []
    held.frames(4)
    assert held.resets(200) != [], "let go and held again"


def test_frames_that_come_with_gaps_are_frozen_too(driving: Held) -> None:
    for _ in range(40):
        driving.silence(600)
        news = driving.frame(ly=127)
    assert (news.command, driving.pad.mode) == (None, LOCKED)


AXIS = st.integers(-128, 127)
FRAME = st.tuples(
    st.sampled_from([0, 0, 0, MODE, MODE, X, MODE | X]), AXIS, AXIS, AXIS, st.integers(1, 900), st.booleans()
)


@given(st.lists(FRAME, max_size=150))
def test_the_pad_keeps_its_rules_whatever_is_done_with_it(frames: list[tuple[int, int, int, int, int, bool]]) -> None:
    """Latched it is locked, commands nothing, and only MODE alone resets; no command is past a limit; whoever presses
    what is not MODE leaves drive."""
    held = Held()
    latched = False
    for buttons, lx, ly, rx, ms, latch in frames:
        held.silence(ms)
        latched = latch if ms > 600 else latched
        held.latch(latched)
        news = held.frame(buttons, lx, ly, rx)
        if latched:
            assert held.pad.mode == LOCKED
            assert news.command is None
        if news.reset:
            assert latched
            assert buttons == MODE
        if news.command:
            assert all(abs(v) <= limit for v, limit in zip(news.command, (0.2, 0.2, 1.0), strict=True))
        if news.cause:
            assert buttons & ~MODE
            assert held.pad.mode == LOCKED
            assert news.command is None


def test_with_an_arm_there_is_a_third_mode_whose_sticks_choose_and_turn_a_joint() -> None:
    held = Held(**{"joints.base.servo": 1, "joints.wrist.servo": 4})
    held.frame()
    held.tap()
    news = held.frame(MODE, lx=127)
    assert (news.command, news.arm) == ((0.0, 0.0, 0.0), (1, 0.0)), "a push that enters it chooses"
    held.frames(12)
    assert held.frame(rx=-127).arm == (1, 1.0)
    assert [held.frame(lx=127).arm for _ in range(3)] == [(0, 0.0)] * 3, "once a push"
    held.frame()
    assert held.frame(lx=-127, rx=64).arm == (1, pytest.approx(-0.504, abs=0.001))
    assert held.frame(lx=0, rx=5).arm == (1, 0.0), "the dead zone"
    assert held.frame().command is None
    assert held.frame(X).arm == (1, 0.0), "a trip lets go"
    assert held.pad.mode == LOCKED
    assert held.frame().arm is None


@pytest.fixture
def armed() -> Held:
    """A pad in the mode of the joints, of three."""
    made = Held(**{"joints.base.servo": 1, "joints.elbow.servo": 2, "joints.wrist.servo": 4})
    made.frame()
    made.tap()
    made.tap()
    assert made.pad.mode == JOINT
    return made


def test_a_joint_is_held_when_the_pad_is_frozen(armed: Held) -> None:
    news = [armed.frame(rx=-127) for _ in range(STILL_FRAMES + 1)]
    assert news[-2].arm == (0, 1.0)
    assert (news[-1].frozen, news[-1].arm) == (True, (0, 0.0))
    assert armed.frame(rx=-127).arm is None


def chosen(held: Held, *sticks: int) -> list[int]:
    """The joint that is chosen after each of these positions of the left stick."""
    return [news.arm[0] for news in (held.frame(lx=lx) for lx in sticks) if news.arm]


def test_a_push_to_the_right_is_the_next_joint_and_one_to_the_left_the_one_before(armed: Held) -> None:
    assert chosen(armed, 127, 0, 127, 0, 127, 0) == [1, 1, 2, 2, 0, 0]
    assert chosen(armed, -128, 0, -127, 0, -127, 0) == [2, 2, 1, 1, 0, 0]


def test_a_push_chooses_from_0_7_on_and_again_once_it_was_back_within_half_of_that(armed: Held) -> None:
    """A thumb that trembles at the end of its way, or pushes slowly, chooses one joint, the one it means."""
    assert chosen(armed, 45, 88, 89) == [0, 0, 1], "88/127 is 0.693"
    assert chosen(armed, 88, 45, 127) == [1, 1, 1], "45/127 is 0.354"
    assert chosen(armed, 44, 127) == [1, 2], "44/127 is 0.346"
    armed.tap()
    assert armed.pad.mode == LOCKED, "MODE leads back: else no press of it takes the sticks off the arm"
    assert armed.tap().arm is None
    assert armed.pad.mode == DRIVING


@pytest.fixture
def sounding() -> Tones:
    made = Tones(on=True)
    made.sound_for(False, LOCKED)
    return made


def test_tones_are_off_by_default() -> None:
    assert not Settings().on("buzzer.tones")
    silent = Tones(on=False)
    seen = [silent.sound_for(latched, mode) for latched in (False, True, False) for mode in (LOCKED, DRIVING)]
    assert set(seen) == {None}


def test_each_trip_and_each_mode_sounds_once(sounding: Tones) -> None:
    for _ in range(2):
        assert [sounding.sound_for(True, LOCKED) for _ in range(3)] == [pad.LATCH_SOUND, None, None]
        assert sounding.sound_for(False, LOCKED) is None
    heard = [sounding.sound_for(False, mode) for mode in (DRIVING, DRIVING, LOCKED)]
    assert heard == [pad.MODE_SOUNDS[DRIVING], None, pad.MODE_SOUNDS[LOCKED]]
    assert len({pad.LATCH_SOUND, *pad.MODE_SOUNDS}) == 1 + len(records.PAD_MODES)
    sounding.sound_for(False, DRIVING)
    assert sounding.sound_for(True, LOCKED) == pad.LATCH_SOUND, "a trip that locks the pad"
    assert sounding.sound_for(False, LOCKED) is None


def test_an_arm_that_is_about_to_tuck_is_heard_once_and_no_stop_of_before_the_start(sounding: Tones) -> None:
    tucks = [False, True, True, False, False, True]
    heard = [sounding.sound_for(False, LOCKED, tucks=each) for each in tucks]
    assert heard == [None, pad.TUCK_SOUND, None, None, None, pad.TUCK_SOUND]
    assert Tones(on=True).sound_for(True, LOCKED) is None
    assert Tones(on=True).sound_for(False, LOCKED, tucks=True) == pad.TUCK_SOUND, "the arm has yet to move"


@pytest.mark.parametrize("sound", [pad.LATCH_SOUND, *pad.MODE_SOUNDS, pad.TUCK_SOUND])
def test_every_tone_ends(sound: pad.Sound) -> None:
    frame = BOARD.buzzer(*sound)
    assert frame[2] == BUZZER
    _, on_ms, off_ms, repeat = struct.unpack("<4H", frame[4:12])
    assert off_ms == 100
    assert (on_ms + off_ms) * repeat <= 1_000
