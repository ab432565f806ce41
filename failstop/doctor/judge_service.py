"""What the facts of the service, its unit and its stop path mean. Pure."""

from __future__ import annotations

import shlex

from failstop.api import words
from failstop.doctor.facts import Facts, again
from failstop.doctor.finding import Finding, fail, ok, skip, warn
from failstop.doctor.service_facts import client_version
from failstop.install.layout import unit_of
from failstop.shm.instance import option

FIRST_REGULAR_UID = 1000
"""logind spares system users (below this, as Debian and Ubuntu count)."""
LOGIND = "/etc/systemd/logind.conf.d"
SHOWN = 3
SLOW_ANSWER_MS = 100.0
"""The burst takes 4 ms on the wire, ping and answer 0.2; a service leaves 50 ms between two pings."""


def running(facts: Facts) -> list[Finding]:
    """The service of this name."""
    service = facts.service
    if service is None:
        return _not_running(facts)
    if not (state := service.state):
        return []
    where = f"{facts.name!r} runs (pid {service.pid}, user {service.user})"
    if state.waiting_for:
        return warn(f"{where} and waits for {state.waiting_for}", f"failstop status --name {facts.name}")
    if state.device.link == "deaf":
        return fail(f"{where}, and the board does not answer", "", "cut the motors' power with the POWER SWITCH")
    if state.device.link == "unproven":
        text = f"{where}; the board has not answered a ping yet"
        return warn(text, f"failstop status --name {facts.name}", "is it the right device?")
    motion = f"stopped: {state.cause}" if state.cause else "enabled" if state.enabled else "disabled"
    found = ok(f"{where}, device {state.device.state}, the board answers, motion {motion}")
    wrong = state.arm.wrong if state.arm else ()
    return found + [row for text in wrong for row in warn(f"the arm: {text}", f"failstop arm --name {facts.name}")]


def _not_running(facts: Facts) -> list[Finding]:
    text = f"no service named {facts.name!r} runs: nothing drives, and nothing would stop wheels that turn"
    others = [name for name in facts.memory.living if name != facts.name]
    if others:
        text += f" (there is {', '.join(others[:SHOWN])}{' and more' if len(others) > SHOWN else ''})"
    name = unit_of(facts.name)
    if facts.unit and facts.unit.load == "loaded":
        if facts.unit.active == "inactive":
            return warn(text, f"sudo systemctl start {name}")
        return warn(text, f"journalctl -eu {name}", f"{name} is {facts.unit.active}: see unit")
    if facts.node is None:
        return warn(text, "", "first see to the port")
    config = f" --config {shlex.quote(facts.settings_file)}" if facts.settings_file else ""
    return warn(text, f"failstop run{option(facts.name)}{config} --device {shlex.quote(facts.device)}")


def clients(facts: Facts) -> list[Finding]:
    """What clients say of themselves."""
    if not facts.state:
        return []
    found = []
    for who, sees, wrong in words.said(facts.state):
        found += warn(f"{who} says: {wrong}", f"failstop why --name {facts.name}") if wrong else ok(f"{who}: {sees}")
    return found or ok("none says anything of itself")


def settings(facts: Facts) -> list[Finding]:
    """The settings that a start would read."""
    if facts.settings_problem:
        text = f"{facts.settings_problem}: the service does not start with them"
        return fail(text, f"failstop config --check {shlex.quote(facts.settings_file)}", "after the correction")
    return ok(facts.settings_file or "no file: every setting has its default")


def version(facts: Facts) -> list[Finding]:
    """Service and client speak the same layout."""
    service = facts.service
    if service is None:
        return ok(f"this is failstop {client_version()}")
    if service.problem:
        return fail(service.problem, *_restart(facts))
    if service.version != client_version():
        text = f"the service is {service.version}, this command {client_version()}; they still understand each other"
        return warn(text, *_restart(facts))
    return ok(f"service and command are failstop {service.version}")


