"""One virtual machine: qemu without /dev/kvm, with a clock that counts instructions, and the agent inside.

Emulated, a guest is some twelve times as slow as the machine, and every deadline of the service is missed. With -icount
its clock counts instructions instead: a second in there is one of a machine a quarter as fast as this, however long it
takes out here, and what is measured inside hardly depends on what else runs here. One processor is all that it offers.
"""

from __future__ import annotations

import contextlib
import json
import os
import shutil
import signal
import socket
import subprocess
import tempfile
import time
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from tests.vm.image import Image, cache, key
from tests.vm.patience import Patience, ran

MEMORY_MB = 768
WAITS = "shift=2"
"""An instruction takes 4 ns of guest time; where the guest waits, its time is that of the machine outside."""
LEAPS = "shift=2,sleep=off"
"""A clock by which a guest that waits goes on at once, to the time it waits for: for what is wholly inside. From a
state that was saved with it either can go on, from one that was saved without it only the other."""
STATE = "ready"
"""The saved state of the booted guest, inside its disk."""
BOOT_S = 420.0
UNUSED = (
    *("ahci", "drm", "evdev", "i2c_i801", "iTCO_wdt", "joydev", "kvm", "lpc_ich", "parport", "pcspkr", "powernow_k8"),
    *("psmouse", "qrtr", "sha512_ssse3", "sr_mod"),
)
"""Drivers that udev would load at each boot for what only looks like hardware."""
APPEND = f"console=ttyS0 quiet clocksource=tsc tsc=reliable mitigations=off module_blacklist={','.join(UNUSED)}"
"""Counting instructions, the time stamp counter is exact, which the kernel does not believe of an emulated one."""
CPU = "qemu64,+ssse3,+sse4.1,+sse4.2,+popcnt,-svm"
"""The least that numpy runs on: what `max` has besides (AVX, pages of five levels) is slower, emulated. A boot took the
machine outside 40 s of its processor instead of 57."""
MACHINE = "q35,sata=off,smbus=off,i8042=off,vmport=off"


LOGS = Path("build", "vm")
"""The output of the guests of the last run, a folder for each: what a message points to outlives the run."""
CONSOLE = "console.log"
QEMU = "qemu.log"


class GuestError(Exception):
    """The guest does not do what it should; the message says where to look."""


def command(image: Image, place: Path, disk: Path, payload: Path, clock: str, state: str, logs: Path) -> list[str]:
    """How qemu is called: one processor, the two disks, the agent, the clock, and a host controller with the board."""
    chardevs = {"console": f"file,path={logs}/{CONSOLE},append=on"}
    chardevs |= {name: f"socket,path={place}/{name},server=on,wait=off" for name in ("agent", "clock", "usb")}
    options = {
        "M": [MACHINE],
        "cpu": [CPU],
        "accel": ["tcg,thread=single"],
        "icount": [clock],
        "smp": ["1"],
        "m": [str(MEMORY_MB)],
        "display": ["none"],
        "kernel": [str(image.kernel)],
        "initrd": [str(image.initrd)],
        "append": [APPEND],
        "drive": [
            f"file={disk},if=none,id=system,cache=unsafe",
            f"file={payload},if=none,id=payload,format=raw,readonly=on",
        ],
        "chardev": [f"{kind.split(',', 1)[0]},id={name},{kind.split(',', 1)[1]}" for name, kind in chardevs.items()],
        "serial": ["chardev:console"],
        "qmp": [f"unix:{place}/qmp,server=on,wait=off"],
        "device": [
            *("virtio-blk-pci,drive=system", "virtio-blk-pci,drive=payload", "virtio-rng-pci", "virtio-serial-pci"),
            "virtserialport,chardev=agent,name=failstop.vm",
            *("virtserialport,chardev=clock,name=failstop.clock", "qemu-xhci", "usb-redir,chardev=usb,id=board"),
        ],
    }
    words = [word for name, values in options.items() for value in values for word in (f"-{name}", value)]
    return ["qemu-system-x86_64", "-nodefaults", *words, *(["-loadvm", state] if state else [])]


