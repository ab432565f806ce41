"""Sources, the scan gate and interlocks: what of them is told, by which settings and by which stamps."""

from __future__ import annotations

import pytest

from failstop.messages.records import BY_HAND, FOR_AN_INTERLOCK, GUARDED, STANDS_IN
from failstop.policy import kinematics
from failstop.policy.settings import PAD_SOURCE, Settings
from failstop.procs.gate.conditions import AHEAD_NS
from failstop.procs.gate.core import REST, GateCore
from failstop.procs.gate.sources import PAD_PRIORITY, PAD_SESSION, Command
from tests.support.why import told, why

from .gate_bench import MS, NO_SPEEDS, T0, TICK, Gate

WITH_TELEOP: dict[str, object] = {
    "sources.cmd_vel.priority": 0,
    "sources.cmd_vel.timeout_s": 0.3,
    "sources.teleop.priority": 10,
    "sources.teleop.timeout_s": 0.2,
}
IN_POSE = "arm is not in the drive pose"
ARM: dict[str, object] = {"interlocks.arm.timeout_s": 0.5, "interlocks.arm.refusal": IN_POSE}


def scanning(changed: dict[str, object] | None = None) -> Gate:
    """An enabled gate, which needs the obstacle sensor."""
    gate = Gate(scan__gate="on", **(changed or {}))
    gate.enable()
    return gate


def scan(gate: Gate) -> None:
    gate.core.scan.deliver(gate.now, gate.now)


def cruise(gate: Gate, vx: float, source: str = "cmd_vel", session: int = 1) -> None:
    for _ in range(25):
        scan(gate)
        assert gate.command(vx, source, session) == ""
        gate.tick()
    assert gate.core.velocity[0] == pytest.approx(vx)


def fall_silent(gate: Gate, ticks: int = 40) -> None:
    """The sensor does, and the commands go on."""
    for _ in range(ticks):
        gate.command(0.1)
        gate.tick()


def test_a_higher_source_takes_over_at_once_and_a_lower_begins_from_zero() -> None:
    gate = scanning(WITH_TELEOP)
    cruise(gate, 0.1)
    gate.command(-0.1, "teleop", session=2)
    assert gate.tick() == pytest.approx(0.09), "from the speed it has, along the ramp"
    assert gate.core.sources.table(gate.now) == [
        {"source": "teleop", "priority": 10, "who": "client 2", "state": "drives"},
        {"source": "cmd_vel", "priority": 0, "who": "client 1", "state": "waits"},
    ]
    cruise(gate, -0.1, "teleop", session=2)
    for _ in range(9):
        scan(gate)
        gate.command(0.1)
        assert gate.tick() == pytest.approx(-0.1), "still the higher one's"
    scan(gate)
    gate.command(0.1)
    assert gate.tick(TICK) == pytest.approx(0.01), "more than 0.2 s of silence: from zero, not from -0.1"


def test_another_publisher_latches_until_the_driver_has_ended(driving: Gate) -> None:
    assert driving.accept(REST, session=2) == "multiple cmd_vel publishers: client 1, client 2"
    driving.gone(2, parted=True)
    assert driving.blocked == "", "a client that does not drive"
    driving.gone(1, parted=True)
    assert (driving.step(0), driving.blocked, driving.core.latch) == (NO_SPEEDS, "cmd timeout", None)
    assert driving.accept((0.2, 0.0, 0.0), session=2) == ""
    driving.step()
    assert driving.core.velocity[0] == pytest.approx(0.01)
    assert driving.accept((0.1, float("nan"), 0.1), session=2) == "command from client 2 is not finite"


def test_the_default_is_one_source_and_the_pad_is_above_all_and_no_client_s() -> None:
    """The settings refuse its name and its rank for a source of the user's."""
    assert list(Settings().sources()) == ["cmd_vel"]
    assert (PAD_SOURCE, PAD_PRIORITY) == ("gamepad", 101)
    gate = scanning(WITH_TELEOP)
    scan(gate)
    assert gate.command(0.1, PAD_SOURCE, session=7, manual=True) == ""
    assert gate.tick() == 0
    assert gate.told() == ["command from client 7 ignored: the source 'gamepad' is the board's gamepad alone"]
    assert gate.command(0.1, "teleop", session=0, manual=True) == "", "nor is the pad a client"
    assert gate.tick() == 0
    gate.command(0.1, "teleop", session=2, manual=True)
    gate.command(0.05, PAD_SOURCE, session=0, manual=True)
    assert gate.core.sources.driving(gate.now).source == PAD_SOURCE  # type: ignore[union-attr]


