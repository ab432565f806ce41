"""What a new user does, in a fresh Debian 12, 13 and testing: `python -m tests.packaging.fresh` (`make fresh`).

The packages of a release are installed by apt, from files or from a signed folder on a server, or its wheels by pip.
Then the demo runs, a program of the user's own drives and is killed, and the stand test runs on the simulated board. A
C program is compiled on Debian 12, and the same file drives on Debian 13.

Debian 13 on arm64 is an emulated one: qemu-user runs its programs, and this machine's kernel serves them. There the
service starts, and a program of the user's own drives and is killed. The simulated board is outside of the emulation,
so it judges with the machine's own clock. Demo and stand test don't run there, because they fail a stop for its time.
"""

from __future__ import annotations

import argparse
import contextlib
import functools
import http.server
import os
import re
import shutil
import subprocess
import sys
import tempfile
import threading
import time
import zipfile
from collections.abc import Iterator, Sequence
from pathlib import Path
from typing import NamedTuple

from packaging.requirements import Requirement

from bench import BenchError
from failstop_lab.sim.client import Event, SimBoard
from failstop_lab.stopped import judge
from tests.packaging import debian
from tests.support.deb import apt

OWN = '''\
"""A program that drives a simulated board is killed while it drives, and the board says when the wheels stand."""

import signal
import subprocess
import sys
import time

from failstop import Robot
from failstop_lab.faults.table import DRIVER_HAS_DIED
from failstop_lab.sim.client import SimBoard

BOARD, LIMIT_S = sys.argv[1], float(sys.argv[2])
PROGRAM = sys.argv[3:]
DRIVE = """
import time
from failstop import Robot
with Robot() as robot:
    while True:
        robot.sensed()
        robot.drive(0.1, 0.0, 0.0)
        time.sleep(0.05)
"""

with SimBoard(BOARD) as board:
    service = subprocess.Popen(["failstop", "run", "--device", BOARD], stdout=subprocess.DEVNULL)
    try:
        until = time.monotonic() + LIMIT_S
        while subprocess.run(["failstop", "enable"], check=False).returncode:
            assert time.monotonic() < until, "motion can't be enabled"
            time.sleep(0.5)
        program = subprocess.Popen(PROGRAM or [sys.executable, "-c", DRIVE])
        board.wait_wheels(True, LIMIT_S)
        program.send_signal(signal.SIGKILL)
        start = time.monotonic()
        board.wait_wheels(False, LIMIT_S)
        print(f"own program: killed while it drove, the wheels stood after {(time.monotonic() - start) * 1e3:.0f} ms")
        until = time.monotonic() + LIMIT_S
        with Robot() as robot:
            while DRIVER_HAS_DIED not in " ".join(str(robot.why()).split()):
                assert time.monotonic() < until, robot.why()
                time.sleep(0.1)
    finally:
        service.send_signal(signal.SIGINT)
    assert service.wait(LIMIT_S) == 0, service.returncode
'''
EMULATED_OWN = '''\
"""A program that drives is killed while it drives. The board is outside of the emulation, and judges."""

import subprocess
import sys
import time

from failstop import FailstopError, Robot
from failstop_lab.faults.table import DRIVER_HAS_DIED

KIND, FOLDER, LIMIT_S = sys.argv[1], sys.argv[2], float(sys.argv[3])
SETTINGS = FOLDER + "/own.toml"
STRIKES = 6
DRIVE = """
import time
from failstop import FailstopError, Robot
with Robot(disable_on_exit=False) as robot:
    while True:
        try:
            if robot.state.cause:
                robot.reset()
            if not robot.state.enabled:
                robot.enable()
        except FailstopError as error:
            print(error, flush=True)
        robot.drive(0.1, 0.0, 0.0, manual=True)
        time.sleep(0.05)
"""


def reached(what, check, limit_s=LIMIT_S):
    until = time.monotonic() + limit_s
    while not (found := check()):
        assert service.poll() is None, f"the service ended with {service.returncode}"
        assert time.monotonic() < until, what
        time.sleep(0.3)
    return found


def ready():
    try:
        with Robot() as robot:
            return robot.wait_for("ready", LIMIT_S)
    except FailstopError:
        return False


def drives(robot):
    state = robot.state
    return state.moving and state.turning.does == "turning"


with open(SETTINGS, "w") as file:  # an emulated process is slow
    file.write(f'board.kind = "{KIND}"\\ngate.command_timeout_s = 2.0\\ngate.lease_s = 1.0\\n')
# At real-time priority the kernel would kill a process for its first turn, which is emulated and so takes too long.
run = ["setpriv", "--bounding-set=-sys_nice", "failstop", "run", "--config", SETTINGS]
service = subprocess.Popen([*run, "--device", FOLDER + "/board"])
reached("the service is not ready", ready)
print("the service is ready", flush=True)
for strike in range(STRIKES):
    program = subprocess.Popen([sys.executable, "-c", DRIVE])
    with Robot() as robot:
        reached(f"the wheels don't turn: {robot.why()}", lambda: drives(robot))
        with open(FOLDER + "/killed", "w") as file:
            file.write(str(time.monotonic_ns()))
        program.kill()
        program.wait()
        try:
            reached(robot.why(), lambda: DRIVER_HAS_DIED in " ".join(str(robot.why()).split()), 20.0)
            break
        except AssertionError as other:  # something else stopped the wheels first, as on a machine that is too busy
            print(f"again, because of {other}", flush=True)
else:
    sys.exit("something else stopped the wheels each time")
service.terminate()
assert service.wait(LIMIT_S) == 0, service.returncode
'''
EMULATED_USE = """
echo "step: own program"
timeout 600 $python /packages/own.py {kind} /packages 120
echo "step: the end"
"""
EMULATED_KIND = "hoverboard"
"""The board of an emulated system, at 115200 baud, because qemu-user 7.2 sets at most 460800."""
APT = """
apt-get update -qq
DEBIAN_FRONTEND=noninteractive apt-get install --yes -qq {debs} >/run/apt 2>&1 || {{ cat /run/apt; exit 1; }}
python=/opt/failstop/bin/python3
"""
PIP = """
python3 -m venv /srv/venv
/srv/venv/bin/pip install --quiet --no-index --find-links /packages/wheels 'failstop[lab]'
PATH=/srv/venv/bin:$PATH
python=/srv/venv/bin/python
"""
FOLDER = """
sudo() {{ "$@"; }}
echo 'APT::Get::Assume-Yes "true";' >/etc/apt/apt.conf.d/99yes
export DEBIAN_FRONTEND=noninteractive
{lines}
sudo apt install failstop-lab
python=/opt/failstop/bin/python3
"""
"""What a person types, who is root here."""
USE = """
echo "step: failstop demo"
failstop demo
echo "step: own program"
timeout {whole_s} $python /packages/own.py /run/board {limit_s}
echo "step: failstop prove --sim --quick"
failstop prove --sim --quick
echo "step: the end"
"""
COMPILE = """
apt-get update -qq
DEBIAN_FRONTEND=noninteractive apt-get install --yes -qq {debs} >/run/apt 2>&1 || {{ cat /run/apt; exit 1; }}
cd /packages
gcc -Wall -Werror -o patrol /usr/share/doc/libfailstop-dev/examples/patrol.c $(pkg-config --cflags --libs failstop)
sha256sum patrol
echo "step: the end"
"""
RUN = """
echo "step: a C program"
cd /packages
sha256sum patrol
timeout {whole_s} $python /packages/own.py /run/board {limit_s} ./patrol
echo "step: the end"
"""
COMPILERS = ("gcc", "libc6-dev", "pkg-config")
LAST = "step: the end"
TIMES = {"limit_s": 30, "whole_s": 120}
"""Each wait of the program has its own limit, which says what did not come; and the whole of it has one."""
TIMEOUT_S, EMULATED_S = 900.0, 3600.0
"""How long one may take; an emulated processor is twenty times slower."""


