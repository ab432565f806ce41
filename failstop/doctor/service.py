"""The checks of the service: what runs, of which version, by which settings, and what systemd and logind are told."""

from __future__ import annotations

import shlex

from failstop.api import words
from failstop.doctor.look import Finding, Look, fail, ok, skip, warn
from failstop.doctor.system import SHM, System
from failstop.instances import unit_of
from failstop.ros2 import transport
from failstop.shm.instance import option
from failstop.version import VERSION

FIRST_REGULAR_UID = 1000
"""logind spares system users (below this, as Debian and Ubuntu count)."""
LOGIND = "/etc/systemd/logind.conf.d"
BRIDGE = "ros2"
"""Its name among the clients."""
FAST_DDS = "fastrtps_"
"""What every process with Fast DDS has in /dev/shm, of the user that it runs as."""


def settings(look: Look) -> list[Finding]:
    """The settings that a start would read."""
    path, _, problem = look.settings
    if problem:
        text = f"{problem}: the service does not start with them"
        return fail(text, f"failstop config --check {shlex.quote(path)}", "after the correction")
    return ok(path or "no file: every setting has its default")


def running(look: Look) -> list[Finding]:
    """The service of this name."""
    service = look.service
    if service is None:
        return _not_running(look)
    if not (state := service.state):
        return []
    where = f"{look.name!r} runs (pid {service.pid}, user {service.user})"
    if state.waiting_for:
        return warn(f"{where} and waits for {state.waiting_for}", f"failstop status --name {look.name}")
    if state.device.link == "deaf":
        return fail(f"{where}, and the board does not answer", "", "cut the motors' power with the POWER SWITCH")
    if state.device.link == "unproven":
        text = f"{where}; the board has not answered a ping yet"
        return warn(text, f"failstop status --name {look.name}", "is it the right device?")
    motion = f"stopped: {state.cause}" if state.cause else "enabled" if state.enabled else "disabled"
    found = ok(f"{where}, device {state.device.state}, the board answers, motion {motion}")
    wrong = state.arm.wrong if state.arm else ()
    return found + [row for text in wrong for row in warn(f"the arm: {text}", f"failstop arm --name {look.name}")]


def _not_running(look: Look) -> list[Finding]:
    text = f"no service named {look.name!r} runs: nothing drives, and nothing would stop wheels that turn"
    if look.others:
        text += f" (there is {', '.join(look.others)})"
    name = unit_of(look.name)
    if look.installed:
        if (active := look.unit["ActiveState"]) == "inactive":
            return warn(text, f"sudo systemctl start {name}")
        return warn(text, f"journalctl -eu {name}", f"{name} is {active}: see unit")
    if look.node is None:
        return warn(text, "", "first see to the port")
    path = look.settings[0]
    config = f" --config {shlex.quote(path)}" if path else ""
    return warn(text, f"failstop run{option(look.name)}{config} --device {shlex.quote(look.device[0])}")


def clients(look: Look) -> list[Finding]:
    """What clients say of themselves."""
    if not look.state:
        return []
    found = []
    for who, sees, wrong in words.said(look.state):
        found += warn(f"{who} says: {wrong}", f"failstop why --name {look.name}") if wrong else ok(f"{who}: {sees}")
    return found or ok("none says anything of itself")


def bridge(look: Look) -> list[Finding]:
    """The bridge to ROS 2, and whether it can hear the robot's nodes."""
    system = look.system
    files = (f"{SHM}/{name}" for name in system.names(SHM) if name.startswith(FAST_DDS))
    users = sorted({owner for path in files if (owner := system.owner(path))})
    pid = next((client.pid for client in look.state.clients if client.name == BRIDGE), 0) if look.state else 0
    if not pid:
        if not users:
            return ok("no ROS 2 node runs here")
        text = f"ROS 2 nodes of {', '.join(users)} run here (or have left files), and no bridge is connected"
        return skip(text, "sudo failstop install --ros2-user NAME", "NAME: the user of the robot's nodes")
    user = system.owner(f"/proc/{pid}")
    given = (system.read(f"/proc/{pid}/environ") or "").split("\0")
    # With one of the user's own it may use shared memory.
    own_profile = transport.own_profile(dict(word.split("=", 1) for word in given if "=" in word))
    where = f"the bridge is connected (pid {pid}, user {user})"
    others = [name for name in users if name != user]
    if others and own_profile:
        text = f"{where}, and Fast DDS of {', '.join(others)} is here: nodes of two users exchange no data"
        advice = "or start the bridge without a Fast DDS profile: then it takes UDP alone"
        return warn(text, f"sudo failstop install --ros2-user {others[0]}", advice)
    return ok(f"{where}{'' if own_profile else ', by UDP alone'}")


