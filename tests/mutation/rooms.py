"""Rooms that are mutated, and the tests that are to notice; mutmut finds out which of them call the changed
function."""

from __future__ import annotations

from typing import NamedTuple


class Room(NamedTuple):
    """Files and tests are patterns under the repository's root."""

    files: tuple[str, ...]
    tests: tuple[str, ...]


ROOMS = {
    "gate": Room(
        (
            *(f"procs/gate/{name}.py" for name in ("conditions", "core", "requests", "sources")),
            "failstop/policy/kinematics.py",
        ),
        ("tests/procs/test_gate_*.py", "tests/policy/test_kinematics.py"),
    ),
    "arm": Room(
        ("procs/gate/arm/*.py", "failstop/policy/capsules.py", "failstop/policy/joints.py"),
        ("tests/procs/test_gate_arm*.py", "tests/policy/test_capsules.py"),
    ),
    "port_owner": Room(
        ("procs/handover.py", "procs/peer.py", "procs/schedule.py", "procs/port_owner/*.py"),
        (
            "tests/procs/test_admission.py",
            "tests/procs/test_handover.py",
            "tests/procs/test_port_owner*.py",
            "tests/procs/test_schedule.py",
            "tests/procs/test_stopper.py",
            "tests/procs/test_wire*.py",
            "tests/procs/telemetry/test_port.py",
        ),
    ),
    "telemetry": Room(
        tuple(f"procs/telemetry/{name}.py" for name in ("battery", "imu", "odometry", "pad", "still")),
        tuple(
            f"tests/procs/telemetry/test_{name}.py"
            for name in ("battery", "imu", "odometry", "pad", "rolling", "square", "still")
        ),
    ),
    "codec": Room(
        (
            "failstop/board/checks.py",
            *(f"failstop/board/rrc/{name}.py" for name in ("arm", "codec", "decoder", "framing", "servos", "steering")),
        ),
        tuple(
            f"tests/board/test_{name}.py"
            for name in ("burst", "codec", "cut_frames", "decoder", "layouts", "receiver", "servos")
        ),
    ),
    "stopper": Room(
        ("procs/stopper/*.py", "failstop/stop_tool.py", "failstop/board/stop_port.py"),
        ("tests/board/test_stop_port.py", "tests/procs/test_stop_tool.py", "tests/procs/test_stopper.py"),
    ),
    "shm": Room(
        (
            "shm/*.py",
            "failstop/files/*.py",
            "failstop/messages/*.py",
            "failstop/data.py",
            "failstop/instances.py",
            "failstop/api/held.py",
        ),
        # Not those that read the sources, measure memory, leave the work to programs that mutmut can't follow, or
        # scribble for minutes.
        (
            "tests/model/test_pairs.py",
            "tests/incidents/test_box.py",
            "tests/incidents/test_memory.py",
            "tests/procs/test_gate_driver_death.py",
            "tests/procs/test_gate_remarks.py",
            "tests/shm/test_[!npst]*.py",
            "tests/shm/test_place.py",
            "tests/shm/test_segment*.py",
            "tests/shm/test_spoiled.py",
            "tests/shm/test_cell.py",
            "tests/shm/test_thread_state.py",
            "tests/shm/test_truncated.py",
            "tests/test_data.py",
        ),
    ),
    "supervisor": Room(
        ("supervisor/*.py",),
        # But test_imports.py: what is mutated imports the tool.
        ("tests/cli/test_fold.py", "tests/e2e/test_look_alikes.py", "tests/supervisor/test_[!i]*.py"),
    ),
}