class Trial(NamedTuple):
    """A system to try."""

    suite: str
    how: str
    """apt, pip, or a signed apt folder."""
    architecture: str = ""
    """An emulated one, by Debian's word; empty: this machine's."""
    compiled: str = ""
    """The suite on which a C program is compiled that drives here, in place of the demo and the rest; empty: none."""

    def name(self) -> str:
        """As people name it."""
        suite = debian.SUITES[self.suite]
        machine = f"{self.architecture} (emulated), " if self.architecture else ""
        if self.compiled:
            there = debian.SUITES[self.compiled].number
            return f"Debian {suite.number}, {machine}C program compiled on Debian {there}, {self.how} install"
        return f"Debian {suite.number}, {machine}Python {suite.python}, {self.how} install"


SIGNED = "signed apt folder"
TRIALS = {
    "12": Trial("bookworm", "apt"),
    "13": Trial("trixie", "apt"),
    "testing": Trial("forky", "pip"),
    "12-folder": Trial("bookworm", SIGNED),
    "13-folder": Trial("trixie", SIGNED),
    "testing-folder": Trial("forky", SIGNED),
    "12-pip": Trial("bookworm", "pip"),
    "13-pip": Trial("trixie", "pip"),
    "c": Trial("trixie", "apt", compiled="bookworm"),
    "arm64": Trial("trixie", "apt", "arm64"),
    "arm64-pip": Trial("trixie", "pip", "arm64"),
}
USUAL = ("12", "13", "testing", "13-folder", "c")
KEY = "tester@example.org"