class Guest:
    """A running guest, with its disk and sockets in `place`, and what it says in `logs`. To be used by `with`."""

    def __init__(
        self, image: Image, place: Path, logs: Path, payload: Path, *, clock: str = WAITS, disk: Path | None = None
    ) -> None:
        self.place, self.logs = place, logs.absolute()
        for folder in (self.place, self.logs):
            folder.mkdir(parents=True, exist_ok=True)
        self.board = place / "usb"
        """Where the usb-redir device listens."""
        self._image, self._payload, self._clock = image, payload, clock
        self._disk = disk
        self._process: subprocess.Popen[bytes] | None = None
        self._number = 0
        self._waiting = b""
        self.boots: list[str] = []
        """The boot ids that the agent has greeted with."""

    def __enter__(self) -> Guest:
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def start(self, state: str = "") -> None:
        """Boot, or go on from the saved state. Raises GuestError."""
        disk = self.place / "disk.qcow2"
        if self._disk is not None:
            shutil.copyfile(self._disk, disk)
        else:
            backing = ("-b", str(self._image.disk), "-F", "raw")
            subprocess.run(["qemu-img", "create", "-q", "-f", "qcow2", *backing, str(disk)], check=True)
        words = command(self._image, self.place, disk, self._payload, self._clock, state, self.logs)
        with (self.logs / QEMU).open("wb") as log:
            # It ends with the thread that started it, however that ends.
            words = ["setpriv", "--pdeathsig", "KILL", *words]
            self._process = subprocess.Popen(words, stdout=log, stderr=log, stdin=subprocess.DEVNULL)
        self.agent = self.dial("agent")
        self._qmp = self.dial("qmp").makefile("rw")
        self._qmp.readline()
        self.qmp("qmp_capabilities")

    # Commands in the guest.

    def run(self, *words: str, timeout_s: float = 60.0, wait_s: float = 600.0) -> tuple[int, list[str]]:
        """Run a command in there; returns its exit code and lines. `timeout_s` is the guest's time, `wait_s` ours."""
        lines: list[str] = []
        for message in self.lines(*words, timeout_s=timeout_s, wait_s=wait_s):
            if isinstance(message, int):
                return message, lines
            lines.append(message)
        raise GuestError(f"{' '.join(words)} has no end")

    def must(self, *words: str, timeout_s: float = 60.0) -> list[str]:
        """Run a command that must succeed. Raises GuestError with what it said."""
        code, lines = self.run(*words, timeout_s=timeout_s)
        if code:
            raise GuestError(f"in the guest, {' '.join(words)} failed ({code}): {' | '.join(lines[-8:])}")
        return lines

    def lines(self, *words: str, timeout_s: float, wait_s: float) -> Iterator[str | int]:
        """The output of a command, line by line, then its exit code."""
        self._number += 1
        message = {"id": self._number, "run": words, "timeout_s": timeout_s}
        self.agent.sendall(json.dumps(message).encode() + b"\n")
        patience = self.patience(wait_s)
        while True:
            answer = self._receive(patience)
            if answer.get("id") == self._number:
                yield answer["line"] if "line" in answer else answer["code"]
                if "code" in answer:
                    return

    def greeted(self, wait_s: float = BOOT_S) -> str:
        """Wait for the agent of a boot; returns the boot's id."""
        before, patience = len(self.boots), self.patience(wait_s)
        while len(self.boots) == before:
            self._receive(patience)
        return self.boots[-1]

    def patience(self, wait_s: float) -> Patience:
        """For so much of a time in which the host has a processor for the guest."""
        pid = self._process.pid if self._process else 0
        return Patience(wait_s, lambda: ran(pid))

    def _receive(self, patience: Patience) -> dict[str, Any]:
        while b"\n" not in self._waiting:
            left_s = patience.left_s()
            if left_s <= 0:
                raise GuestError(f"the guest says nothing any more: {patience.why()}; see {self.logs / CONSOLE}")
            self.agent.settimeout(left_s)
            with contextlib.suppress(TimeoutError):
                data = self.agent.recv(65536)
                if not data:
                    raise GuestError(f"the guest has ended: see {self.logs / QEMU} and {self.logs / CONSOLE}")
                self._waiting += data
        line, _, self._waiting = self._waiting.partition(b"\n")
        message: dict[str, Any] = json.loads(line)
        if "hello" in message:
            self.boots.append(message["hello"])
        return message

    # qemu.

    def qmp(self, command: str, **arguments: Any) -> Any:
        """One command of qemu's monitor; returns its answer. Raises GuestError."""
        self._qmp.write(json.dumps({"execute": command, "arguments": arguments}) + "\n")
        self._qmp.flush()
        for line in self._qmp:
            answer = json.loads(line)
            if "return" in answer:
                return answer["return"]
            if "error" in answer:
                raise GuestError(f"qemu refuses {command}: {answer['error']['desc']}")
        raise GuestError(f"qemu has ended: see {self.logs / QEMU}")

    def save(self, state: str) -> None:
        """Save the state of all of it into the disk."""
        said = self.qmp("human-monitor-command", **{"command-line": f"savevm {state}"})
        if said.strip():
            raise GuestError(f"qemu can't save the guest: {said.strip()}")

    def fork(self, state: str) -> Path:
        """Save the state, and go on; returns a disk of its own with it, for another guest."""
        self.save(state)
        copy = self.place / f"{state}.qcow2"
        self.qmp("stop")
        shutil.copyfile(self.place / "disk.qcow2", copy)
        self.qmp("cont")
        return copy

    def ended(self, wait_s: float) -> bool:
        """Whether qemu ends by itself, as it does when the guest turns the machine off."""
        assert self._process is not None
        patience = self.patience(wait_s)
        while self._process.poll() is None and (left_s := patience.left_s()) > 0:
            with contextlib.suppress(subprocess.TimeoutExpired):
                self._process.wait(left_s)
        return self._process.poll() is not None

    def close(self) -> None:
        """End it."""
        process, self._process = self._process, None
        if process is not None and process.poll() is None:
            process.send_signal(signal.SIGKILL)
            process.wait()

    def dial(self, name: str) -> socket.socket:
        """Connect to one of its sockets. Raises GuestError."""
        until_s = time.monotonic() + 60.0
        connection = socket.socket(socket.AF_UNIX, socket.SOCK_STREAM)
        while True:
            try:
                connection.connect(str(self.place / name))
                return connection
            except OSError:
                assert self._process is not None
                if self._process.poll() is not None or time.monotonic() > until_s:
                    said = (self.logs / QEMU).read_text().strip()
                    raise GuestError(f"qemu does not start: {said}") from None
                time.sleep(0.05)


