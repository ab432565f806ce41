"""What the tests of the installation share: small parts, an environment of three files, a machine that only notes."""

from __future__ import annotations

import dataclasses
import os
import stat
from collections.abc import Sequence
from pathlib import Path

from failstop.install import InstallError
from failstop.install.found import Found, Request
from failstop.install.layout import MANIFEST, Manifest
from failstop.install.machine import Machine
from failstop.install.rows import EXTRAS
from failstop.install.steps import Command, Directory, File, Link, Plan, Remove, Start, Tree
from failstop.install.tree import Entry, Environment

UNIT = "[Service]\nExecStart=/opt/failstop/bin/failstop run\n[Install]\nWantedBy=multi-user.target some.device\n"
TEMPLATE = "[Service]\nExecStart=/opt/failstop/bin/failstop run --name %i\n[Install]\nWantedBy=multi-user.target\n"
SYSUSERS = '# who\nu failstop - "the service" /var/lib/failstop\ng dialout -\nm failstop dialout\n'
PASSWD = b"root:x:0:0:root:/root:/bin/sh\nfailstop:x:990:990:the service:/var/lib/failstop:/usr/sbin/nologin\n"
GROUP = b"root:x:0:\ndialout:x:20:failstop\nfailstop:x:990:\n"
SLEEP = "[Service]\nExecStart=/opt/failstop/bin/failstop stop --services\n[Install]\nWantedBy=sleep.target\n"
LATE = "[Service]\nExecStart=/opt/failstop/bin/failstop stop --name %i\n"
EXAMPLE = '# Every setting.\n[device]\n# the board\'s port\npath = "/dev/ttyACM0"\n'
CATALOG = "-- 5d1bd76d7a4e4b0f9c1f0b3fae1c0e55\nSubject: a stop\nDefined-By: failstop\n\nIt stopped.\n"
MANUAL = ".TH FAILSTOP 1\n"
SHELLS = {shell: f"# {shell}\n" for shell in ("bash", "zsh", "fish")}
TEXTS = {
    "failstop.service": UNIT,
    "failstop@.service": TEMPLATE,
    "failstop-sleep.service": SLEEP,
    "failstop-late@.service": LATE,
    "failstop.sysusers": SYSUSERS,
    "failstop.udev": "# udev\n",
    "failstop.catalog": CATALOG,
    "failstop.toml": EXAMPLE,
    "failstop.1": MANUAL,
    **SHELLS,
    **{extra.source: "# an extra\n" for extra in EXTRAS},
}


def environment(version: str = "1.0") -> Environment:
    """A small environment that differs by version."""
    return Environment(
        "/opt/failstop",
        "/usr/bin/python3",
        (
            Entry("bin/python3", target="/usr/bin/python3"),
            Entry("bin/failstop", data=b"#!/bin/sh\n", executable=True),
            Entry("lib/module.py", data=f"VERSION = {version!r}\n".encode()),
        ),
    )


class NotingMachine(Machine):
    """Notes what it is to run; one command of these may fail."""

    def __init__(self, failing: str = "") -> None:
        super().__init__()
        self.ran: list[str] = []
        self._failing = failing

    def run(self, words: Sequence[str], accepted: Sequence[int] = (0,)) -> None:
        """Note it, or fail."""
        self.ran.append(" ".join(words))
        if self._failing and self._failing in self.ran[-1]:
            raise InstallError(f"{words[0]}: no")

    def start(self, unit: str) -> None:
        """Note it, or fail."""
        self.run(("start", unit))


def snapshot(root: Path) -> dict[str, tuple[str, int, bytes]]:
    """Everything below a directory: by path, its kind, mode and content."""
    found = {}
    for folder, folders, names in os.walk(root):
        for name in [*folders, *names]:
            path = Path(folder, name)
            mode = path.lstat().st_mode
            if stat.S_ISLNK(mode):
                content = str(path.readlink()).encode()
            else:
                content = path.read_bytes() if stat.S_ISREG(mode) else b""
            found[str(path.relative_to(root))] = (stat.filemode(mode)[0], stat.S_IMODE(mode), content)
    return found


BARE = Found(
    {"/etc/passwd": b"root:x:0:0:root:/root:/bin/sh\n", "/etc/group": b"root:x:0:\n"},
    directories=frozenset(
        {"/etc", "/etc/systemd", "/etc/systemd/system", "/etc/udev", "/etc/udev/rules.d", "/etc/sysusers.d"}
        | {"/opt", "/usr", "/usr/local", "/usr/local/bin", "/usr/local/lib"}
    ),
    udev=True,
)


LIVE = Request()


def after(plan: Plan, found: Found, tree: str = "tree 1") -> Found:
    """What is found when a plan was carried out."""
    files, links, directories = dict(found.files), dict(found.links), set(found.directories)
    for step in plan.steps:
        if isinstance(step, File):
            files[step.subject] = step.data
        elif isinstance(step, Link):
            links[step.subject] = step.target
        elif isinstance(step, Directory):
            directories.add(step.subject)
        elif isinstance(step, Tree):
            directories.add(step.subject)
            files[MANIFEST] = step.manifest
        elif isinstance(step, Remove):
            files.pop(step.subject, None)
            links.pop(step.subject, None)
        elif isinstance(step, Command) and step.words[:1] == ("systemd-sysusers",):
            files |= {"/etc/passwd": PASSWD, "/etc/group": GROUP}
    units = tuple(step.subject for step in plan.steps if isinstance(step, Start))
    return dataclasses.replace(
        found,
        files=files,
        links=links,
        directories=frozenset(directories),
        tree=tree,
        manifest=Manifest.load(files[MANIFEST]),
        active=tuple(dict.fromkeys((*found.active, *units))),
        configured_device="/dev/ttyACM0",
    )


def shown(plan: Plan) -> list[str]:
    return [f"{step.verb} {step.subject}" for step in plan.steps if step.verb]