def test_an_unknown_source_moves_nothing_and_is_told_of_once_by_session_and_name() -> None:
    gate = scanning()
    scan(gate)
    for session in (1, 2, 1, 2):
        for source in ("a", "b", "a"):
            assert gate.command(0.1, source=source, session=session) == ""
    assert gate.tick() == 0
    assert [(note.text, note.fields) for note in gate.core.notes] == [
        (f"command from {who} ignored: no source '{source}' in the settings", {"who": who, "source": source})
        for who in ("client 1", "client 2")
        for source in "ab"
    ]
    for number in range(100):
        gate.command(0.1, source=f"s{number}")
    assert len(gate.core.notes) == 64, "ever new ones are not told of for ever"


def test_a_sensor_that_is_silent_and_back_is_told_of_once_with_its_age() -> None:
    gate = scanning()
    for _ in range(2):
        gate.core.notes.clear()
        cruise(gate, 0.1)
        fall_silent(gate)
        assert gate.told() == ["no scan for 0.52 s, so the wheels are told to stop"]
        scan(gate)
        gate.command(0.1)
        assert gate.tick() == pytest.approx(0.01), "by itself, along the ramp"
        silent, back = gate.core.notes
        assert (silent.level, silent.fields) == ("", {"state": "silent", "age_s": pytest.approx(0.52)})
        assert (back.level, back.fields) == ("info", {"state": "back", "age_s": pytest.approx(0.02)})
        assert back.text == "scan is back (age 0.02 s): motion resumes by itself"
    cruise(gate, 0.1)
    fall_silent(gate, 30)
    gate.core.notes.clear()
    gate.tick(400 * MS)
    assert (gate.blocked, gate.told()) == ("cmd timeout", []), "not back because something else blocks"


def test_a_sensor_that_is_back_before_a_later_enable_is_told_of_to_nobody() -> None:
    """Nothing resumes then. If it is silent again, that is reported again."""
    gate = scanning()
    cruise(gate, 0.1)
    fall_silent(gate)
    gate.core.disable()
    gate.core.notes.clear()
    gate.tick(3600 * 1000 * MS)
    scan(gate)
    gate.enable()
    gate.command(0.1)
    gate.tick()
    assert gate.told() == []
    cruise(gate, 0.1)
    fall_silent(gate)
    assert gate.told() == ["no scan for 0.52 s, so the wheels are told to stop"]


@pytest.mark.parametrize("ahead", [False, True])
def test_before_the_first_scan_or_with_a_clock_that_is_ahead_nothing_moves(ahead: bool) -> None:
    """A silence as long as the uptime is told to nobody."""
    gate = scanning()
    if ahead:
        gate.core.scan.deliver(gate.now + AHEAD_NS + 1, gate.now)
    gate.command(0.1)
    assert gate.tick() == 0
    assert gate.blocked == "no scan"
    assert [(note.text, note.fields) for note in gate.core.notes] == [
        ("no scan yet: programs can't move the wheels", {"state": "silent"})
    ]


def test_enabling_needs_every_interlock_and_its_loss_disables_and_does_not_latch() -> None:
    gate = Gate(scan__gate="on", **ARM)
    refusal = gate.core.enable(1, "", gate.now)
    assert (told(refusal), refusal.refused_for) == ((False, IN_POSE), FOR_AN_INTERLOCK)
    gate.core.interlocks.hear(["arm"], gate.now, gate.now)
    gate.enable()
    gate.tick(500 * MS)
    assert gate.blocked == "cmd timeout"
    gate.tick(1)
    assert (gate.blocked, gate.core.latch) == ("disabled", None)
    (note,) = gate.core.notes
    assert (note.text, note.fields) == (f"motion disabled: {IN_POSE}", {"reason": IN_POSE})
    gate.core.interlocks.hear(["arm"], gate.now, gate.now)
    gate.tick()
    assert gate.blocked == "disabled", "what comes back does not enable"


def test_an_interlock_holds_by_its_own_name_alone() -> None:
    gate = Gate(**ARM, **{"interlocks.lid.timeout_s": 0.5, "interlocks.lid.refusal": "the lid is open"})
    for asserted, unmet in ((["lid", "other"], IN_POSE), (["arm"], "")):
        gate.core.interlocks.hear(asserted, gate.now, gate.now)
        assert gate.core.interlocks.unmet(gate.now) == unmet


