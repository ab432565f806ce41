"""The arm64 guest as far as it goes without one: what is asked of it, and what is made of what it says."""

from __future__ import annotations

import subprocess
import sys
import tarfile
from pathlib import Path

import pytest

from tests.vm import arm64, image


def test_everything_that_is_asked_for_says_how_it_ended(tmp_path: Path) -> None:
    script = arm64.asked(["tests/shm"]).replace(f"python{image.PYTHON} -m failstop demo", "echo driven; false")
    script = script.replace(f"python{image.PYTHON} -m pytest", "echo tested;:")
    said = subprocess.run(["sh", "-c", script], capture_output=True, text=True, check=True).stdout.splitlines()
    assert [arm64.ENDED.fullmatch(line) is not None for line in said] == [False, True, False, True]
    assert said[1].startswith("ENDED tests/shm 0 ")
    assert said[3].startswith("ENDED demo 1 ")


def test_the_payload_is_this_checkout_and_the_script(tmp_path: Path) -> None:
    disk = tmp_path / "payload.img"
    arm64.payload(disk, "true\n")
    assert disk.stat().st_size == arm64.PAYLOAD_SIZE
    with tarfile.open(disk) as tar:
        names = tar.getnames()
    assert {"asked.sh", "pyproject.toml", "failstop/procs", "tests/conftest.py"} <= set(names)


def test_what_a_guest_prints_is_passed_on_until_it_has_ended() -> None:
    chatter = [sys.executable, "-c", "print('one'); print('two')"]
    assert list(arm64.lines(chatter)) == ["one", "two"]
    with pytest.raises(image.ImageError, match="has not ended within 0 s"):
        list(arm64.lines([sys.executable, "-c", "print('one', flush=True); input()"], 0.0))


def test_without_its_programs_it_names_the_packages(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    monkeypatch.setenv("PATH", str(tmp_path))
    assert arm64.main([]) == 2
    assert "apt-get install --no-install-recommends e2fsprogs kmod mmdebstrap qemu-system-arm util-linux" in (
        capsys.readouterr().err
    )
