"""The settings of a stand: the user's, as an installation writes them, with those of the test over them."""

from __future__ import annotations

from pathlib import Path

import pytest

from failstop import config
from failstop_lab.faults import scene
from failstop_lab.prove import stand
from failstop_lab.trial import write_settings

EXAMPLES = sorted((Path(__file__).resolve().parents[3] / "examples").glob("*.toml"))


@pytest.mark.parametrize("example", EXAMPLES, ids=lambda path: path.name)
def test_tables_that_a_file_leaves_empty_do_not_hinder(example: Path, tmp_path: Path) -> None:
    path = str(tmp_path / "own.toml")
    user = config.read(str(example))
    for values in (stand.settings_for(user), {**user, **scene.SETTINGS}):
        write_settings(path, values)
        settings = config.load(path)
        assert settings.values["restart.deaths"] == values["restart.deaths"] == 100_000


def test_an_empty_table_that_says_something_stays(tmp_path: Path) -> None:
    path = str(tmp_path / "own.toml")
    write_settings(path, {"sources.lidar": {}, "interlocks": {}, "interlocks.arm.timeout_s": 0.5})
    assert config.read(path) == {"sources.lidar": {}, "interlocks.arm.timeout_s": 0.5}
