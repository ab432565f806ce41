"""The Debian package on a real systemd with a simulated board: all that docs/install.md says of it."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path

import pytest

from bench.container import Bind, Container, ContainerMissing
from failstop.lab.sim.client import SimBoard
from failstop.lab.trial import wait_for
from tests.support.deb import tree
from tests.support.pages import ROOT

UNIT = "failstop.service"
BOARD = "/board/port"
LINK = "/dev/failstop"
"""There is no udev inside: what its rule would make is made by the tests."""
SETTINGS = "/etc/failstop/failstop.toml"
OLDER = "0.0.9"
ASKING = "0.0.8"
OPERATES = "/etc/systemd/system/failstop-web.service.d"
PLACES = (
    *(
        "/opt/failstop",
        "/etc",
        "/var/lib/failstop",
        "/run/failstop",
        "/usr/lib/systemd",
        "/usr/lib/sysusers.d",
        "/usr/bin",
    ),
    *("/usr/lib/udev/rules.d", "/usr/share/bash-completion", "/usr/share/zsh", "/usr/share/fish"),
    "/usr/share/man/man1",
)

pytestmark = [pytest.mark.slow, pytest.mark.timeout(180)]


class Place:
    """A container with an empty directory for packages, and a board."""

    def __init__(self, box: Container, board: SimBoard, packages: Path) -> None:
        self.box = box
        self.board = board
        self.packages = packages

    def dpkg(self, *words: str, code: int = 0) -> str:
        """Run dpkg inside; returns all that it and the package's scripts said. It must end with this code."""
        done = self.box.run("dpkg", *words, check=False, timeout_s=90)
        assert done.returncode == code, (done.stdout + done.stderr)[-3000:]
        return done.stdout + done.stderr

    def files(self) -> set[str]:
        """Every path where failstop could leave something; the container's own changes there are not counted."""
        found = self.box.run("find", *PLACES, check=False).stdout.splitlines()
        own = ("/etc/.pwd.lock", "/etc/passwd-", "/etc/group-", "/etc/shadow-", "/etc/gshadow-")
        return {path for path in found if path not in own and "__pycache__" not in path}

    def accounts(self) -> list[str]:
        """What the user and group files say of failstop."""
        return self.box.run("grep", "-h", "failstop", "/etc/passwd", "/etc/group", check=False).stdout.splitlines()

    def plug(self) -> None:
        """The board has the name that the udev rule gives it."""
        self.box.path(LINK).symlink_to(BOARD)

    def unplug(self) -> None:
        self.box.path(LINK).unlink(missing_ok=True)

    @contextlib.contextmanager
    def driving(self) -> Iterator[None]:
        """The wheels turn, and a client goes on commanding."""
        self.box.run("failstop", "enable")
        words = self.box.entering("failstop", "drive", "0.1", "0", "0", "--for", "60")
        with subprocess.Popen(words, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as client:
            self.board.wait_wheels(True, 5.0)
            try:
                yield
            finally:
                client.kill()

    def ready(self) -> bool:
        return self.active(UNIT)

    def active(self, unit: str) -> bool:
        found = self.box.show(unit, "ActiveState", "SubState")
        return found == {"ActiveState": "active", "SubState": "running"}

    def pid(self, unit: str) -> int:
        """Inside; 0: none."""
        return int(self.box.show(unit, "MainPID")["MainPID"])

    def settings(self) -> str:
        return self.box.run("cat", SETTINGS).stdout


@pytest.fixture(scope="module")
def module_place() -> Iterator[Place]:
    tools = ("dpkg", "dpkg-deb", "deb-systemd-helper", f"/usr/bin/{tree.PYTHON}")
    if absent := [tool for tool in tools if not shutil.which(tool)]:
        pytest.skip(f"not installed: {', '.join(absent)}")
    with tempfile.TemporaryDirectory(prefix="failstop-install-") as name:
        directory = Path(name)
        directory.chmod(0o755)
        for part in ("board", "packages"):
            (directory / part).mkdir()
        binds = [Bind(str(directory / "board"), "/board"), Bind(str(directory / "packages"), "/packages")]
        with SimBoard(directory / "board" / "port", mode=0o666) as board:
            try:
                # Images for containers forbid the start of services by packages.
                box = Container({}, binds, "rm -f /usr/sbin/policy-rc.d")
            except ContainerMissing as reason:
                pytest.skip(str(reason))
            with box:
                # No index of every manual page of the machine after each installation.
                box.path("/var/lib/man-db/auto-update").unlink(missing_ok=True)
                yield Place(box, board, directory / "packages")


@pytest.fixture
def place(module_place: Place) -> Iterator[Place]:
    """Without failstop, before and after."""
    before = module_place.files()
    assert module_place.accounts() == []
    yield module_place
    # A test that failed does not spoil the next.
    module_place.box.run("dpkg", "--purge", "failstop", check=False)
    module_place.unplug()
    left = module_place.files() ^ before, module_place.accounts(), module_place.box.pids(UNIT)
    assert left == (set(), [], [])


@pytest.fixture(scope="module")
def built(module_place: Place) -> list[str]:
    """What the build says."""
    build = [sys.executable, str(ROOT / "packaging/deb/build.py"), "--out", str(module_place.packages)]
    done = subprocess.run(build, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    return done.stdout.splitlines()


@pytest.fixture(scope="module")
def package(built: list[str]) -> str:
    """The package's path inside."""
    return f"/packages/{Path(built[0]).name}"


Rebuild = Callable[[str, Mapping[str, str]], str]


@pytest.fixture(scope="module")
def rebuild(built: list[str], module_place: Place, tmp_path_factory: pytest.TempPathFactory) -> Rebuild:
    """A function that builds the same package with another version and some files more; returns its path inside."""

    def build(version: str, more: Mapping[str, str]) -> str:
        place = tmp_path_factory.mktemp("older") / "package"
        subprocess.run(["dpkg-deb", "--raw-extract", built[0], str(place)], check=True)
        control = place / "DEBIAN/control"
        lines = control.read_text().splitlines(keepends=True)
        control.write_text("".join(f"Version: {version}\n" if line.startswith("Version:") else line for line in lines))
        for name, text in more.items():
            (place / name).parent.mkdir(parents=True, exist_ok=True)
            (place / name).write_text(text)
        out = module_place.packages / f"failstop_{version}.deb"
        subprocess.run(["dpkg-deb", "--root-owner-group", "-Zgzip", "-z1", "--build", str(place), str(out)], check=True)
        return f"/packages/{out.name}"

    return build


@pytest.fixture(scope="module")
def older(rebuild: Rebuild) -> str:
    """The path inside of the same package with another version."""
    return rebuild(OLDER, {})


@pytest.fixture(scope="module")
def asking(rebuild: Rebuild) -> str:
    """The path inside of an older package that dpkg asks about: the settings are among its files."""
    return rebuild(ASKING, {"DEBIAN/conffiles": f"{SETTINGS}\n", SETTINGS.lstrip("/"): "# the package's\n"})


def stopped(board: SimBoard) -> bool:
    """The board's word: the last motor frame was a stop, and the wheels are still."""
    motor = [event for event in board.events() if event.is_motor]
    return bool(motor) and motor[-1].is_stop and not any(board.wheels())


def completes(place: Place, script: str) -> bool:
    """Whether bash knows with this script what to type after `failstop est`."""
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


def test_a_way_back_to_a_package_that_asks_says_what_to_answer_and_asks_nothing_with_the_option(
    place: Place, package: str, asking: str
) -> None:
    place.plug()
    place.dpkg("-i", package)
    mine = f'# mine\n[device]\npath = "{LINK}"\n'
    place.box.path(SETTINGS).write_text(mine)
    said = place.dpkg("-i", asking, code=1)  # nobody is there to answer
    assert "*** failstop.toml" in said
    assert "the service is down until this ends; if dpkg asks about failstop.toml, N keeps your settings" in said
    assert not place.ready()
    assert "force-confold" in (ROOT / "docs/install.md").read_text()
    place.dpkg("-i", package)
    place.dpkg("--force-confold", "-i", asking)
    assert place.ready()
    assert place.settings() == mine
    place.box.run("dpkg", "--purge", "failstop")


@contextlib.contextmanager
def by_hand(place: Place, name: str) -> Iterator[None]:
    """A service that root has started from this checkout, on a board of its own."""
    with SimBoard(place.packages.parent / "board" / name, mode=0o666):
        place.box.write(f"/tmp/{name}.toml", f'[device]\npath = "/board/{name}"\n')
        words = ("-m", "failstop", "run", "--name", name, "--config", f"/tmp/{name}.toml")
        running = place.box.entering("env", f"PYTHONPATH={ROOT}", sys.executable, *words)
        with subprocess.Popen(running, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL) as service:
            try:
                yield
            finally:
                # The signal is for the supervisor: nsenter does not pass it on.
                place.box.run("sh", "-c", f"kill $(cat /run/failstop/{name}/lock)")
                service.wait(20)


def test_a_service_that_was_started_by_hand_outlives_a_removal(place: Place, package: str) -> None:
    """Its pipe stays where its clients look for it."""
    place.plug()
    place.dpkg("-i", package)
    wait_for("the service to be ready", place.ready)
    pipe = place.box.path("/run/failstop/byhand/stop")
    with by_hand(place, "byhand"):
        wait_for("the pipe of the other service", pipe.exists)
        said = place.dpkg("-r", "failstop")
        assert "'byhand' was not started by a unit of the package, and goes on" in said
        assert pipe.exists()
        assert not place.box.path("/run/failstop/failstop").exists()
    place.dpkg("-i", package)
    place.dpkg("-r", "failstop")
    assert not place.box.path("/run/failstop").exists()


def test_a_purge_takes_the_page_s_keys_and_devices_and_what_the_fleet_remembers(place: Place, package: str) -> None:
    place.plug()
    place.dpkg("-i", package)
    place.box.run("failstop", "fleet", "key")
    units = ("failstop-web.service", "failstop-fleet.service")
    place.box.ctl("enable", "--now", *units)
    kept = [f"/var/lib/private/{unit.removesuffix('.service')}" for unit in units]
    wait_for("their folders", lambda: all(place.box.path(path).is_dir() for path in kept))
    place.box.write(f"{kept[0]}/failstop/devices.json", "{}")
    place.dpkg("-r", "failstop")
    assert all(place.box.path(path).is_dir() for path in kept), "a removal keeps them"
    place.dpkg("-P", "failstop")
    links = [path.replace("private/", "") for path in kept]
    assert not [path for path in (*kept, *links) if os.path.lexists(place.box.path(path))]


def test_where_systemd_does_not_run_the_installation_says_that_nothing_stops_the_wheels(
    place: Place, package: str
) -> None:
    hidden = "mount -t tmpfs tmpfs /run/systemd && dpkg -i"
    said = place.box.run("unshare", "--mount", "sh", "-c", f"{hidden} {package}", timeout_s=90)
    assert "systemd does not run here, so nothing was started: NOTHING STOPS THE WHEELS" in said.stderr
    assert "failstop run --config /etc/failstop/failstop.toml" in said.stderr
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


def test_a_second_robot(place: Place, package: str) -> None:
    place.plug()
    place.dpkg("-i", package)
    place.box.ctl("disable", "--now", UNIT)
    place.box.path("/etc/failstop/front.toml").write_text(f'[device]\npath = "{LINK}"\n')
    place.box.ctl("enable", "--now", "failstop@front")
    assert place.active("failstop@front.service")
    assert "front" in place.box.run("failstop", "status", "--name", "front").stdout
    pid = place.pid("failstop@front.service")
    place.dpkg("-i", package)
    assert place.active("failstop@front.service"), "an upgrade starts it again"
    assert place.pid("failstop@front.service") not in (0, pid)
    place.dpkg("-r", "failstop")
    assert not place.active("failstop@front.service")
    assert not [path for path in place.files() if path.endswith("failstop@front.service")]


def test_page_fleet_and_bridge_are_switched_on_by_systemctl(place: Place, package: str) -> None:
    place.plug()
    place.dpkg("-i", package)
    more = ("failstop-web.service", "failstop-fleet.service", "failstop-ros2@daemon.service")
    for unit in more:
        assert not place.active(unit)
    place.box.run("failstop", "fleet", "key")
    place.box.write(f"{OPERATES}/override.conf", "[Service]\nSupplementaryGroups=failstop\n")
    place.box.write("/opt/ros/humble/setup.sh", "sleep 1000\n")
    place.box.ctl("daemon-reload")
    place.box.ctl("enable", "--now", *more)
    group = place.box.run("getent", "group", "failstop").stdout.split(":")[2]
    for unit in more:
        assert place.active(unit)
        [groups] = [
            line.split()[1:]
            for line in place.box.run("cat", f"/proc/{place.pid(unit)}/status").stdout.splitlines()
            if line.startswith("Groups:")
        ]
        assert (group in groups) == (unit != "failstop-fleet.service"), f"{unit}: who may drive"
    assert place.box.show(more[2], "User") == {"User": "daemon"}
    place.dpkg("-r", "failstop")
    assert not any(place.active(unit) for unit in more)
    assert not [path for path in place.files() if path.endswith(more)]
    place.box.run("rm", "-r", "/opt/ros", OPERATES)


def test_the_package_does_not_go_over_an_older_installation(place: Place, package: str) -> None:
    place.box.write("/opt/failstop/install.json", "{}\n")
    said = place.dpkg("-i", package, code=1)
    assert "sudo /usr/local/bin/failstop uninstall" in said
    place.box.run("rm", "-r", "/opt/failstop")