def test_a_stamp_that_is_a_little_ahead_counts_as_now_and_one_of_the_future_never() -> None:
    gate = Gate(scan__gate="on", **ARM)
    for ahead_ns, looks in ((AHEAD_NS, 1), (10_000 * MS, 100)):
        stamp_ns = gate.now + ahead_ns
        for look in range(looks):
            gate.core.interlocks.hear(["arm"], stamp_ns, gate.now)
            gate.core.scan.deliver(stamp_ns, gate.now)
            holds = looks == 1
            assert (gate.core.interlocks.unmet(gate.now), gate.core.scan.silent(gate.now)) == (
                "" if holds else IN_POSE,
                not holds,
            ), look
            gate.now += TICK
        gate.now += 501 * MS
        assert (gate.core.interlocks.unmet(gate.now), gate.core.scan.silent(gate.now)) == (IN_POSE, True)


def test_a_layout_without_a_sideways_axis_stands_sideways() -> None:
    settings = Settings({"wheels.layout": "differential", "scan.gate": "off"})
    core = GateCore(settings, kinematics.from_settings(settings), T0)
    core.enable(1, "", T0)
    for tick in range(1, 30):
        core.accept(Command(1, "one", T0 + tick * TICK, (0.1, 0.2, 0.0)), T0 + tick * TICK)
        core.step(T0 + tick * TICK)
    assert core.velocity == pytest.approx((0.1, 0.0, 0.0))


# What somebody commands while motion is being enabled.


def holding(**changed: object) -> Gate:
    """An enabled gate whose client 1 commanded before the enable, and goes on."""
    gate = Gate(**changed)
    gate.command(0.1)
    assert gate.core.enable(1, "", gate.now).done
    for _ in range(30):
        gate.command(0.1)
        gate.tick()
    assert (gate.blocked, gate.core.velocity) == ("let go first", REST)
    return gate


def test_whoever_commands_at_an_enable_drives_after_a_zero() -> None:
    gate = holding()
    gate.command(0.0)
    gate.tick()
    assert gate.blocked == ""
    gate.command(0.1)
    assert gate.tick() > 0.0


@pytest.mark.parametrize(("paused_ns", "drives"), [(300 * MS, False), (300 * MS + 1, True)])
def test_or_after_a_pause_of_its_timeout(paused_ns: int, drives: bool) -> None:
    gate = holding()
    gate.now += paused_ns - TICK
    gate.command(0.1)
    assert (gate.tick() > 0.0) is drives


def test_a_zero_that_stands_in_for_a_motion_lets_go_of_nothing() -> None:
    """The guard writes it where it has refused what the driver wrote."""
    gate = holding()
    gate.accept(REST, flags=STANDS_IN)
    gate.tick()
    gate.command(0.1)
    gate.tick()
    assert (gate.blocked, gate.core.velocity) == ("let go first", REST)


def test_an_enable_holds_a_program_whose_motion_was_refused_just_now() -> None:
    gate = Gate()
    gate.accept(REST, flags=STANDS_IN)
    assert "client 1 must send zero or pause" in told(gate.core.enable(1, "", gate.now))[1]
    gate.tick()
    gate.command(0.1)
    gate.tick()
    assert (gate.blocked, gate.core.velocity) == ("let go first", REST)


def test_every_enable_names_the_program_that_it_holds() -> None:
    gate = holding()
    held = (
        "motion enabled; client 1 must send zero or pause before it can drive "
        "(or end it, enable motion, and start it again)"
    )
    assert told(gate.core.enable(2, "", gate.now)) == (True, held)
    gate.command(0.0)
    assert told(gate.core.enable(2, "", gate.now)) == (True, "motion enabled")


@pytest.mark.parametrize(
    ("velocity", "ago_ns", "said"),
    [
        (
            0.1,
            300 * MS,
            "; client 1 must send zero or pause before it can drive (or end it, enable motion, and start it again)",
        ),
        (0.1, 450 * MS, "; client 1 commanded motion 0.5 s ago, so the robot moves when it commands again"),
        (0.1, 500 * MS, "; client 1 commanded motion 0.5 s ago, so the robot moves when it commands again"),
        (0.1, 5000 * MS, "; client 1 commanded motion 5.0 s ago, so the robot moves when it commands again"),
        (0.1, 5001 * MS, ""),
        (0.0, 500 * MS, ""),
    ],
)
def test_an_enable_names_a_program_that_commands_more_seldom_than_its_timeout(
    velocity: float, ago_ns: int, said: str
) -> None:
    gate = Gate()
    gate.command(velocity)
    gate.now += ago_ns
    assert told(gate.core.enable(1, "", gate.now)) == (True, f"motion enabled{said}")
    gate.command(velocity)
    assert bool(gate.tick() > 0.0) is bool(velocity and ago_ns > 300 * MS)


