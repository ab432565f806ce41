"""Coverage: the marks that a campaign of simulated runs must reach at least once: each cause, each answer of the
admission table, each change of a process's state. The campaign names the marks that no run reached, and fails. The
simulation supports a claim only as far as the marks that cite it are reached."""

from __future__ import annotations

import re
from collections.abc import Callable, Iterator, Mapping
from typing import Any

from failstop.policy import causes
from failstop_lab.boards.traits import HAS_ARM, HAS_KEYS, HAS_REPORTS, HAS_WHEEL_REPORTS, SHOWS_DEAF, Traits
from failstop_lab.machine.kernel import Machine
from failstop_lab.machine.loading import Loader
from failstop_lab.simulate.witness import Witness

NOT_TRIED = {
    "cause mute": "a gate that beats and sends nothing does not come of one fault",
    "cause bad_frame": "nor does a gate that sends nonsense",
    "admission bad frame": "nor does a gate that sends nonsense",
    "admission burst": "a zero frame that is too old comes of a gate and a port owner that are both held up",
    "cause uncounted": "no wheel that is told to turn loses its encoder here",
    "cause wheel_missing": "every wheel of the simulated board answers here",
    **{f"cause {row.name}": "no ROS bridge asks" for row in causes.SIGNED if row is not causes.REQUESTED},
    "cause not_heard": "a second without an answer, and a process that is held up within it: two faults",
    "cause defect": "nothing happens to a process that cannot happen",
    "cause battery": "its voltage takes seconds to show",
    "cause button": "no gamepad is plugged in",
    "cause fleet": "no broker is there",
    "cause driver_silent": "no setting asks for it",
    "cause two_move_the_arm": "one program moves the arm",
    "cause all_died": "told by readers of a run that is over, raised by nobody",
    "cause silent": "told by readers of a run that is over, raised by nobody",
    "cause unknown": "a cause of another version",
    "state down started": "a gate that is down is tried again after a minute",
    "state starting spared": "no start takes ten seconds",
    "state starting beats": "no start takes ten seconds",
    "state starting killed": "no start takes ten seconds",
    "state running beats": "a process that was spared as it started beats again",
    "state hanging died": "a process that is starved and spared dies: two faults",
    "state waiting beats": "a process that was spared beats just before its end, which is noticed first",
    "state down beats": "a process that was spared beats just before its end, which is noticed first",
    "state fenced beats": "a beat between the kill and the end",
    "state dead beats": "a beat between the end and its notice",
}
"""Marks that no scenario reaches, and why; tests with real processes reach them."""
CLAIMS: tuple[tuple[str, tuple[str, ...]], ...] = (
    ("cause died", ("DEATH-1", "SEVERAL-1")),
    ("cause (hangs|starved|held_up|supervisor_suspended)", ("HANG-1",)),
    ("cause suspended", ("TIME-1",)),
    ("cause removed", ("ASK-2",)),
    ("cause device_lost", ("PORT-1",)),
    ("cause (stuck|deaf|not_heard|restarted|wheel_missing)", ("BOARD-1",)),
    ("cause board_silent", ("SILENCE-1",)),
    ("cause (runaway|unstill|uncounted)", ("RUNAWAY-1",)),
    ("cause (not_finite|two_publishers|driver_died|driver_silent)", ("CLIENT-1",)),
    ("cause operator_gone", ("ATTEND-1",)),
    ("cause (key|requested|piped|ros_.*)", ("ASK-1",)),
    ("cause stopping", ("END-1",)),
    ("admission write", ("MOVE-1", "RETURN-1")),
    ("admission drop", ("MOVE-1", "MOVE-2")),
    ("admission request", ("ASK-1",)),
    ("admission hangs", ("HANG-1",)),
    ("state fenced died", ("HANG-1",)),
    ("state [a-z]+ died", ("DEATH-1", "SEVERAL-1")),
    ("state [a-z]+ (spared|killed|beats)", ("HANG-1",)),
    ("state waiting given up", ("RETURN-1",)),
    ("state [a-z]+ (started|runs|reaped|recalled)", ("RETURN-1",)),
)
"""The claims (lab/case/claims.py) that a mark supports, by the first pattern that matches its name."""
OF_PARTS = {
    "cause key": HAS_KEYS,
    "cause deaf": SHOWS_DEAF,
    "cause board_silent": HAS_REPORTS,
    "cause runaway": HAS_WHEEL_REPORTS,
    "cause unstill": HAS_WHEEL_REPORTS,
    "cause restarted": HAS_REPORTS,
    "admission hangs": HAS_ARM,
}
"""Marks that a campaign reaches only at a board that has this part (lab/boards/traits.py). For example, a lease can run
out between its check and a frame only if frames wait for the servos' bus."""
ADMISSION = ("write", "drop", "burst", "request", "bad frame", "hangs")


