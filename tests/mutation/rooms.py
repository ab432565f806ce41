"""What is mutated, and which tests must notice: by file where a few tests hold it, so that a mutant takes seconds.

rooms.py paths ROOM...     the files to mutate, for mutmut
rooms.py tests ROOM...     every test of these rooms
"""

from __future__ import annotations

import sys

GATE = "tests/procs/test_gate_*.py tests/procs/test_kinematics.py"
PORT_OWNER = (
    "tests/procs/test_port_owner.py tests/procs/test_port_owner_faults.py tests/procs/test_pings.py "
    "tests/procs/test_suspend.py"
)
ANSWERS = "tests/supervisor/test_answers.py tests/supervisor/test_watching.py tests/supervisor/test_aftermath.py"

ROOMS: dict[str, dict[str, str]] = {
    "gate": dict.fromkeys(
        [f"procs/gate/{name}.py" for name in ("core", "sources", "scan", "interlocks", "kinematics")], GATE
    ),
    "burst": {"board/burst.py": "tests/test_burst.py"},
    "port_owner": {
        "procs/port_owner/admission.py": f"tests/procs/test_admission.py {PORT_OWNER}",
        "procs/port_owner/repeats.py": f"tests/procs/test_repeats.py {PORT_OWNER}",
        "procs/port_owner/pings.py": PORT_OWNER,
        "procs/port_owner/wire.py": f"tests/procs/test_wire.py {PORT_OWNER}",
        "procs/port_owner/main.py": PORT_OWNER,
    },
    "stopper": {
        "procs/stopper/tool.py": "tests/procs/test_stop_tool.py",
        "procs/stopper/rest.py": "tests/procs/test_rest.py",
        "procs/stopper/main.py": "tests/procs/test_stopper.py",
    },
    "shm": {
        "shm/slot.py": "tests/shm/test_slot.py tests/shm/test_latest.py tests/shm/test_ring.py",
        "shm/latest.py": "tests/shm/test_latest.py tests/shm/test_torn.py",
        "shm/ring.py": "tests/shm/test_ring.py tests/shm/test_ring_model.py",
        "shm/words.py": "tests/shm/test_words.py",
        "shm/views.py": "tests/shm/test_words.py tests/shm/test_latest.py tests/shm/test_truncated.py",
        "shm/bell.py": "tests/shm/test_bell.py",
        "shm/box.py": "tests/incidents/test_box.py",
        "shm/blocks.py": "tests/incidents/test_box.py tests/procs/test_gate_halts.py",
        "shm/packing.py": "tests/shm/test_packing.py",
        "shm/place.py": "tests/shm/test_place.py tests/shm/test_instance.py",
        "shm/root.py": "tests/shm/test_instance.py",
        "shm/claim.py": "tests/shm/test_claim.py",
        "shm/heartbeat.py": "tests/shm/test_heartbeat.py",
        "shm/lifeline.py": "tests/shm/test_lifeline.py",
        "shm/mutex.py": "tests/shm/test_lifeline.py",
        "shm/records.py": "tests/shm/test_records.py",
        "shm/notes.py": "tests/shm/test_packing.py tests/supervisor/test_teller.py",
        "shm/layout.py": "tests/shm/test_layout.py",
        "shm/segment.py": "tests/shm/test_segment.py tests/shm/test_segment_header.py",
        "shm/instance.py": "tests/shm/test_instance.py",
    },
    "supervisor": {
        "supervisor/allowance.py": "tests/supervisor/test_allowance.py",
        "supervisor/answer.py": "tests/supervisor/test_answer.py tests/supervisor/test_answers.py",
        "supervisor/causes.py": "tests/supervisor/test_causes.py tests/supervisor/test_answers.py",
        "supervisor/fence.py": "tests/supervisor/test_stops.py tests/supervisor/test_watching.py",
        "supervisor/grant.py": "tests/supervisor/test_grant.py",
        "supervisor/herald.py": "tests/supervisor/test_answers.py",
        "supervisor/silence.py": "tests/supervisor/test_watching.py",
        "supervisor/device.py": "tests/supervisor/test_device.py",
        "supervisor/health.py": "tests/supervisor/test_health.py tests/supervisor/test_answers.py",
        "supervisor/link.py": "tests/supervisor/test_link.py tests/supervisor/test_aftermath.py",
        "supervisor/restarts.py": "tests/supervisor/test_restarts.py",
        "supervisor/stops.py": "tests/supervisor/test_stops.py tests/supervisor/test_aftermath.py",
        "supervisor/aftermath.py": ANSWERS,
        "supervisor/children.py": f"tests/supervisor/test_family.py {ANSWERS}",
        "supervisor/events.py": "tests/supervisor/test_events.py tests/supervisor/test_allowance.py",
        "supervisor/family.py": f"tests/supervisor/test_family.py {ANSWERS}",
        "supervisor/journal.py": "tests/supervisor/test_journal.py",
        "supervisor/main.py": f"{ANSWERS} tests/supervisor/test_names.py",
        "supervisor/names.py": "tests/supervisor/test_names.py",
        "supervisor/notify.py": "tests/supervisor/test_notify.py",
        "supervisor/port.py": f"tests/supervisor/test_own_port.py {ANSWERS}",
        "supervisor/sharing.py": f"tests/supervisor/test_sharing.py {ANSWERS}",
        "supervisor/teller.py": "tests/supervisor/test_teller.py tests/supervisor/test_answers.py",
    },
}


def tests_of(path: str) -> str:
    """The tests that must notice a mutant of this file."""
    return next(room[path] for room in ROOMS.values() if path in room)


def main(what: str, *names: str) -> int:
    """Print what the runner needs of these rooms, or of all."""
    rooms = [ROOMS[name] for name in names or ROOMS]
    if what == "paths":
        print(",".join(file for room in rooms for file in room))
    else:
        print(" ".join(sorted({word for room in rooms for tests in room.values() for word in tests.split()})))
    return 0


if __name__ == "__main__":
    sys.exit(main(*sys.argv[1:]))
