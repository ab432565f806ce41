"""Pace: how fast the wheels turned compared with what they were told, by the board's raw reports. Pure."""

from __future__ import annotations

from bisect import bisect_right
from collections.abc import Iterator, Sequence
from statistics import median

from failstop.board.interface import Board, WheelReports
from failstop.policy import kinematics, scale
from failstop.policy.settings import Settings
from failstop.procs.telemetry.wheels import Measured
from failstop_lab.prove.sight import SeenSample
from failstop_lab.prove.table import Turning
from failstop_lab.prove.watch import Commanded

ROUNDING = 1.0005
"""The gate's, of the fastest wheel."""
TURNS_RPS = 0.02
"""A wheel that is told less is not compared."""
CONFIRMS = f"the board reports speeds that fit: set {scale.PER_RPS_CONFIRMED} = {{:.6g}}, which lifts the speed cap"


def commanded_rps(settings: Settings, velocity: Turning, board: Board) -> tuple[float, ...]:
    """The speed that each wheel is told at this velocity, by wire id, as the board's frame has it: in whole units."""
    chassis = kinematics.from_settings(settings)
    speeds = chassis.wheels_rps(*velocity.command)
    sent = board.speeds(board.motor_speeds(speeds, kinematics.max_wheel_rps(settings) * ROUNDING))
    if sent is not None:
        return tuple(sent)
    return speeds[:-1] if chassis.steers else speeds


def measured(samples: Sequence[SeenSample], reports: WheelReports, commanded: Sequence[Commanded]) -> float | None:
    """Measured speed over the commanded one, of the wheels that turn; None: the reports share the scale of the
    commands, or say no speeds.

    A report is compared with the frame that was in force when it came, because repeated frames of a slow speed may
    differ by more than the speed that is looked for. Sums are compared, so a report of the frame before counts little.
    """
    if not reports.own_scale:
        return None
    times = [t_ns for t_ns, _ in commanded]
    sums: dict[int, tuple[float, float]] = {}
    for t_ns, speeds_rps, weight in _speeds(samples, reports):
        if not (at := bisect_right(times, t_ns)):
            continue
        for wheel, (speed_rps, wanted) in enumerate(zip(speeds_rps, commanded[at - 1][1], strict=False)):
            if speed_rps and abs(wanted) >= TURNS_RPS:
                seen, told = sums.get(wheel, (0.0, 0.0))
                sums[wheel] = seen + speed_rps * weight, told + wanted * weight
    return median(seen / told for seen, told in sums.values()) if sums else None


def _speeds(samples: Sequence[SeenSample], reports: WheelReports) -> Iterator[tuple[int, tuple[float, ...], float]]:
    """(when, the speed of each wheel in turns a second, its weight) of each report, or between two of positions that
    are far enough apart."""
    if reports.speed_per_rps:
        for t_ns, speeds, _ in samples:
            yield t_ns, tuple(speed / reports.speed_per_rps for speed in speeds), 1.0
        return
    measured, last_ns = Measured(reports, summed=True), 0
    for t_ns, _, positions in samples:
        if measured.add((), positions, t_ns):
            yield t_ns, measured.speeds_rps, (t_ns - last_ns) / 1e9 if last_ns else 0.0
            last_ns = t_ns


def of_simulated(true_rps: Sequence[float], told: Sequence[float], per_rps: float) -> tuple[str, ...]:
    """What a simulated board, which knows its wheels, says of the scale in the settings; empty: it fits."""
    found = [true / wanted for true, wanted in zip(true_rps, told, strict=False) if abs(wanted) >= TURNS_RPS]
    ratio = median(found) if found else 0.0
    if ratio <= 0 or scale.near(ratio, scale.WHEELS_FIT[True]):
        return ()
    return (
        f"THE SIMULATED WHEELS TURN {ratio:.2g} TIMES AS FAST AS COMMANDED: this simulated board has board.per_rps = "
        f"{per_rps / ratio:.4g}, the settings say {per_rps:.4g}, and reports that share the setting can't show it",
    )
