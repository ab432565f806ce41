"""`unshare --mount --pid ... python -m tests.used.machine BASE WORDS`: run a command on a machine that is made used.

Used means: an account, settings, units, a state directory with incidents, names that a dead run left in shared memory,
and a running service of the default name. What the command changed of all this is printed; then the exit code is 1.
The machine itself never sees any of it: BASE is an empty directory, on which everything lies, in the mount namespace.
"""

from __future__ import annotations

import os
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

from failstop.api.client import send_stop
from failstop.api.robot import Robot
from failstop.files.instance import DEFAULT_NAME
from failstop_lab.sim.client import SimBoard
from failstop_lab.trial import Service, wait_for

OVERLAID = ("/etc", "/var/lib")
EMPTIED = ("/run", "/dev/shm", "/var/tmp")
ACCOUNT = {
    "passwd": "failstop:x:979:979::/var/lib/failstop:/usr/sbin/nologin\n",
    "group": "failstop:x:979:\n",
    "shadow": "failstop:!:19000::::::\n",
    "gshadow": "failstop:!::\n",
}
SETTINGS = Path("/etc/failstop/failstop.toml")
STATE = Path("/var/lib/failstop/failstop")
"""Where systemd has the service of the default name keep its files."""
SAVED_S = 30.0
LEFT = ("failstop.left.gate", "failstop.left.supervisor")
WATCHED = ("/etc", "/run", "/dev/shm", "/var/lib/failstop", "/var/tmp")


def main(base: Path, words: list[str]) -> int:
    """The exit code of the command; 1 when it has left something behind."""
    _mount(base)
    for name, line in ACCOUNT.items():
        with open(f"/etc/{name}", "a", encoding="utf-8") as file:
            file.write(line)
    os.environ["HOME"] = str(base / "home")
    SETTINGS.parent.mkdir(exist_ok=True)
    SETTINGS.write_text(f'[device]\npath = "{base}/board"\n[limits]\n[restart]\n[battery]\nlog = "off"\n')
    for unit in ("failstop.service", "failstop@.service"):
        Path("/etc/systemd/system", unit).touch()
    Path("/run/systemd/system").mkdir(parents=True)
    for name in LEFT:
        Path("/dev/shm", name).touch()
    with SimBoard(base / "board") as board:
        service = Service(DEFAULT_NAME, board.link, str(STATE), ("--config", str(SETTINGS)))
        service.start()
        try:
            _live(service)
            watched = (*WATCHED, os.environ["HOME"])
            before = _listing(watched)
            code = subprocess.run(words, check=False).returncode
            changed = sorted(before ^ _listing(watched))
            with Robot() as robot:
                same = service.ready() and robot.state.estop == "stop request: used"
        finally:
            service.end()
    if changed or not same:
        print(f"left or gone: {changed}; the service of the default name is {'as it was' if same else 'ANOTHER'}")
        return 1
    return code


def _mount(base: Path) -> None:
    """Mount the files of outside, to be changed without a trace. Raises CalledProcessError."""
    run = ["mount", "-t", "tmpfs", "-o", "mode=755", "tmpfs"]
    subprocess.run(["mount", "--make-rprivate", "/"], check=True)
    subprocess.run([*run, str(base)], check=True)
    for place in OVERLAID:
        own = base / "overlay" / place.lstrip("/")
        options = f"lowerdir={place},upperdir={own}/files,workdir={own}/work"
        for part in ("files", "work"):
            (own / part).mkdir(parents=True)
        # A directory of the overlay has the mode of its upper layer.
        shutil.copystat(place, own / "files")
        subprocess.run(["mount", "-t", "overlay", "-o", options, "overlay", place], check=True)
    for place in EMPTIED:
        mode = oct(os.stat(place).st_mode & 0o7777)[2:]
        subprocess.run(["mount", "-t", "tmpfs", "-o", f"mode={mode}", "tmpfs", place], check=True)


def _live(service: Service) -> None:
    """Leave incidents: one of this run, and older and newer ones beside it."""
    send_stop(service.name, "used")
    folder = STATE / "incidents"
    wait_for("an incident", lambda: folder.is_dir() and any(folder.glob("*.incident")), SAVED_S)
    (one,) = folder.glob("*.incident")
    for day in ("20200101", "20990101"):
        shutil.copy(one, folder / f"{day}-000000-{DEFAULT_NAME}.incident")
    with Robot() as robot:
        assert robot.state.estop == "stop request: used"


def _listing(watched: tuple[str, ...]) -> set[str]:
    """Every path below these."""
    found: set[Any] = set()
    for top in watched:
        for folder, folders, names in os.walk(top):
            found.update(os.path.join(folder, name) for name in [*folders, *names])
    return found


if __name__ == "__main__":
    sys.exit(main(Path(sys.argv[1]), sys.argv[2:]))