class Coverage:
    """How often each mark was reached."""

    def __init__(self) -> None:
        self.counts: dict[str, int] = {}

    def reach(self, name: str) -> None:
        self.counts[name] = self.counts.get(name, 0) + 1


def watch(loader: Loader, coverage: Coverage, witness: Witness) -> None:
    """Make the modules of one machine record the marks that they reach, without changing what they do. A broken
    invariant of the core makes a run wrong, although the robot stops for it."""
    _watch_causes(loader, coverage, witness)
    _watch_admission(loader, coverage)
    _watch_invariants(loader, witness)
    _watch_states(loader, coverage, witness)


def watch_commands(loader: Loader, witness: Witness) -> None:
    """Make the witness see when programs command speeds."""
    robot = loader.load("failstop.api.robot").Robot
    for name in ("drive", "drive_wheels"):
        setattr(robot, name, _seen(getattr(robot, name), witness))


def _seen(command: Callable[..., Any], witness: Witness) -> Callable[..., Any]:
    def seen(*arguments: Any, **words: Any) -> Any:
        witness.commands()
        try:
            return command(*arguments, **words)
        finally:
            witness.commanded()

    return seen


def _watch_causes(loader: Loader, coverage: Coverage, witness: Witness) -> None:
    epochs = loader.load("failstop.supervisor.latch").Epochs
    raise_for = epochs.raise_for

    def watched(self: Any, stops: list[Any], now_ns: int) -> None:
        for stop in stops:
            coverage.reach(f"cause {stop.cause.kind.name}")
            witness.causes.append(str(stop.cause))
            witness.note(f"the supervisor stops: {stop.cause}")
        raise_for(self, stops, now_ns)

    epochs.raise_for = watched


def _watch_admission(loader: Loader, coverage: Coverage) -> None:
    module = loader.load("failstop.procs.port_owner.admission")
    names = {module.ADMIT: "write", module.DROP: "drop", module.STAND_STILL: "burst", module.STOP_ASKED: "request"}
    decide = module.Admission.decide

    def watched(self: Any, *arguments: Any, **words: Any) -> Any:
        found = decide(self, *arguments, **words)
        coverage.reach(f"admission {names[found] if isinstance(found, int) else found.kind.name}")
        return found

    module.Admission.decide = watched


def _watch_invariants(loader: Loader, witness: Witness) -> None:
    admission = loader.load("failstop.procs.port_owner.admission").Admission

    def noted(real: Callable[..., Any]) -> Callable[..., Any]:
        def watched(*arguments: Any, **words: Any) -> Any:
            if found := real(*arguments, **words):
                witness.wrong(str(found))
            return found

        return watched

    admission.impossible, admission.follow = noted(admission.impossible), noted(admission.follow)


def _watch_states(loader: Loader, coverage: Coverage, witness: Witness) -> None:
    module = loader.load("failstop.supervisor.children")
    on = module.Child.on

    def watched(self: Any, event: str) -> None:
        coverage.reach(f"state {self.state} {event}")
        on(self, event)
        if self.defects:
            witness.wrong(str(self.defects[-1]))

    module.Child.on = watched


def names() -> Iterator[str]:
    """Every mark, from the declarations in the service's modules."""
    loader = Loader(Machine())
    module = loader.load("failstop.supervisor.children")
    yield from (f"cause {name}" for name in loader.load("failstop.policy.causes").CAUSE_BY_NAME)
    yield from (f"admission {name}" for name in ADMISSION)
    for state, row in module.NEXT.items():
        yield from (f"state {state} {event}" for event in row)


def claims_of(name: str) -> tuple[str, ...]:
    """The claims that a mark supports; empty if no pattern of CLAIMS matches."""
    return next((claims for pattern, claims in CLAIMS if re.fullmatch(pattern, name)), ())


def unreached(counts: Mapping[str, int], traits: Traits) -> list[str]:
    """The marks that this board can reach and that were not reached."""
    beyond = NOT_TRIED.keys() | {name for name, part in OF_PARTS.items() if part not in traits.parts}
    return [name for name in names() if not counts.get(name) and name not in beyond]
