"""Files that the page keeps: a revoked device stays so, on a full disk too, and the command says what is wrong."""

from __future__ import annotations

import contextlib
import errno
import fcntl
import json
import os
import subprocess
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

import pytest

from failstop.api.errors import FailstopError
from failstop.files import durable
from failstop.web import control
from failstop.web.devices import Device, Devices
from failstop.web.storage import DEVICES, Storage
from tests.web.parts import Web

PAIRING = '[web]\npairing = "on"\n'


def device(number: int) -> Device:
    return Device(str(number), f"phone {number}", f"{number:064}", 1.0)


@pytest.fixture
def kept(tmp_path: Path) -> Storage:
    """The folder of a page with three devices."""
    found = Storage(str(tmp_path))
    found.keep(Devices(tuple(device(number) for number in range(3))))
    return found


@pytest.fixture
def full(kept: Storage, monkeypatch: pytest.MonkeyPatch) -> None:
    """No new file finds room there."""

    def write_draft(draft: str, data: bytes) -> None:
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC), draft)

    monkeypatch.setattr(durable, "write_draft", write_draft)


@pytest.mark.usefixtures("full")
def test_fewer_devices_are_kept_on_a_full_disk(kept: Storage) -> None:
    for left in (2, 1, 0):
        kept.keep_fewer(Devices(tuple(device(number) for number in range(left))))
        assert kept.devices().all() == [device(number) for number in range(left)]


@pytest.mark.usefixtures("full")
def test_where_nothing_can_be_written_the_cause_is_told(kept: Storage) -> None:
    os.unlink(kept.path(DEVICES))
    with pytest.raises(FailstopError, match="No space left on device"):
        kept.keep_fewer(Devices())


@pytest.fixture
def tiny(tmp_path: Path) -> Iterator[Path]:
    """A disk of its own for what the page keeps."""
    place = tmp_path / "tiny"
    place.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=32k", "none", str(place)]
    if os.geteuid() or subprocess.run(mount, capture_output=True, check=False).returncode:
        pytest.skip("mounting is not allowed here")
    yield place
    subprocess.run(["umount", str(place)], check=True)


def fill(place: Path) -> None:
    """Write until nothing fits any more."""
    with (place / "fill").open("wb", buffering=0) as file, contextlib.suppress(OSError):
        while True:
            file.write(b"x" * 512)
    assert os.statvfs(place).f_bavail == 0


def test_a_revoked_device_stays_so_after_a_restart_with_a_full_disk(tmp_path: Path, tiny: Path) -> None:
    config = tmp_path / "web.toml"
    config.write_text(PAIRING)
    with Web("kept-nobody", "--config", str(config), state=str(tiny)) as web:
        headers = web.pair("Anna"), web.pair("Bert")
        identity = web.command("devices").stdout.split()[0]
        fill(tiny)
        said = web.command("revoke", identity)
        assert (said.returncode, said.stdout) == (0, "Anna can now only watch and stop the robot\n")
    with Web("kept-nobody", "--config", str(config), state=str(tiny)) as web:
        assert [web.post("/api/disable", headers=each)[0] for each in headers] == [401, 409]


def test_a_device_that_can_only_be_revoked_until_a_restart_is_told_so(tmp_path: Path) -> None:
    """The file is gone, and nothing new can be written: the command names that, and not a page that does not run."""
    config = tmp_path / "web.toml"
    config.write_text(PAIRING)
    folder = tmp_path / "state"
    with Web("kept-gone", "--config", str(config), state=str(folder)) as web:
        headers = web.pair("Anna")
        identity = web.command("devices").stdout.split()[0]
        (folder / DEVICES).unlink()
        (folder / DEVICES).mkdir()
        said = web.command("revoke", identity)
        assert said.returncode == 1
        assert "Anna is revoked, and back after a restart of the page: " in said.stderr
        assert "devices.json: Is a directory" in said.stderr
        assert web.post("/api/disable", headers=headers)[0] == 401, "at once all the same"


