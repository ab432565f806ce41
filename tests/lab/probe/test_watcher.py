"""The watcher of a probe kills the processes that drive before it writes the stop."""

from __future__ import annotations

import subprocess
import sys

import pytest

TRIES = 3
# It has memory to give back, so its death takes the kernel a moment.
DRIVES = "import time; held = bytearray(100_000_000); print('drives', flush=True); time.sleep(600)"
WATCHES = """
import os, select, sys
from failstop_lab.probe.watcher import Watcher
driver = os.pidfd_open(int(sys.argv[1]))

def halt(wait_s):
    print("dead" if select.select([driver], [], [], 0.0)[0] else "ALIVE", flush=True)
    return True

Watcher(halt).run()
"""


@pytest.mark.starts
def test_nothing_that_drove_is_alive_when_the_stop_is_written() -> None:
    """A process that is killed in the middle of a write finishes that write. After a stop it would move the robot."""
    for _ in range(TRIES):
        with subprocess.Popen([sys.executable, "-c", DRIVES], stdout=subprocess.PIPE, text=True) as driver:
            assert driver.stdout
            driver.stdout.readline()
            orders = f"drive {driver.pid}\nstop\n"
            words = [sys.executable, "-c", WATCHES, str(driver.pid)]
            done = subprocess.run(words, input=orders, capture_output=True, text=True, timeout=60, check=False)
            driver.kill()
        assert done.stdout.split() == ["done", "dead", "done", "dead"], done.stderr
