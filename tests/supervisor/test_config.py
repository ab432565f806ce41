"""The configuration file: read once, whole, and refused with its reason."""

from __future__ import annotations

import json
import os
import sys
from pathlib import Path

import pytest
from hypothesis import example, given
from hypothesis import strategies as st

from failstop import config
from failstop.board.kinds import watchdog_of, wire_of
from failstop.cli import main as cli
from failstop.files import root
from failstop.fleet import settings as fleet_settings
from failstop.policy.kinematics import max_wheel_rps
from failstop.policy.layouts import BOARDS
from failstop.policy.setting import SettingError
from failstop.policy.settings import BAUDS, DECLARED, Settings
from failstop.supervisor.fit import checked_board
from tests.support.boards import own_folder
from tests.support.supervisor_scene import Scene
from tests.support.unprivileged import unprivileged


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "failstop.toml"


def refusal(file: Path, text: str | bytes) -> str:
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(SettingError) as raised:
        config.load(str(file))
    return str(raised.value)


@pytest.mark.parametrize(
    ("data", "set_to"),
    [
        (None, {}),
        (b"", {}),
        (b"# nothing\n", {}),
        (b"[gate]\n", {}),
        (b"[limits]\nvx_mps = 0.35\nwz_radps = 2\n[restart]\ndeaths = 9\n",
         {"limits.vx_mps": 0.35, "limits.wz_radps": 2.0, "restart.deaths": 9}),
        (b"limits.vx_mps = 0.35\n", {"limits.vx_mps": 0.35}),
        (b"\xef\xbb\xbf[limits]\r\nvx_mps = 0.35\r\n", {"limits.vx_mps": 0.35}),  # as editors on Windows write it
        (b"#" * config.LONGEST_LINE, {}),
    ],
)  # fmt: skip
def test_a_file_sets_what_it_names_and_nothing_else(file: Path, data: bytes | None, set_to: dict[str, float]) -> None:
    file.write_bytes(data or b"")
    link = file.with_name("link")
    link.symlink_to(file)
    for path in (None,) if data is None else (str(file), str(link)):
        assert config.load(path).values == {**Settings().values, **set_to}


def test_the_command_line_wins(file: Path) -> None:
    file.write_text('[device]\npath = "/dev/file"\n')
    assert config.load(str(file), {"device.path": "/dev/line"}).text("device.path") == "/dev/line"
    assert config.load(str(file), None).text("device.path") == "/dev/file"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("period_s = 0.02\n", "period_s is not a setting"),
        ("gate = 5\n", "gate is not a setting"),
        ("[gate.period_s]\nvalue = 1\n", "gate.period_s.value is not a setting"),
        ("[gate]\nperiod_s = 1979-05-27\n", "gate.period_s = datetime.date(1979, 5, 27): it must be a number"),
        ("[[sources]]\npriority = 1\n", "sources = [{'priority': 1}]: it must be a table, [sources.NAME]"),
        ("[gate]\nlease_s.x = 1\n", "gate.lease_s.x is not a setting"),
        ("'gate.lease_s' = 0.1\n", '"gate.lease_s" is not a setting; write tables as [gate], keys without quotes'),
        ("[gate]\n'' = 0.1\n", 'gate."" is not a setting'),
    ],
)
def test_what_is_not_allowed_names_the_key(file: Path, text: str, message: str) -> None:
    assert refusal(file, text).startswith(f"{file}: {message}")


@pytest.mark.parametrize("text", ["[gate\n", "gate.period_s 0.02\n", "[gate]\n[gate]\n", b"\xff\xfe", b"a = '\xff'"])
def test_broken_toml_names_the_file(file: Path, text: str | bytes) -> None:
    message = refusal(file, text)
    assert message.startswith(f"configuration {file} is not TOML: ")
    assert "\n" not in message


TABLES = '# mine\n[device]\npath = "/dev/x"\n[board]\n#kind = "rrc"\n[arm]\nhot_c = 60\n'
ABOVE = TABLES.replace("[device]", "{}[device]")


