"""Records of the service as a whole, for clients and the service manager."""

from __future__ import annotations

from failstop.messages import layout, records
from failstop.policy.processes import PROCESS_BY_NAME
from failstop.supervisor.main import STOP_ANSWER_NS
from failstop.supervisor.status import NOTIFY_EVERY_NS
from tests.support.stage import MS
from tests.support.supervisor_scene import NOT_STARVED, Scene


def test_the_service_is_not_ready_before_its_stop_is_answered_and_its_port_open() -> None:
    scene = Scene(*PROCESS_BY_NAME)
    scene.has_port(layout.STOPPER)
    scene.answers()
    scene.turn()
    assert scene.word("ready").get() == 1
    scene.gate_stops()
    scene.turn()
    scene.turn(STOP_ANSWER_NS)
    assert scene.waits_for() == "a stop being carried out", "answered for an older epoch only"
    scene.answers()
    scene.turn()
    assert scene.waits_for() == ""
    scene.wire.unplug()
    scene.turn()
    assert scene.waits_for() == "the port"


def test_clients_are_told_the_settings(scene: Scene) -> None:
    assert scene.table("settings") == scene.settings.flat()
    namespace = scene.os.stat("/proc/self/ns/pid").st_ino
    assert namespace > 0
    rules = {"sources": ["cmd_vel"], "interlocks": [], "lease_ns": 60 * MS, "pid_namespace": namespace}
    assert scene.table("rules") == rules


def test_the_process_table_is_written_anew_when_it_changes(scene: Scene) -> None:
    scene.dies(layout.PORT_OWNER)
    scene.pass_time()
    gate = scene.employ(layout.GATE)
    scene.pass_time(MS)
    number, again = scene.number("processes"), scene.supervisor.processes[layout.PORT_OWNER].pid
    killed = {"last_exit": "killed by SIGKILL", "killed": True}
    never = {"pid": 0, "state": "waiting", "restarts": 0, "last_exit": None, "killed": False, "starts_at": 0}
    assert scene.table("processes") == {
        "waiting_for": "port_owner, stopper, telemetry",
        **NOT_STARVED,
        "processes": {
            "port_owner": {"pid": again, "state": "starting", "restarts": 1, **killed, "starts_at": 0},
            "stopper": never,
            "gate": {**never, "pid": gate.pid, "state": "running"},
            "telemetry": never,
        },
    }
    scene.pass_time(MS)
    assert scene.number("processes") == number


def test_clients_see_when_a_process_that_died_again_is_started(scene: Scene) -> None:
    for _ in range(2):
        scene.dies(layout.TELEMETRY)
        scene.pass_time()
    [row] = [row for name, row in scene.table("processes")["processes"].items() if name == layout.TELEMETRY]
    assert (row["state"], row["starts_at"]) == ("waiting", scene.now_ns + scene.settings.ns("restart.backoff_s"))


def heard(scene: Scene) -> list[str]:
    """Messages that a service manager gets from now on."""
    said: list[str] = []
    notify = scene.load("failstop.notify").Notify("/nowhere")
    notify.say = lambda message: not said.extend(message.split("\n"))
    scene.supervisor.status.notify = notify
    return said


def test_the_service_manager_is_told_first_of_wheels_that_turn_although_told_zero(scene: Scene) -> None:
    said = heard(scene)
    seen = records.WHEELS_SEEN.pack(2, 2, True, 2, 1, scene.now_ns, *[0.8] * 4, *[0.0] * 4)
    scene.telemetry.latest_writer("wheels").write(seen)
    scene.pass_time()
    assert said == [
        "STATUS=THE WHEELS TURN ALTHOUGH THEY ARE TOLD TO STOP; "
        "motion disabled, waiting for port_owner, stopper, gate, telemetry"
    ]


def test_the_service_manager_is_told_what_is_new(scene: Scene) -> None:
    said = heard(scene)
    scene.pass_time()
    assert said == ["STATUS=motion disabled, waiting for port_owner, stopper, gate, telemetry"]
    for name in PROCESS_BY_NAME:
        scene.employ(name)
    scene.has_port(layout.STOPPER)
    scene.answers()
    scene.pass_time(NOTIFY_EVERY_NS - MS)
    assert scene.supervisor.status.ever
    told = [(event["kind"], event["fields"].get("what")) for event in scene.events()]
    assert told[:3] == [("ready", None), ("rights", "SCHED_FIFO"), ("rights", "robust futexes")]
    assert len(said) == 1, "it is told ten times a second"
    scene.pass_time(MS)
    assert said[1:] == ["READY=1", "STATUS=ready, motion disabled"]
    scene.enabled(blocked="no scan", sources=[])
    scene.pass_time(NOTIFY_EVERY_NS)
    assert said[3:] == ["STATUS=motion enabled; blocked: no scan"]
    scene.gate_stops("bumper")
    scene.pass_time(NOTIFY_EVERY_NS)
    scene.answers(written_ns=scene.now_ns)
    scene.pass_time(NOTIFY_EVERY_NS)
    assert said[4:] == [
        "STATUS=stop latched: stop request: bumper; waiting for a stop being carried out",
        "STATUS=stop latched: stop request: bumper",
    ]


def test_the_status_names_who_is_down(scene: Scene) -> None:
    while scene.state(layout.TELEMETRY) != "down":
        scene.dies(layout.TELEMETRY)
        scene.pass_time()
    said = heard(scene)
    scene.pass_time(MS)
    (line,) = said
    assert line.startswith("STATUS=stop latched: telemetry died; telemetry died too often and is down until a reset")
    assert scene.supervisor.status.fault == "", "one that is down is no fault of the supervisor's"
