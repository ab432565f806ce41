"""Bad parents of `failstop run`: signals ignored or blocked, descriptors open or closed, soft limits too low."""

from __future__ import annotations

import os
import resource
import sys

import pytest

from failstop.procs.rights import DESCRIPTORS, STACK_BYTES
from failstop_lab.trial import Trial, wait_for
from tests.support.shared_trial import IMU_HZ

OPEN = 1100
OTHERS = 13
"""Descriptors that the supervisor has now and then (rights.DESCRIPTORS): 5 of a dead run's, 2 for each of 4 savers."""
STACK = 65536 if sys.version_info < (3, 14) else 102400
"""Bytes of stack with which Python itself still starts, and which are fewer than the service needs."""
LOW = f"""
import resource
for which, soft in ((resource.RLIMIT_STACK, {STACK}), (resource.RLIMIT_NOFILE, 24)):
    resource.setrlimit(which, (soft, resource.getrlimit(which)[1]))
"""
PARENTS = {
    "ignores SIGCHLD, and leaves descriptors open": f"""
import signal
signal.signal(signal.SIGCHLD, signal.SIG_IGN)
for _ in range({OPEN}):
    os.set_inheritable(os.open("/dev/null", 0), True)
""",
    "blocks signals, closes the standard descriptors, and has low soft limits": f"""
import signal
signal.pthread_sigmask(signal.SIG_BLOCK, range(1, 32))
[os.close(fd) for fd in range(3)]
{LOW}
""",
}


def open_in(pid: int) -> dict[int, str]:
    return {int(fd): os.readlink(f"/proc/{pid}/fd/{fd}") for fd in os.listdir(f"/proc/{pid}/fd")}


@pytest.mark.parametrize("parent", PARENTS)
def test_the_service_works_all_the_same(name: str, parent: str) -> None:
    if resource.getrlimit(resource.RLIMIT_NOFILE)[0] < OPEN + 100 and "open" in parent:
        pytest.skip("not so many descriptors here")
    trial = Trial(name, imu_hz=IMU_HZ)
    prelude = f"import os, sys\n{PARENTS[parent]}\nos.execv(sys.argv[1], sys.argv[1:])"
    trial.service.become(sys.executable, "-c", prelude)
    with trial:
        pids = trial.service.pids()
        for process, pid in pids.items():
            found = open_in(pid)
            assert max(found) < DESCRIPTORS - OTHERS, process
            assert "/dev/pts/" not in "".join(found.get(fd, "") for fd in range(3)), process
            assert set(range(3)) <= set(found), process
            if "low" in parent:
                assert resource.prlimit(pid, resource.RLIMIT_STACK)[0] == STACK_BYTES, process
        trial.enable()
        stopped = trial.kill("gate")
        assert stopped.was_turning
        assert stopped.stop_ns is not None
        trial.recover("gate", pids["gate"])
        assert trial.service.pids()["supervisor"] == pids["supervisor"]
        assert trial.service.end() == 0
        wait_for("every process to be gone", lambda: not any(os.path.exists(f"/proc/{pid}") for pid in pids.values()))