@pytest.mark.parametrize(
    ("before", "told", "after"),
    [
        (
            TABLES + "scan.gate = 'off'\n",
            "line 8, `scan.gate` is below `[arm]`, so it would set arm.scan.gate: "
            "move it above line 2, the first [table]",
            ABOVE.format("scan.gate = 'off'\n"),
        ),
        (
            TABLES + "board.kind = 'ugv'\n",
            "line 8, `board.kind` is below `[arm]`, so it would set arm.board.kind: "
            "write it as `kind = ...` below `[board]` (line 4)",
            TABLES.replace("[board]\n", "[board]\nkind = 'ugv'\n"),
        ),
        (
            TABLES + "[joints.pan]\nservo = 1\nsources.page.priority = 5\n",
            "line 10, `sources.page.priority` is below `[joints.pan]`, so it would set "
            "joints.pan.sources.page.priority: move it above line 2, the first [table]",
            ABOVE.format("sources.page.priority = 5\n") + "[joints.pan]\nservo = 1\n",
        ),
        (
            "device.path = '/dev/x'\ndevice.path = '/dev/y'\n",
            "line 2 sets device.path, which line 1 has set: keep one of them",
            "device.path = '/dev/y'\n",
        ),
        (
            "board.kind = 'ugv'\nscan.gate = 'off'\n" * 2 + "gate.lease_s = 0.1\nscan.gate = 'on'\n",
            "line 3 sets board.kind, which line 1 has set, and 2 more lines up to line 6 set what is set already: "
            "keep one of each",
            "board.kind = 'ugv'\nscan.gate = 'off'\n",
        ),
        (
            TABLES + "[device]\n#path = 1\n",
            "line 8 begins [device], as line 2 has: put its settings below that line",
            TABLES,
        ),
        (
            "gate.lease_s = 0.1\n[gate]\nrefresh_s = 0.3\n",
            "line 2 begins [gate], and line 1 sets gate.lease_s outside it: write that as `lease_s = ...` below [gate]",
            "[gate]\nlease_s = 0.1\nrefresh_s = 0.3\n",
        ),
    ],
)  # fmt: skip
def test_a_line_in_the_wrong_place_is_told_where_it_belongs_and_is_right_there(
    file: Path, before: str, told: str, after: str
) -> None:
    assert refusal(file, before).endswith(f": {told}")
    file.write_text(after)
    config.load(str(file))


def test_of_many_misplaced_lines_the_first_are_named_and_the_rest_counted(file: Path) -> None:
    lines = "".join(f"wheels.sign_{number} = 1\n" for number in (1, 2, 3, 4)) + "web.port = 1\n"
    message = refusal(file, TABLES + lines)
    assert message.count("is below `[arm]`") == 4
    assert message.endswith("; and 1 more")


@pytest.mark.parametrize(
    ("content", "problem"),
    [
        (b"a = " + b"[\n" * 5000, "it is nested too deeply"),
        ("gate.period_s = 0.02\n".encode("utf-16"), "it is UTF-16: save it as UTF-8"),
        (b"a." * 450 + b"a = 1\n", ""),
        (b"a = {" * 190, ""),
        (b'"a\\u001b[2J\\n" = 1\n', ""),
        (b"gate.period_s = 0x" + b"f" * 970, "gate.period_s = 9917"),
        (b"pad.mode_button = 0x" + b"f" * 970, "pad.mode_button = 9917"),
        (b"#" * (config.LONGEST_LINE + 1), "line 1 has more than 1000 characters"),
        (b"scan.gate = [\n" + b"[\n" * 100 + b"]" * 101, "scan.gate = [[[["),
        (b"device.path = '" + b"x" * 900 + b"'\n", "device.path = 'xxxx"),
        (b"sources." + b"x" * 900 + b" = 1\n", ""),
        (b"sources.'a\tb' = 1\n", ""),
    ],
)
def test_whatever_is_in_a_file_is_one_short_line(file: Path, content: bytes, problem: str) -> None:
    message = refusal(file, content)
    assert problem in message
    assert message.isprintable()
    assert len(message) < 500 + len(str(file))