def test_a_program_that_has_gone_and_a_person_who_let_go_are_not_named() -> None:
    gate = Gate()
    gate.command(0.1)
    gate.gone(1, parted=False)
    gate.accept((0.1, 0.0, 0.0), session=2, manual=True)
    gate.now += 500 * MS
    assert told(gate.core.enable(1, "", gate.now)) == (True, "motion enabled")


@pytest.mark.parametrize("again", ["disable", "stop"])
def test_a_stick_that_is_held_over_a_disable_or_a_stop_moves_nothing_at_the_next_enable(again: str) -> None:
    gate = Gate()
    gate.enable()
    gate.drive((0.1, 0.0, 0.0), 5)
    if again == "disable":
        gate.core.disable()
    else:
        gate.core.stop(why("key1"), 1)
        gate.core.follow(None, 2)
    assert told(gate.core.enable(2, "", gate.now))[0]
    for _ in range(100):
        gate.command(0.1)
        assert gate.tick() == 0.0


def test_a_lower_source_drives_while_a_higher_one_is_held() -> None:
    gate = Gate(**WITH_TELEOP)
    gate.command(0.1, "teleop", 2)
    assert gate.core.enable(1, "", gate.now).done
    gate.command(0.1, "teleop", 2)
    gate.command(0.2)
    assert gate.tick() > 0.0
    states = {row["source"]: row["state"] for row in gate.core.sources.table(gate.now)}
    assert states == {"teleop": "held", "cmd_vel": "drives"}


def test_the_gamepad_is_held_too_until_its_stick_is_let_go() -> None:
    gate = Gate()

    def pad(vx: float) -> float:
        velocity = (vx, 0.0, 0.0)
        gate.core.accept(Command(PAD_SESSION, PAD_SOURCE, gate.now, velocity, PAD_SOURCE, BY_HAND), gate.now)
        return gate.tick()

    pad(0.1)
    assert gate.core.enable(1, "", gate.now).done
    assert pad(0.1) == 0.0
    pad(0.0)
    assert pad(0.1) > 0.0


def test_a_program_that_was_started_after_the_enable_drives_at_once() -> None:
    gate = holding()
    gate.gone(1, parted=True)
    gate.command(0.1, session=2)
    assert gate.tick() > 0.0


# A driver that stops sending while it drives.


@pytest.mark.parametrize(
    ("velocity", "manual", "states"),
    [(0.1, False, {"cmd_vel": "silent"}), (0.1, True, {}), (0.0, False, {})],
    ids=["a program", "a person who let go", "a zero"],
)
def test_the_table_shows_a_program_that_fell_silent_while_it_drove_and_nobody_who_only_waited(
    velocity: float, manual: bool, states: dict[str, str]
) -> None:
    gate = Gate(**WITH_TELEOP)
    gate.enable()
    gate.command(0.1, session=1)
    gate.tick()
    gate.accept((velocity, 0.0, 0.0), 1, manual=manual)
    gate.tick()
    gate.now += 1_000 * MS
    gate.accept((0.1, 0.0, 0.0), 2, age_ns=500 * MS, source="teleop")
    assert {row["source"]: row["state"] for row in gate.core.sources.table(gate.now)} == states


@pytest.mark.parametrize(
    ("answer", "blocked"), [("wait", "cmd timeout"), ("disable", "disabled"), ("latch", "cmd timeout")]
)
def test_what_a_driver_s_silence_does_is_a_setting(answer: str, blocked: str) -> None:
    gate = Gate(gate__driver_silence=answer)
    gate.enable()
    gate.drive((0.1, 0.0, 0.0), 5)
    gate.core.notes.clear()
    gate.tick(301 * MS)
    assert gate.core.velocity == REST
    assert gate.blocked == blocked
    if answer == "latch":
        assert str(gate.silence) == "driver silent: client 1, 321 ms"
    else:
        assert gate.silence is None
        assert [note.fields["who"] for note in gate.core.notes] == ["client 1"]
        gate.command(0.1)
        assert (gate.tick() > 0.0) is (answer == "wait")


