"""The check of the stop path: what its self-test found, or why that was left out."""

from __future__ import annotations

from failstop.api.errors import FailstopError
from failstop.doctor.device import BOARD_USB
from failstop.doctor.finding import Finding, fail, ok, skip, warn
from failstop.doctor.stop_test import SLOW_ANSWER_MS, StopPath, StopTest, by_hand, by_service, no_right

TYPE_CHECKING = False
if TYPE_CHECKING:
    from failstop.doctor.look import Look


def stop_path(look: Look) -> list[Finding]:
    """Each writer's burst, and the board's answer behind it."""
    found = []
    tested = look.stops or tried(look)
    for writer, written, answered_ms, problem in tested.stops:
        if problem:
            advice = "once that is seen to; wheels that turn: the POWER SWITCH"
            found += fail(f"{writer}: {problem}", look.again(), advice)
        elif not written:
            found += fail(f"{writer}: the burst could not be written", "", "unplug the board and plug it in again")
        elif answered_ms is None:
            text = f"{writer}: the burst was written, and the board did not answer the ping behind it"
            found += fail(text, look.again(), "is it the board? if so, cut its power and try again")
        elif answered_ms > SLOW_ANSWER_MS:
            text = f"{writer}: acknowledged by the board after {answered_ms:.1f} ms, which is late"
            found += warn(text, look.again(), "once more on a quiet machine")
        else:
            found += ok(f"{writer}: acknowledged by the board after {answered_ms:.1f} ms")
    if tested.skipped:
        told = warn if look.stop_wanted else skip
        fix = tested.fix
        found += told(f"not tested: {tested.skipped}", fix, "" if fix else "see to that first")
    return found


def tried(look: Look) -> StopPath:
    """The self-test where it is safe, else why it was left out."""
    node, (holders, _) = look.node, look.holders
    if look.service:
        return _of_service(look)
    if node is None or not node.character:
        return StopPath(skipped="there is no port")
    if not node.accessible:
        return StopPath(skipped="this user may not open the port")
    if holders:
        return StopPath(skipped=f"{holders[0].name} (pid {holders[0].pid}) has the port open")
    if not (look.named or node.pseudo or node.usb_id == BOARD_USB):
        unsure = f"{node.path} may not be the board, and it is not written to"
        return StopPath(skipped=unsure, fix=f"failstop doctor --device {node.path}")
    return StopPath(by_hand(node.path))


def _of_service(look: Look) -> StopPath:
    test = f"failstop doctor --stop-test --name {look.name}"
    if not (state := look.state):
        return StopPath(skipped="the running service can't be asked")
    if state.enabled:
        return StopPath(skipped="motion is enabled", fix=f"failstop disable --name {look.name}")
    if state.cause:
        return StopPath(skipped=f"a stop is latched already ({state.cause})", fix=f"failstop reset --name {look.name}")
    if not look.stop_wanted:
        return StopPath(skipped="the service runs, and would be stopped once and reset", fix=test)
    if problem := no_right(look.name):
        return StopPath(skipped=problem, fix=f"sudo {test}")
    try:
        return StopPath(by_service(look.name))
    except FailstopError as error:
        return StopPath((StopTest("port owner, by a stop request", False, None, str(error)),))