@pytest.mark.parametrize(("over", "allowed"), [(0, True), (1, False)])
def test_a_file_may_be_as_long_as_said_and_comes_in_parts(over: int, allowed: bool) -> None:
    most = "MOST_BYTES + 1 - len(data)"
    scene = Scene(patches=(("failstop.config", most, f"min(4096, {most})"),))
    scene.write("/file", ("limits.vx_mps = 0.35\n" + ("#" * 999 + "\n") * 66)[: config.MOST_BYTES + over])
    loaded = scene.load("failstop.config")
    if allowed:
        assert loaded.load("/file")["limits.vx_mps"] == 0.35
    else:
        with pytest.raises(loaded.SettingError, match="it has more than 65536 bytes"):
            loaded.load("/file")


def test_a_key_that_is_longer_than_any_is_told_as_it_is_written(file: Path) -> None:
    longest = "x" * config.LONGEST_KEY
    assert refusal(file, f"{longest} = 1\n").startswith(f"{file}: {longest} is not a setting")
    told = f"{file}: '{longest}x' is not a setting; `failstop config` lists them all"
    assert refusal(file, f"{longest}x = 1\n") == told


def test_a_mistake_without_words_is_told_by_its_name(scene: Scene) -> None:
    loaded = scene.load("failstop.config")
    scene.refuse("open", MemoryError())
    with pytest.raises(loaded.SettingError, match="is not TOML: MemoryError;"):
        loaded.load("/file")


def test_a_number_of_thousands_of_digits_on_a_line_that_may_be_is_one_line(file: Path) -> None:
    """The interpreter's limit is a setting of the environment's, and can be lower than the longest line."""
    before = sys.get_int_max_str_digits()
    sys.set_int_max_str_digits(640)
    try:
        assert "is not TOML: Exceeds the limit" in refusal(file, b"gate.period_s = " + b"1" * 700)
    finally:
        sys.set_int_max_str_digits(before)


@pytest.mark.timeout(20)
@pytest.mark.parametrize(
    ("path", "told"),
    [
        *((path, "") for path in ("/dev/zero", "/dev/ptmx", "/dev/tty", "fifo", "/proc/kcore", "/proc/kmsg")),
        ("absent", ": No such file or directory: check the path"),
        (".", ": a directory, not a regular file"),
    ],
)
def test_what_is_no_settings_file_ends_and_is_told(path: str, told: str, tmp_path: Path) -> None:
    os.mkfifo(tmp_path / "fifo")
    where = os.path.join(tmp_path, path)
    with pytest.raises(SettingError, match=f"configuration {where}{told}") as raised:
        config.read(where)
    assert str(raised.value).isprintable()


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        *((0, "0x0000"), (0x3000, "0x3000"), (0xFFFF, "0xFFFF"), (0x10000, "0x10000"), (0x6000, "0x6000")),
        *((1 << 32, "4294967296"), (-0x2000, "0x-2000"), (8193.0, "8193.0"), (float("nan"), "nan")),
    ],
)
def test_the_mode_button_is_exactly_one_bit(value: float, shown: str) -> None:
    """With two a second button would be no stop, and with none MODE would be one."""
    for bit in range(16):
        assert config.checked({"pad.mode_button": 1 << bit})["pad.mode_button"] == 1 << bit
    told = f"pad.mode_button = {shown}: it must be exactly one bit, 0x0001, 0x0002 ... 0x8000"
    with pytest.raises(SettingError) as raised:
        config.checked({"pad.mode_button": value})
    assert str(raised.value) == told


