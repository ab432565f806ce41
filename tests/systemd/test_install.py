"""The Debian package on a real systemd with a simulated board: all that docs/install.md says of it."""

from __future__ import annotations

import os

import pytest

from failstop.lab.trial import wait_for
from tests.support.deb import tree

from .installing import BOARD, LINK, OPERATES, SETTINGS, UNIT, Place, stopped

pytestmark = [pytest.mark.slow, pytest.mark.timeout(180)]
BRIDGE = "failstop-ros2@daemon.service"


def completes(place: Place, script: str) -> bool:
    """True where bash knows with this script what to type after `failstop est`."""
    words = f". {script}; COMP_WORDS=(failstop est); COMP_CWORD=1; $(complete -p failstop | grep -o '_[a-z]*')"
    done = place.box.run("bash", "-c", f'{words} failstop est failstop; echo "${{COMPREPLY[@]}}"', check=False)
    return "estop" in done.stdout.split()


def test_the_build_says_what_to_type_next(built: list[str]) -> None:
    path = os.path.relpath(built[0])
    assert built[-1] == f"next: sudo apt install {path if path.startswith('..') else f'./{path}'}"


def test_the_package_as_a_machine_sees_it(place: Place, package: str) -> None:
    fields = place.box.run("dpkg-deb", "--field", package).stdout
    names = {line.split(":")[0] for line in fields.splitlines() if not line.startswith(" ")}
    assert names >= {"Package", "Version", "Architecture", "Maintainer", "Installed-Size", "Depends", "Description"}
    assert f"Depends: {tree.PYTHON}, libc6 (>= 2." in fields
    assert "Recommends: openssl" in fields, "HTTPS of the page needs it"
    rows = [row.split(maxsplit=5) for row in place.box.run("dpkg-deb", "--contents", package).stdout.splitlines()]
    assert {row[1] for row in rows} == {"root/root"}
    assert {row[0] for row in rows} == {"drwxr-xr-x", "-rw-r--r--", "-rwxr-xr-x", "lrwxrwxrwx"}
    tops = {"/".join(row[5].split("/")[:3]) for row in rows}
    usr = {f"./usr/{part}" for part in ("bin", "lib", "share")}
    own = {"./", "./opt/", "./opt/failstop", "./usr/"}
    assert tops == own | usr, "nothing below /lib, which is a link where /usr is merged"
    assert not any(row[5].endswith(".egg-link") or "__editable__" in row[5] for row in rows)


def test_the_laboratory_is_a_package_of_its_own(place: Place, package: str) -> None:
    laboratory = next(module.name for module in place.packages.glob("failstop-lab_*_all.deb"))
    inside = [f"./opt/failstop/{tree.SITE}/failstop/lab/", f"./opt/failstop/{tree.SITE}/failstop/lab/trial.py"]
    rows = place.box.run("dpkg-deb", "--contents", f"/packages/{laboratory}").stdout
    robots = place.box.run("dpkg-deb", "--contents", package).stdout
    assert all(path in rows for path in inside)
    assert not any(path in robots for path in inside)
    version = place.box.run("dpkg-deb", "--field", package, "Version").stdout.strip()
    assert (
        f"failstop (= {version})" in place.box.run("dpkg-deb", "--field", f"/packages/{laboratory}", "Depends").stdout
    )


def test_installed_removed_and_purged(place: Place, package: str) -> None:
    before = place.files()
    place.plug()
    said = place.dpkg("-i", package)
    assert "Next: failstop status" in said
    assert "does not run yet" not in said
    wait_for("the service to be ready", place.ready)
    assert place.box.show(UNIT, "UnitFileState", "User") == {"UnitFileState": "enabled", "User": "failstop"}
    assert place.box.show("failstop-sleep.service", "UnitFileState") == {"UnitFileState": "enabled"}
    assert place.box.run("dpkg", "--verify", "failstop").stdout == "", "every file has its checksum"
    assert completes(place, "/usr/share/bash-completion/completions/failstop")
    shells = {"/usr/share/zsh/vendor-completions/_failstop", "/usr/share/fish/vendor_completions.d/failstop.fish"}
    assert shells | {"/usr/share/man/man1/failstop.1.gz", "/usr/bin/failstop"} <= place.files()
    assert "failstop" in place.box.run("journalctl", "--list-catalog").stdout
    assert f'path = "{LINK}"\n' in place.settings()
    place.box.run("failstop", "config", "--check", SETTINGS)
    place.box.run("failstop", "fleet", "--config", "/etc/failstop/fleet/fleet.toml", "config")
    place.board.events()
    with place.driving():
        place.dpkg("-r", "failstop")
        assert stopped(place.board)
    left = {path for path in place.files() - before if not path.startswith("/var/lib/failstop")}
    fleet = {"/etc/failstop/fleet", "/etc/failstop/fleet/fleet.toml"}
    assert left == {"/etc/failstop", SETTINGS} | fleet
    assert place.accounts()
    place.dpkg("-i", package)
    assert place.ready()
    place.dpkg("-P", "failstop")
    assert not place.box.path("/var/lib/dpkg/info/failstop.list").exists()