def version(look: Look) -> list[Finding]:
    """Service and client speak the same layout."""
    service = look.service
    if service is None:
        return ok(f"this is failstop {VERSION}")
    restart = (f"sudo kill {service.pid}", "it stops the wheels; then start it again")
    if look.unit.get("ActiveState") == "active":
        restart = (f"sudo systemctl restart {unit_of(look.name)}", "it stops the wheels")
    if service.problem:
        return fail(service.problem, *restart)
    if service.version != VERSION:
        text = f"the service is {service.version}, this command {VERSION}; they still understand each other"
        return warn(text, *restart)
    return ok(f"service and command are failstop {service.version}")


def unit(look: Look) -> list[Finding]:
    """Its systemd unit."""
    if not look.systemd:
        return skip("systemd does not run here: nobody starts the service at boot or after a death")
    name, found = unit_of(look.name), look.unit
    if not found:
        return warn("systemd does not answer this user", f"sudo {look.again()}")
    load, active, sub, result = (found.get(key, "") for key in ("LoadState", "ActiveState", "SubState", "Result"))
    if load == "not-found":
        return warn(f"no unit {name}: nobody starts the service at boot or after a death", "sudo failstop install")
    if load != "loaded":
        return fail(f"{name} is {load}", f"systemd-analyze verify {name}")
    if active == "failed" or result not in ("", "success"):
        return fail(f"{name} is {active} (result: {result})", f"journalctl -xeu {name}")
    if (restarts := found.get("NRestarts") or "0") != "0":
        text = f"{name} is {active} ({sub}), and systemd has restarted it {restarts} times"
        return (warn if active == "active" else fail)(text, f"journalctl -xeu {name}")
    if found.get("NeedDaemonReload") == "yes":
        return warn(f"{name} has changed on disk since systemd read it", "sudo systemctl daemon-reload")
    if look.service and active == "active" and (pid := found.get("MainPID") or "0") != str(look.service.pid):
        text = f"{look.name!r} runs as pid {look.service.pid}, which is not of {name} (pid {pid})"
        return warn(text, f"failstop status --name {look.name}")
    if found.get("UnitFileState") not in ("enabled", "enabled-runtime", "static"):
        return warn(f"{name} is {active} and not started at boot", f"sudo systemctl enable {name}")
    return ok(f"{name} is {active} ({sub}), started at boot")


def remove_ipc(look: Look) -> list[Finding]:
    """logind deletes the shared memory of a regular user who logs out."""
    if not look.systemd:
        return []
    on, origin = logind_removes(look.system)
    who = look.service_user or look.user
    where = f"RemoveIPC is {'on' if on else 'off'} ({origin or 'the default'})"
    if on and who.uid >= FIRST_REGULAR_UID:
        text = f"{where}: the service's shared memory goes when {who.name} logs out"
        fix = f"sudo mkdir -p {LOGIND} && printf '[Login]\\nRemoveIPC=no\\n' | sudo tee {LOGIND}/failstop.conf"
        return warn(text, fix, "in force after the next boot; or run it as the system user failstop")
    return ok(f"{where}; it does not concern {who.name}" if on else where)


def logind_removes(system: System) -> tuple[bool, str]:
    """RemoveIPC and the file that says so: the last word counts of all that logind reads, which systemd shows in order,
    each file below a line `# PATH`."""
    found, path = (True, ""), ""
    shown = system.said("systemd-analyze", f"--root={system.root}", "cat-config", "systemd/logind.conf")
    for line in (shown or "").splitlines():
        key, _, value = line.partition("=")
        if line.startswith("# /"):
            path = line.removeprefix("# ")
        elif key.strip() == "RemoveIPC":
            found = value.strip().lower() in ("yes", "true", "on", "1", "y", "t"), path
    return found
