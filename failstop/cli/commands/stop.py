"""`failstop stop`, also called `failstop estop`: asks the running service to stop the robot. If that fails, the command
writes the stop to the port itself, for which it needs no service."""

from __future__ import annotations

import contextlib
import os
import time
from argparse import ArgumentParser, Namespace

from failstop import instances, stop_tool
from failstop.api.errors import FailstopError
from failstop.board.port import PortError
from failstop.cli import standard
from failstop.cli.commands import add_name
from failstop.cli.target import BAUD, CAN_ID, DEFAULTS, DEVICE, KIND, WAIT, Target
from failstop.data import Data

TYPE_CHECKING = False
if TYPE_CHECKING:
    from collections.abc import Callable


END_SERVICE_S = 12.0
"""How long the whole command may take with --end-service, in seconds. This is less than TimeoutStopSec of the systemd
unit, after which systemd kills this program."""
REST_S = 1.0
"""How long to wait for killed processes to end, in seconds. A process that is writing to a hanging port ends late."""

EXAMPLES = """\
failstop stop
failstop stop hand near wheel   # with a reason
failstop stop --device /dev/ttyACM1 --wait 60   # another port, for a minute
failstop stop --config /etc/failstop/failstop.toml
"""


def add_arguments(parser: ArgumentParser) -> None:
    """Define the options of `failstop stop`, which `failstop estop` has too."""
    device, wait_s = DEFAULTS[DEVICE], DEFAULTS[WAIT]
    parser.add_argument("reason", nargs="*", help="why you stop the robot; `failstop status` and the journal show it")
    add_name(parser)
    parser.add_argument(
        "--config",
        metavar="FILE",
        help="TOML file with settings (default: the installed file, if there is one); stop uses only "
        f"{DEVICE}, {KIND}, {BAUD}, {CAN_ID} and {WAIT}",
    )
    parser.add_argument(
        "--device",
        metavar="PATH",
        help=f"the board's port (default: {DEVICE} of the file given with --config, else the last run's port, "
        f"unless another device is there, else {DEVICE} of the installed file, else {device})",
    )
    parser.add_argument(
        "--wait",
        metavar="S",
        type=float,
        help=f"for how many seconds to keep trying (default: the setting {WAIT}, else {wait_s:g})",
    )
    parser.add_argument(
        "--services",
        action="store_true",
        help="ask every running service that this user can see to stop, but write to no port; only for the systemd "
        "unit that runs before the computer sleeps",
    )
    parser.add_argument(
        "--end-service",
        action="store_true",
        help="first kill (SIGKILL) all remaining processes of the service; only for its systemd unit (ExecStopPost); "
        "implies --last-port",
    )
    parser.add_argument(
        "--last-port",
        action="store_true",
        help="if the board of the last run is still at the port that this run had, write to it, even if the file given "
        "with --config names another port; then wait for that port and write to it too, if the service could not open "
        "it; only for the systemd units",
    )


def main(arguments: Namespace) -> int:
    """Run the command. Raises FailstopError if no stop could be written in time, and SettingError if the value of an
    option is not allowed.

    Returns 0 if a stop was written and there is no doubt about it. Returns 1 in each of these cases:

    - The stop may have gone to the wrong port.
    - Another process has the port open and was not asked, so it may drive on: a service, or any other program.
    - With --last-port, the settings name another port than the last run's, and no stop could be written there.
    - The board has not answered, although this kind of board answers. (With --end-service, this is printed, but does
      not make the result 1.)
    - A service has stopped, but the wheels may still turn, or this user can't see whether the stop was written.
    - With --services, a service has not confirmed its stop.
    - --end-service was used outside of the service's systemd unit.
    """
    with standard.never_waiting():
        return _stop(arguments)