def state(image: Image, payload: Path) -> Path:
    """A disk with the saved state of the booted guest, made if it is not there. Raises GuestError."""
    # A state is of one machine: of these devices, by this qemu.
    nowhere = Path("-")
    words = command(Image("", nowhere, nowhere, nowhere), nowhere, nowhere, nowhere, LEAPS, "", nowhere)
    version = subprocess.run(["qemu-system-x86_64", "--version"], check=True, capture_output=True, text=True).stdout
    path = cache() / f"state-{key(image.key, version, *words)}.qcow2"
    if path.exists():
        return path
    print("booting the guest once, to keep its state ...", flush=True)
    with (
        tempfile.TemporaryDirectory(prefix="failstop-vm-") as place,
        Guest(image, Path(place), LOGS / "first-boot", payload, clock=LEAPS) as guest,
    ):
        guest.start()
        guest.greeted()
        guest.must("systemctl", "is-system-running", "--wait", timeout_s=120.0)
        # Modules that every trial would load first.
        guest.must("/srv/venv/bin/python", "-c", "import numpy, psutil, msgpack, serial", timeout_s=120.0)
        guest.must("modprobe", "-a", "vhci-hcd", "cdc-acm")
        guest.must("sync")
        guest.save(STATE)
        guest.close()
        beside = path.with_suffix(f".{os.getpid()}.new")
        shutil.move(guest.place / "disk.qcow2", beside)
        beside.rename(path)
    return path