def _restart(facts: Facts) -> tuple[str, str]:
    """The command that ends a service of another version; it stops the wheels."""
    if facts.unit and facts.unit.active == "active":
        return f"sudo systemctl restart {facts.unit.name}", "it stops the wheels"
    return f"sudo kill {facts.service.pid if facts.service else 0}", "it stops the wheels; then start it again"


def unit(facts: Facts) -> list[Finding]:
    """Its systemd unit."""
    if not facts.systemd:
        return skip("systemd does not run here: nobody starts the service at boot or after a death")
    found = facts.unit
    name = unit_of(facts.name)
    if found is None:
        return warn("systemd does not answer this user", f"sudo {again(facts)}")
    if found.load == "not-found":
        return warn(f"no unit {name}: nobody starts the service at boot or after a death", "sudo failstop install")
    if found.load != "loaded":
        return fail(f"{name} is {found.load}", f"systemd-analyze verify {name}")
    if found.active == "failed" or found.result not in ("", "success"):
        return fail(f"{name} is {found.active} (result: {found.result})", f"journalctl -xeu {name}")
    if found.restarts:
        text = f"{name} is {found.active} ({found.sub}), and systemd has restarted it {found.restarts} times"
        return (warn if found.active == "active" else fail)(text, f"journalctl -xeu {name}")
    if found.needs_reload:
        return warn(f"{name} has changed on disk since systemd read it", "sudo systemctl daemon-reload")
    if facts.service and found.active == "active" and found.main_pid != facts.service.pid:
        text = f"{facts.name!r} runs as pid {facts.service.pid}, which is not of {name} (pid {found.main_pid})"
        return warn(text, f"failstop status --name {facts.name}")
    if found.enabled not in ("enabled", "enabled-runtime", "static"):
        return warn(f"{name} is {found.active} and not started at boot", f"sudo systemctl enable {name}")
    return ok(f"{name} is {found.active} ({found.sub}), started at boot")


def remove_ipc(facts: Facts) -> list[Finding]:
    """logind deletes the shared memory of a regular user who logs out."""
    found = facts.remove_ipc
    if found is None:
        return []
    who = facts.service_user or facts.user
    where = f"RemoveIPC is {'on' if found.on else 'off'} ({found.origin or 'the default'})"
    if found.on and who.uid >= FIRST_REGULAR_UID:
        text = f"{where}: the service's shared memory goes when {who.name} logs out"
        fix = f"sudo mkdir -p {LOGIND} && printf '[Login]\\nRemoveIPC=no\\n' | sudo tee {LOGIND}/failstop.conf"
        return warn(text, fix, "in force after the next boot; or run it as the system user failstop")
    return ok(f"{where}; it does not concern {who.name}" if found.on else where)


def stop_path(facts: Facts) -> list[Finding]:
    """Each writer's burst, and the board's answer behind it."""
    found = []
    for test in facts.stops:
        if test.problem:
            advice = "once that is seen to; wheels that turn: the POWER SWITCH"
            found += fail(f"{test.writer}: {test.problem}", again(facts), advice)
        elif not test.written:
            found += fail(f"{test.writer}: the burst could not be written", "", "unplug the board and plug it in again")
        elif test.answered_ms is None:
            text = f"{test.writer}: the burst was written, and the board did not answer the ping behind it"
            found += fail(text, again(facts), "is it the board? if so, cut its power and try again")
        elif test.answered_ms > SLOW_ANSWER_MS:
            text = f"{test.writer}: acknowledged by the board after {test.answered_ms:.1f} ms, which is late"
            found += warn(text, again(facts), "once more on a quiet machine")
        else:
            found += ok(f"{test.writer}: acknowledged by the board after {test.answered_ms:.1f} ms")
    if facts.stop_skipped:
        advice = "" if facts.stop_fix else "see to that first"
        found += (warn if facts.stop_wanted else skip)(f"not tested: {facts.stop_skipped}", facts.stop_fix, advice)
    return found
