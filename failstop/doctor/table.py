"""The table of checks: each a name and a pure judgement over the facts."""

from __future__ import annotations

import dataclasses
from collections.abc import Callable
from typing import Any

from failstop.doctor import judge_machine, judge_port, judge_ros2, judge_service, paste
from failstop.doctor.facts import Facts
from failstop.doctor.finding import LEVELS, Finding


@dataclasses.dataclass(frozen=True)
class Check:
    """One row. A judgement may find nothing, one thing, or several."""

    name: str
    judge: Callable[[Facts], list[Finding]]


CHECKS = (
    Check("port", judge_port.present),
    Check("identity", judge_port.identity),
    Check("permission", judge_port.permission),
    Check("holders", judge_port.holders),
    Check("grabbers", judge_port.grabbers),
    Check("settings", judge_service.settings),
    Check("service", judge_service.running),
    Check("clients", judge_service.clients),
    Check("ROS 2", judge_ros2.bridge),
    Check("version", judge_service.version),
    Check("unit", judge_service.unit),
    Check("realtime", judge_machine.realtime),
    Check("memory lock", judge_machine.memory_lock),
    Check("deaths", judge_machine.early_news),
    Check("clock", judge_machine.clock),
    Check("wall clock", judge_machine.wall_clock),
    Check("shared memory", judge_machine.shared_memory),
    Check("leftovers", judge_machine.leftovers),
    Check("RemoveIPC", judge_service.remove_ipc),
    Check("processor", judge_machine.cpu),
    Check("idle", judge_machine.idle),
    Check("ticks", judge_machine.ticks),
    Check("stop path", judge_service.stop_path),
)


def examine(facts: Facts) -> list[tuple[str, Finding]]:
    """Every finding with its check's name, the most serious first, those of one level in the table's order; commands
    are such as the user who asks can paste."""
    shell, sudo = facts.commands
    root = facts.user.uid == 0
    found = [
        (check.name, dataclasses.replace(finding, fix=paste.ready(finding.fix, shell, sudo, root=root)))
        for check in CHECKS
        for finding in check.judge(facts)
    ]
    return sorted(found, key=lambda row: -LEVELS.index(row[1].level))


def as_records(found: list[tuple[str, Finding]]) -> list[dict[str, Any]]:
    """For programs."""
    return [{"check": name, **dataclasses.asdict(finding)} for name, finding in found]
