"""`failstop install`, `failstop uninstall` and the Debian package, on a real systemd with a simulated board."""

from __future__ import annotations

import contextlib
import os
import shutil
import subprocess
import sys
import tempfile
from collections.abc import Iterator
from pathlib import Path

import pytest

from bench.container import Bind, Container, ContainerMissing
from failstop.install import InstallError, tree
from failstop.install.rows import ROWS, UNITS
from failstop.lab.sim.client import SimBoard
from failstop.lab.trial import wait_for

ROOT = Path(__file__).resolve().parents[2]
UNIT = "failstop.service"
BOARD = "/board/port"
RUNNING = str(Path(sys.executable).parent / "failstop")
"""The command of the environment that the tests run in, which is there inside too."""
PLACES = (
    *("/opt", "/etc", "/var/lib/failstop", "/run/failstop", "/usr/lib/systemd"),
    *("/usr/local/bin", "/usr/local/lib", "/usr/local/share"),
    *("/usr/share/bash-completion", "/usr/share/zsh", "/usr/share/fish", "/usr/share/man/man1"),
)
INSTALLED = f"{tree.SITE}/failstop/version.py"

pytestmark = [pytest.mark.slow, pytest.mark.timeout(180)]


class Place:
    """A container with the checkout's command, an empty directory for packages, and a board."""

    def __init__(self, box: Container, board: SimBoard, packages: Path) -> None:
        self.box = box
        self.board = board
        self.packages = packages

    def failstop(self, *words: str, code: int = 0, command: str = RUNNING) -> str:
        """Run the command line inside, as root; returns all that it said. It must end with this code."""
        done = self.box.run(command, *words, check=False, timeout_s=90)
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
        found = self.box.show(UNIT, "ActiveState", "SubState")
        return found == {"ActiveState": "active", "SubState": "running"}


@pytest.fixture(scope="module")
def module_place() -> Iterator[Place]:
    try:
        tree.interpreter()
    except InstallError as reason:
        pytest.skip(str(reason))
    with tempfile.TemporaryDirectory(prefix="failstop-install-") as name:
        directory = Path(name)
        directory.chmod(0o755)
        for part in ("board", "packages"):
            (directory / part).mkdir()
        binds = [Bind(str(directory / "board"), "/board"), Bind(str(directory / "packages"), "/packages")]
        # The container has a /tmp of its own.
        mine = dict.fromkeys((str(ROOT), sys.prefix, sys.base_prefix))
        binds += [Bind(path, path) for path in mine if path.startswith("/tmp/")]
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
    left = module_place.files() ^ before, module_place.accounts(), module_place.box.pids(UNIT)
    # A test that failed does not spoil the next.
    module_place.box.run("dpkg", "-P", "failstop", check=False)
    module_place.box.run(RUNNING, "uninstall", "--yes", "--purge", check=False)
    assert left == (set(), [], [])


def stopped(board: SimBoard) -> bool:
    """The board's word: the last motor frame was a stop, and the wheels are still."""
    motor = [event for event in board.events() if event.is_motor]
    return bool(motor) and motor[-1].is_stop and not any(board.wheels())


def test_installed_ready_driven_and_taken_away(place: Place) -> None:
    before = place.files()
    place.failstop("install", "--dry-run", "--device", BOARD)
    assert place.files() == before
    said = place.failstop("install", "--yes", "--device", BOARD)
    assert "failstop.service runs. Next: failstop status" in said
    assert place.ready()
    assert place.box.show(UNIT, "UnitFileState", "User") == {"UnitFileState": "enabled", "User": "failstop"}
    assert "nothing to do" in place.failstop("install", "--yes")
    assert "nothing to do" in place.failstop("install", "--yes", command="/opt/failstop/bin/failstop")
    assert "failstop" in place.box.run("journalctl", "--list-catalog").stdout
    assert completes(place, "/usr/local/share/bash-completion/completions/failstop")
    assert {row.place for row in ROWS if not row.place.startswith(UNITS)} <= place.files() - before
    place.board.events()
    with place.driving():
        assert "THE WHEELS STOP" in place.failstop("uninstall", "--yes")
        assert stopped(place.board)
    left = place.files() - before
    assert {path for path in left if path.startswith("/etc")} == {"/etc/failstop", "/etc/failstop/failstop.toml"}
    assert not any(path.startswith(("/opt", "/usr")) for path in left)
    assert place.accounts()
    place.failstop("uninstall", "--yes", "--purge")