OPENSSL = """#!/bin/sh
while [ $# -gt 0 ]; do case $1 in -keyout | -out) echo draft > "$2" ;; esac; shift; done
echo it fails >&2
exit 1
"""
"""An openssl that fails at the end of its work."""
SLOW_S = 1.5
SLOW_DISK = f"""
import os, sys, time
from failstop.cli.main import main
sync = os.fsync
os.fsync = lambda fd: (time.sleep({SLOW_S}), sync(fd))
sys.exit(main(sys.argv[1:]))
"""
"""A program as on an SD card that other programs keep busy."""


def test_a_stop_does_not_wait_for_a_slow_disk(tmp_path: Path) -> None:
    """Whatever saves the devices: each is under way while the page answers."""
    config = tmp_path / "web.toml"
    config.write_text(PAIRING)
    with Web("kept-slow", "--config", str(config), state=str(tmp_path), program=("-c", SLOW_DISK)) as web:
        anna, bert = web.pair("Anna"), web.pair("Bert")
        listed = control.ask(web.name, web.environment, "GET", "/devices")["devices"]
        (identity,) = [each["id"] for each in listed if each["name"] == "Bert"]
        code = web.code()
        ways: list[Callable[[], object]] = [
            lambda: web.pair("Cleo", code),
            lambda: web.post("/api/forget", headers=anna),
            lambda: control.ask(web.name, web.environment, "POST", "/devices", {"id": identity}),
        ]
        with ThreadPoolExecutor() as others:
            for way in ways:
                saved = others.submit(way)
                time.sleep(SLOW_S / 4)
                since_s = time.monotonic()
                assert web.post("/api/stop")[0] == 503, "no service runs"
                assert time.monotonic() - since_s < SLOW_S / 2
                assert not saved.done()
                saved.result()
        assert [web.post("/api/disable", headers=each)[0] for each in (anna, bert)] == [401, 401]
        assert [row["name"] for row in json.loads((tmp_path / DEVICES).read_text())] == ["Cleo"]


def test_a_second_page_with_the_same_files_is_refused(tmp_path: Path) -> None:
    """It would have devices of its own: a device that was revoked at one page would be back with the other one."""
    config = tmp_path / "web.toml"
    config.write_text(PAIRING)
    folder = tmp_path / "state"
    with Web("kept-twice", "--config", str(config), state=str(folder)) as web:
        headers = web.pair("Anna")
        second = web.command("--port", "0", "--config", str(config))
        assert (second.returncode, second.stdout) == (1, "")
        said = " ".join(second.stderr.split())
        assert f"another page runs with the files in {folder}: end it, or give this one another XDG_STATE_HOME" in said
        identity = web.command("devices").stdout.split()[0]
        assert web.command("revoke", identity).returncode == 0
        assert web.post("/api/disable", headers=headers)[0] == 401
        web.process.kill()
        web.process.wait()
        with Web("kept-twice", "--config", str(config), state=str(folder)) as again:
            assert again.post("/api/disable", headers=headers)[0] == 401


def test_a_certificate_that_cannot_be_made_leaves_no_key(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Such as one for a name that openssl refuses, after it has made the key: the page is started again and again."""
    openssl = tmp_path / "bin" / "openssl"
    openssl.parent.mkdir()
    openssl.write_text(OPENSSL)
    openssl.chmod(0o755)
    monkeypatch.setenv("PATH", f"{openssl.parent}:{os.environ['PATH']}")
    place = tmp_path / "state"
    kept = Storage(str(place))
    with pytest.raises(FailstopError, match="openssl made no certificate: it fails"):
        kept.tls(["localhost"])
    kept.close()
    assert os.listdir(place) == []


def test_where_a_folder_cannot_be_locked_the_page_starts(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    def flock(_fd: int, _how: int) -> None:
        raise OSError(errno.ENOLCK, os.strerror(errno.ENOLCK))

    monkeypatch.setattr(fcntl, "flock", flock)
    Storage(str(tmp_path)).close()