def main(words: Sequence[str] | None = None) -> int:
    """Try them and print a line for each; exit code 1 when one fails."""
    parser = argparse.ArgumentParser(description="What a new user does, in a fresh Debian.")
    parser.add_argument("release", type=Path, help="the folder of a release (make release)")
    parser.add_argument("names", nargs="*", help=f"which of {', '.join(TRIALS)} (default: {', '.join(USUAL)})")
    arguments = parser.parse_args(words)
    if unknown := [name for name in arguments.names if name not in TRIALS]:
        parser.error(f"there is no {unknown[0]}: {', '.join(TRIALS)}")
    failed = 0
    for name in arguments.names or USUAL:
        start_s = time.monotonic()
        try:
            wrong = tried(TRIALS[name], arguments.release)
        except BenchError as error:
            print(f"failstop: {error}", file=sys.stderr)
            return 1
        failed += bool(wrong)
        verdict = f"FAILED ({wrong})" if wrong else "good"
        print(f"{TRIALS[name].name()}: {verdict}, {time.monotonic() - start_s:.0f} s", flush=True)
    return int(failed > 0)


def tried(trial: Trial, release: Path) -> str:
    """The step that failed; empty: none did. What was printed goes on to the terminal. Raises BenchError."""
    with tempfile.TemporaryDirectory(prefix="failstop-fresh-") as name, contextlib.ExitStack() as stack:
        folder = Path(name)
        folder.chmod(0o755)
        (folder / "own.py").write_text(EMULATED_OWN if trial.architecture else OWN)
        machine = trial.architecture or debian_architecture()
        use, board = USE.format(**TIMES), None
        if trial.architecture:
            stack.enter_context(debian.emulated())
            board = stack.enter_context(SimBoard(folder / "board", board=EMULATED_KIND))
            use = EMULATED_USE.format(kind=EMULATED_KIND)
        include: tuple[str, ...] = ()
        if trial.compiled:
            debs = packages(release, machine, folder, "libfailstop*.deb")
            step = f"set -eu\necho 'step: compiling on {trial.compiled}'\n{COMPILE.format(debs=debs)}"
            done = debian.run(debian.unpacked(trial.compiled, COMPILERS), step, folder, TIMEOUT_S)
            print(done.stdout, flush=True)
            if wrong := failed_step(done):
                return wrong
            script = APT.format(debs=packages(release, machine, folder, "*.deb", without="libfailstop-dev"))
            use = RUN.format(**TIMES)
        elif trial.how == SIGNED:
            include, script = ("curl",), FOLDER.format(lines=stack.enter_context(hosted(release, folder)))
        elif trial.how == "apt":
            script = APT.format(debs=packages(release, machine, folder, "failstop*.deb"))
        else:
            wheelhouse(release, folder / "wheels", debian.SUITES[trial.suite].python, machine)
            include, script = ("python3-venv",), PIP
        system = debian.unpacked(trial.suite, include, trial.architecture)
        done = debian.run(
            system,
            f"set -eu\necho 'step: {trial.how} install'\n{script}{use}",
            folder,
            EMULATED_S if trial.architecture else TIMEOUT_S,
        )
        print(done.stdout, flush=True)
        wrong = failed_step(done)
        return wrong if wrong or board is None else unstopped(board.events(), int((folder / "killed").read_text()))


def unstopped(events: Sequence[Event], killed_ns: int) -> str:
    """What the board saw wrong of the death of the program that drove; empty: it stopped. Prints when."""
    before = [event for event in events if event.arrival_ns < killed_ns]
    found = judge(events, killed_ns, was_turning=bool(before) and any(before[-1].speeds))
    if not found.was_turning:
        return "the wheels were not turning"
    if found.still_ns is None or found.motion_after:
        return f"no stop, or motion after it: {found}"
    print(f"killed while it drove: the last wheel stood after {found.still_ns / 1e6:.0f} ms", flush=True)
    return ""


def failed_step(done: subprocess.CompletedProcess[str]) -> str:
    """The last step that began, where not all of them were done; else nothing."""
    if done.returncode == 0 and LAST in done.stdout:
        return ""
    steps = [line.removeprefix("step: ") for line in done.stdout.splitlines() if line.startswith("step: ")]
    return steps[-1]


