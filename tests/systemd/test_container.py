"""The container itself: a real systemd, there and gone with everything in it."""

from __future__ import annotations

import os
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from bench import container
from bench.container import Bind, Container, ContainerMissing
from failstop_lab.trial import wait_for

SLEEP = "[Service]\nExecStart=/bin/sleep 1000\n"


@pytest.fixture(scope="module")
def box(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Container]:
    shared = tmp_path_factory.mktemp("shared")
    (shared / "file").write_text("from out here")
    binds = [Bind(str(shared), "/shared"), Bind(str(shared / "file"), "/etc/new/file", "rw")]
    units = {"sleep.service": SLEEP, "sleep.service.d/more.conf": "[Service]\nEnvironment=MORE=1\n"}
    try:
        made = Container(units, binds, setup="echo was here > /etc/setup")
    except ContainerMissing as reason:
        pytest.skip(str(reason))
    with made:
        yield made


@pytest.mark.skipif(os.geteuid() != 0, reason="takes an account away, which needs root")
def test_nothing_of_an_installation_on_the_machine_is_in_it(tmp_path: Path) -> None:
    """The container's root begins as the machine's own files: with an account, settings, incidents and a command,
    say."""
    accounts = {
        "passwd": "root:x:0:0:root:/root:/bin/sh\nfailstop:x:979:979::/var/lib/failstop:/bin/false\n",
        "group": "root:x:0:\nfailstop:x:979:\ndialout:x:20:failstop,anna\n",
    }
    files = [*container.INSTALLED, "/etc/passwd", "/etc/group", "/var/lib/other/one"]
    files = [f"{path}/failstop/one" if path == "/var/lib/failstop" else path for path in files]
    for path in (tmp_path / file[1:] for file in files):
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_text(accounts.get(path.name, ""))
    subprocess.run(["sh", "-euc", f"root=$0{container.ANEW}", str(tmp_path)], check=True)
    left = {str(path.relative_to(tmp_path)) for path in tmp_path.rglob("*") if path.is_file()}
    assert {path for path in left if not path.endswith(("-", ".lock"))} == {file[1:] for file in files[-3:]}
    assert "failstop" not in "".join((tmp_path / "etc" / name).read_text() for name in accounts)
    assert "anna" in (tmp_path / "etc/group").read_text()


def test_binds_and_setup_are_there_and_the_machine_sees_nothing(box: Container) -> None:
    assert box.run("cat", "/shared/file", "/etc/new/file", "/etc/setup").stdout == "from out here" * 2 + "was here\n"
    assert box.run("touch", "/shared/new", check=False).returncode, "it is read-only"
    box.run("touch", "/etc/new/file")
    box.run("touch", "/usr/written-inside")
    assert box.path("/usr/written-inside").exists()
    assert not any(os.path.exists(path) for path in ("/etc/new", "/etc/setup", "/usr/written-inside", "/shared/file"))


def test_it_ends_with_everything_in_it() -> None:
    try:
        with Container({"sleep.service": SLEEP}) as box:
            box.ctl("start", "sleep.service")
            pids = [box.pid, *box.pids("sleep.service")]
            group, base = box.group("sleep.service").parents[1], box.base
            assert len(pids) == 2
    except ContainerMissing as reason:
        pytest.skip(str(reason))
    assert not any(os.path.exists(f"/proc/{pid}") for pid in pids)
    assert not group.exists()
    assert not base.exists()


def test_it_ends_with_a_killed_owner(box: Container) -> None:
    program = (
        "import signal; from bench.container import Container as C; c = C(); print(c.pid, flush=True); signal.pause()"
    )
    with subprocess.Popen([sys.executable, "-c", program], stdout=subprocess.PIPE, text=True) as owner:
        assert owner.stdout is not None
        pid = int(owner.stdout.readline())
        owner.kill()
    wait_for("its systemd to end", lambda: not os.path.exists(f"/proc/{pid}"))
    groups = container.hierarchy().glob(f"failstop-{owner.pid}-*")
    # Another worker's container may take them away as well, at any time.
    left = [*groups, *Path(tempfile.gettempdir()).glob(f"{container.DIRECTORY}{owner.pid}-*")]
    with Container():
        pass
    assert not any(path.exists() for path in left)


def test_without_root_it_says_so() -> None:
    with pytest.raises(ContainerMissing, match="needs root"):
        container.check(1000)


def test_what_is_not_installed_is_named() -> None:
    with pytest.raises(ContainerMissing, match=r"not installed: /lib/systemd/no-systemd, no-enter$"):
        container.check(0, ("/lib/systemd/no-systemd", "sh", "no-enter"))


def test_a_boot_that_fails_says_why(box: Container) -> None:
    with pytest.raises(ContainerMissing, match=r"the container has ended: .*no such thing"):
        Container(setup="echo no such thing >&2; exit 1")
