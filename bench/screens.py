"""`python -m bench.screens`: takes the pictures of the terminal that README and docs/ show, of a service that runs, and
the card of a probe."""

from __future__ import annotations

import fcntl
import os
import pty
import shutil
import signal
import struct
import subprocess
import sys
import tempfile
import termios
from pathlib import Path

from rich.console import Console
from rich.terminal_theme import MONOKAI
from rich.text import Text

from failstop.api.snapshot import Stop
from failstop.messages import layout
from failstop.setup.ending import interruptible
from failstop_lab.sim.client import SimBoard
from failstop_lab.trial import Trial, wait_for

PICTURES = Path(__file__).parents[1] / "docs/pictures"
NAME = "failstop"
COLUMNS, ROWS = 80, 50
SPEED_MPS = 0.199
CARD_ROWS = "sigkill,sigstop,close,silence"
"""Everything but the plug, which a simulated board has not."""
FAILSTOP = (sys.executable, "-m", "failstop")
WINDOW = """\
<svg viewBox="0 0 {width} {height}" xmlns="http://www.w3.org/2000/svg">
<style>
.{unique_id}-matrix {{ font: {char_height}px "DejaVu Sans Mono", Menlo, Consolas, monospace; }}
.{unique_id}-title {{ font: bold 18px sans-serif; }}
{styles}
</style>
<defs>
<clipPath id="{unique_id}-clip-terminal">
<rect x="0" y="0" width="{terminal_width}" height="{terminal_height}"/>
</clipPath>
{lines}
</defs>
{chrome}
<g transform="translate({terminal_x}, {terminal_y})" clip-path="url(#{unique_id}-clip-terminal)">
{backgrounds}
<g class="{unique_id}-matrix">
{matrix}
</g>
</g>
</svg>
"""
"""As rich draws it, without a font from elsewhere."""


def shown(*words: str) -> str:
    """The output of the command on a terminal of COLUMNS columns. Raises CalledProcessError."""
    master, slave = pty.openpty()
    fcntl.ioctl(slave, termios.TIOCSWINSZ, struct.pack("4H", ROWS, COLUMNS, 0, 0))
    environment = {**os.environ, "TERM": "xterm-256color", "LANG": "C.UTF-8"}
    environment.pop("NO_COLOR", None)
    with subprocess.Popen((*FAILSTOP, *words), stdin=slave, stdout=slave, stderr=slave, env=environment) as process:
        os.close(slave)
        found = b""
        try:
            while part := os.read(master, 65536):
                found += part
        except OSError:
            pass  # the last of its writers has gone
    os.close(master)
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, words, found)
    return found.decode().replace("\r", "")


def save(name: str, *commands: tuple[str, ...]) -> None:
    """One picture of these commands, each behind its prompt."""
    with open(os.devnull, "w", encoding="utf-8") as nowhere:
        console = Console(file=nowhere, record=True, width=COLUMNS, force_terminal=True, color_system="256")
        for number, words in enumerate(commands):
            console.print(Text(f"{chr(10) if number else ''}$ failstop {' '.join(words)}", "bold"))
            console.print(Text.from_ansi(shown(*words).rstrip()))
        console.save_svg(
            str(PICTURES / f"{name}.svg"), title="failstop", theme=MONOKAI, code_format=WINDOW, unique_id=name
        )


def save_card() -> None:
    """The picture that a probe makes: a simulated bus of servos, alone and behind the guard port. Raises
    CalledProcessError."""
    with tempfile.TemporaryDirectory(prefix="failstop-screens-") as folder:
        port, card = os.path.join(folder, "board"), os.path.join(folder, "card")
        words = ["--board", "feetech", "--port", port, "--robot", "a simulated LeKiwi", "--out", card]
        with SimBoard(port, board="feetech"):
            subprocess.run((*FAILSTOP, "probe", "serial", *words, "--guard", "--rows", CARD_ROWS, "--yes"), check=True)
        shutil.copyfile(f"{card}.svg", PICTURES / "probe.svg")


def proven(stop: Stop | None) -> bool:
    """True when all is known of it that will be."""
    return stop is not None and stop.observed_s is not None


@interruptible()
def main() -> int:
    """Take them."""
    save("demo", ("demo",))
    save_card()
    with Trial(NAME) as trial:
        trial.enable()
        with subprocess.Popen((*FAILSTOP, "drive", "0.2", "0", "0", "--for", "10"), stderr=subprocess.DEVNULL):
            wait_for("the ramp's end", lambda: trial.robot.state.body_vel.vx_mps >= SPEED_MPS)
            save("status", ("status",))
            os.kill(trial.robot.state.processes[layout.GATE].pid, signal.SIGKILL)
        wait_for("the proof of the stop", lambda: proven(trial.robot.state.last_stop))
        save("why", ("why",), ("reset",), ("enable",))
    return 0


if __name__ == "__main__":
    sys.exit(main())
