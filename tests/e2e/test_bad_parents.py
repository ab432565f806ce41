"""Bad parents of `failstop run`: signals ignored or blocked, descriptors open or closed."""

from __future__ import annotations

import os
import resource
import sys

import pytest

from failstop.lab.trial import Trial, wait_for

MANY = 1100
PARENTS = {
    "ignores SIGCHLD": "import signal; signal.signal(signal.SIGCHLD, signal.SIG_IGN)",
    "blocks signals": "import signal; signal.pthread_sigmask(signal.SIG_BLOCK, range(1, 32))",
    "leaves descriptors open": f"[os.set_inheritable(os.open('/dev/null', 0), True) for _ in range({MANY})]",
    "closes the standard ones": "[os.close(fd) for fd in range(3)]",
}


def open_in(pid: int) -> dict[int, str]:
    return {int(fd): os.readlink(f"/proc/{pid}/fd/{fd}") for fd in os.listdir(f"/proc/{pid}/fd")}


@pytest.mark.parametrize("parent", PARENTS)
def test_the_service_works_all_the_same(name: str, parent: str) -> None:
    if resource.getrlimit(resource.RLIMIT_NOFILE)[0] < MANY + 100 and "open" in parent:
        pytest.skip("not so many descriptors here")
    trial = Trial(name)
    prelude = f"import os, sys; {PARENTS[parent]}; os.execv(sys.argv[1], sys.argv[1:])"
    trial.service.become(sys.executable, "-c", prelude)
    with trial:
        pids = trial.service.pids()
        for process, pid in pids.items():
            found = open_in(pid)
            assert max(found) < 200, process
            assert "/dev/pts/" not in "".join(found.get(fd, "") for fd in range(3)), process
            assert set(range(3)) <= set(found), process
        trial.enable()
        stopped = trial.kill("gate")
        assert stopped.was_moving
        assert stopped.stop_ns is not None
        trial.recover("gate", pids["gate"])
        assert trial.service.pids()["supervisor"] == pids["supervisor"]
        assert trial.service.end() == 0
        wait_for("every process to be gone", lambda: not any(os.path.exists(f"/proc/{pid}") for pid in pids.values()))
