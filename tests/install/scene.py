"""What the tests of the installation share: small parts, an environment of three files, and a directory as a system
whose programs only note what they are asked."""

from __future__ import annotations

import os
import stat
from collections.abc import Mapping, Sequence
from pathlib import Path

from failstop.install import InstallError, plan
from failstop.install.do import Doer
from failstop.install.plan import Plan, Request
from failstop.install.rows import EXTRAS, OWN
from failstop.install.system import System
from failstop.install.tree import Entry, Environment

UNIT = "[Service]\nExecStart=/opt/failstop/bin/failstop run\n[Install]\nWantedBy=multi-user.target some.device\n"
TEMPLATE = "[Service]\nExecStart=/opt/failstop/bin/failstop run --name %i\n[Install]\nWantedBy=multi-user.target\n"
PASSWD = "root:x:0:0:root:/root:/bin/sh\nfailstop:x:990:990:the service:/var/lib/failstop:/usr/sbin/nologin\n"
GROUP = "root:x:0:\ndialout:x:20:failstop\nfailstop:x:990:\n"
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
    "failstop.sysusers": 'u failstop - "the service" /var/lib/failstop\nm failstop dialout\n',
    "failstop.udev": "# udev\n",
    "failstop.catalog": CATALOG,
    "failstop.toml": EXAMPLE,
    "failstop.1": MANUAL,
    **SHELLS,
    **{extra.source: "# an extra\n" for extra in EXTRAS},
}
INSTALLED = {
    "etc/failstop/failstop.toml",
    *(row.place.lstrip("/") for row in OWN),
    "opt/failstop/bin/failstop",
    "opt/failstop/install.json",
    "opt/failstop/lib/module.py",
}
"""Every file of an installation, but for links and what is compiled."""
LIVE = Request()


def environment(version: str = "1.0") -> Environment:
    """A small environment that differs by version."""
    return Environment(
        "/opt/failstop",
        "/usr/bin/python3",
        (
            Entry("bin/python3", "/usr/bin/python3"),
            Entry("bin/failstop", b"#!/bin/sh\n", executable=True),
            Entry("lib/module.py", f"VERSION = {version!r}\n".encode()),
        ),
    )


class PlayedSystem(System):
    """A directory as a system, which runs if it is live. Its programs are noted; one of them may fail, and the one that
    makes accounts makes them."""

    def __init__(self, root: Path, live: bool = True, failing: str = "", running: tuple[str, ...] = ()) -> None:
        super().__init__(str(root))
        self.live = live
        self.udev = live
        self.board = False
        self.ran: list[str] = []
        self._failing = failing
        self._running = running

    def active(self, patterns: Sequence[str]) -> tuple[str, ...]:
        """Those that were said to run."""
        return self._running

    def run(self, words: Sequence[str], accepted: Sequence[int] = (0,)) -> None:
        """Note it, or fail."""
        self.ran.append(" ".join(words))
        if self._failing and self._failing in self.ran[-1]:
            raise InstallError(f"{words[0]}: no")
        if words[0] == "systemd-sysusers":
            Path(self.at("/etc/passwd")).write_text(PASSWD)
            Path(self.at("/etc/group")).write_text(GROUP)

    def start(self, unit: str) -> None:
        """Note it, or fail."""
        self.run(("start", unit))


def bare(root: Path) -> Path:
    """Make a system of it that has nothing of failstop, and an administrator's own unit."""
    for folder in ("etc/systemd/system", "etc/udev/rules.d", "etc/sysusers.d", "opt", "usr/local/bin", "usr/local/lib"):
        (root / folder).mkdir(parents=True)
    (root / "etc/systemd/system/own.service").write_text("[Service]\n")
    (root / "etc/passwd").write_text("root:x:0:0:root:/root:/bin/sh\n")
    (root / "etc/group").write_text("root:x:0:\n")
    return root


def planned(system: System, request: Request = LIVE, texts: Mapping[str, str] = TEXTS, version: str = "1.0") -> Plan:
    """What installing would do there."""
    return plan.install(texts, request, environment(version), system)


def installed(root: Path, request: Request = LIVE, texts: Mapping[str, str] = TEXTS, version: str = "1.0") -> Plan:
    """Install into a directory; returns what was done."""
    system = PlayedSystem(root)
    made = planned(system, request, texts, version)
    assert Doer(system).do(made.steps) == []
    return made


def running(root: Path, *others: str) -> PlayedSystem:
    """The system there, with the service running."""
    return PlayedSystem(root, running=("failstop.service", *others))


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


def shown(plan: Plan) -> list[str]:
    """Its steps as people see them, without the remarks."""
    return [f"{step.verb} {step.subject}" for step in plan.steps if step.verb]
