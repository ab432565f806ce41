"""Picture and export: made, readable by others' tools, and a clear word where the tools are missing."""

from __future__ import annotations

import copy
import sys
from math import tau
from pathlib import Path

import pytest

from failstop import extras
from failstop.board.kinds import board_of
from failstop.board.rrc.servos import bus_servo_move
from failstop.cli.screen import incident as screen
from failstop.incidents import export, files, plot, story
from failstop.incidents.files import IncidentError
from failstop.incidents.incident import SILENT, Incident, WriteSort
from failstop.messages import box, layout
from failstop.policy import causes
from failstop.policy.settings import Settings
from tests.support.incident_parts import UNIX_NS, Recorder, at, drive_and_die

SHOWN = (
    *("gate died", "acknowledged after 3.10 ms", "was killed by SIGKILL", "stop burst", "still below 3.5"),
    *("the gate is silent", "Where the arm was sent"),
)


@pytest.fixture(scope="module")
def incident() -> Incident:
    made = drive_and_die()
    for ms in range(-3000, 2200, 50):
        made.wheels(ms, *((0.8, 0.8, -0.8, -0.8) if ms < 80 else (0.0,) * 4))
    return made.incident()


@pytest.mark.starts
def test_no_line_is_drawn_across_a_gap_in_the_reports_of_the_wheels() -> None:
    pytest.importorskip("matplotlib")
    import numpy as np
    from matplotlib.figure import Figure

    made = drive_and_die()
    for ms in (*range(-900, -100, 150), *range(340, 2000, 150)):
        made.wheels(ms, *((0.8,) * 4 if ms < 0 else (0.0,) * 4))
    axes = Figure().subplots()
    plot._wheels(axes, made.incident())
    reported = [line for line in axes.get_lines() if line.get_marker() == "."]
    for line in reported:
        times, values = np.asarray(line.get_xdata()), np.asarray(line.get_ydata())
        breaks = times[np.isnan(values)].tolist()
        assert breaks == [-150.0], "after the last report, and none between reports that come as often as usual"
    assert len(reported) == 4


def telemetry_dies(back_ms: float | None) -> Incident:
    """Telemetry dies at the cause, and is back after so long, if at all."""
    made = Recorder(causes.DIED(layout.TELEMETRY))
    made.event(0.3, "died", "telemetry (pid 103) was killed by SIGKILL", "error", process=layout.TELEMETRY, pid=103)
    for ms in range(-1000, 2200, 100):
        dead = ms > 0 and (back_ms is None or ms <= back_ms)
        made.beats(ms, **({layout.TELEMETRY: ms + 1.0} if dead else {}))
    if back_ms is None:
        made.last_beats_ms[layout.TELEMETRY] = -2.0
    return made.incident()


@pytest.mark.parametrize(
    ("back_ms", "spans"),
    [(600.0, [(-1000.0, -2.0), (599.0, 2100.0)]), (None, [(-1000.0, -2.0)])],
    ids=["back", "never"],
)
@pytest.mark.starts
def test_no_bar_says_that_a_dead_process_beats(back_ms: float | None, spans: list[tuple[float, float]]) -> None:
    pytest.importorskip("matplotlib")
    import numpy as np
    from matplotlib.colors import to_rgba
    from matplotlib.figure import Figure

    axes = Figure().subplots()
    incident = telemetry_dies(back_ms)
    plot._lanes(axes, incident)
    labels = [label.get_text() for label in axes.get_yticklabels()]
    row = axes.get_yticks()[labels.index("telemetry")]
    drawn = []
    for bars in axes.collections:
        if np.array_equal(np.asarray(bars.get_facecolor())[:1], [to_rgba(plot.BEATS_COLOR)]):
            boxes = [path.get_extents() for path in bars.get_paths()]
            drawn += [(box.x0, box.x1) for box in boxes if box.y0 < row < box.y1]
    assert drawn == [pytest.approx(span) for span in spans]


@pytest.mark.parametrize(
    ("module", "needed", "extra"), [(plot, "matplotlib", "plots"), (export, "mcap_ros2.writer", "export")]
)
def test_a_missing_extra_is_named(
    incident: Incident, tmp_path: Path, monkeypatch: pytest.MonkeyPatch, module: object, needed: str, extra: str
) -> None:
    monkeypatch.setitem(sys.modules, needed, None)
    path = str(tmp_path / "a.png")
    with pytest.raises(IncidentError, match=f"pip install {' '.join(extras.PACKAGES[extra])}"):
        plot.save(incident, path, 5.0) if module is plot else export.save(incident, path)
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize(
    ("needed", "ends"), [("matplotlib", r"\.png or \.svg or \.pdf"), ("mcap_ros2.writer", r"\.mcap")]
)
def test_a_name_of_no_such_file_is_refused(incident: Incident, tmp_path: Path, needed: str, ends: str) -> None:
    pytest.importorskip(needed)
    path = str(tmp_path / "a.txt")
    with pytest.raises(IncidentError, match=rf"must end in {ends}"):
        plot.save(incident, path, 5.0) if needed == "matplotlib" else export.save(incident, path)