def test_a_list_of_any_depth_is_refused_in_one_line() -> None:
    deep: list[object] = []
    for _ in range(50_000):
        deep = [deep]
    # Before Python 3.14 its text is more than the interpreter allows.
    with pytest.raises(SettingError, match=r"^scan\.gate = (list that is too large to show|\[+\.\.\.): [^\n]*$"):
        config.checked({"scan.gate": deep})


KEYS = st.sampled_from([*(setting.key for setting in DECLARED), "sources.a.priority", "interlocks.a.refusal", "x.y"])
SCALARS = st.none() | st.booleans() | st.integers() | st.floats() | st.text() | st.dates()
VALUES = st.recursive(SCALARS, lambda inner: st.lists(inner) | st.dictionaries(st.text(), inner), max_leaves=5)


@given(KEYS, VALUES)
@example("gate.period_s", 1 << 20000)
@example("pad.mode_button", 1 << 20000)
def test_a_value_of_any_type_is_taken_or_refused_in_one_short_line(key: str, value: object) -> None:
    said = ""
    try:
        config.checked({key: value})
    except SettingError as error:
        said = str(error)
    assert said.isprintable()
    assert len(said) < 500


def test_sources_and_interlocks_of_a_file(file: Path) -> None:
    file.write_text(
        """
        [sources.teleop]
        priority = 10
        [sources.nav]
        priority = 5
        timeout_s = 0.5
        [interlocks.arm]
        refusal = "arm is not in the drive pose"
        [interlocks.door]
        """
    )
    settings = config.load(str(file))
    assert settings.sources() == {"teleop": (10, 300_000_000), "nav": (5, 500_000_000), "cmd_vel": (0, 300_000_000)}
    assert settings.interlocks() == {
        "arm": (500_000_000, "arm is not in the drive pose"),
        "door": (500_000_000, "interlock door is not satisfied"),
    }


