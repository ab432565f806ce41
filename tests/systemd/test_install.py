"""The Debian package on a real systemd with a simulated board: all that docs/install.md says of it."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
from collections.abc import Iterator

import pytest

from bench.guard_scene import Process
from bench.service_scene import READY
from failstop.board.rrc import codec
from failstop_lab.sim.client import SimBoard
from failstop_lab.trial import wait_for
from tests.support.c_client import Driver, driver, library
from tests.support.deb import tree
from tests.support.package_scene import BOARD, LINK, OPERATES, SETTINGS, UNIT, Place, stopped
from tests.support.pages import ROOT

pytestmark = [pytest.mark.slow, pytest.mark.timeout(180)]
BRIDGE = "failstop-ros2@daemon.service"
GUARD = "failstop-guard@daemon.service"
FRAME = codec.motor_speeds((-0.3, -0.3, 0.3, 0.3), 1.0).hex()
"""All wheels forward; on the left the motors are mounted the other way round."""
DRIVER = """
import os, sys, time, tty
while True:
    try:
        port = os.open("/run/failstop-guard/port", os.O_RDWR | os.O_NOCTTY)
        tty.setraw(port)
        os.set_blocking(port, False)
        print("open", flush=True)
        while True:
            os.write(port, bytes.fromhex(sys.argv[1]))
            time.sleep(0.02)
            try:
                os.read(port, 65536)
            except BlockingIOError:
                pass
    except OSError as error:
        print(error.strerror, flush=True)
        time.sleep(0.1)
"""
"""It knows nothing of failstop: it writes one speed again and again, and after an error it opens the port again."""
OK, NO_SERVICE = 0, -1
"""Of failstop.h."""
CONFIGURES = ("env", "DPKG_MAINTSCRIPT_PACKAGE=failstop", "/var/lib/dpkg/info/failstop.postinst", "configure")
"""The script that dpkg runs once the files are there."""


def completes(place: Place, script: str) -> bool:
    """True where bash knows with this script what to type after `failstop est`."""
    words = f". {script}; COMP_WORDS=(failstop est); COMP_CWORD=1; $(complete -p failstop | grep -o '_[a-z]*')"
    done = place.box.run("bash", "-c", f'{words} failstop est failstop; echo "${{COMPREPLY[@]}}"', check=False)
    return "estop" in done.stdout.split()


def said_of(package: str, what: str, *words: str) -> str:
    return subprocess.run(["dpkg-deb", what, package, *words], check=True, capture_output=True, text=True).stdout


def test_the_packages_as_a_machine_sees_them(built: list[str]) -> None:
    package, laboratory = built[:2]
    path = os.path.relpath(package)
    assert built[-1] == f"next: sudo apt install {path if path.startswith('..') else f'./{path}'}"
    fields = said_of(package, "--field")
    names = {line.split(":")[0] for line in fields.splitlines() if not line.startswith(" ")}
    assert names >= {"Package", "Version", "Architecture", "Maintainer", "Installed-Size", "Depends", "Description"}
    minor = sys.version_info[1]
    assert f"Depends: python3 (>= 3.{minor}), python3 (<< 3.{minor + 1}), libc6 (>= 2." in fields
    assert "Recommends: openssl" in fields, "HTTPS of the page needs it"
    listed = said_of(package, "--contents")
    rows = [row.split(maxsplit=5) for row in listed.splitlines()]
    assert {row[1] for row in rows} == {"root/root"}
    assert {row[0] for row in rows} == {"drwxr-xr-x", "-rw-r--r--", "-rwxr-xr-x", "lrwxrwxrwx"}
    tops = {"/".join(row[5].split("/")[:3]) for row in rows}
    usr = {f"./usr/{part}" for part in ("bin", "lib", "share")}
    own = {"./", "./opt/", "./opt/failstop", "./usr/"}
    assert tops == own | usr, "nothing below /lib, which is a link where /usr is merged"
    assert not any(row[5].endswith(".egg-link") or "__editable__" in row[5] for row in rows)
    inside = [f"./opt/failstop/{tree.SITE}/failstop_lab/", f"./opt/failstop/{tree.SITE}/failstop_lab/trial.py"]
    other = said_of(laboratory, "--contents")
    assert all(path in other for path in inside)
    assert not any(path in listed for path in inside)
    version = said_of(package, "--field", "Version").strip()
    assert f"failstop (= {version})" in said_of(laboratory, "--field", "Depends")


def test_installed_upgraded_removed_and_purged(place: Place, package: str, asking: str) -> None:
    """The life of a package: the wheels are stopped whenever the service goes, and the settings stay a person's."""
    before = place.files()
    place.plug()
    installed_at_first(place, place.dpkg("-i", package))
    mine = f'# mine\n[device]\npath = "{BOARD}"\n'
    place.box.path(SETTINGS).write_text(mine)
    place.unplug()
    a_way_back(place, asking)
    assert place.settings() == mine
    pid = place.pid(UNIT)
    place.board.events()
    with place.driving():
        place.dpkg("-i", package)
        assert stopped(place.board), "it is restarted, with motion disabled"
    assert place.ready()
    assert place.pid(UNIT) not in (0, pid)
    assert place.settings() == mine
    place.board.events()
    with place.driving():
        place.dpkg("-r", "failstop")
        assert stopped(place.board)
    assert not place.box.path("/run/failstop").exists()
    left = {path for path in place.files() - before if not path.startswith("/var/lib/failstop")}
    fleet = {"/etc/failstop/fleet", "/etc/failstop/fleet/fleet.toml"}
    assert left == {"/etc/failstop", SETTINGS, f"{SETTINGS}.dpkg-dist"} | fleet
    assert place.accounts()
    place.dpkg("-P", "failstop")
    assert not place.box.path("/var/lib/dpkg/info/failstop.list").exists()