def test_an_export_is_read_back_with_the_decoder_of_ros_2(incident: Incident, tmp_path: Path) -> None:
    reader = pytest.importorskip("mcap_ros2.reader")
    path = str(tmp_path / "a.mcap")
    count = export.save(incident, path)
    found: dict[str, list[tuple[int, object]]] = {}
    for message in reader.read_ros2_messages(path):
        found.setdefault(message.channel.topic, []).append((message.log_time_ns, message.ros_msg))
        assert message.schema.data.decode() == export.definition(message.schema.name.replace("/msg/", "/"))
    assert sum(map(len, found.values())) == count
    assert set(found) == {f"/failstop/{topic}" for topic in ("command", "gated", "wheels", "measured", "imu", "events")}
    check_values(found)


def check_values(found: dict[str, list[tuple[int, object]]]) -> None:

    def value(topic: str, index: int) -> object:
        return found[f"/failstop/{topic}"][index][1]

    last = value("gated", -1)
    assert last.twist.linear.x == pytest.approx(0.2)  # type: ignore[attr-defined]
    wheels = found["/failstop/wheels"]
    moving = [message for at_ns, message in wheels if at_ns < UNIX_NS][-1]
    assert moving.name == ["front_left", "rear_left", "front_right", "rear_right"]  # type: ignore[attr-defined]
    speeds = [0.796 * tau, 0.796 * tau, -0.796 * tau, -0.796 * tau]
    assert moving.velocity == pytest.approx(speeds, abs=0.01)  # type: ignore[attr-defined]
    assert [m.velocity for at_ns, m in wheels if at_ns > UNIX_NS] == [[0.0] * 4] * 13  # type: ignore[attr-defined]
    measured = found["/failstop/measured"]
    assert measured[0][1].velocity == pytest.approx([0.8 * tau, 0.8 * tau, -0.8 * tau, -0.8 * tau])  # type: ignore[attr-defined]
    assert measured[-1][1].velocity == [0.0] * 4  # type: ignore[attr-defined]
    imu = value("imu", 0)
    assert imu.angular_velocity.z == pytest.approx(0.01)  # type: ignore[attr-defined]
    assert imu.linear_acceleration.z == pytest.approx(9.8)  # type: ignore[attr-defined]
    assert imu.orientation_covariance[0] == -1  # type: ignore[attr-defined]
    causes = [(at_ns, m) for at_ns, m in found["/failstop/events"] if m.name == "failstop.cause"]  # type: ignore[attr-defined]
    assert [(at_ns, m.msg, m.level) for at_ns, m in causes] == [(UNIX_NS, "gate died", 40)]  # type: ignore[attr-defined]


def test_an_export_that_fails_leaves_nothing(incident: Incident, tmp_path: Path) -> None:
    pytest.importorskip("mcap_ros2.writer")
    (tmp_path / "a.mcap").mkdir()
    with pytest.raises(IncidentError, match="can't be written"):
        export.save(incident, str(tmp_path / "a.mcap"))
    assert [path.name for path in tmp_path.iterdir()] == ["a.mcap"]


@pytest.mark.parametrize("unix_s", [-(10**9), 2**31 + 10**6])
def test_an_export_of_a_time_that_ros_2_does_not_know_is_refused(tmp_path: Path, unix_s: int) -> None:
    pytest.importorskip("mcap_ros2.writer")
    made = drive_and_die()
    incident = Incident("odd", made.head(unix_ns=unix_s * 10**9), made.body())
    with pytest.raises(IncidentError, match="odd can't be exported: this computer's clock was wrong"):
        export.save(incident, str(tmp_path / "a.mcap"))
    assert list(tmp_path.iterdir()) == []


def test_where_the_gate_was_silent_the_picture_says_so_and_draws_no_decision() -> None:
    made = Recorder(causes.HANGS("gate", 360))
    made.core.enable(7, "", at(-1000))
    for ms in (*range(-1000, -60, 20), *range(300, 1000, 20)):
        made.core.scan.deliver(at(ms), at(ms))
        made.command(ms, (0.2, 0.0, 0.0))
        made.tick(ms)
    made.beats(2200)
    told = [(what, begin, end) for what, begin, end in made.incident().gate_spans() if what == SILENT]
    assert told == [(SILENT, at(-80), at(300)), (SILENT, at(980), at(2200))]


def test_a_dead_gate_is_silent_however_soon_it_is_back() -> None:
    made = Recorder()
    for ms in (-40, -20, 0, 40, 60):
        made.tick(ms)
    assert [what for what, _, _ in made.incident().gate_spans()] == ["disabled"]
    made.event(5, "died", "gate (pid 102) was killed by SIGKILL", "error", process="gate", pid=102)
    before, after = ("disabled", at(-40), at(0)), ("disabled", at(40), at(60))
    assert made.incident().gate_spans() == [before, (SILENT, at(0), at(40)), after]


def test_a_curve_is_broken_where_the_board_was_silent() -> None:
    at_ms, values = plot.broken([0.0, 9.0, 18.0, 900.0, 909.0], [1.0, 2.0, 3.0, 4.0, 5.0])
    assert list(at_ms) == [0.0, 9.0, 18.0, 18.0, 900.0, 909.0]
    assert repr(values.tolist()) == "[1.0, 2.0, 3.0, nan, 4.0, 5.0]"


