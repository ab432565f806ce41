"""LeKiwi's nine servos on one simulated bus, and a policy of LeRobot's that drives by the plugin. With `--python` it
runs in an environment with the real LeRobot (`make lerobot` makes one), else with the tests' stand-in.

The simulated servos say when the wheels' goals are zero, when each joint stands, and whether it holds.
"""

from __future__ import annotations

import argparse
import contextlib
import itertools
import json
import os
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator, Sequence
from pathlib import Path

from bench import BenchError, report, stats
from bench.carriers import Carriers
from bench.report import progress
from bench.stats import Row
from failstop.api.errors import Refused
from failstop.messages.layout import PROCESS_NAMES
from failstop.setup.ending import interruptible
from failstop_lab.faults import arm, arm_table
from failstop_lab.faults.arm import ArmTrial, Rested
from failstop_lab.faults.arm_table import BESIDE_BY_NAME, BY_ITSELF_MS, GOAL_MS, ArmFault
from failstop_lab.faults.table import FAULT_BY_NAME
from failstop_lab.trial import Stopped, wait_for

ROOT = Path(__file__).resolve().parents[1]
PROGRAM = Path(__file__).with_name("kiwi_policy.py")
SETTINGS: dict[str, object] = {"scan.gate": "off"}
PERIOD_MS = 1000 / 30
JITTER_MS = 5.0
REPLY_MS = 1.5
"""A stop that falls into an answer is heard behind it: the longest one's time, and that of the stop's own bytes."""
PLUGIN = "lerobot"
"""The plugin's name among the clients."""