def installed_at_first(place: Place, said: str) -> None:
    """Everything that an installation with a board brings, is there."""
    assert "Next: failstop status" in said
    assert "does not run yet" not in said
    place.box.wait(UNIT, 30.0, **READY)
    assert place.box.show(UNIT, "UnitFileState", "User") == {"UnitFileState": "enabled", "User": "failstop"}
    assert place.box.run("ls", "/etc/systemd/system/dev-failstop.device.wants").stdout == f"{UNIT}\n"
    assert place.box.show("failstop-sleep.service", "UnitFileState") == {"UnitFileState": "enabled"}
    assert place.box.run("dpkg", "--verify", "failstop").stdout == "", "every file has its checksum"
    assert completes(place, "/usr/share/bash-completion/completions/failstop")
    shells = {"/usr/share/zsh/vendor-completions/_failstop", "/usr/share/fish/vendor_completions.d/failstop.fish"}
    assert shells | {"/usr/share/man/man1/failstop.1.gz", "/usr/bin/failstop"} <= place.files()
    assert "failstop" in place.box.run("journalctl", "--list-catalog").stdout
    assert f'path = "{LINK}"\n' in place.settings()
    place.box.run("failstop", "config", "--check", SETTINGS)
    place.box.run("failstop", "fleet", "--config", "/etc/failstop/fleet/fleet.toml", "config")


def a_way_back(place: Place, asking: str) -> None:
    """A package of before asks about the settings: it says the answer, and an option answers."""
    place.board.events()
    with place.driving():
        said = place.dpkg("-i", asking, code=1)  # nobody is there to answer
        assert stopped(place.board)
    assert "*** failstop.toml" in said
    assert "the service is down until this ends; if dpkg asks about failstop.toml, N keeps your settings" in said
    assert not place.ready()
    assert "force-confold" in (ROOT / "docs/install.md").read_text()
    place.dpkg("--force-confold", "--configure", "failstop")
    assert place.ready()


def test_without_a_board_with_wrong_settings_and_without_systemd_it_says_so(place: Place, package: str) -> None:
    said = place.dpkg("-i", package)
    assert "failstop does not run yet: is the board plugged in" in said
    assert 'path = "/dev/ttyACM0"\n' in place.settings()
    place.box.path("/dev/ttyACM0").symlink_to(BOARD)
    place.box.wait(UNIT, 30.0, **READY)
    place.box.ctl("stop", UNIT)
    refused = "[gate]\nperiod = 1\n"
    place.box.path(SETTINGS).write_text(refused)
    said = place.box.run(*CONFIGURES, timeout_s=90).stderr
    assert "gate.period" in said
    assert f"failstop does not run yet, because of {SETTINGS}" in said
    assert place.settings() == refused
    hidden = f"mount -t tmpfs tmpfs /run/systemd && {' '.join(CONFIGURES)}"
    said = place.box.run("unshare", "--mount", "sh", "-c", hidden, timeout_s=90).stderr
    assert "systemd does not run here, so nothing was started: NOTHING STOPS THE WHEELS" in said
    assert "failstop run --config /etc/failstop/failstop.toml" in said
    assert not place.ready()
    place.dpkg("-P", "failstop")
    place.box.path("/dev/ttyACM0").unlink()