def test_an_upgrade_and_a_way_back_stop_the_wheels_and_keep_the_settings(
    place: Place, package: str, older: str
) -> None:
    place.plug()
    place.dpkg("-i", older)
    mine = f'# mine\n[device]\npath = "{BOARD}"\n'
    place.box.path(SETTINGS).write_text(mine)
    place.unplug()
    for next_one in (package, older):
        pid = place.pid(UNIT)
        place.board.events()
        with place.driving():
            place.dpkg("-i", next_one)
            assert stopped(place.board), "it is restarted, with motion disabled"
        assert place.ready()
        assert place.pid(UNIT) not in (0, pid)
        assert place.settings() == mine
    place.box.ctl("disable", "--now", UNIT)
    place.dpkg("-i", package)
    assert place.box.show(UNIT, "UnitFileState") == {"UnitFileState": "disabled"}, "an administrator's choice stays"
    assert not place.ready()


def test_without_a_board_it_waits_for_it(place: Place, package: str) -> None:
    said = place.dpkg("-i", package)
    assert "failstop does not run yet: is the board plugged in" in said
    assert 'path = "/dev/ttyACM0"\n' in place.settings()
    place.box.path("/dev/ttyACM0").symlink_to(BOARD)
    wait_for("the service to be ready", place.ready, 30.0)
    place.dpkg("-P", "failstop")
    place.box.path("/dev/ttyACM0").unlink()


def test_a_setting_that_the_new_version_refuses_is_named(place: Place, package: str) -> None:
    place.box.path("/etc/failstop").mkdir()
    place.box.path(SETTINGS).write_text("[gate]\nperiod = 1\n")
    said = place.dpkg("-i", package)
    assert "gate.period" in said
    assert "failstop does not run yet" in said
    assert place.settings() == "[gate]\nperiod = 1\n"


def test_a_second_robot_page_fleet_and_bridge_live_and_go_with_the_package(place: Place, package: str) -> None:
    place.plug()
    place.dpkg("-i", package)
    front, more = "failstop@front.service", ("failstop-web.service", "failstop-fleet.service", BRIDGE)
    start_a_second_robot(place, front)
    switch_on(place, more)
    kept = [f"/var/lib/private/{unit.removesuffix('.service')}" for unit in more[:2]]
    wait_for("their folders", lambda: all(place.box.path(path).is_dir() for path in kept))
    place.box.write(f"{kept[0]}/failstop/devices.json", "{}")
    pid = place.pid(front)
    place.dpkg("-i", package)
    assert place.active(front), "an upgrade starts it again"
    assert place.pid(front) not in (0, pid)
    place.dpkg("-r", "failstop")
    assert not any(place.active(unit) for unit in (front, *more))
    assert not [path for path in place.files() if path.endswith((front, *more))]
    assert all(place.box.path(path).is_dir() for path in kept), "a removal keeps what they remember"
    place.dpkg("-P", "failstop")
    links = [path.replace("private/", "") for path in kept]
    assert not [path for path in (*kept, *links) if os.path.lexists(place.box.path(path))]
    place.box.run("rm", "-r", "/opt/ros", OPERATES)


def start_a_second_robot(place: Place, unit: str) -> None:
    """On the only board there is: the first one is switched off."""
    place.box.ctl("disable", "--now", UNIT)
    place.box.path("/etc/failstop/front.toml").write_text(f'[device]\npath = "{LINK}"\n')
    place.box.ctl("enable", "--now", unit)
    assert place.active(unit)
    assert "front" in place.box.run("failstop", "status", "--name", "front").stdout


def switch_on(place: Place, units: tuple[str, ...]) -> None:
    """Page, fleet and bridge, which are off after an installation."""
    for unit in units:
        assert not place.active(unit)
    place.box.run("failstop", "fleet", "key")
    place.box.write(f"{OPERATES}/override.conf", "[Service]\nSupplementaryGroups=failstop\n")
    place.box.write("/opt/ros/humble/setup.sh", "sleep 1000\n")
    place.box.ctl("daemon-reload")
    place.box.ctl("enable", "--now", *units)
    group = place.box.run("getent", "group", "failstop").stdout.split(":")[2]
    for unit in units:
        assert place.active(unit)
        [groups] = [
            line.split()[1:]
            for line in place.box.run("cat", f"/proc/{place.pid(unit)}/status").stdout.splitlines()
            if line.startswith("Groups:")
        ]
        assert (group in groups) == (unit != "failstop-fleet.service"), f"{unit}: who may drive"
    assert place.box.show(BRIDGE, "User") == {"User": "daemon"}
    fleet = "failstop-fleet.service"
    wait_for("the publisher's word", lambda: place.box.show(fleet, "StatusErrno") == {"StatusErrno": "107"}, 20.0)
    assert place.box.show(fleet, "StatusText")["StatusText"].startswith("obeys no fleet stop: no broker at 127.0.0.1")
    assert "obeys no fleet stop: no broker" in place.box.run("failstop", "doctor", "--quick", check=False).stdout


def test_the_package_does_not_go_over_an_older_installation(place: Place, package: str) -> None:
    place.box.write("/opt/failstop/install.json", "{}\n")
    said = place.dpkg("-i", package, code=1)
    assert "sudo /usr/local/bin/failstop uninstall" in said
    place.box.run("rm", "-r", "/opt/failstop")
