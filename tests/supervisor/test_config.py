"""The configuration file: read once, whole, and refused with its reason."""

from __future__ import annotations

from pathlib import Path

import pytest

from failstop.supervisor import config
from failstop.supervisor.settings import SettingError, Settings


@pytest.fixture
def file(tmp_path: Path) -> Path:
    return tmp_path / "failstop.toml"


def refusal(file: Path, text: str | bytes) -> str:
    file.write_bytes(text if isinstance(text, bytes) else text.encode())
    with pytest.raises(SettingError) as raised:
        config.load(str(file))
    return str(raised.value)


def test_no_file_is_the_defaults() -> None:
    assert config.load(None).values == Settings().values


@pytest.mark.parametrize("text", ["", "# nothing\n", "[gate]\n"])
def test_an_empty_file_is_the_defaults(file: Path, text: str) -> None:
    file.write_text(text)
    assert config.load(str(file)).values == Settings().values


def test_values_of_a_file(file: Path) -> None:
    file.write_text('[device]\npath = "/dev/board"\n[limits]\nvx_mps = 0.35\nwz_radps = 2\n[restart]\ndeaths = 9\n')
    settings = config.load(str(file))
    assert settings.text("device.path") == "/dev/board"
    assert (settings["limits.vx_mps"], settings["limits.wz_radps"], settings["restart.deaths"]) == (0.35, 2.0, 9)
    assert settings["limits.vy_mps"] == 0.2


def test_dotted_keys_are_the_same(file: Path) -> None:
    file.write_text("limits.vx_mps = 0.35\n")
    assert config.load(str(file))["limits.vx_mps"] == 0.35


def test_the_command_line_wins(file: Path) -> None:
    file.write_text('[device]\npath = "/dev/file"\n')
    assert config.load(str(file), {"device.path": "/dev/line"}).text("device.path") == "/dev/line"
    assert config.load(str(file), None).text("device.path") == "/dev/file"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[gate]\nperod_s = 0.02\n", "gate.perod_s: no such setting; `failstop config` lists them all"),
        ("[gaet]\nperiod_s = 0.02\n", "gaet.period_s: no such setting"),
        ("period_s = 0.02\n", "period_s: no such setting"),
        ("gate = 5\n", "gate: no such setting"),
        ("[gate.period_s]\nvalue = 1\n", "gate.period_s.value: no such setting"),
        ('[gate]\nperiod_s = "fast"\n', "gate.period_s = 'fast': a number is expected, 0.005 to 0.05 s"),
        ("[gate]\nperiod_s = true\n", "gate.period_s = True: a number is expected"),
        ("[gate]\nperiod_s = [0.02]\n", "gate.period_s = [0.02]: a number is expected"),
        ("[gate]\nperiod_s = 1979-05-27\n", "gate.period_s = datetime.date(1979, 5, 27): a number is expected"),
        ("[gate]\nperiod_s = nan\n", "gate.period_s = nan: allowed is 0.005 to 0.05 s"),
        ("[gate]\nperiod_s = -inf\n", "gate.period_s = -inf: allowed is"),
        ("[gate]\nlease_s = 9.0\n", "gate.lease_s = 9.0: allowed is 0.02 to 1 s"),
        ("[restart]\ndeaths = nan\n", "restart.deaths = nan: allowed is 1 to 100000"),
        ("[restart]\ndeaths = inf\n", "restart.deaths = inf: allowed is 1 to 100000"),
        ("[restart]\ndeaths = 2.5\n", "restart.deaths = 2.5: a whole number is expected"),
        ("[device]\npath = 5\n", "device.path = 5: a text is expected"),
        ('[device]\npath = ""\n', "device.path = '': a text is expected"),
        ("[gate]\nlease_s = 0.5\n", "gate.command_timeout_s = 0.3 s must be longer than gate.lease_s = 0.5 s"),
    ],
)
def test_what_is_not_allowed_names_the_key(file: Path, text: str, message: str) -> None:
    assert refusal(file, text).startswith(message)


@pytest.mark.parametrize("text", ["[gate\n", "gate.period_s 0.02\n", "[gate]\n[gate]\n", b"\xff\xfe", b"a = '\xff'"])
def test_broken_toml_names_the_file(file: Path, text: str | bytes) -> None:
    message = refusal(file, text)
    assert message.startswith(f"configuration {file} is not TOML: ")
    assert "\n" not in message


def test_a_missing_file_names_it(file: Path) -> None:
    with pytest.raises(SettingError) as raised:
        config.load(str(file))
    assert str(raised.value) == f"configuration {file}: No such file or directory: check the path"


def test_a_directory_is_no_file(tmp_path: Path) -> None:
    with pytest.raises(SettingError, match=f"configuration {tmp_path}: Is a directory"):
        config.load(str(tmp_path))
