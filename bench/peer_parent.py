"""A parent that starts a stop tool when its driver exits, as a launch file's exit handler does: asyncio's child
watcher, then a process of its own for the tool.

Says the driver's pid on its standard output. The tool's exit code says nothing here, because the drivers of other peers
may have the port open too; the board sees whether the stop came.
"""

from __future__ import annotations

import asyncio
import sys


async def main(link: str) -> None:
    """Run the driver; when it has exited, run `failstop stop`."""
    driver = await asyncio.create_subprocess_exec(sys.executable, "-m", "bench.peer_driver", link)
    print(driver.pid, flush=True)
    await driver.wait()
    stop = ("-m", "failstop", "stop", "--device", link)
    tool = await asyncio.create_subprocess_exec(sys.executable, *stop, stdout=asyncio.subprocess.DEVNULL)
    await tool.wait()


if __name__ == "__main__":
    asyncio.run(main(sys.argv[1]))