@pytest.mark.parametrize("answer", ["disable", "latch"])
def test_a_driver_that_hangs_after_a_refused_motion_is_silent(answer: str) -> None:
    gate = Gate(gate__driver_silence=answer)
    gate.enable()
    gate.drive((0.1, 0.0, 0.0), 5)
    gate.accept(REST, flags=STANDS_IN)
    gate.tick()
    gate.tick(301 * MS)
    assert (gate.silence is not None, gate.core.enabled) == (answer == "latch", answer == "latch")


@pytest.mark.parametrize("guard_s", [0.1, 2.5])
def test_a_driver_at_the_guard_port_was_silent_for_as_long_as_its_motion_counts(guard_s: float) -> None:
    """The guard repeats its motion, and the time of the last repeat is when the motion would have to be repeated."""
    gate = Gate(gate__driver_silence="latch", guard__timeout_s=guard_s)
    gate.enable()
    gate.silence, written_ns, counts_ns = None, gate.now, round(guard_s * 1e9)
    while not gate.silence:
        repeated_ns = min(gate.now, written_ns + counts_ns - 300 * MS)
        gate.accept((0.1, 0.0, 0.0), age_ns=gate.now - repeated_ns, flags=GUARDED)
        gate.tick()
    silent_ms = (gate.now - written_ns) // MS
    assert str(gate.silence) == f"driver silent: client 1, {silent_ms} ms"
    assert 0 < silent_ms - guard_s * 1e3 <= TICK / MS


@pytest.mark.parametrize("answer", ["disable", "latch"])
def test_a_person_who_lets_go_of_a_key_is_no_silent_driver(answer: str) -> None:
    gate = Gate(gate__driver_silence=answer)
    gate.enable()
    gate.command(0.1, manual=True)
    gate.tick()
    gate.tick(301 * MS)
    assert (gate.silence, gate.blocked) == (None, "cmd timeout")


@pytest.mark.parametrize("timeout_ms", [1_000, 500], ids=["later than the scan", "as soon as the scan"])
@pytest.mark.parametrize("answer", ["wait", "disable", "latch"])
def test_a_program_that_delivers_the_scans_and_hangs_is_a_silent_driver(answer: str, timeout_ms: int) -> None:
    """It delivers a scan before each command, so the wheels are at rest already when the command gets too old."""
    gate = Gate(scan__gate="on", gate__command_timeout_s=timeout_ms / 1000, gate__driver_silence=answer)
    scan(gate)
    gate.enable()
    gate.tick()
    gate.command(0.1)
    assert gate.tick() > 0.0
    gate.tick(461 * MS)
    assert (gate.core.velocity, gate.blocked, gate.silence) == (REST, "no scan", None)
    gate.core.notes.clear()
    gate.tick((timeout_ms - 480) * MS)
    silent_ms = timeout_ms + 1
    assert str(gate.silence) == (f"driver silent: client 1, {silent_ms} ms" if answer == "latch" else "None")
    assert [note.kind for note in gate.core.notes] == ["disabled"] * (answer == "disable")
    gate.tick()
    assert gate.silence is None, "once"
    scan(gate)
    gate.command(0.1)
    assert (gate.tick() > 0.0) is (answer != "disable"), "the gate's loop has latched the cause"


@pytest.mark.parametrize("end", ["zero", "goodbye", "disabled"])
def test_a_driver_that_ended_its_motion_without_scans_is_not_silent(end: str) -> None:
    gate = Gate(scan__gate="on", gate__driver_silence="latch")
    scan(gate)
    gate.enable()
    gate.tick(501 * MS)
    gate.command(0.1)
    gate.tick()
    assert gate.blocked == "no scan"
    if end == "zero":
        gate.command(0.0)
        gate.tick()
    elif end == "goodbye":
        gate.gone(parted=True)
    else:
        gate.core.disable()
        gate.core.enable(2, "", gate.now)
    gate.tick(301 * MS)
    assert (gate.silence, gate.core.enabled) == (None, True)


def test_a_zero_command_ends_the_motion_though_the_wheels_still_slow_down() -> None:
    gate = Gate(gate__driver_silence="latch")
    gate.enable()
    gate.drive((0.2, 0.0, 0.0), 30)
    gate.command(0.0)
    gate.tick()
    assert gate.core.velocity != REST
    gate.tick(301 * MS)
    assert (gate.silence, gate.core.velocity, gate.core.enabled) == (None, REST, True)
