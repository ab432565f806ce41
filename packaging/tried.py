"""`make tried ROWS="versions lerobot"`: try these, and keep what came of it for docs/reference/tried.md.

A run that fails is kept too, as a failure. Without ROWS it lists what there is, and which rows are out of date: since
their last run, the code that they try has changed.
"""

from __future__ import annotations

import os
import platform
import re
import subprocess
import sys
import time
from pathlib import Path
from typing import NamedTuple

from failstop.board.kinds import ALL_KINDS
from failstop_lab.faults.report import LAST, processor_ticks, stolen_share
from failstop_lab.pages import tried

ROOT = Path(__file__).resolve().parents[1]
PAGE = ROOT / "docs/reference/tried.md"
TOTALS = re.compile(r"^=*\s*((?:\d+ (?:failed|passed|skipped|error|errors|xfailed)(?:, )?)+)", re.MULTILINE)
"""pytest's last line: how many passed, failed and were skipped."""
FAILED = re.compile(r"^\d+ failed, ")
SECOND = re.compile(r"^Passed on the second try only.*\n((?:  \S.*\n)+)", re.MULTILINE)
"""The end of `make test`, with the names of the tests that it tried twice."""
BARS = re.compile(r"^    bar: .*  (met|MISSED)$", re.MULTILINE)
"""A line below each row of a bench's table that has a bar."""
EQUAL = re.compile(r"^built twice, (equal to the byte: \d+ files)$", re.MULTILINE)
"""The last line of `make reproduce`."""
SUMMARY = re.compile(
    r"^(?:"
    r"(\d+ faults in \d+ s: .* not as the table says)"  # failstop chaos
    r"|(\d+ runs at .*): (\d+ wrong), in .*"  # make faults
    r"|(\d+ seeds, .*): (\d+ wrong): .*"  # make seeds
    r"|(every verdict is the expected one|\d+ of \d+ verdicts are not the expected one)"  # make model
    r"|(.* none differs)"  # make feetech
    r"|(\d+ of \d+ controls found)"  # make controls
    r")",
    re.MULTILINE,
)
"""The last line of a campaign."""
FUZZED = re.compile(r"^\w+: (good|FAILED); .*$", re.MULTILINE)
"""A line of `make fuzz` for each parser."""
PASSED = {"good": "passed"}
VERSION = re.compile(r"^(python 3\.\d+|Debian \S+, .*install): (good|FAILED)", re.MULTILINE)
"""A line of `make versions` for each Python that it tried, and one of `make fresh` for each Debian."""


PRODUCT = ("failstop", "procs", "shm", "supervisor")
SIMULATED = ("lab/failstop_lab/machine", "lab/failstop_lab/sim", "lab/failstop_lab/simulate")
NOT_SIMULATED = ("cli", "doctor", "fleet", "ros2", "setup", "web")
"""Packages of failstop that the simulated machine doesn't run."""
ON_THE_MACHINE = (
    "failstop",
    *(f":(exclude)failstop/{name}" for name in NOT_SIMULATED),
    *PRODUCT[1:],
    *SIMULATED,
)


class Row(NamedTuple):
    """Something to try."""

    what: str
    command: tuple[str, ...]
    """Words for make."""
    probe: str
    """A shell command that prints the version of what it is tried with."""
    tries: tuple[str, ...] = PRODUCT
    """The paths of the code that it tries, as pathspecs of git."""


