"""A machine to install the Debian package on: a real systemd in a container, with a simulated board."""

from __future__ import annotations

import contextlib
import subprocess
import tempfile
from collections.abc import Iterator
from pathlib import Path

from bench.container import Bind, Container
from bench.service_scene import READY
from failstop_lab.sim.client import SimBoard

UNIT = "failstop.service"
BOARD = "/board/port"
LINK = "/dev/failstop"
"""Files that the udev rule would make: there is no udev inside, and the tests make them."""
SETTINGS = "/etc/failstop/failstop.toml"
OLDER = "0.0.9"
OPERATES = "/etc/systemd/system/failstop-web.service.d"
PLACES = (
    *("/opt/failstop", "/etc", "/var/lib/failstop", "/run/failstop", "/usr/lib/systemd", "/usr/lib/sysusers.d"),
    *("/usr/lib/udev/rules.d", "/usr/share/bash-completion", "/usr/share/zsh", "/usr/share/fish"),
    *("/usr/bin", "/usr/share/man/man1"),
)


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
        """The lines of the user and group files about failstop."""
        return self.box.run("grep", "-h", "failstop", "/etc/passwd", "/etc/group", check=False).stdout.splitlines()

    def plug(self) -> None:
        self.box.path(LINK).symlink_to(BOARD)

    def unplug(self) -> None:
        self.box.path(LINK).unlink(missing_ok=True)

    @contextlib.contextmanager
    def driving(self) -> Iterator[None]:
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
        return self.box.show(unit, *READY) == READY

    def pid(self, unit: str) -> int:
        """Inside; 0: none."""
        return int(self.box.show(unit, "MainPID")["MainPID"])

    def settings(self) -> str:
        return self.box.run("cat", SETTINGS).stdout


@contextlib.contextmanager
def machine(system: Path = Path("/")) -> Iterator[Place]:
    """One without failstop, whose packages lie in /packages. `system`: the folder of another system than this
    machine's. Raises ContainerMissing."""
    with contextlib.ExitStack() as stack:
        directory = Path(stack.enter_context(tempfile.TemporaryDirectory(prefix="failstop-install-")))
        directory.chmod(0o755)
        for part in ("board", "packages"):
            (directory / part).mkdir()
        binds = [Bind(str(directory / part), f"/{part}") for part in ("board", "packages")]
        board = stack.enter_context(SimBoard(directory / "board" / "port", mode=0o666))
        # Images for containers forbid the start of services by packages.
        box = stack.enter_context(Container({}, binds, "rm -f /usr/sbin/policy-rc.d", system))
        # No index of every manual page of the machine after each installation.
        box.path("/var/lib/man-db/auto-update").unlink(missing_ok=True)
        yield Place(box, board, directory / "packages")


def stopped(board: SimBoard) -> bool:
    """The board's word: the last motor frame was a stop, and the wheels are still."""
    motor = [event for event in board.events() if event.is_motor]
    return bool(motor) and motor[-1].is_stop and not any(board.wheels())
