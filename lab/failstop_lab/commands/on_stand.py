"""`failstop chaos --device`: the campaign on a real board, on a stand."""

from __future__ import annotations

import os
import sys
import tempfile
import time
from argparse import Namespace
from collections.abc import Callable, Iterator

from failstop import config, instances
from failstop.api.errors import FailstopError, Refused
from failstop.cli import style
from failstop.files.instance import DEFAULT_NAME
from failstop.setup.ending import interruptible
from failstop_lab.commands import check_json, matching, write_json
from failstop_lab.prove import random_runs, report
from failstop_lab.prove.random_runs import Draw
from failstop_lab.prove.session import check_free, session
from failstop_lab.prove.stand import ProveStand
from failstop_lab.prove.table import Path, Turning, within

WARNING = """\
THIS TURNS THE WHEELS on {device}, \
and kills the programs that stop them, at random. Ctrl-C stops the wheels. Keep \
the POWER SWITCH at hand. The stops are judged by the board's answers and its IMU."""


def run(arguments: Namespace, seed: int, default_s: float) -> int:
    """Make the campaign; the exit code of `failstop chaos`. Raises Refused without both consents."""
    device: str = arguments.device
    _check(arguments, device)
    chosen = _chosen(arguments.only)
    if not os.path.exists(device):
        raise FailstopError(f"no device {device}: plug the board in, or give another --device")
    path = config.chosen(DEFAULT_NAME, arguments.config)
    config.load(path)
    check_free(device, DEFAULT_NAME, *instances.listening())
    check_json(arguments.json)
    style.warn(WARNING.format(device=device))
    print(f"seed {seed}, {len(chosen)} stop paths", file=sys.stderr, flush=True)
    with interruptible(), tempfile.TemporaryDirectory(prefix="failstop-chaos-", ignore_cleanup_errors=True) as folder:
        stand = ProveStand(device, config.read(path), folder)
        width = max(len(path.name) for path in chosen)
        velocities = within(stand.settings)
        draws = _draws(arguments, chosen, seed, default_s, velocities)
        evidence = session(draws, velocities, stand, say=report.print_now, tool="chaos", keep_all=False, width=width)
    print("\n" + "\n".join([*random_runs.table_lines(evidence.results), "", *report.last_lines(evidence)]), flush=True)
    if arguments.json:
        write_json(arguments.json, {"seed": seed, **evidence.as_dict()})
    print(f"to repeat it: the same options and --seed {seed}", file=sys.stderr)
    return evidence.exit_code


def _check(arguments: Namespace, device: str) -> None:
    """Raises Refused, FailstopError."""
    given = {"--on-the-stand": arguments.on_the_stand, "--wheels-are-free": arguments.wheels_are_free}
    if missing := [word for word, consent in given.items() if not consent]:
        raise Refused(f"{device} moves real wheels: put the robot on a stand, then add {' '.join(missing)}")
    if arguments.markdown or arguments.source:
        raise FailstopError("--markdown and --from go with a simulated board; use --json FILE to keep this result")


def _chosen(only: str | None) -> list[Path]:
    missing = "no stop path {} on a stand; `failstop chaos --device PATH --list` has them"
    return matching(only, random_runs.paths(), missing)


def list_paths(only: str | None) -> None:
    """Print what can be done on a stand."""
    for path in _chosen(only):
        print(f"{path.name:<{random_runs.WIDTH}} {path.words}")


def _draws(
    arguments: Namespace, chosen: list[Path], seed: int, default_s: float, velocities: list[Turning]
) -> Iterator[Draw]:
    if arguments.each is not None:
        plan = [path for path in chosen for _ in range(arguments.each)]
        return ((path, *random_runs.draw([path], index, seed, velocities)[1:]) for index, path in enumerate(plan))
    if arguments.count is not None:
        return random_runs.draws(chosen, seed, lambda made: made >= arguments.count, arguments.first, velocities)
    seconds = default_s if arguments.seconds is None else arguments.seconds
    return random_runs.draws(chosen, seed, _after(seconds), arguments.first, velocities)


def _after(seconds: float) -> Callable[[int], bool]:
    """True when so many have passed since it was asked first: the robot's character is known by then."""
    until_s = 0.0

    def over(made: int) -> bool:
        nonlocal until_s
        until_s = until_s or time.monotonic() + seconds
        return made > 0 and time.monotonic() >= until_s

    return over