def test_a_second_robot_page_fleet_and_bridge_live_and_go_with_the_package(place: Place, package: str) -> None:
    """A service that was started by hand outlives it: its pipe stays where its clients look for it."""
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
    assert place.box.show(UNIT, "UnitFileState") == {"UnitFileState": "disabled"}, "an administrator's choice stays"
    assert not place.ready()
    pipe = place.box.path("/run/failstop/byhand/stop")
    with by_hand(place, "byhand"):
        wait_for("the pipe of the other service", pipe.exists)
        said = place.dpkg("-r", "failstop")
        assert "'byhand' was not started by a unit of the package, and goes on" in said
        assert pipe.exists()
        assert not place.box.path("/run/failstop/front").exists()
    assert not any(place.active(unit) for unit in (front, *more))
    assert not [path for path in place.files() if path.endswith((front, *more))]
    assert all(place.box.path(path).is_dir() for path in kept), "a removal keeps what they remember"
    place.dpkg("-P", "failstop")
    links = [path.replace("private/", "") for path in kept]
    assert not [path for path in (*kept, *links) if os.path.lexists(place.box.path(path))]
    place.box.run("rm", "-r", "/opt/ros", OPERATES, "/run/failstop")


def test_a_service_that_runs_and_is_not_enabled_runs_again_after_an_upgrade(place: Place, package: str) -> None:
    place.plug()
    place.dpkg("-i", package)
    place.box.ctl("disable", UNIT)
    pid = place.pid(UNIT)
    place.board.events()
    with place.driving():
        place.dpkg("-i", package)
        assert stopped(place.board)
    assert place.ready()
    assert place.pid(UNIT) not in (0, pid)
    assert place.box.show(UNIT, "UnitFileState") == {"UnitFileState": "disabled"}, "an administrator's choice stays"
    place.box.ctl("stop", UNIT)
    place.dpkg("-i", package)
    assert not place.active(UNIT), "neither enabled nor running: an upgrade starts nothing"
    place.dpkg("-P", "failstop")


def test_a_driver_at_the_guard_port_is_stopped_by_an_upgrade_and_opens_the_port_again(
    place: Place, package: str
) -> None:
    place.plug()
    place.box.write(SETTINGS, f'[device]\npath = "{LINK}"\n[scan]\ngate = "off"\n')
    place.box.write("/run/driver.py", DRIVER)
    place.dpkg("-i", package)
    place.box.ctl("enable", "--now", GUARD)
    wait_for("the guard port", place.box.path("/run/failstop-guard/port").is_symlink)
    place.box.run("failstop", "enable")
    guard = place.pid(GUARD)
    as_user = ("setpriv", "--reuid=daemon", "--regid=daemon", "--init-groups", "--")
    driver = Process(*place.box.entering(*as_user, "/usr/bin/python3", "/run/driver.py", FRAME))
    try:
        driver.until("open")
        place.board.wait_wheels(True, 10.0)
        place.board.events()
        place.dpkg("-i", package)
        assert driver.line() == "Input/output error", "the guard's port goes with its old version"
        driver.until("open", 20.0)
        assert place.pid(GUARD) not in (0, guard)
        wait_for("the service to know it", lambda: "driver.py" in place.box.run("failstop", "status").stdout)
        motor = [event for event in place.board.events() if event.is_motor]
        first = next(at for at, event in enumerate(motor) if event.is_stop)
        assert not [event for event in motor[first:] if any(event.speeds)], "nobody has enabled motion since"
        assert not any(place.board.wheels())
    finally:
        driver.close()
    place.dpkg("-P", "failstop")


def why(place: Place) -> str:
    """Its lines break at other words with a pid of more digits."""
    return " ".join(place.box.run("failstop", "why").stdout.split())