ASK = "import sys; print('Python', *sys.version.split()[:1])"
ASK_LEROBOT = "import lerobot, sys; print('LeRobot', lerobot.__version__, 'on Python', *sys.version.split()[:1])"
ASK_ROS = """
. "$ROS" && version=$(sed -nE 's:.*<version>(.+)</version>.*:\\1:p' "$AMENT_PREFIX_PATH/share/rclpy/package.xml")
case $ROS in /opt/ros/*) from= ;; *) from=", built from source" ;; esac
echo "ROS 2 $ROS_DISTRO, rclpy $version$from"
"""
"""For a ROS in one folder, as Debian's packages and `colcon build --merge-install` make it."""
ASK_ROS2_CONTROL = """
. "$ROS" && cd "$(ros2 pkg prefix controller_manager)/share/controller_manager"
case $ROS in /opt/ros/*) from= ;; *) from=", built from source" ;; esac
echo "ROS 2 $ROS_DISTRO, ros2_control $(grep -o "[0-9.]*</version>" package.xml | cut -d "<" -f 1)$from"
"""
ROWS = {
    "versions": Row("quick tests", ("versions", "ALL=yes"), ""),
    "test": Row("all tests", ("test",), f'"$BIN"/python -c "{ASK}"'),
    "lerobot": Row(
        "robot for LeRobot",
        ("lerobot",),
        f'"$LEROBOT" -c "{ASK_LEROBOT}"',
        ("integrations/lerobot", "failstop/api", "failstop/board/feetech", *PRODUCT[1:]),
    ),
    "ros2": Row("bridge to ROS 2", ("ros2",), ASK_ROS),
    "ros2-control": Row(
        "controller manager of ros2_control, killed and hung",
        ("ros2-control",),
        ASK_ROS2_CONTROL,
        ("integrations/ros2_control", "clients/c", *PRODUCT[1:]),
    ),
    "web": Row("operator's page, also under attack", ("web",), "chromium --version | head -n 1"),
    "fleet": Row("fleet", ("fleet",), "PATH=$PATH:/usr/sbin mosquitto -h | head -n 1"),
    "package-test": Row("life of the Debian packages", ("package-test",), "echo Debian 12 and 13"),
    "fresh": Row("installed, demo, own program, prove", ("fresh", "ON=12 13 testing"), ""),
    "folder": Row("installed, demo, own program, prove", ("fresh", "ON=12-folder 13-folder testing-folder"), ""),
    "c": Row("C program driving, killed", ("fresh", "ON=c"), ""),
    "arm64": Row("installed, own program", ("fresh", "ON=arm64 arm64-pip"), ""),
    "reproduce": Row("a release built twice", ("reproduce",), f'"$BIN"/python -c "{ASK}"', (*PRODUCT, "packaging")),
    "vm": Row("USB, boot and sleep of a stock Debian", ("vm",), "qemu-system-x86_64 --version | head -n 1"),
    "vm-arm64": Row("shared memory and a demo on ARM", ("vm-arm64",), "qemu-system-aarch64 --version | head -n 1"),
    "bench": Row("the bench", ("bench",), f'"$BIN"/python -c "{ASK}"'),
    "chaos": Row("campaign of random faults", ("chaos",), "echo rrc"),
    **{
        f"{kind}-{name}": Row(what, (*command, f"BOARD={kind}"), f"echo {kind}", ON_THE_MACHINE)
        for kind in ALL_KINDS
        for name, what, command in (
            ("faults", "single faults of a process at its own calls", ("faults",)),
            ("simulate", "every single fault at every call, and seeds", ("simulate", "SEEDS=600")),
            ("seeds", "random orders and faults", ("seeds", "SECONDS=600")),
        )
    },
    "controls": Row(
        "parts taken out, which a campaign must miss", ("controls",), f'"$BIN"/python -c "{ASK}"', ON_THE_MACHINE
    ),
    "model": Row("the stop protocol in a model checker", ("model",), "spin -V", ("model",)),
    "fuzz": Row("parsers, fuzzed", ("fuzz",), f'"$BIN"/python -c "{ASK}"'),
    "feetech": Row(
        "frames of two foreign hosts of Feetech servos",
        ("feetech",),
        f'"$BIN"/python -c "{ASK}"',
        ("failstop/board/feetech", "failstop/board/servos.py"),
    ),
}
"""For campaigns of a board, `with` is the board."""


def machine(release: Path = Path("/etc/os-release")) -> str:
    """This one, in words."""
    text = release.read_text() if release.exists() else ""
    named = re.search(r'^PRETTY_NAME="?([^"\n]*)', text, re.MULTILINE)
    return f"{named[1] if named else platform.system()}, {platform.machine()}"


def results(row: Row, output: str, code: int, version: str) -> dict[str, str]:
    """What came of a run, by what it was tried with."""
    if each := VERSION.findall(output):
        return {name.replace("python", "Python"): PASSED.get(verdict, verdict) for name, verdict in each}
    totals = [found.strip(" ,") for found in TOTALS.findall(output)] + EQUAL.findall(output)
    totals += [": ".join(filter(None, groups)) for groups in SUMMARY.findall(output)]
    if fuzzed := FUZZED.findall(output):
        totals.append(f"{fuzzed.count('good')} of {len(fuzzed)} parsers passed")
    if bars := BARS.findall(output):
        totals.append(f"{bars.count('met')} of {len(bars)} bars met")
    if code == 0 and (names := SECOND.findall(output)):
        totals = [FAILED.sub("", total) for total in totals]
        totals.append(f"{sum(each.count(chr(10)) for each in names)} of them on the second try")
    counted = "; ".join(totals) or ("passed" if code == 0 else "stopped early")
    return {version: counted if code == 0 else f"FAILED ({counted})"}


