"""A run of the service without its processes, which the test writes by itself, and a handle of the C library on it."""

from __future__ import annotations

import contextlib
import ctypes
import os
import random
import shutil
import struct
from collections.abc import Iterator
from typing import Any

from failstop.api.state import StateReader
from failstop.files import instance
from failstop.messages import layout, records, segments
from failstop.messages.packing import pack
from failstop.policy.settings import Settings
from failstop.procs.gate.clients import Slot
from failstop.shm import bell
from failstop.supervisor.run import Run
from tests.support.c_client import whole_library

MOST_WHEELS = 4


class State(ctypes.Structure):
    """fs_state of failstop.h."""

    _fields_ = [
        ("size", ctypes.c_uint32),
        *((name, ctypes.c_int32) for name in ("enabled", "latched", "cause", "block", "answer", "answer_block")),
        *((name, ctypes.c_int32) for name in ("moving", "ready", "link", "port_open", "reserved1_")),
        ("epoch", ctypes.c_uint64),
        ("enabled_ns", ctypes.c_uint64),
        ("age_s", ctypes.c_double),
        ("velocity", ctypes.c_double * 3),
        ("wheels_radps", ctypes.c_double * MOST_WHEELS),
        ("steering_rad", ctypes.c_double),
        ("speed_limit", ctypes.c_double),
        ("turning", ctypes.c_int32),
        ("turning_unexpected", ctypes.c_int32),
        ("measured_age_s", ctypes.c_double),
        ("measured_radps", ctypes.c_double * MOST_WHEELS),
        ("turned_rad", ctypes.c_double * MOST_WHEELS),
        ("acceleration", ctypes.c_double * 3),
        ("rate", ctypes.c_double * 3),
        ("imu_age_s", ctypes.c_double),
        ("battery_v", ctypes.c_double),
        ("battery_age_s", ctypes.c_double),
        ("pose", ctypes.c_double * 3),
        ("twist", ctypes.c_double * 3),
        ("odometry_measured", ctypes.c_int32),
        ("reserved2_", ctypes.c_int32),
        ("odometry_age_s", ctypes.c_double),
    ]


class Velocity(ctypes.Structure):
    """fs_velocity of failstop.h."""

    _fields_ = [
        ("size", ctypes.c_uint32),
        ("manual", ctypes.c_int32),
        ("vx", ctypes.c_double),
        ("vy", ctypes.c_double),
        ("wz", ctypes.c_double),
        ("source", ctypes.c_char_p),
        ("wanted_ns", ctypes.c_uint64),
    ]


class OwnRun:
    """The run, its records to write, the gate's view of slot 0, and a connected handle."""

    def __init__(self, name: str, values: dict[str, Any]) -> None:
        self.settings = Settings(values)
        self.folder = instance.places(name)[0]
        os.makedirs(self.folder, mode=0o755)
        self.run = Run(self.settings, name, self.folder)
        self.run.publish()
        self._writers = {
            which: segments.attach(self.run.memory, which, self.run.incarnation, write=True)
            for which in layout.PROCESS_NAMES
        }
        table: dict[str, object] = {"processes": {}, "waiting_for": "", "starved": None, "starved_times": 0}
        self.writer(layout.SUPERVISOR, "processes").write(pack(table))
        self.reader = StateReader(name)
        self.c = whole_library()
        self.c.fs_open.argtypes = [ctypes.c_void_p, ctypes.c_char_p, ctypes.c_char_p]
        self.handle = ctypes.c_void_p()
        assert self.c.fs_open(ctypes.byref(self.handle), name.encode(), b"written") == 0
        assert self.c.fs_connect(self.handle) == 0
        self.slot = Slot(0, segments.read_client_slot(self.run.memory, 0, self.run.incarnation))
        session = self.slot.greet()
        assert session
        self.slot.join(session)

    def close(self) -> None:
        self.c.fs_close(self.handle)
        self.run.remove()
        shutil.rmtree(self.folder)

    def writer(self, which: str, record: str) -> Any:
        return self._writers[which].latest_writer(record)

    def word(self, which: str, record: str) -> Any:
        return self._writers[which].word(record)

    def rang(self) -> bytes:
        """What clients have written into the bell since the last call."""
        return bell.receive(self.run.client_bell)

    def asked(self) -> bytes:
        """What clients have written into the stop pipe since the last call."""
        return bell.receive(self.run.stop_pipe)


@contextlib.contextmanager
def own_run(name: str, **values: Any) -> Iterator[OwnRun]:
    made = OwnRun(name, values)
    try:
        yield made
    finally:
        made.close()


def a_double(draw: random.Random) -> float:
    """Any finite number: half of them of any bits, so that each exponent, sign and payload is seen."""
    while True:
        number = draw.choice((0.0, -0.0, 5e-324, draw.uniform(-2, 2), bits(draw), bits(draw)))
        if number - number == 0:
            return number


def bits(draw: random.Random) -> float:
    """Any number, infinite ones and NaN among them."""
    found: float = struct.unpack("<d", draw.randbytes(8))[0]
    return found


def same(one: object, other: object) -> bool:
    """Whether values are the same to the bit; a float and an equal one of another sign or payload are not."""
    if isinstance(one, (tuple, list)) and isinstance(other, (tuple, list)):
        return len(one) == len(other) and all(map(same, one, other))
    if isinstance(one, float) and isinstance(other, float):
        return struct.pack("<d", one) == struct.pack("<d", other)
    return type(one) is type(other) and one == other


__all__ = ["OwnRun", "State", "Velocity", "a_double", "bits", "own_run", "records", "same"]