def test_a_c_program_is_stopped_by_an_upgrade_and_can_still_stop(place: Place, package: str) -> None:
    """It is told that its service has gone. Its stop is heard by the new one, with and without a new connection."""
    place.plug()
    place.box.write(SETTINGS, f'[device]\npath = "{LINK}"\n[scan]\ngate = "off"\n')
    place.dpkg("-i", package)
    for path in (driver(), library() / "libfailstop.so.0"):
        shutil.copy(path, place.box.path("/run"))
    words = place.box.entering("env", "LD_LIBRARY_PATH=/run", f"/run/{driver().name}")
    with Driver(command=tuple(words)) as program:
        program.connect("failstop")
        assert program.do("enable 5") == OK
        program.tell("for 20 0.2")
        place.board.wait_wheels(True, 10.0)
        place.board.events()
        place.dpkg("-i", package)
        assert int(program.answer()) == NO_SERVICE
        motor = [event for event in place.board.events() if event.is_motor]
        first = next(at for at, event in enumerate(motor) if event.is_stop)
        assert not [event for event in motor[first:] if any(event.speeds)], "it went on commanding"
        assert program.text("error").startswith("the service has ended: start it, then call fs_connect()")
        assert place.ready()
        assert program.do("stop by a C program of before") == OK
        wait_for("the stop", lambda: "by a C program of before" in why(place))
        wait_for("the reset", lambda: not place.box.run("failstop", "reset", check=False).returncode)
        assert program.do("connect") == OK
        assert program.state()["enabled"] == 0
        assert program.do("stop by a C program, connected again") == OK
        wait_for("the stop", lambda: "connected again" in why(place))
    place.dpkg("-P", "failstop")


def python_package(place: Place) -> str:
    """The path inside of another package that brings /usr/bin/python3, as an upgrade of Debian's Python does."""
    folder = place.packages / "other"
    (folder / "DEBIAN").mkdir(parents=True)
    fields = {"Package": "other-python", "Version": "1", "Architecture": "all", "Maintainer": "a", "Description": "b"}
    (folder / "DEBIAN/control").write_text("".join(f"{name}: {text}\n" for name, text in fields.items()))
    (folder / "usr/bin").mkdir(parents=True)
    (folder / "usr/bin/python3").symlink_to(os.readlink(place.box.path("/usr/bin/python3")))
    out = folder.with_suffix(".deb")
    subprocess.run(["dpkg-deb", "--root-owner-group", "--build", folder, out], check=True, capture_output=True)
    return f"/packages/{out.name}"


def test_what_runs_restarts_once_the_system_has_another_python(place: Place, package: str) -> None:
    """`make package-test` upgrades Debian's Python. Here it is the same Python, and the modules are said to be for
    another one; root has run a command meanwhile, which compiled some modules for this one."""
    place.plug()
    place.dpkg("-i", package)
    other, pid = python_package(place), place.pid(UNIT)
    installs = ("--force-overwrite", "-i", other)
    assert "another Python" not in place.dpkg(*installs), "the modules are there for this one"
    assert place.pid(UNIT) == pid
    compiled = "/opt/failstop/site-packages/failstop/__pycache__"
    place.box.run("rm", "-r", compiled)
    place.box.write("/opt/failstop/compiled/python", "3.9\n")
    place.board.events()
    with place.driving():
        said = place.dpkg(*installs)
        assert stopped(place.board)
    assert "the system has another Python now, so what runs of failstop restarts, with motion disabled" in said
    modules = {path.stem for path in place.box.path("/opt/failstop/site-packages/failstop").glob("*.py")}
    assert {path.name.partition(".")[0] for path in place.box.path(compiled).glob("*.pyc")} == modules
    assert place.ready()
    assert place.pid(UNIT) not in (0, pid)
    place.dpkg("-P", "failstop")


@contextlib.contextmanager
def by_hand(place: Place, name: str) -> Iterator[None]:
    """A service that root has started from another environment, on a board of its own."""
    place.box.run("cp", "-r", "/opt/failstop", "/srv/failstop")
    with SimBoard(place.packages.parent / "board" / name, mode=0o666):
        place.box.write(f"/tmp/{name}.toml", f'[device]\npath = "/board/{name}"\n')
        words = ("-m", "failstop", "run", "--name", name, "--config", f"/tmp/{name}.toml")
        running = place.box.entering("/srv/failstop/bin/python3", *words)
        with subprocess.Popen(running, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as service:
            try:
                yield
            finally:
                # The signal is for the supervisor: nsenter does not pass it on.
                place.box.run("sh", "-c", f"kill $(cat /run/failstop/{name}/lock)")
                service.wait(20)
                place.box.run("rm", "-r", "/srv/failstop")


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
    place.box.wait(fleet, 20.0, StatusErrno="107")
    assert place.box.show(fleet, "StatusText")["StatusText"].startswith("obeys no fleet stop: no broker at 127.0.0.1")
    assert "obeys no fleet stop: no broker" in place.box.run("failstop", "doctor", "--quick", check=False).stdout


def test_the_package_does_not_go_over_an_older_installation(place: Place, package: str) -> None:
    place.box.write("/opt/failstop/install.json", "{}\n")
    said = place.dpkg("-i", package, code=1)
    assert "sudo /usr/local/bin/failstop uninstall" in said
    place.box.run("rm", "-r", "/opt/failstop")
