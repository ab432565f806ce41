"""The MODE button is one bit: with two, a second button would be no stop; with none, MODE would be one."""

from __future__ import annotations

from pathlib import Path

import pytest

from failstop import config
from failstop.cli import main as cli
from failstop.policy.setting import SettingError

KEY = "pad.mode_button"


def test_any_one_bit_is_allowed() -> None:
    for bit in range(16):
        assert config.checked({KEY: 1 << bit})[KEY] == 1 << bit


@pytest.mark.parametrize(
    ("value", "shown"),
    [
        (0, "0x0000"),
        (0x3000, "0x3000"),
        (0xFFFF, "0xFFFF"),
        (0x10000, "0x10000"),
        (0xFFFFFFFF, "0xFFFFFFFF"),
        (1 << 32, "4294967296"),
        (0x6000, "0x6000"),
        (-0x2000, "0x-2000"),
        (8193.0, "8193.0"),
        (float("nan"), "nan"),
    ],
)
def test_anything_else_names_the_key_the_value_and_what_is_allowed(value: float, shown: str) -> None:
    with pytest.raises(SettingError) as raised:
        config.checked({KEY: value})
    assert str(raised.value) == f"pad.mode_button = {shown}: allowed is exactly one bit, 0x0001, 0x0002 ... 0x8000"


@pytest.mark.parametrize("value", ["0x2000", True, None, [0x2000]])
def test_what_is_no_number_is_refused_as_elsewhere(value: object) -> None:
    with pytest.raises(SettingError, match=r"^pad\.mode_button = .*: a number is expected"):
        config.checked({KEY: value})


@pytest.mark.parametrize("words", [["config", "--check"], ["config", "--config"], ["run", "--config"]])
def test_each_way_to_read_a_file_refuses_it(
    words: list[str], tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "pad.toml"
    file.write_text("[pad]\nmode_button = 0x3000\n")
    assert cli.main([*words, str(file)]) == 1
    said = capsys.readouterr().err
    problem = f"failstop: {file}: pad.mode_button = 0x3000: allowed is exactly one bit, 0x0001, 0x0002 ... 0x8000"
    assert said.startswith(f"{problem}; no stop was written: no device" if words[0] == "run" else f"{problem}\n")