def _stop(arguments: Namespace) -> int:
    reason, who = " ".join(arguments.reason), f"failstop {arguments.command}"
    if arguments.services:
        return _every_service(reason, who)
    start_s = time.monotonic()
    last_first = arguments.end_service or arguments.last_port
    order = Order(arguments.name, reason, who, Target(arguments, last_first=last_first))
    if arguments.end_service:
        return _end(order.target, start_s)
    why_not = ""
    for attempt in ATTEMPTS:
        if why_not:
            standard.say(f"{why_not}{NEXT}")
        outcome = attempt(order)
        if isinstance(outcome, int):
            return outcome
        why_not = outcome
    raise FailstopError(why_not)


class Order(Data):
    """A stop that the user has requested."""

    name: str
    """The name of the service."""
    reason: str
    who: str
    target: Target


Outcome = int | str
"""The result of one way to stop the robot. If a stop was written, it is the exit code. Otherwise it is a text that says
why not, which may be empty."""
NEXT = "; writing the stop to the port instead"


def _ask_services(order: Order) -> Outcome:
    """Ask the service `order.name` to stop the robot. If no service of that name is running, ask every service that may
    use the port instead.

    With --device, ask only the services at that port. If only the file given with --config names a port, still ask the
    service `order.name`, because its board may be at another port than the file says. Then go on to the port in the
    file, unless this service has that port or was started with that file.
    """
    try:
        target, why_not = order.target, ""
        device = target.wanted()
        if (last := target.of_dead_run()) is not None:
            # The settings' port may be another robot's by now. Its service can't stop this robot.
            if not last:
                return ""
            device = last
        first = order.name if not device or target.only_file_names_port() else ""
        if first and instances.listens(first):
            outcome = _ask(order, [first], "")
            if not device or (isinstance(outcome, int) and _has_the_robot(target, first, device)):
                return outcome
            why_not = "" if isinstance(outcome, int) else outcome
        running = [name for name in instances.listening() if name not in (*target.asked, *target.confirmed)]
        outcome = _ask(order, running, device or target.device()) if running else ""
        return outcome if isinstance(outcome, int) else "; ".join(filter(None, (why_not, outcome)))
    except Exception as error:  # whatever has failed, the stop can still be written to the port
        return f"no service could be asked ({error})"


def _has_the_robot(target: Target, name: str, device: str) -> bool:
    """Return True if the robot that the user meant is the one of this service, which has just stopped it. `device`: the
    port in the file that the user has named."""
    from failstop.api import ask

    its = ask.port_of(name)
    if its and ask.same(its, device):
        return True
    if not target.is_file_of(name):
        return False
    if its:
        standard.print_line(f"its board is at {its}, not at {device} as the file given with --config says")
    return True


def _ask(order: Order, names: list[str], device: str) -> Outcome:
    """Ask these services one after the other, until one has stopped the robot. If `device` is not empty, skip services
    that use a different port, unless only a file names the port and the service was started with that file."""
    # Imported only here. If no service is running, the stop must not wait for these imports.
    from failstop.api import ask
    from failstop.api.client import send_stop

    target, why_not = order.target, []
    by_file = target.only_file_names_port()
    for name in names:
        its = ask.port_of(name) if device else ""
        if device and not its and name == order.name:
            with contextlib.suppress(FailstopError):
                # This service may hold the port. If it doesn't, one stop too many does no harm.
                send_stop(name, order.reason, order.who)
        elif device and not (its and ask.same(its, device)) and not (by_file and target.is_file_of(name)):
            continue
        else:
            done, problem, doubt = ask.stop(name, order.reason, order.who)
            if done:
                target.confirmed.append(name)
                target.unproved |= doubt
                standard.print_line(done)
                if problem:
                    standard.say(problem)
                # The port may be only a guess, and the robot that was meant may be at another one.
                doubtful = name != order.name and not target.wanted() and target.stopped_by_another(name)
                target.complain()
                return int(target.unproved or doubtful)
            why_not.append(problem)
            target.learn(name, ask.port_of(name), ask.owner_of(name))
        target.asked.append(name)
    return "; ".join(filter(None, why_not))


