"""In the guest: commands all the while, whatever becomes of the service, and passes the guest's time on.

    python -m tests.vm.client

The time, CLOCK_MONOTONIC in ns as a line of text, goes out by a virtio port every 10 ms, so that the board outside,
whose clock is another and runs at another rate, can say when something came by the guest's.
"""

from __future__ import annotations

import os
import threading
import time

from failstop_lab.faults.driving import Driver
from failstop_lab.trial import TrialError

PORT = "/dev/virtio-ports/failstop.clock"
ENABLE = "/run/vm-enable"
"""When this is there, motion is enabled, and it is removed: to start the command for that takes the guest a second."""
COMMAND_EVERY_S = 0.05
EVERY_S = 0.01
PRIORITY = 50


def tell_time(path: str) -> None:
    """Write the time forever."""
    fd = os.open(path, os.O_RDWR)
    os.sched_setscheduler(0, os.SCHED_FIFO, os.sched_param(PRIORITY))
    while True:
        os.write(fd, b"%d\n" % time.monotonic_ns())
        time.sleep(EVERY_S)


def main() -> None:
    """Command until it is killed."""
    threading.Thread(target=tell_time, args=(PORT,), daemon=True).start()
    driver = Driver("failstop", client="vm", interlocks=())
    while True:
        if os.path.exists(ENABLE):
            try:
                driver.enable()
                os.unlink(ENABLE)
            except TrialError as error:
                print(error, flush=True)
        driver.step()
        time.sleep(COMMAND_EVERY_S)


if __name__ == "__main__":
    main()
