"""The end of setup: its settings file."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from failstop.files import durable
from failstop.setup import finish


class Answers:
    """Somebody who names a file and replaces it."""

    def __init__(self, path: Path) -> None:
        self._answers = {"file": str(path), "replace": finish.REPLACE}

    def ask(self, key: str, *_: Any, **__: Any) -> str:
        return self._answers[key]

    def say(self, *_: Any) -> None:
        pass


@pytest.mark.parametrize("calls", [0, 1])
def test_whenever_it_ends_there_is_a_settings_file(calls: int, tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = tmp_path / "failstop.toml"
    path.write_text("board.kind = 'ugv'\n")
    left = calls

    def ends(act: Any) -> Any:
        def each(*words: Any) -> None:
            nonlocal left
            if not left:
                raise KeyboardInterrupt
            left -= 1
            act(*words)

        return each

    for name in ("write_draft", "publish"):
        monkeypatch.setattr(durable, name, ends(getattr(durable, name)))
    with pytest.raises(KeyboardInterrupt):
        finish.write(Answers(path), "board.kind = 'rrc'\n", "failstop")  # type: ignore[arg-type]
    assert path.read_text() == "board.kind = 'ugv'\n"
    monkeypatch.undo()
    finish.write(Answers(path), "board.kind = 'rrc'\n", "failstop")  # type: ignore[arg-type]
    assert path.read_text() == "board.kind = 'rrc'\n"
    assert (tmp_path / "failstop.toml.old").read_text() == "board.kind = 'ugv'\n"