def test_a_new_version_waits_for_consent_while_the_service_runs(place: Place) -> None:
    place.failstop("install", "--yes", "--device", BOARD)
    pid = place.box.main_pid(UNIT)
    installed = place.box.path(f"/opt/failstop/{INSTALLED}")
    new = installed.read_text()
    installed.write_text('VERSION = "0.0.1"\n')
    said = place.failstop("install", "--yes", code=2)
    assert "refused: failstop.service runs and would be restarted, which stops the wheels: say --restart too" in said
    assert place.box.main_pid(UNIT) == pid
    assert installed.read_text() == 'VERSION = "0.0.1"\n'
    place.failstop("install", "--yes", "--restart")
    assert installed.read_text() == new
    assert place.ready()
    assert place.box.main_pid(UNIT) not in (0, pid)
    # The installed command takes itself away.
    place.failstop("uninstall", "--yes", "--purge", command="/usr/local/bin/failstop")


def test_a_service_that_does_not_become_ready_is_taken_back_whole(place: Place) -> None:
    # A device, and no board's; nobody waits for it to become one.
    place.box.path("/etc/failstop").mkdir()
    configuration = place.box.path("/etc/failstop/failstop.toml")
    configuration.write_text('[device]\npath = "/dev/null"\n[stop]\nwait_s = 0.0\n')
    before = place.files()
    said = place.failstop("install", "--yes", "--wait", "2", code=1)
    assert "failstop.toml is yours and stays as it is" in said
    assert "start failstop.service: failstop.service " in said
    assert said.rstrip().endswith("everything is as it was before")
    assert place.files() == before
    place.box.run("rm", "-r", "/etc/failstop")
    assert "no device /dev/nothing: plug the board in" in place.failstop("install", "--device", "/dev/nothing", code=1)


def test_with_the_environment_that_runs_and_a_second_robot(place: Place) -> None:
    environment = tree.running("/srv/failstop", tree.interpreter())
    environment.write(str(place.box.path("/srv/failstop")))
    command = "/srv/failstop/bin/failstop"
    assert "hidden from it" in place.failstop("install", "--use-running-venv", code=1) or not hidden(RUNNING)
    words = ("install", "--yes", "--use-running-venv", "--device", BOARD)
    place.failstop(*words, command=command)
    assert place.ready()
    assert sorted(os.listdir(place.box.path("/opt/failstop"))) == ["install.json"]
    assert command in place.box.run("cat", "/etc/systemd/system/failstop.service").stdout
    place.failstop("uninstall", "--yes", command=command)
    place.failstop(*words, "--name", "front", command=command)
    assert place.box.show("failstop@front.service", "ActiveState") == {"ActiveState": "active"}
    assert not place.ready()
    place.failstop("uninstall", "--yes", "--name", "front", "--purge", command=command)
    assert place.box.show("failstop@front.service", "ActiveState") == {"ActiveState": "inactive"}
    place.failstop("uninstall", "--yes", "--purge", command=command)
    place.box.run("rm", "-r", "/srv/failstop")


def completes(place: Place, script: str) -> bool:
    """Whether bash knows with this script what to type after `failstop est`."""
    words = f". {script}; COMP_WORDS=(failstop est); COMP_CWORD=1; $(complete -p failstop | grep -o '_[a-z]*')"
    done = place.box.run("bash", "-c", f'{words} failstop est failstop; echo "${{COMPREPLY[@]}}"', check=False)
    return "estop" in done.stdout.split()


def hidden(path: str) -> bool:
    return bool(tree.unreachable(path))


@pytest.fixture(scope="module")
def package(module_place: Place) -> str:
    """The package's path inside."""
    if absent := [tool for tool in ("dpkg", "dpkg-deb", "deb-systemd-helper") if not shutil.which(tool)]:
        pytest.skip(f"not installed: {', '.join(absent)}")
    build = [sys.executable, str(ROOT / "packaging/deb/build.py"), "--out", str(module_place.packages)]
    done = subprocess.run(build, capture_output=True, text=True, timeout=120, check=False)
    assert done.returncode == 0, done.stderr
    return f"/packages/{Path(done.stdout.splitlines()[0]).name}"