def conditions(begun: tuple[int, int], took_s: float) -> str:
    """What the machine was like during a run: its length, the load at its end, and the share of the processors' time
    that the host took away. `begun`: processor_ticks() at the start."""
    return f"{took_s:.0f} s, load {os.getloadavg()[0]:.1f}, steal {stolen_share(begun):.1%}"


def said(*words: str) -> str:
    """What a command prints, without the end of the line; empty where it can't run."""
    try:
        done = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=False)
    except OSError:
        return ""
    return done.stdout.strip() if done.returncode == 0 else ""


def tree() -> str:
    """The newest commit of this checkout that main has, with a + where a file differs from it: a branch's own commits
    get other names when it is rebased. The files that a row before this one has renewed don't count, because nothing
    is tried with them."""
    commit = said("git", "merge-base", "HEAD", "main") or said("git", "rev-parse", "HEAD")
    others = [f":(exclude){path.relative_to(ROOT)}" for path in (tried.FILE, PAGE, ROOT / LAST)]
    changed = said("git", "diff", "--name-only", commit, "--", ".", *others)
    return commit[:8] + ("+" if changed else "")


def since(name: str) -> str:
    """When a row was last tried, and how much of what it tries has changed since, in words."""
    found = [record for record in tried.records() if record["row"] == f"make tried ROWS={name}"]
    if not found:
        return "never tried"
    oldest = min(found, key=lambda record: record["day"])
    commit = oldest["commit"].rstrip("+")
    if not said("git", "cat-file", "-t", commit):
        return f"tried on {oldest['day']}; this checkout lacks its commit {commit}"
    changed = said("git", "diff", "--name-only", commit, "--", *ROWS[name].tries).splitlines()
    lately = f"out of date: {len(changed)} file{'s' * (len(changed) > 1)} changed" if changed else "nothing changed"
    failed = ", FAILED" if any("FAILED" in record["result"] for record in found) else ""
    return f"tried on {oldest['day']} at {commit}{failed}; since then {lately}"


def attempt(name: str) -> list[tried.Attempt]:
    """Try a row, showing what it prints; its records."""
    row = ROWS[name]
    print(f"== {name}: make {' '.join(row.command)}", flush=True)
    commit = tree()  # before it runs, because somebody may go on working meanwhile
    ticks, begun_s = processor_ticks(), time.monotonic()
    lines = []
    with subprocess.Popen(
        ("make", *row.command), cwd=ROOT, stdout=subprocess.PIPE, stderr=subprocess.STDOUT, text=True
    ) as run:
        assert run.stdout
        for line in run.stdout:
            sys.stdout.write(line)
            lines.append(line)
    under = conditions(ticks, time.monotonic() - begun_s)
    version = said("sh", "-c", row.probe) if row.probe else ""
    day = time.strftime("%Y-%m-%d", time.gmtime())
    again = f"make tried ROWS={name}"
    return [
        dict(zip(tried.IN_A_RECORD, (row.what, one, machine(), result, under, day, commit, again), strict=True))
        for one, result in results(row, "".join(lines), run.returncode, version or "version not known").items()
    ]


def main(names: list[str]) -> int:
    """Try these rows and keep their records; exit code 1 where one failed."""
    if unknown := [name for name in names if name not in ROWS]:
        print(f"no row {unknown[0]!r}: there are {', '.join(ROWS)}", file=sys.stderr)
        return 2
    if not names:
        print("which rows?", *(f"  {name}: {row.what} ({since(name)})" for name, row in ROWS.items()), sep="\n")
        return 0
    failed = False
    for name in names:
        found = attempt(name)
        tried.kept(found)
        failed |= any("FAILED" in record["result"] for record in found)
    PAGE.write_text(tried.page(), "utf-8")
    return int(failed)


if __name__ == "__main__":
    sys.exit(main(sys.argv[1:]))