def test_an_installed_file_in_a_closed_folder_is_not_taken_for_none(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv(root.VARIABLE, str(tmp_path))
    assert config.chosen("left", None) is None
    folder = tmp_path / "etc/failstop"
    folder.mkdir(parents=True)
    folder.chmod(0)

    def look() -> str:
        path = config.chosen("left", None)
        said = [f"{path}"]
        for load in (lambda: config.load(path), lambda: fleet_settings.load(None)):
            try:
                load()
            except SettingError as error:
                said.append(str(error))
        return json.dumps(said)

    try:
        path, settings, fleet = json.loads(unprivileged(look))
    finally:
        folder.chmod(0o755)
    assert path == config.installed("left")
    assert f"configuration {path} can't be read by" in settings
    assert "because a folder above it lets only other users in" in settings
    assert "can't be read by" in fleet


# The command.


def run(capsys: pytest.CaptureFixture[str], *words: str) -> tuple[int, str, str]:
    code = cli.main([*words])
    captured = capsys.readouterr()
    return code, captured.out, captured.err


@pytest.mark.parametrize(
    "words", [("config", "--check", ""), ("config", "--config", ""), ("config", "--within", "0.1", "--config", "")]
)
def test_a_path_of_no_letters_is_no_file(words: tuple[str, ...], capsys: pytest.CaptureFixture[str]) -> None:
    """An unset variable of a script, for one: it must not be the defaults without a word."""
    code, out, err = run(capsys, *words)
    assert (code, out) == (1, "")
    assert "the path of the configuration is empty: name a file" in err


def row(text: str, key: str) -> list[str]:
    return next(line.split() for line in text.splitlines() if line.startswith(f"{key} "))


def test_value_unit_and_origin_of_each_setting(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file.write_text("[limits]\nvx_mps = 0.35\nwz_radps = 1.0\n[sources.teleop]\npriority = 10\n")
    code, text, _ = run(capsys, "config", "--config", str(file))
    assert code == 0
    assert row(text, "device.path")[1:3] == ["/dev/ttyACM0", "default"]
    assert row(text, "limits.vx_mps")[1:4] == ["0.35", "m/s", "failstop.toml"]
    assert row(text, "limits.vy_mps")[1:4] == ["0.2", "m/s", "default"]
    assert row(text, "limits.wz_radps")[1:4] == ["1.0", "rad/s", "failstop.toml"], "set, though to the default"
    assert row(text, "sources.teleop.priority")[1:3] == ["10", "failstop.toml"]
    assert row(text, "sources.teleop.timeout_s")[1:4] == ["0.3", "s", "default"]
    assert row(text, "pad.mode_button")[1:3] == ["0x2000", "default"]
    for key in config.load(str(file)).flat():
        assert row(text, key)


def test_readable_in_80_columns(capsys: pytest.CaptureFixture[str]) -> None:
    _, text, _ = run(capsys, "config")
    assert max(map(len, text.splitlines())) <= 80
    groups = [block.split(".")[0] for block in text.split("\n\n")]
    assert groups[:5] == ["device", "board", "gate", "limits", "wheels"], "an empty line between two groups"


def test_as_json(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file.write_text("[limits]\nvx_mps = 0.35\n")
    found = json.loads(run(capsys, "config", "--json", "--config", str(file))[1])
    assert found["limits.vx_mps"] == {"value": 0.35, "unit": "m/s", "origin": str(file), "allowed": "0.01 to 3 m/s"}
    assert found["device.path"]["origin"] == "default"
    assert {key: entry["value"] for key, entry in found.items()} == config.load(str(file)).flat()


def test_check_of_a_file_that_is_right(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    file.write_text("[limits]\nvx_mps = 0.35\n[interlocks.arm]\n")
    assert run(capsys, "config", "--check", str(file)) == (0, f"{file} is right; it sets 1 value\n", "")
    file.write_text("")
    assert run(capsys, "config", "--check", str(file)) == (0, f"{file} is right; it sets 0 values\n", "")


def test_a_stick_that_nobody_would_see_is_no_right_file(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A service with these settings starts all the same: it is the page that lacks something."""
    file.write_text('web.drive = "on"\n')
    code, out, err = run(capsys, "config", "--check", str(file))
    assert (code, out) == (1, "")
    assert 'web.drive = "on" needs attend.required = "on": the page shows no stick without' in err
    assert config.load(str(file)).on("web.drive")
    file.write_text('web.drive = "on"\nattend.required = "on"\n')
    assert run(capsys, "config", "--check", str(file))[0] == 0


def test_a_file_that_others_may_write_is_no_right_file(file: Path, capsys: pytest.CaptureFixture[str]) -> None:
    """A service still starts with it: a robot must not stand still after an upgrade."""
    file.write_text('still.command = "relay off"\n')
    file.chmod(0o666)
    code, out, err = run(capsys, "config", "--check", str(file))
    assert (code, out) == (1, "")
    assert f"others may write {file}, so they can change the settings in {file}" in err
    assert f": sudo chmod go-w {file}" in err
    assert config.load(str(file)).text("still.command") == "relay off"
    file.chmod(0o644)
    assert run(capsys, "config", "--check", str(file))[0] == 0
    file.parent.chmod(0o777)
    assert f"sudo chmod go-w {file.parent}" in run(capsys, "config", "--check", str(file))[2]


def test_the_smallest_speed_of_a_board_is_told_and_smaller_limits_are_refused(
    file: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    """One unit is a turn a minute, of wheels of 8 cm."""
    file.write_text('board.kind = "hoverboard"\n')
    said = f"{file} is right; it sets 1 value; a wheel that should go slower than 0.0042 m/s does not turn\n"
    assert run(capsys, "config", "--check", str(file)) == (0, said, "")
    file.write_text('board.kind = "hoverboard"\nboard.per_rps = 1.0\nlimits.vx_mps = 0.1\nlimits.wz_radps = 0.1\n')
    code, _, err = run(capsys, "config", "--check", str(file))
    assert code == 1
    assert "the board's smallest speed of a wheel is 0.25 m/s, and the limits are 0.11: raise [limits]" in err


@pytest.mark.parametrize(
    ("lines", "notes"),
    [
        (
            ('board.kind = "arduino"', "battery.stop_mv = 10500"),
            ["battery.stop_mv = 10500 never stops the robot, because board.kind arduino reports no battery: remove it"],
        ),
        (
            ('board.imu = "off"', 'still.command = "relay off"'),
            ['still.command never runs, because with board.imu = "off" nothing on board.kind rrc shows whether'],
        ),
        (
            ('board.kind = "vesc"', "key.stop = 1", 'buzzer.tones = "on"'),
            [
                "key.stop = 1 never stops the robot, because board.kind vesc reports no keys: remove it",
                'buzzer.tones = "on" warns nobody, because board.kind vesc has no buzzer',
            ],
        ),
        (("battery.stop_mv = 10500", "key.stop = 2", 'still.command = "relay off"', 'buzzer.tones = "on"'), []),
        (('board.kind = "arduino"', 'still.command = "relay off"', "battery.stop_mv = -1"), []),
    ],
)
def test_a_protection_that_the_board_can_t_give_is_named(
    capsys: pytest.CaptureFixture[str], tmp_path: Path, lines: tuple[str, ...], notes: list[str]
) -> None:
    """The file is right, because the service starts with it."""
    file = tmp_path / "robot.toml"
    file.write_text("\n".join(lines))
    code, out, _ = run(capsys, "config", "--check", str(file))
    first, *others = out.splitlines()
    assert code == 0
    assert first.startswith(f"{file} is right; ")
    assert len(others) == len(notes)
    for line, note in zip(others, notes, strict=True):
        assert line.startswith(f"but {note}")


def asked(kind: str, *, most: float = 0.0, least: float = 0.0) -> Settings:
    """Settings of which the fastest wheel is so many times the most, or the least, that the board takes."""
    given: dict[str, object] = {"board.kind": kind, "wheels.diameter_m": 0.0625}
    motion, fastest_rps = wire_of(kind).motion, max_wheel_rps(Settings(given))
    per_rps = most * motion.limit / fastest_rps if most else least * motion.step / fastest_rps
    return Settings({**given, "board.per_rps": per_rps})


@pytest.mark.parametrize("kind", ["arduino", "ugv"])
def test_limits_that_are_just_what_a_board_takes_are_right(kind: str) -> None:
    for settings in (asked(kind, most=1.0), asked(kind, least=1.0)):
        assert checked_board(settings, None).name == wire_of(kind).name


FAST = "the board takes 0.728 turns of a wheel a second, and the limits are 1.46: lower [limits], or see board.per_rps"
SLOW = (
    "the board's smallest speed of a wheel is 0.57 m/s, and the limits are 0.29: raise [limits], or see board.per_rps"
)


@pytest.mark.parametrize("path", ["/etc/failstop.toml", None])
@pytest.mark.starts
def test_what_a_board_does_not_take_is_refused_with_the_file_it_is_in(path: str | None, tmp_path: Path) -> None:
    folder = own_folder(tmp_path / "tank")
    refused = [
        (
            Settings({"board.kind": folder, "wheels.layout": "omni3"}),
            f"board.kind {folder} takes 2 speeds, and wheels.layout omni3 has 3 wheels",
        ),
        (asked("arduino", most=2.0), FAST),
        (
            Settings({"board.kind": "rrc", "board.baud": 921600}),
            "board.baud = 921600: board.kind rrc has 1000000, and a stop would take longer than its repeats allow: "
            "set 0, or build the firmware for 1000000 or more",
        ),
        (asked("arduino", least=0.5), SLOW),
    ]
    for settings, text in refused:
        with pytest.raises(SettingError) as error:
            checked_board(settings, path)
        assert str(error.value) == f"{path or 'settings'}: {text}"


@pytest.mark.parametrize("kind", BOARDS)
def test_speeds_must_be_sent_twice_in_the_time_of_the_board_s_own_watchdog(kind: str) -> None:
    acts_s, _ = watchdog_of(kind)
    most_s = min(acts_s / 2 or 1.0, 1.0)
    checked_board(Settings({"board.kind": kind, "gate.refresh_s": most_s}), None)
    if most_s < 1.0:
        with pytest.raises(SettingError) as error:
            checked_board(Settings({"board.kind": kind, "gate.refresh_s": most_s + 0.001}), None)
        why = f"the board's own watchdog stops the wheels {acts_s:g} s after the last frame"
        step = f"set gate.refresh_s to {most_s:g} or less"
        assert str(error.value) == f"settings: gate.refresh_s = {most_s + 0.001:g} s: {why}: {step}"


@pytest.mark.starts
def test_the_watchdog_of_an_own_board_counts_too(tmp_path: Path) -> None:
    folder = Path(own_folder(tmp_path / "tank"))
    wire = folder / "wire.py"
    text = wire.read_text()
    assert text.count("after_ns=2000 * _MS") == 1
    wire.write_text(text.replace("after_ns=2000 * _MS", "after_ns=300 * _MS"))
    with pytest.raises(SettingError, match=r"gate\.refresh_s = 0\.2 s: .* 0\.3 s after .*: set .* to 0\.15 or less$"):
        checked_board(Settings({"board.kind": str(folder)}), None)


@pytest.mark.parametrize("kind", BOARDS)
def test_each_baud_rate_is_refused_or_the_port_has_it(kind: str) -> None:
    usual = checked_board(Settings({"board.kind": kind}), None).port.baud
    for baud in BAUDS[1:]:
        settings = Settings({"board.kind": kind, "board.baud": baud})
        if baud >= usual:
            assert checked_board(settings, None).port.baud == baud
        else:
            with pytest.raises(SettingError, match=f"board.baud = {baud}: board.kind {kind} has {usual}, and"):
                checked_board(settings, None)


@pytest.mark.parametrize(
    ("text", "told"),
    [
        ('board.kind = "arduino"\nboard.baud = 115200\n', ""),
        ('board.kind = "arduino"\nboard.baud = 57600\n', ""),
        ('board.kind = "hoverboard"\nboard.baud = 57600\n', "a stop would take longer than its repeats allow"),
        ("board.baud = 115200\n", "board.kind rrc has 1000000, and a stop would take longer"),
        ("board.baud = 1000000\n", ""),
        ("board.baud = 9600\n", "board.baud = 9600: it must be 0 or 57600 or 115200 or"),
    ],
)
def test_a_baud_rate_is_one_that_the_board_s_stop_is_made_for(
    file: Path, text: str, told: str, capsys: pytest.CaptureFixture[str]
) -> None:
    file.write_text(text)
    code, out, err = run(capsys, "config", "--check", str(file))
    assert code == bool(told)
    assert told in err
    assert bool(out) is not bool(told)


@pytest.mark.parametrize("words", [["config", "--check"], ["config", "--config"], ["run", "--config"]])
@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("pad.mode_button = 0x3000\n", "{file}: pad.mode_button = 0x3000: it must be exactly one bit, 0x0001, 0x0002"),
        ("limits.vx = 0.1\n", "{file}: limits.vx is not a setting; did you mean limits.vx_mps?"),
        ("[limits\n", "configuration {file} is not TOML: "),
        (None, "configuration {file}: No such file or directory: check the path"),
    ],
)
def test_each_way_to_read_a_wrong_file_refuses_it_in_one_line(
    file: Path, text: str | None, message: str, words: list[str], capsys: pytest.CaptureFixture[str]
) -> None:
    if text is not None:
        file.write_text(text)
    code, out, err = run(capsys, *words, str(file))
    assert (code, out, err.count("\n")) == (1, "", 1)
    assert err.startswith(f"failstop: {message.format(file=file)}")
    assert ("no stop was written: no device" in err) is (words[0] == "run")