@pytest.mark.slow
def test_a_file_whose_name_is_no_text_is_drawn_and_shown(incident: Incident, tmp_path: Path) -> None:
    made = copy.copy(incident)
    made.id = "a\x1b[2J\udcff"
    pytest.importorskip("matplotlib")
    plot.save(made, str(tmp_path / "a.svg"), 5.0)
    assert (tmp_path / "a.svg").stat().st_size
    title = "".join(text for text, _ in screen.text(made, 100, 0.0)[0])
    assert title == r"Incident a\x1b[2J\udcff"
    ((listed, _),) = screen.table([{**made.head, "id": made.id, "clock_jump_s": 0.0}], 100)[0]
    assert listed == r"a\x1b[2J\udcff"
    assert str(files.IncidentError("a\x1b[2J")) == r"a\x1b[2J"


@pytest.mark.starts  # matplotlib asks fc-list for fonts
def test_a_picture_of_next_to_nothing_and_one_that_fails(tmp_path: Path) -> None:
    pytest.importorskip("matplotlib")
    made = Recorder()
    made.stop = None
    incident = made.incident()
    plot.save(incident, str(tmp_path / "empty.pdf"), 5.0)
    assert (tmp_path / "empty.pdf").read_bytes().startswith(b"%PDF")
    assert (tmp_path / "empty.pdf").stat().st_size > 5_000
    (tmp_path / "a.png").mkdir()
    with pytest.raises(IncidentError, match="can't be written"):
        plot.save(incident, str(tmp_path / "a.png"), 5.0)
    assert {path.name for path in tmp_path.iterdir()} == {"a.png", "empty.pdf"}, "nothing is left of it"


@pytest.mark.starts
def test_a_picture_obeys_no_settings_but_ours(incident: Incident, tmp_path: Path) -> None:
    """They could come from a matplotlibrc in another user's folder, and text.usetex runs LaTeX."""
    matplotlib = pytest.importorskip("matplotlib")
    pictures = []
    for theirs in ({}, {"savefig.facecolor": "red", "text.usetex": True, "lines.marker": "o"}):
        path = str(tmp_path / "a.png")
        with matplotlib.rc_context(theirs):
            plot.save(incident, path, 5.0)
        pictures.append((tmp_path / "a.png").read_bytes())
    assert pictures[0] == pictures[1]


@pytest.mark.starts  # matplotlib asks fc-list for fonts
def test_a_picture_says_what_happened_and_where_the_arm_s_joints_were_sent(tmp_path: Path) -> None:
    parts = drive_and_die()
    parts.settings = Settings({"joints.base.servo": 1, "joints.wrist.servo": 4})
    for step in range(20):
        parts.frame(-800.0 + 40 * step, bus_servo_move([(1, 500 + step), (4, 300 - step)], 40))
    goals = parts.ring(layout.GATE, "arm_box")
    for ms, mode, aims in ((-810.0, "follow", [(1, 519.0), (4, 281.5)]), (-400.0, "jog", [(1, 24.0)]), (5.0, "", [])):
        goals.put(box.pack_arm(mode, "nav (pid 77)" if mode else "", aims), at(ms))
    found = parts.incident()
    sent = found.joints()
    assert [pulses for _, pulses in sent[1]] == list(range(500, 520))
    assert [pulses for _, pulses in sent[4]] == list(range(300, 280, -1))
    assert [found.joint(servo) for servo in (1, 4, 6)] == ["base", "wrist", "servo 6"]
    told = [line.text for line in story.whole(found) if line.what == "arm"]
    by_nav = ["follow for nav (pid 77): base 519, wrist 282", "jog for nav (pid 77): base 24/s"]
    assert told == [*by_nav, "moved by nobody"]
    assert found.undecoded == 0
    pytest.importorskip("matplotlib")
    plot.save(found, str(tmp_path / "a.svg"), 5.0)
    shown = (tmp_path / "a.svg").read_text()  # a comment has each text
    assert shown.startswith("<?xml")
    assert len(shown) > 20_000
    assert "dotted: as reported" not in shown, "this board reports no wheel speeds"
    for words in SHOWN:
        assert words in shown


def test_the_joints_of_an_arm_on_another_bus_are_shown_too() -> None:
    """Each board reads its own frames."""
    parts = drive_and_die()
    parts.settings = Settings({"board.kind": "feetech", "joints.base.servo": 1, "joints.wrist.servo": 4})
    arm = board_of("feetech", 0.1, 0.0).arm
    assert arm
    for step in range(20):
        parts.frame(-800.0 + 40 * step, arm.move([(1, 2000 + step), (4, 300 - step)], 40))
    found = parts.incident()
    assert [pulses for _, pulses in found.joints()[1]] == list(range(2000, 2020))
    assert [pulses for _, pulses in found.joints()[4]] == list(range(300, 280, -1))
    assert [write.sort for write in found.writes if write.head == arm.move([(1, 2000), (4, 300)], 40)] == [
        WriteSort.ARM
    ]