def _write_to_port(order: Order) -> Outcome:
    """Write the stop to the port itself, and try again until it is written or the waiting time (--wait) is over. If
    another process holds the port, ask a service that has just been started. If the port of the last run can't be used,
    try the port that the settings name."""
    target = order.target
    by_service: list[int] = []

    def otherwise(error: PortError) -> bool:
        if error.kind == "busy":
            by_service.extend(_ask_late_service(order))
            return bool(by_service)
        return (error.kind == "absent" or target.is_not_theirs(error)) and target.wrote_instead(error)

    try:
        after_s = target.stop(otherwise=otherwise)
    except PortError as error:
        return target.explained(error)
    if by_service:
        return int(by_service[0] or target.unproved)
    why = "" if target.asked or target.wanted() else f" (no service {order.name!r} runs)"
    # The bytes are for this kind of board. Another board would ignore them, so the text says which board they are for.
    whose, unless = (
        (f" for {target.board().name}", "; no settings name another board") if target.assumes_kind() else ("", "")
    )
    sent = f"stop frame{whose} sent (after {after_s:.1f} s), directly to {target.described()}{why}{unless}"
    standard.print_line(sent)
    unheard, bypassed = target.unheard(patient=True), target.bypassed()
    doubtful = target.doubtful()
    missed = target.missed()  # if True, systemd starts failstop-late again, which goes on trying
    return int(doubtful or unheard or bypassed or missed or target.unproved)


ATTEMPTS: tuple[Callable[[Order], Outcome], ...] = (_ask_services, _write_to_port)
"""The ways to stop, in the order in which they are tried. The first one that returns an exit code ends the command."""


def _ask_late_service(order: Order) -> list[int]:
    """Ask the service `order.name` to stop the robot, but only once, and only if it was started after the first
    attempt. Returns a list with the exit code if the service has stopped the robot, else an empty list."""
    target = order.target
    if order.name in (*target.asked, *target.confirmed) or not instances.listens(order.name):
        return []
    outcome = _ask_services(order)
    if isinstance(outcome, int):
        return [outcome]
    if outcome:
        standard.say(f"{outcome}{NEXT}")
    if order.name not in target.asked:
        target.asked.append(order.name)
    return []


def _end(target: Target, start_s: float) -> int:
    """End the service: kill its remaining processes, and write the stop to its port."""
    misused = not _end_service()
    try:
        after_s = target.stop(END_SERVICE_S - (time.monotonic() - start_s))
    except PortError as error:
        raise FailstopError(target.explained(error)) from None
    standard.print_line(f"stop frame sent (after {after_s:.1f} s)")
    target.unheard(patient=False)  # only printed, because the unit has not failed
    doubtful = target.doubtful()
    # The result is that of the last run's board, which the service has driven.
    target.missed(END_SERVICE_S - (time.monotonic() - start_s))
    return int(doubtful or misused)


def _every_service(reason: str, who: str) -> int:
    """Ask every running service to stop its robot. Returns 0 if every service has confirmed its stop and there is no
    doubt about it, else 1."""
    from failstop.api import ask

    answers = [ask.stop(name, reason, who) for name in instances.listening()]
    for done, problem, _ in answers:
        if done:
            standard.print_line(done)
        if problem:
            standard.say(problem)
    return int(not all(done and not doubt for done, _, doubt in answers))


def _end_service() -> bool:
    """Kill (SIGKILL) the other processes of this service. If the service's systemd unit does not run this process, kill
    nothing, and return False."""
    try:
        if "SERVICE_RESULT" not in os.environ or not stop_tool.of_a_service():
            standard.say(
                "nothing killed: --end-service kills the rest of the control group, and is for ExecStopPost in the "
                "systemd unit; by hand use `failstop stop` without it"
            )
            return False
        killed, left = stop_tool.kill_rest(REST_S)
    except OSError as error:
        standard.say(f"cannot kill what is left of the service: {error}")
        return True
    if killed:
        standard.say(f"killed what was left of the service: {killed} processes")
    if left:
        standard.say(f"{left} of them have not ended within {REST_S:g} s")
    return True
