"""The port: found by its plug, named so that a replug changes nothing, and what keeps a person from it."""

from __future__ import annotations

import os
from pathlib import Path

import pytest

from failstop.doctor.port import talkers
from failstop.doctor.system import System
from failstop.setup import ports
from failstop.setup.draft import Draft
from failstop.setup.talk import Left, Talk

LOGIN = "serial-getty@ttyAMA0.service"


def talk(place: Path, **given: str) -> Talk:
    return Talk(given, Draft("failstop", {"STATE_DIRECTORY": str(place)}), silent=True)


class Computer(System):
    """A machine of these files, on which these units run."""

    def __init__(self, root: Path, files: dict[str, str], units: tuple[str, ...] = ()) -> None:
        super().__init__(str(root))
        self._units = units
        for path, text in files.items():
            (root / path).parent.mkdir(parents=True, exist_ok=True)
            (root / path).write_text(text)

    def said(self, *words: str, timeout_s: float = 1.0) -> str | None:
        return "active" if words[-1] in self._units else None


def test_the_board_is_found_by_what_goes_and_comes(tmp_path: Path) -> None:
    looks = iter([{"/dev/ttyS0", "/dev/ttyUSB0"}, {"/dev/ttyS0"}, {"/dev/ttyS0"}, {"/dev/ttyS0", "/dev/ttyUSB1"}])
    assert ports.went(talk(tmp_path, unplugged="done", plugged="done"), lambda: next(looks)) == "/dev/ttyUSB1"
    with pytest.raises(Left, match="no port disappeared when the cable was pulled"):
        ports.went(talk(tmp_path, unplugged="done"), lambda: {"/dev/ttyS0"})


def test_an_unplug_in_vain_is_no_answer_and_the_question_comes_again(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    master, slave = os.openpty()
    path = os.ttyname(slave)
    draft = Draft("failstop", {"STATE_DIRECTORY": str(tmp_path)})
    kept, answers = [], iter(["unplug", "", "unplug", "", path])

    def typed(_prompt: str) -> str:
        kept.append(dict(Draft("failstop", {"STATE_DIRECTORY": str(tmp_path)}).answers))
        return next(answers)

    monkeypatch.setattr("failstop.setup.talk.read_line", typed)
    monkeypatch.setattr(ports, "nodes", lambda: {"/dev/ttyS0"})
    monkeypatch.setattr(ports.went, "__defaults__", (lambda: {"/dev/ttyS0"}, 0.0))
    assert ports.choose(Talk({}, draft, silent=False), Computer(tmp_path, {})) == path
    os.close(master)
    os.close(slave)
    assert capsys.readouterr().out.count("No port disappeared") == 2
    assert kept == [{}] * 5, "what is in vain is kept as no answer"
    assert draft.answers == {"port": path}


@pytest.mark.parametrize(
    ("others", "name"),
    [
        ([], "by-id/usb-board"),
        ([("1a86", "55d4", "B")], "by-id/usb-board"),
        ([("1a86", "55d4", "A")], "by-path/usb-0:1.0"),
        ([("1546", "01a8", "A")], "by-id/usb-board"),
    ],
)
def test_a_name_that_stays_and_is_no_other_device_s_is_preferred(
    tmp_path: Path, others: list[tuple[str, str, str]], name: str
) -> None:
    sysfs, node = tmp_path / "sys", tmp_path / "ttyACM0"
    node.symlink_to("/dev/null")  # which is a character device, whatever its number
    number = os.stat(node).st_rdev
    for index, (vendor, product, serial) in enumerate([("1a86", "55d4", "A"), *others]):
        place = sysfs / f"devices/1-{index}"
        (place / f"1-{index}:1.0").mkdir(parents=True)
        for key, value in (("idVendor", vendor), ("idProduct", product), ("serial", serial)):
            (place / key).write_text(f"{value}\n")
        links = [sysfs / f"class/tty/ttyACM{index}/device"]
        links += [] if index else [sysfs / f"dev/char/{os.major(number)}:{os.minor(number)}/device"]
        for link in links:
            link.parent.mkdir(parents=True)
            link.symlink_to(place / f"1-{index}:1.0")
    for link in (tmp_path / "by-id/usb-board", tmp_path / "by-path/usb-0:1.0"):
        link.parent.mkdir()
        link.symlink_to(node)
    assert ports.stable(str(node), str(tmp_path), str(sysfs)) == str(tmp_path / name)
    assert ports.stable(str(tmp_path / "gone"), str(tmp_path), str(sysfs)) == str(tmp_path / "gone")
    assert ports.stable("/dev/zero", str(tmp_path), str(sysfs)) == "/dev/zero"


@pytest.mark.parametrize(
    ("files", "units", "said"),
    [
        ({"proc/cmdline": "console=ttyAMA0,115200 root=/dev/sda"}, (), ["sudo raspi-config nonint do_serial_cons 1"]),
        ({"proc/cmdline": "console=tty1 root=/dev/sda"}, (), []),
        ({"proc/cmdline": "console=ttyAMA01"}, (), []),
        ({}, (LOGIN,), [f"sudo systemctl disable --now {LOGIN}"]),
        ({}, ("serial-getty@ttyS0.service",), []),
    ],
)
def test_what_else_talks_on_serial_pins_is_told(
    files: dict[str, str], units: tuple[str, ...], said: list[str], tmp_path: Path
) -> None:
    found = talkers(Computer(tmp_path, files, units), "/dev/ttyAMA0")
    assert [row.fix for row in found] == said


def test_serial_pins_that_are_off_are_told_on_a_raspberry_pi_alone(tmp_path: Path) -> None:
    model = {"proc/device-tree/model": "Raspberry Pi 5 Model B Rev 1.0\0"}
    [found] = ports.pins(Computer(tmp_path / "off", model))
    assert "do_serial_hw" in found.fix
    assert "restart" in found.advice
    assert not ports.pins(Computer(tmp_path / "on", {**model, "dev/serial0": ""}))
    assert not ports.pins(Computer(tmp_path / "pc", {}))


def test_a_command_that_helps_stays_on_its_line_and_advice_goes_with_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    fix = "sudo systemctl disable --now " + "long-" * 20
    talk(tmp_path).warn("A login waits.", "then log in again", fix)
    _, command, advice = capsys.readouterr().out.splitlines()
    assert command.strip() == f"-> {fix}"
    assert advice.strip() == "then log in again"
