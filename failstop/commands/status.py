"""`failstop status`: one screen, or JSON."""

from __future__ import annotations

import json
import time
from argparse import ArgumentParser, Namespace

from failstop.commands import add_name
from failstop.robot import Robot
from failstop.state import State, Stop
from failstop.supervisor.stops import still_after


def add_arguments(parser: ArgumentParser) -> None:
    """Options of `failstop status`."""
    parser.add_argument("--json", action="store_true", help="for programs")
    add_name(parser)


def main(arguments: Namespace) -> int:
    """Print the state."""
    with Robot(arguments.name) as robot:
        state = robot.state
    print(json.dumps(state.as_dict(), indent=2) if arguments.json else "\n".join(_screen(state)))
    return 0


def next_step(state: State) -> str:
    """The command to type next, for what blocks the wheels now."""
    if state.estop:
        return "`failstop reset`, then `failstop enable`"
    if state.waiting_for:
        return f"wait for {state.waiting_for}"
    if not state.enabled:
        return "`failstop enable`"
    if state.blocked == "no scan":
        return "look at the obstacle sensor; its program calls robot.sensed()"
    if state.blocked == "cmd timeout":
        return "`failstop drive 0.1 0 0`, or your program's commands"
    return ""


def _proofs(stop: Stop) -> str:
    """The three levels of a stop, as far as they are known."""
    if stop.written_us is None:
        return "NOT written"
    known = [f"written after {stop.written_us / 1000:.2f} ms by the {stop.written_by}"]
    if stop.acknowledged_us is not None:
        known.append(f"acknowledged after {stop.acknowledged_us / 1000:.1f} ms")
    if stop.observed_ms is not None:
        known.append(f"wheels still after {still_after(stop.observed_ms / 1000)}")
    return ", ".join(known)


def _screen(state: State) -> list[str]:
    vx, vy, wz = state.body_vel
    wheels = f"blocked: {state.blocked}" if state.blocked else f"driving {vx:+.2f} m/s {vy:+.2f} m/s {wz:+.2f} rad/s"
    charger = f" {state.plugged}" if state.plugged != "unknown" else ""
    battery = f", battery {state.battery_mv / 1000:.2f} V{charger}" if state.battery_mv else ""
    lines = [f"wheels   {wheels}"]
    if step := next_step(state):
        lines.append(f"next     {step}")
    lines.append(f"device   {state.device['path']} {state.device['state']}, link {state.device['link']}{battery}")
    if stop := state.last_stop:
        lines.append(f"stop     {stop.reason}, {time.time() - stop.t:.0f} s ago: {_proofs(stop)}")
    lines += [
        f"source   {row['source']} (priority {row['priority']}): {row['who']} {row['state']}" for row in state.sources
    ]
    for client in state.clients:
        does = "drives" if client["driving"] else "connected"
        lines.append(f"client   {client['name']} (pid {client['pid']}) {does}")
    lines.append("")
    lines.append(f"{'process':<12}{'pid':>8} {'state':<9}{'beat':>8}{'worst':>9}{'restarts':>9}  rights")
    for name, process in state.processes.items():
        granted = [word for word, has in (("realtime", process.realtime), ("locked", process.memory_locked)) if has]
        lines.append(
            f"{name:<12}{process.pid:>8} {process.state:<9}{process.age_ms:>5.0f} ms{process.worst_ms:>6.1f} ms"
            f"{process.restarts:>9}  {' '.join(granted) or 'none'}"
        )
    return lines
