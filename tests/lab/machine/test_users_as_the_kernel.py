"""The simulated machine's users may what this machine's may: one program, run on both, must tell the same story."""

from __future__ import annotations

import os
import stat
from collections.abc import Callable
from pathlib import Path
from typing import Any

from failstop_lab.machine.process import Process
from failstop_lab.machine.robot import Robot
from tests.support.children import NOBODY, call, needs_root, reachable

OTHER = 61_235


def prepare(system: Any, folder: str) -> None:
    """Files of two users, of every mode, in folders of theirs, and in one that is everybody's."""
    for uid in (0, OTHER):
        for name, rights in (("own", 0o755), ("open", 0o777), ("sticky", 0o1777), ("shut", 0o700)):
            place = f"{folder}/{name}{uid}"
            system.mkdir(place)
            for mode in (0o600, 0o644, 0o622, 0o666, 0o640):
                for owner in (0, OTHER, NOBODY):
                    path = f"{place}/{mode:o}-{owner}"
                    system.close(system.open(path, os.O_RDWR | os.O_CREAT, 0o600))
                    system.chmod(path, mode)
                    system.chown(path, owner, owner)
            system.chmod(place, rights)
            system.chown(place, uid, uid)


def story(system: Any, folder: str) -> list[object]:
    """Acts on all that, with the error of each that the calling user may not do."""
    told: list[object] = [system.geteuid(), system.getegid()]

    def ask(what: Callable[..., Any], *arguments: Any) -> None:
        try:
            found = what(*arguments)
            told.append(system.close(found) if what == system.open else "done")
        except OSError as error:
            told.append(f"errno {error.errno}")

    for uid in (0, OTHER):
        for name in ("own", "open", "sticky", "shut"):
            place = f"{folder}/{name}{uid}"
            for mode in (0o600, 0o644, 0o622, 0o666, 0o640):
                for owner in (0, OTHER, NOBODY):
                    path = f"{place}/{mode:o}-{owner}"
                    for flags in (os.O_RDONLY, os.O_WRONLY, os.O_RDWR, os.O_PATH):
                        ask(system.open, path, flags)
                    ask(system.chmod, path, mode)
                    ask(system.chown, path, -1, NOBODY)
                    ask(system.chown, path, OTHER, -1)
                    ask(system.rename, path, f"{path}-")
                    ask(system.unlink, f"{path}-")
            ask(system.listdir, place)
            ask(system.mkdir, f"{place}/new")
            ask(system.mkfifo, f"{place}/pipe")
            ask(system.open, f"{place}/file", os.O_RDWR | os.O_CREAT)
            ask(system.rmdir, f"{place}/new")
    return told


def modes(system: Any, folder: str) -> list[object]:
    """The owners and modes of the files that are left."""
    found: list[object] = []
    for place in sorted(system.listdir(folder)):
        for name in sorted(system.listdir(f"{folder}/{place}")):
            status = system.stat(f"{folder}/{place}/{name}")
            found.append((place, name, stat.filemode(status.st_mode), status.st_uid, status.st_gid))
    return found


@needs_root
def test_both_tell_the_same_story(tmp_path: Path) -> None:
    reachable(tmp_path)
    robot = Robot()
    system, told = robot.loader.system["os"], []

    def run(process: Process) -> int:
        system.umask(0o22)
        system.makedirs("/srv/it")
        prepare(system, "/srv/it")
        process.uid = process.gid = NOBODY
        told.append(story(system, "/srv/it"))
        process.uid = process.gid = 0
        told.append(modes(system, "/srv/it"))
        return 0

    process = robot.machine.process("program", run)
    robot.machine.run(lambda: process.dead, 10**10)
    before = os.umask(0o22)
    prepare(os, str(tmp_path))
    os.umask(before)
    assert told[0] == call(lambda: story(os, str(tmp_path)), NOBODY)
    assert told[1] == modes(os, str(tmp_path))
