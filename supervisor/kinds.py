"""Kinds: every kind of event there is - its level, its MESSAGE_ID, its fields, and what the catalog says of it.

`journalctl -x` shows the catalog's text below an entry; systemd/failstop.catalog is made from this table
(`python -m failstop.cli.catalog`). A MESSAGE_ID, once given, never changes its meaning.
"""

from __future__ import annotations

LEVELS = {"critical": 2, "error": 3, "warning": 4, "notice": 5, "info": 6}
"""The journal's PRIORITY of each level."""


class EventKind:
    """One kind of event. `fields`: those that every event of the kind has; `body`: what it means and what to do, with
    @FIELD@ for a field's value."""

    __slots__ = ("body", "fields", "level", "message_id", "name", "subject")

    def __init__(
        self, name: str, level: str, message_id: str, fields: tuple[str, ...], subject: str, body: str
    ) -> None:
        self.name = name
        self.level = level
        self.message_id = message_id
        self.fields = fields
        self.subject = subject
        self.body = body


KINDS = (
    EventKind(
        "ready",
        "notice",
        "019484cdaf0545c2b4ff5e8fc487d4bb",
        (),
        "@FAILSTOP_NAME@ is ready",
        "Every process runs, the port is open and the wheels were told to stop. Motion is disabled.\n"
        "Next: failstop enable --name @FAILSTOP_NAME@",
    ),
    EventKind(
        "waiting",
        "warning",
        "e12d029f8969465ebe24b87501c4fa50",
        ("for",),
        "@FAILSTOP_NAME@ waits for @FAILSTOP_FOR@",
        "Motion can't be enabled until it is there; the wheels are told to stop meanwhile.\n"
        "For the port: is the board plugged in and powered, and is device.path its path? For a process: the journal\n"
        "says how it died.\n"
        "Next: failstop doctor --name @FAILSTOP_NAME@",
    ),
    EventKind(
        "stop",
        "warning",
        "d64c7adf98c047808bc2802fe77d504b",
        ("reason", "noticed_by", "written_by", "epoch"),
        "Stop latched: @FAILSTOP_REASON@",
        "A latched protective stop. Noticed by: @FAILSTOP_NOTICED_BY@. The stop frame was handed to the kernel by:\n"
        "@FAILSTOP_WRITTEN_BY@, FAILSTOP_LATENCY_US after the notice. By nobody: it could NOT be written, so use the\n"
        "POWER SWITCH. Whether the board and the wheels obeyed is told by the entry stop_outcome that follows within\n"
        "two seconds. Nothing moves until people reset and enable.\n"
        "Next: see to the cause, then failstop reset and failstop enable, each with --name @FAILSTOP_NAME@",
    ),
    EventKind(
        "stop_again",
        "warning",
        "2c6e64c285a7435ab4556b269c245db3",
        ("reason", "noticed_by", "written_by", "epoch", "latched"),
        "Stopped again: @FAILSTOP_REASON@",
        "Another cause while a stop is latched for: @FAILSTOP_LATCHED@. The first cause is the one to look for.\n"
        "Next: journalctl -x FAILSTOP_EVENT=stop FAILSTOP_NAME=@FAILSTOP_NAME@",
    ),
    EventKind(
        "stop_also",
        "notice",
        "16e91c030a5347e792e929e9f1a13adb",
        ("reason", "noticed_by"),
        "The same stop, also noticed as: @FAILSTOP_REASON@",
        "Several causes came at once, or several processes noticed the same one. Nothing is to be done beyond the\n"
        "stop itself.",
    ),
    EventKind(
        "stop_outcome",
        "notice",
        "fc05c1f31f724be5bca7cd7dd6834b42",
        ("reason", "link"),
        "What became of the stop: @FAILSTOP_REASON@",
        "Two proofs beyond the written bytes. acknowledged: the board answered a ping that was sent after the stop\n"
        "(FAILSTOP_ACKNOWLEDGED_US from the cause). observed: the IMU saw the wheels come to rest\n"
        "(FAILSTOP_OBSERVED_MS). What is missing is not known; it does not say that the wheels turn.\n"
        "Next: if the wheels were NOT seen still, use the POWER SWITCH; else failstop status --name @FAILSTOP_NAME@",
    ),
    EventKind(
        "unstill",
        "critical",
        "f71aa7ca3afa4b01a9932952acebe386",
        ("reason",),
        "The wheels do not come to rest",
        "A stop was written for: @FAILSTOP_REASON@. The IMU still shakes: the board does not obey, or somebody\n"
        "pushes the robot. The stop is written again and again, and still.command is run where there is one.\n"
        "Next: use the POWER SWITCH. Software can do no more.",
    ),
    EventKind(
        "died",
        "error",
        "1e64f97a9f8242b9bbd9dac4d3533ca8",
        ("process", "pid", "how"),
        "@FAILSTOP_PROCESS@ died",
        "Process @FAILSTOP_PID@ @FAILSTOP_HOW@. Its death was a stop cause; how it died is known only now.\n"
        "Next: journalctl _PID=@FAILSTOP_PID@, and coredumpctl info @FAILSTOP_PID@ where it crashed",
    ),
    EventKind(
        "restarting",
        "notice",
        "839c001330c04363ace8f58dd80349f3",
        ("process", "wait_s"),
        "@FAILSTOP_PROCESS@ is started anew",
        "In @FAILSTOP_WAIT_S@ s. A restarted process never enables motion again: that is for people.\n"
        "Next: failstop status --name @FAILSTOP_NAME@",
    ),
    EventKind(
        "down",
        "critical",
        "d425ec3582c843a999835f153362effe",
        ("process",),
        "@FAILSTOP_PROCESS@ is down",
        "It died too often (settings restart.deaths, restart.window_s). The wheels are told to stop and the status is\n"
        "served, but motion can't be enabled before a reset, which starts the process anew. The gate, which hears\n"
        "resets, is started anew after a minute.\n"
        "Next: journalctl FAILSTOP_EVENT=died FAILSTOP_PROCESS=@FAILSTOP_PROCESS@; see to the cause; then\n"
        "failstop reset --name @FAILSTOP_NAME@",
    ),
    EventKind(
        "start_failed",
        "error",
        "136159b2497249b0a1a23e57aa59480a",
        ("process", "reason"),
        "@FAILSTOP_PROCESS@ could not be started",
        "@FAILSTOP_REASON@. It is tried again twice a second; motion waits for it.\n"
        "Next: look for what the machine is short of: memory, processes, file descriptors",
    ),
    EventKind(
        "not_started",
        "error",
        "192201d8d49d43efb4ce40b1729976ac",
        ("reason",),
        "@FAILSTOP_NAME@ could not be started",
        "@FAILSTOP_REASON@. The stop was written before; nothing watches the robot from here on.\n"
        "Next: see to the reason, then start the service again",
    ),
    EventKind(
        "fenced",
        "error",
        "61960dd921854ce5960e3d28f97288ee",
        ("process", "pid", "silent_ms", "kill_us"),
        "@FAILSTOP_PROCESS@ hung and was fenced",
        "It was silent for @FAILSTOP_SILENT_MS@ ms, so it was killed: what it still wanted to write can't happen.\n"
        "The times are from the notice to the kill and to the end of the process; for the port owner also to the\n"
        "stops on the supervisor's own descriptor, one after the kill and one after the end.\n"
        "Next: was the machine overloaded or frozen? failstop doctor --name @FAILSTOP_NAME@ looks for real-time rights",
    ),
    EventKind(
        "starved",
        "warning",
        "3823733a664c4c1aa730d19d41555c76",
        ("process", "silent_ms", "times"),
        "The machine did not run @FAILSTOP_PROCESS@",
        "It was silent for @FAILSTOP_SILENT_MS@ ms, beyond its deadline, while it wanted to run: other programs had\n"
        "the processor, or its memory was on the disk. Nothing was stopped for it and no process was ended, since\n"
        "motion was disabled, or a stop was latched for it already. It is told of every ten seconds at most; so far\n"
        "it has happened @FAILSTOP_TIMES@ times.\n"
        "Next: give the service real-time rights (failstop doctor --name @FAILSTOP_NAME@ has the command), or see\n"
        "what else the machine does",
    ),
    EventKind(
        "enabled",
        "notice",
        "3bfd144a1c00461f861da553c93614d9",
        ("who",),
        "Motion was enabled by @FAILSTOP_WHO@",
        "From here on commands move the wheels. The name and the pid are what the client says of itself.\n"
        "Next: failstop disable --name @FAILSTOP_NAME@ takes it back",
    ),
    EventKind(
        "disabled",
        "notice",
        "9ed186beffa7488bbf12bd4f6463b06f",
        (),
        "Motion was disabled",
        "By the client FAILSTOP_WHO, or because of FAILSTOP_REASON: an interlock that is no longer held. The wheels\n"
        "were stopped; nothing is latched.\n"
        "Next: failstop enable --name @FAILSTOP_NAME@",
    ),
    EventKind(
        "reset",
        "notice",
        "085c02e749f54017874cb058835723df",
        ("who",),
        "The latched stop was cleared by @FAILSTOP_WHO@",
        "A reset clears the latch and nothing else: motion stays disabled.\n"
        "Next: failstop enable --name @FAILSTOP_NAME@",
    ),
    EventKind(
        "refused",
        "notice",
        "e46f8afd78764309952f8428eebda5b9",
        ("who", "verb", "reason"),
        "@FAILSTOP_WHO@ was refused: @FAILSTOP_VERB@",
        "The reason: @FAILSTOP_REASON@. Nothing was changed.\nNext: failstop status --name @FAILSTOP_NAME@",
    ),
    EventKind(
        "ignored",
        "warning",
        "b3b319d319c74c748c77923638d33b72",
        ("who", "source"),
        "Commands of @FAILSTOP_WHO@ are ignored",
        "It commands as a source that is no client's: @FAILSTOP_SOURCE@. The settings do not name it, or it is the\n"
        "board's gamepad, which no program may stand in for.\n"
        "Next: correct the program, or declare a source under [sources] and restart the service",
    ),
    EventKind(
        "said",
        "info",
        "7d3f0b6e9c1a4f52a8e45b0c6d2f9137",
        ("who", "sees", "wrong"),
        "@FAILSTOP_WHO@ says of itself",
        "A client's own words, shown as they are: what it sees, and what is wrong by its account.\n"
        "Next: failstop why --name @FAILSTOP_NAME@ shows what holds the wheels, with the newest words of each client",
    ),
    EventKind(
        "driver_silent",
        "warning",
        "c551b8c00bd64343874e0bef0e460f9d",
        ("who", "source", "silent_ms"),
        "@FAILSTOP_WHO@ fell silent while it drove",
        "No command of it for FAILSTOP_SILENT_MS, longer than the timeout of the source @FAILSTOP_SOURCE@, so the\n"
        "wheels were told zero. Nothing is latched: they turn again as soon as it commands again.\n"
        "Next: does that program still run, and does it repeat its command often enough?",
    ),
    EventKind(
        "driver_gone",
        "warning",
        "5c69d278e12541c884ee76082770b8f7",
        ("who", "source"),
        "@FAILSTOP_WHO@ has gone while it drove",
        "It crashed or was killed, or ended without a word, so the wheels were told zero at once.\n"
        "Nothing is latched: they turn again as soon as somebody commands.\n"
        "Next: that program's own log; coredumpctl list, where it crashed",
    ),
    EventKind(
        "driver_ended",
        "info",
        "92de198a2b114a578f729782376c96f8",
        ("who", "source"),
        "@FAILSTOP_WHO@ ended its command",
        "The program that drove ended in order, or a person let go of the key: the wheels were told zero. Nothing is\n"
        "wrong, and nothing is latched.",
    ),
    EventKind(
        "device_lost",
        "error",
        "ad86431d272243de804dc53ce7353048",
        ("path",),
        "The board's port is gone: @FAILSTOP_PATH@",
        "Unplugged, without power, or reset. Nothing can stop wheels that turn now but the board and its power.\n"
        "The stop is written the moment the port is back.\n"
        "Next: use the POWER SWITCH if the wheels turn; look at the cable; journalctl -k shows what the kernel saw",
    ),
    EventKind(
        "device_back",
        "notice",
        "9ccb732a9e874f2ba9495eeedcf3228f",
        ("path",),
        "The board's port is back: @FAILSTOP_PATH@",
        "The first bytes on it were a stop. What is latched stays latched.\n"
        "Next: failstop reset, then failstop enable, each with --name @FAILSTOP_NAME@",
    ),
    EventKind(
        "link",
        "notice",
        "26df9cadbcba4b67963b906680e6a454",
        ("state",),
        "The board's link is @FAILSTOP_STATE@",
        "unproven: it has not answered a ping since the port was opened, so whether it hears is not known.\n"
        "alive: it answers. deaf: it answered before and is silent now, a stop cause: then use the POWER SWITCH.\n"
        "Next: failstop status --name @FAILSTOP_NAME@",
    ),
    EventKind(
        "rights",
        "warning",
        "a56c088a927e4d8f9106a8df85dec9c6",
        ("what",),
        "Missing rights: @FAILSTOP_WHAT@",
        "On a busy machine stops come later, and some for no cause. The entry's own text has the command that gives\n"
        "them, as the unit's LimitRTPRIO=40 and LimitMEMLOCK=infinity do.\n"
        "Next: failstop doctor --name @FAILSTOP_NAME@",
    ),
    EventKind(
        "pad",
        "notice",
        "a06ff401a7f049889d61e332ac51386f",
        (),
        "The gamepad",
        "Its mode changed, one of its buttons stopped the robot, or MODE was held to reset. The last raw frames are\n"
        "told with a button: they show whether somebody pressed it or the pad sent garbage.\n"
        "Next: failstop status --name @FAILSTOP_NAME@ shows the mode",
    ),
    EventKind(
        "arm",
        "notice",
        "7873e90547884f3d9adf7b087d72596e",
        (),
        "The arm",
        "A servo does not answer, or answers again; one is hot, or short of supply, and would let go of what the arm\n"
        "holds; or the arm, left alone, is about to go to its tuck pose.\n"
        "Next: failstop arm --name @FAILSTOP_NAME@ shows each joint",
    ),
    EventKind(
        "charger",
        "info",
        "72df7bd7397a41fca08599cf028e6a11",
        ("state", "battery_mv"),
        "The charger is @FAILSTOP_STATE@",
        "Judged from a step of the battery's voltage, to @FAILSTOP_BATTERY_MV@ mV.\n"
        "Next: failstop config shows battery.step_mv, in case that it is wrong",
    ),
    EventKind(
        "scan",
        "warning",
        "5db72888dc83420d9884c7633dd8d1f9",
        ("state",),
        "The obstacle sensor is @FAILSTOP_STATE@",
        "While it is silent, software commands move nothing (no scan). That is not latched: motion resumes by itself,\n"
        "from zero speed, when the sensor delivers again.\n"
        "Next: does the sensor's driver run, and does its client call sensed()?",
    ),
    EventKind(
        "gyro",
        "info",
        "082c033a964f4063a2b4f6814ee960e8",
        (),
        "The gyro's calibration",
        "Its bias at the start, or that the robot did not stand still for it.\n"
        "Next: after `not stationary`, leave the robot standing and restart the service",
    ),
    EventKind(
        "disk",
        "warning",
        "9e790b1bc2634737a9047e698e7df8ff",
        (),
        "A file of the service",
        "A file in the state directory could not be read or written, or can be again. Stops do not depend on it.\n"
        "Next: df and ls -ld on the directory that the entry names",
    ),
    EventKind(
        "command",
        "warning",
        "24cb47b33041490ba3a67714e953ea58",
        ("state",),
        "still.command @FAILSTOP_STATE@",
        "The command that the settings name for wheels that do not come to rest.\n"
        "Next: did what it switches do its work? Its own output is in the journal too",
    ),
    EventKind(
        "left_out",
        "notice",
        "8a1febefb5a44a38a98feb2f2d38c465",
        ("of", "count"),
        "@FAILSTOP_COUNT@ events of the kind @FAILSTOP_OF@ were left out",
        "At most 64 KiB a minute are told of each kind, and 8 KiB of the stop requests of everybody while a stop is\n"
        "latched; what is more is counted. Every stop was written all the same.\n"
        "Next: journalctl FAILSTOP_EVENT=@FAILSTOP_OF@ FAILSTOP_NAME=@FAILSTOP_NAME@",
    ),
    EventKind(
        "note",
        "info",
        "52bb8f68c7914cb6b272bc07f6b0b35c",
        (),
        "A remark",
        "What no other kind is for; the entry's own text says all of it.",
    ),
    EventKind(
        "incident",
        "notice",
        "03354876ce0c41f98bc62f66572f716a",
        (),
        "The record of a stop",
        "The last minute before a latched stop, and what followed, as a file; or why there is none.\n"
        "Next: failstop incident list --name @FAILSTOP_NAME@",
    ),
    EventKind(
        "stopping",
        "notice",
        "59066ee0452549998781172916643259",
        ("reason",),
        "@FAILSTOP_NAME@ is stopping",
        "It was told to end. The stop is written first, then its processes end, then it is written once more.",
    ),
    EventKind(
        "stopped",
        "notice",
        "a9c157b26c984105a437043f1ba39f09",
        ("link",),
        "@FAILSTOP_NAME@ has ended",
        "Nothing watches the robot from here on. acknowledged: the board answered a ping that was sent after the\n"
        "first of the two stops (FAILSTOP_ACKNOWLEDGED_US from that). If it had answered before and did NOT\n"
        "acknowledge this one, or if the second could NOT be written, the exit code is 1: look at the wheels.\n"
        "unproven: it has not answered since its port was opened, so whether it hears is not known.\n"
        "Next: failstop stop writes a stop without any service; systemctl start starts the service",
    ),
)

BY_NAME = {kind.name: kind for kind in KINDS}
