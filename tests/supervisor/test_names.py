"""Names that are taken away: what is told of each, and what the service can't go on without."""

from __future__ import annotations

import os
from collections.abc import Iterator
from pathlib import Path

import pytest

from failstop.procs.world import World
from failstop.supervisor.events import Events
from failstop.supervisor.names import LOOK_EVERY_NS, Names

ALL = (
    "shared memory gate",
    "shared memory lifelines",
    "shared memory client.0",
    "shared memory client.7",
    "the stop pipe",
)


class Told(Events):
    """What people were told."""

    def __init__(self) -> None:
        super().__init__(World(), "none")
        self.found: list[tuple[str, str]] = []

    def tell(self, kind: str, text: str, fields: object = None, *, level: str = "") -> None:
        self.found.append((level, text))


class Scene:
    def __init__(self, directory: Path) -> None:
        self.paths = {name: directory / name for name in ALL}
        self.named = {name: os.open(path, os.O_CREAT | os.O_RDWR) for name, path in self.paths.items()}
        self.told = Told()
        self.names = Names(self.named, self.told)
        self.now_ns = 5 * LOOK_EVERY_NS

    def lost(self, *removed: str, elapsed_ns: int = LOOK_EVERY_NS) -> str:
        for name in removed:
            self.paths[name].unlink()
        self.now_ns += elapsed_ns
        return str(self.names.lost(self.now_ns) or "")


@pytest.fixture
def scene(tmp_path: Path) -> Iterator[Scene]:
    made = Scene(tmp_path)
    yield made
    for fd in made.named.values():
        os.close(fd)


def test_nothing_is_lost(scene: Scene) -> None:
    assert scene.lost() == ""
    assert scene.told.found == []


@pytest.mark.parametrize("name", [name for name in ALL if "client" not in name])
def test_a_name_that_the_service_needs(scene: Scene, name: str) -> None:
    assert scene.lost(name) == f"{name} was removed: restart the service"
    ((level, text),) = scene.told.found
    assert level == "error"
    assert name in text
    assert "RemoveIPC" in text
    assert scene.lost() == "", "once"


def test_a_client_slot_is_told_of_once(scene: Scene) -> None:
    assert scene.lost("shared memory client.7") == ""
    assert scene.lost() == ""
    ((level, text),) = scene.told.found
    assert level == "warning"
    assert "client.7" in text


def test_all_at_once_is_one_remark(scene: Scene) -> None:
    assert scene.lost(*ALL) == "shared memory gate was removed: restart the service"
    ((_, text),) = scene.told.found
    assert "lifelines" in text


def test_a_name_that_somebody_else_has_taken_is_gone(scene: Scene) -> None:
    scene.paths["the stop pipe"].unlink()
    scene.paths["the stop pipe"].touch()
    assert scene.lost() == "the stop pipe was removed: restart the service"


def test_it_looks_once_a_second(scene: Scene) -> None:
    assert scene.lost() == ""
    assert scene.lost("the stop pipe", elapsed_ns=LOOK_EVERY_NS - 1) == ""
    assert scene.lost(elapsed_ns=1)