class KiwiTrial(ArmTrial):
    """The service, and a policy's program in the place of the client that moves wheels and arm. It streams on through
    stops and starts of the service."""

    def __init__(self, python: str, home: str) -> None:
        """`python`: of an environment with the real LeRobot; empty: the stand-in."""
        super().__init__("bench-kiwi", SETTINGS, kind="feetech")
        path = [ROOT, ROOT / "integrations/lerobot"] + ([] if python else [ROOT / "tests/integrations/lerobot/standin"])
        self._python = python or sys.executable
        self._environment = {
            **os.environ,
            "PYTHONPATH": os.pathsep.join(map(str, path)),
            "HF_LEROBOT_HOME": home,
            "HF_HUB_OFFLINE": "1",
        }
        self.whole_host = False
        """Its client is the shell with all that runs in it, and not the policy alone."""
        self._seconds = 0.5
        self._struck = False
        """Its client is what is struck."""

    def program(self, *words: str) -> subprocess.Popen[bytes]:
        """A policy's program, that streams, in a session of its own; of a whole host with another program beside it."""
        command = [self._python, str(PROGRAM), self.name]
        shell = ["/bin/sh", "-c", '"$1" "$2" "$3" nothing >/dev/null & exec "$@"', "host"] if self.whole_host else []
        process = subprocess.Popen(
            [*shell, *command, *words],
            env=self._environment,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
        assert process.stdout
        if process.stdout.readline() != b"streams\n":
            end(process)
            raise BenchError("the policy's program has ended: no LeRobot in that environment?")
        return process

    def read(self) -> None:
        """Have the arm read. A machine that is busy may be too late to hear its answers."""
        wait_for("the arm to be read", self._read)

    def _read(self) -> bool:
        with contextlib.suppress(Refused):
            self.robot.arm.read()
            return True
        return False

    def follow(self, seconds: float = 0.0) -> int:
        """Have the policy drive and move every joint; returns its pid, or that of its session, negative."""
        if self._follower is None:
            self.settle()
            self.read()
            self._follower = self.program("both")
        wait_for("the policy to be connected", self._connected)
        self.enable()
        self._follower.send_signal(signal.SIGUSR1)
        wait_for("the arm to move", lambda: self._turns("follow"))
        self.board.wait_wheels(turning=True, timeout_s=10.0)
        time.sleep(seconds or self._seconds)
        return -self._follower.pid if self.whole_host else self._follower.pid

    def _connected(self) -> bool:
        """The policy is there, and has had the arm read."""
        state = self.robot.state
        known = state.arm and all(joint.at_rad is not None for joint in state.arm.joints.values())
        return bool(known) and any(client.name == PLUGIN for client in state.clients)

    def stop_following(self) -> None:
        """End a policy that was struck; another streams on."""
        if self._follower and (self._struck or self._follower.poll() is not None):
            self.end_policy()

    def end_policy(self) -> None:
        """End it, and all in its group."""
        if self._follower:
            end(self._follower)
            self._follower = None

    def strike(self, fault: ArmFault, chance: random.Random) -> Rested:
        """One fault at a moment of chance."""
        self._struck = not fault.process
        self._seconds = chance.uniform(0.2, 0.5)
        return arm.strike(self, fault)

    def close(self) -> None:
        self.end_policy()
        super().close()


def end(program: subprocess.Popen[bytes]) -> None:
    """End all programs of a group."""
    os.killpg(program.pid, signal.SIGKILL)
    program.wait()
    assert program.stdout
    program.stdout.close()


def off(turns: list[list[int]]) -> list[int]:
    """How far from the period the turns began, ns."""
    begun = [turn[0] for turn in turns]
    return [abs(after - before - round(PERIOD_MS * 1e6)) for before, after in itertools.pairwise(begun)]


def streaming(trial: KiwiTrial, seconds: float) -> Iterator[Row]:
    """Thirty turns a second with everything read back, while wheels and arm move; beside it a loop that does
    nothing."""
    progress("streaming")
    trial.settle()
    trial.read()
    trial.enable()
    policy, idle = trial.program("both", str(seconds)), trial.program("nothing", str(seconds))
    assert policy.stdout
    assert idle.stdout
    turns, bare = json.loads(policy.stdout.readline()), json.loads(idle.stdout.readline())
    for process in (policy, idle):
        end(process)
    trial.settle()
    yield stats.timing(
        "30 Hz, nine servos read back: a turn's period off by", off(turns), p50_ms=None, p99_ms=JITTER_MS
    )
    yield stats.timing("of it a loop beside it that does nothing", off(bare), p50_ms=None, p99_ms=None)
    for name, index in (("get_observation()", 1), ("send_action()", 2)):
        yield stats.timing(f"{name} of nine numbers", [turn[index] for turn in turns], p50_ms=None, p99_ms=None)


def driving(trial: KiwiTrial, carriers: Carriers, count: int, chance: random.Random) -> Iterator[Row]:
    """Each of failstop's processes is killed while an ordinary client drives; the arm holds."""
    for process in PROCESS_NAMES:
        found: list[Stopped] = []
        for turn in range(count):
            progress(f"kills of the {process} while driving, {turn + 1} of {count}")
            trial.settle()
            trial.enable()
            pid = trial.service.pids()[process]
            carriers.first()
            found.append(trial.kill(process, chance.uniform(0.1, 0.2)))
            trial.recover(process, pid)
        times = [stopped.executed_ns for stopped in found if stopped.executed_ns is not None]
        yield wheels_row(f"kill {process} while driving", times, f"kill-{process}")
        missed = sum(stopped.stop_ns is None or stopped.motion_after > 0 for stopped in found)
        yield stats.count(f"stops missed, kills of the {process} while driving", missed, count)
        yield stats.count(f"kills that found the wheels at rest, of the {process}", idle(found), count)


def idle(found: Sequence[Stopped]) -> int:
    """Kills that say nothing."""
    return sum(not stopped.was_turning for stopped in found)


def wheels_row(measure: str, times_ns: list[int], row: str) -> Row:
    """To the wheels' goals, by the bar of a row of the fault table and one reply's time."""
    bar_ms = FAULT_BY_NAME[row].bar_ms
    assert bar_ms is not None
    return stats.timing(
        f"{measure} -> wheels' goals zero at the servos", times_ns, p50_ms=None, p99_ms=bar_ms + REPLY_MS
    )


def streamed(
    trial: KiwiTrial, carriers: Carriers, fault: ArmFault, who: str, row: str, count: int, chance: random.Random
) -> Iterator[Row]:
    """One fault, again and again, while the policy drives and moves the arm. `row`: of the wheels, in the fault
    table."""
    found: list[Rested] = []
    for turn in range(count):
        progress(f"{who}, {turn + 1} of {count}")
        carriers.first()
        found.append(trial.strike(fault, chance))
    trial.end_policy()
    wheels = [round(rested.wheels_ms * 1e6) for rested in found if rested.wheels_ms is not None]
    rests = [round(rested.rest_ms * 1e6) for rested in found if rested.rest_ms is not None]
    wrong = [rested.wrong for rested in found if rested.wrong]
    yield wheels_row(f"{who} while driving", wheels, row)
    stands_ms = BY_ITSELF_MS + (GOAL_MS if fault.what == arm_table.CLIENT_HANG else 0.0)
    yield stats.timing(f"{who} -> every joint stands", rests, p50_ms=None, p99_ms=stands_ms)
    missed = stats.count(f"stops missed, or an arm that does not hold: {who}", len(wrong), count)
    missed.result += f" {wrong}" if wrong else ""
    yield missed


@interruptible()
def main() -> int:
    """Measure; exit code 1 when a bar is missed."""
    parser = argparse.ArgumentParser(prog="python -m bench.kiwi", description=__doc__)
    parser.add_argument("--python", default="", help="of an environment with LeRobot (default: the stand-in)")
    parser.add_argument("--seconds", type=float, default=60.0, help="of streaming; 0: none (default: 60)")
    parser.add_argument("--kills", type=int, default=40, help="SIGKILLs of each kind (default: 40)")
    parser.add_argument("--hangs", type=int, default=8, help="SIGSTOPs of the policy (default: 8)")
    parser.add_argument("--only", default="", metavar="TEXT", help="faults alone that have this in their names")
    parser.add_argument("--seed", type=int, default=1, help="of the random moments")
    parser.add_argument("--out", default="bench/out/kiwi.json", help="where the JSON goes")
    arguments = parser.parse_args()
    begun_s, chance = time.monotonic(), random.Random(arguments.seed)
    kills, only = arguments.kills, arguments.only
    rows: list[Row] = []
    with Carriers() as carriers, tempfile.TemporaryDirectory() as home, KiwiTrial(arguments.python, home) as trial:
        rows += streaming(trial, arguments.seconds) if arguments.seconds else []
        rows += driving(trial, carriers, kills, chance) if kills and not only else []
        for who, fault, row, count, whole_host in (
            *(
                (f"SIGKILL of the {name} under the policy", f"arm-kill-{name}", f"kill-{name}", kills, False)
                for name in PROCESS_NAMES
            ),
            ("SIGKILL of the policy", "arm-client-killed", "client-killed", kills, False),
            ("SIGKILL of the policy and its host", "arm-client-killed", "client-killed", kills, True),
            ("SIGSTOP of the policy", "arm-client-hung", "client-hung", arguments.hangs, False),
        ):
            trial.whole_host = whole_host
            if count and only in who:
                rows += streamed(trial, carriers, BESIDE_BY_NAME[fault], who, row, count, chance)
        machine = {"pty carriers": carriers.priority, "LeRobot": arguments.python or "the stand-in"}
        machine["took_s"] = str(round(time.monotonic() - begun_s))
    return report.end(rows, arguments.out, machine)


if __name__ == "__main__":
    sys.exit(main())