class Silent(http.server.SimpleHTTPRequestHandler):
    """Serves files and prints nothing."""

    def log_message(self, format: str, *args: object) -> None:
        """Print nothing."""


@contextlib.contextmanager
def hosted(release: Path, folder: Path) -> Iterator[str]:
    """A server on this machine for the apt folder of a release, signed with a key of its own; yields the lines that add
    it to a system. Raises BenchError."""
    site = folder / "apt"
    with http.server.ThreadingHTTPServer(("127.0.0.1", 0), functools.partial(Silent, directory=str(site))) as server:
        lines = signed(release, folder, f"http://127.0.0.1:{server.server_port}", site)
        thread = threading.Thread(target=server.serve_forever)
        thread.start()
        try:
            yield lines
        finally:
            server.shutdown()
            thread.join()


def signed(release: Path, folder: Path, url: str, site: Path) -> str:
    """Make the apt folder of a release, with a key that is made for it; returns the lines that add it. Raises
    BenchError."""
    keys = folder / "keys"
    keys.mkdir(mode=0o700)
    had = os.environ.get("GNUPGHOME")
    os.environ["GNUPGHOME"] = str(keys)
    try:
        words = ("gpg", "--batch", "--quiet", "--passphrase", "", "--quick-generate-key", KEY, "ed25519")
        subprocess.run(words, check=True, capture_output=True)
        return apt.make(release, site, url, KEY)  # type: ignore[no-any-return]
    except (OSError, subprocess.CalledProcessError, apt.AptError) as error:
        raise BenchError(f"no signed apt folder can be made: {error}") from None
    finally:
        subprocess.run(["gpgconf", "--kill", "all"], check=False)
        if had is None:
            del os.environ["GNUPGHOME"]
        else:
            os.environ["GNUPGHOME"] = had


def packages(release: Path, machine: str, folder: Path, names: str, without: str = "nothing") -> str:
    """Copy the packages of these names that a machine can install; returns their paths inside. Raises BenchError."""
    found = [path for path in sorted(release.glob(names)) if path.stem.endswith((f"_{machine}", "_all"))]
    debs = [path for path in found if not path.name.startswith(without)]
    if not debs:
        raise BenchError(f"no package {names} for {machine} in {release}: make release VERSION=x builds them")
    for path in debs:
        shutil.copy(path, folder)
    return " ".join(f"/packages/{path.name}" for path in debs)


def wheelhouse(release: Path, out: Path, python: str, machine: str) -> None:
    """The wheels of a release, and the newest of all that they need. Raises BenchError."""
    out.mkdir()
    ours = sorted(release.glob("*.whl"))
    if not ours:
        raise BenchError(f"no wheel in {release}: make release VERSION=x builds them")
    arch = {"amd64": "x86_64", "arm64": "aarch64"}[machine]
    needed = {line for wheel in ours for line in requirements(wheel, python)}
    for wheel in ours:
        shutil.copy(wheel, out)
    platforms = [word for glibc in ("2_17", "2_28") for word in ("--platform", f"manylinux_{glibc}_{arch}")]
    words = (sys.executable, "-m", "pip", "download", "--quiet", "--no-deps", "--only-binary=:all:")
    done = subprocess.run(
        [
            *words,
            "--python-version",
            python,
            *platforms,
            "--platform",
            f"manylinux2014_{arch}",
            "--dest",
            str(out),
            *needed,
        ],
        capture_output=True,
        text=True,
        check=False,
    )
    if done.returncode:
        raise BenchError(f"pip can't fetch what the wheels need: {done.stderr[-2000:]}")


def requirements(wheel: Path, python: str) -> set[str]:
    """What a wheel of ours needs of others on a Python, without conditions: pip judges them by the Python that it runs
    on. None of these needs anything itself."""
    with zipfile.ZipFile(wheel) as packed:
        (about,) = (name for name in packed.namelist() if name.endswith(".dist-info/METADATA"))
        lines = re.findall(r"^Requires-Dist: (.+)$", packed.read(about).decode(), re.MULTILINE)
    where = {"python_version": python, "extra": ""}
    found = [one for one in map(Requirement, lines) if one.marker is None or one.marker.evaluate(where)]
    return {f"{one.name}{one.specifier}" for one in found if not one.name.startswith("failstop")}


def debian_architecture() -> str:
    """This machine's, by Debian's word."""
    words = ("dpkg", "--print-architecture")
    return subprocess.run(words, check=True, capture_output=True, text=True).stdout.strip()


if __name__ == "__main__":
    sys.exit(main())