def test_the_package_as_a_machine_sees_it(place: Place, package: str) -> None:
    fields = place.box.run("dpkg-deb", "--field", package).stdout
    names = {line.split(":")[0] for line in fields.splitlines() if not line.startswith(" ")}
    assert names >= {"Package", "Version", "Architecture", "Maintainer", "Installed-Size", "Depends", "Description"}
    assert f"Depends: {tree.PYTHON}, libc6 (>= 2." in fields
    rows = [row.split(maxsplit=5) for row in place.box.run("dpkg-deb", "--contents", package).stdout.splitlines()]
    assert {row[1] for row in rows} == {"root/root"}
    assert {row[0] for row in rows} == {"drwxr-xr-x", "-rw-r--r--", "-rwxr-xr-x", "lrwxrwxrwx"}
    tops = {"/".join(row[5].split("/")[:3]) for row in rows}
    assert tops == {"./", "./etc/", "./etc/failstop", "./opt/", "./opt/failstop", "./usr/"} | {
        f"./usr/{part}" for part in ("bin", "lib", "share")
    }, "nothing below /lib, which is a link where /usr is merged"
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


def test_the_package_installed_upgraded_removed_and_purged(place: Place, package: str) -> None:
    before = place.files()
    place.box.path("/dev/ttyACM0").symlink_to(BOARD)
    place.box.run("dpkg", "-i", package)
    wait_for("the service to be ready", place.ready)
    assert place.box.show(UNIT, "UnitFileState", "User") == {"UnitFileState": "enabled", "User": "failstop"}
    assert place.box.run("dpkg", "--verify", "failstop").stdout == "", "every file has its checksum"
    assert completes(place, "/usr/share/bash-completion/completions/failstop")
    shells = {"/usr/share/zsh/vendor-completions/_failstop", "/usr/share/fish/vendor_completions.d/failstop.fish"}
    assert shells | {"/usr/share/man/man1/failstop.1.gz"} <= place.files()
    assert "Debian package of failstop is installed here" in place.failstop("install", "--yes", code=1)
    assert "apt remove failstop" in place.failstop("uninstall", "--yes", code=1)
    place.box.path("/etc/failstop/failstop.toml").write_text(f'[device]\npath = "{BOARD}"\n')
    pid = place.box.main_pid(UNIT)
    place.board.events()
    with place.driving():
        place.box.run("dpkg", "--force-confold", "-i", package)
        assert stopped(place.board), "an upgrade restarts it, with motion disabled"
    assert place.ready()
    assert place.box.main_pid(UNIT) not in (0, pid)
    place.box.ctl("disable", UNIT)
    script = ("/var/lib/dpkg/info/failstop.postinst", "configure", "0.0.1")
    place.box.run("env", "DPKG_MAINTSCRIPT_PACKAGE=failstop", *script)
    assert place.box.show(UNIT, "UnitFileState") == {"UnitFileState": "disabled"}, "an administrator's choice stays"
    assert BOARD in place.box.run("cat", "/etc/failstop/failstop.toml").stdout
    place.box.run("dpkg", "-r", "failstop")
    left = {path for path in place.files() - before if not path.startswith("/var/lib/failstop")}
    assert left == {"/etc/failstop", "/etc/failstop/failstop.toml"}
    place.box.run("dpkg", "-i", package)
    assert place.ready()
    place.box.run("dpkg", "-P", "failstop")
    place.box.path("/dev/ttyACM0").unlink()
    assert not place.box.path("/var/lib/dpkg/info/failstop.list").exists()


def test_the_package_does_not_go_over_an_installation(place: Place, package: str) -> None:
    place.failstop("install", "--yes", "--device", BOARD, "--no-start")
    done = place.box.run("dpkg", "-i", package, check=False)
    assert done.returncode
    assert "'failstop uninstall' first" in done.stderr
    place.failstop("uninstall", "--yes", "--purge")
