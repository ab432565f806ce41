"""Texts of `journalctl -x` for each kind of event: the subject, and what it means and what to do, with @FIELD@ for a
field's value. systemd/failstop.catalog is made from this (`make docs`)."""

from __future__ import annotations

TEXTS = {
    "ready": (
        "@FAILSTOP_NAME@ is ready",
        "Every process runs, the port is open and the wheels were told to stop. Motion is disabled.\n"
        "Next: failstop enable --name @FAILSTOP_NAME@",
    ),
    "waiting": (
        "@FAILSTOP_NAME@ waits for @FAILSTOP_FOR@",
        "Motion can't be enabled until it is there; the wheels are told to stop meanwhile.\n"
        "For the port: is the board plugged in and powered, and is device.path its path? For a process: the journal\n"
        "says how it died.\n"
        "Next: failstop doctor --name @FAILSTOP_NAME@",
    ),
    "stop": (
        "Stop latched: @FAILSTOP_REASON@",
        "A latched protective stop. Noticed by: @FAILSTOP_NOTICED_BY@. The stop frame was handed to the kernel by:\n"
        "@FAILSTOP_WRITTEN_BY@, FAILSTOP_LATENCY_US after the notice. By nobody: it could NOT be written, so use the\n"
        "POWER SWITCH. Whether the board and the wheels obeyed is told by the entry stop_outcome that follows within\n"
        "two seconds. Nothing moves until people reset and enable.\n"
        "Next: see to the cause, then failstop reset and failstop enable, each with --name @FAILSTOP_NAME@",
    ),
    "stop_again": (
        "Stopped again: @FAILSTOP_REASON@",
        "Another cause while a stop is latched for: @FAILSTOP_LATCHED@. The first cause is the one to look for.\n"
        "Next: journalctl -x FAILSTOP_EVENT=stop FAILSTOP_NAME=@FAILSTOP_NAME@",
    ),
    "stop_also": (
        "The same stop, also noticed as: @FAILSTOP_REASON@",
        "Several causes came at once, or several processes noticed the same one. Nothing is to be done beyond the\n"
        "stop itself.",
    ),
    "stop_outcome": (
        "What became of the stop: @FAILSTOP_REASON@",
        "Two proofs beyond the written bytes. acknowledged: the board answered a ping that was sent after the stop\n"
        "(FAILSTOP_ACKNOWLEDGED_US from the cause). observed: the IMU saw the wheels come to rest\n"
        "(FAILSTOP_OBSERVED_MS). What is missing is not known; it does not say that the wheels turn.\n"
        "Next: if the wheels were NOT seen still, use the POWER SWITCH; else failstop status --name @FAILSTOP_NAME@",
    ),
    "unstill": (
        "The wheels do not come to rest",
        "A stop was written for: @FAILSTOP_REASON@. The IMU still shakes: the board does not obey, or somebody\n"
        "pushes the robot. The stop is written again and again, and still.command is run where there is one.\n"
        "Next: use the POWER SWITCH. Software can do no more.",
    ),
    "wheels_turn": (
        "The wheels turn although they were told to stop, or are still again",
        "Motion is disabled, so somebody pushes the robot, another program at the port drives it, or the board does\n"
        "not obey. FAILSTOP_BY is wheels where the board reports it, and then the stop is written again. IMU: the\n"
        "robot moves, or is being moved. Nothing is latched, and still.command is not run.\n"
        "Next: if nobody pushes the robot, use the POWER SWITCH; then failstop doctor --name @FAILSTOP_NAME@",
    ),
    "wheel_stands": (
        "The @FAILSTOP_WHEEL@ wheel stands although it is told to turn",
        "It is told @FAILSTOP_TOLD@ turns a second, and the board has reported @FAILSTOP_SEEN@ for 3 s. It is\n"
        "stalled, or its motor or its encoder is unplugged. The robot is not stopped for that.\n"
        "Next: look at that wheel, its cable and its encoder",
    ),
    "servo": (
        "@FAILSTOP_PART@: @FAILSTOP_WRONG@",
        "A servo of the bus reports an error, or does not answer while others do. Motion can't be enabled while a\n"
        "wheel's servo does not answer, because that wheel would stand while the others turn.\n"
        "Next: look at that servo's plug, its power, its id and what blocks it, then failstop status",
    ),
    "died": (
        "@FAILSTOP_PROCESS@ died",
        "Process @FAILSTOP_PID@ @FAILSTOP_HOW@. Its death was a stop cause; how it died is known only now.\n"
        "Next: journalctl _PID=@FAILSTOP_PID@, and coredumpctl info @FAILSTOP_PID@ where it crashed",
    ),
    "restarting": (
        "@FAILSTOP_PROCESS@ is restarted",
        "It starts in @FAILSTOP_WAIT_S@ s. A restarted process never enables motion again: that is for people.\n"
        "Next: failstop status --name @FAILSTOP_NAME@",
    ),
    "down": (
        "@FAILSTOP_PROCESS@ is down",
        "It died too often (settings restart.deaths, restart.window_s). The wheels are told to stop and the status is\n"
        "served, but motion can't be enabled before a reset, which restarts the process. The gate, which hears\n"
        "resets, is restarted after a minute.\n"
        "Next: journalctl FAILSTOP_EVENT=died FAILSTOP_PROCESS=@FAILSTOP_PROCESS@; see to the cause; then\n"
        "failstop reset --name @FAILSTOP_NAME@",
    ),
    "start_failed": (
        "@FAILSTOP_PROCESS@ could not be started",
        "@FAILSTOP_REASON@. It is tried again twice a second; motion waits for it.\n"
        "Next: look for what the machine is short of: memory, processes, file descriptors",
    ),
    "not_started": (
        "@FAILSTOP_NAME@ could not be started",
        "@FAILSTOP_REASON@. The stop was written before; nothing watches the robot from here on.\n"
        "Next: see to the reason, then start the service again",
    ),
    "fenced": (
        "@FAILSTOP_PROCESS@ hung and was fenced",
        "It was silent for @FAILSTOP_SILENT_MS@ ms, so it was killed: what it still wanted to write can't happen.\n"
        "The times are from the notice to the kill and to the end of the process; for the port owner also to the\n"
        "stops on the supervisor's own descriptor, one after the kill and one after the end.\n"
        "Next: was the machine overloaded or frozen? failstop doctor --name @FAILSTOP_NAME@ looks for real-time rights",
    ),
    "starved": (
        "The machine did not run @FAILSTOP_PROCESS@",
        "It was silent for @FAILSTOP_SILENT_MS@ ms, beyond its deadline, while it wanted to run: other programs had\n"
        "the processor, or its memory was on the disk. Nothing was stopped for it and no process was ended, since\n"
        "motion was disabled, or a stop was latched for it already. It is told of every ten seconds at most; so far\n"
        "it has happened @FAILSTOP_TIMES@ times.\n"
        "Next: give the service real-time rights (failstop doctor --name @FAILSTOP_NAME@ has the command), or see\n"
        "what else the machine does",
    ),
    "suspended": (
        "The supervisor was suspended",
        "Somebody suspended it for @FAILSTOP_SILENT_MS@ ms, by a signal, as Ctrl-Z in its terminal does: nobody\n"
        "watched the other processes. Nothing was stopped for it, since motion was disabled or a stop latched.\n"
        "Next: leave the service running in its terminal, or end it with Ctrl-C",
    ),
    "enabled": (
        "Motion was enabled by @FAILSTOP_WHO@",
        "From here on commands move the wheels. The name and the pid are what the client says of itself.\n"
        "Next: failstop disable --name @FAILSTOP_NAME@ takes it back",
    ),
    "disabled": (
        "Motion was disabled",
        "By the client FAILSTOP_WHO, or because of FAILSTOP_REASON: an interlock that is no longer held. The wheels\n"
        "were stopped; nothing is latched.\n"
        "Next: failstop enable --name @FAILSTOP_NAME@",
    ),
    "reset": (
        "The latched stop was cleared by @FAILSTOP_WHO@",
        "A reset clears the latch and nothing else: motion stays disabled.\n"
        "Next: failstop enable --name @FAILSTOP_NAME@",
    ),
    "limit": (
        "@FAILSTOP_WHO@ has changed the speed limit",
        "It counts for every driver until another is set or the service ends.\n"
        "Next: failstop limit 100 --name @FAILSTOP_NAME@ lifts it",
    ),
    "refused": (
        "@FAILSTOP_WHO@ was refused: @FAILSTOP_VERB@",
        "The reason: @FAILSTOP_REASON@. Nothing was changed.\nNext: failstop status --name @FAILSTOP_NAME@",
    ),
    "ignored": (
        "Commands of @FAILSTOP_WHO@ are ignored",
        "It commands as a source that is no client's: @FAILSTOP_SOURCE@. The settings do not name it, or it is the\n"
        "board's gamepad, which no program may stand in for.\n"
        "Next: correct the program, or declare a source under [sources] and restart the service",
    ),
    "said": (
        "@FAILSTOP_WHO@ says of itself",
        "A client's own words, shown as they are: what it sees, and what is wrong by its account.\n"
        "Next: failstop why --name @FAILSTOP_NAME@ shows what holds the wheels, with the newest words of each client",
    ),
    "driver_silent": (
        "@FAILSTOP_WHO@ fell silent while it drove",
        "No command of it for FAILSTOP_SILENT_MS, longer than the timeout of the source @FAILSTOP_SOURCE@, so the\n"
        "wheels were told zero. Nothing is latched: they turn again as soon as it commands again.\n"
        "Next: does that program still run, and does it repeat its command often enough?",
    ),
    "driver_gone": (
        "The driver @FAILSTOP_WHO@ has died",
        "It crashed or was killed, or ended without a word, so the wheels were told zero at once, and motion was\n"
        'disabled: nothing drives before somebody enables it. With gate.driver_death = "stay" motion stays enabled.\n'
        "Next: that program's own log; coredumpctl list, where it crashed; failstop enable --name @FAILSTOP_NAME@",
    ),
    "driver_ended": (
        "@FAILSTOP_WHO@ ended its command",
        "The program that drove ended in order, or a person let go of the key: the wheels were told zero. Nothing is\n"
        "wrong, and nothing is latched.",
    ),
    "device_lost": (
        "The board's port is gone: @FAILSTOP_PATH@",
        "It was unplugged, lost its power, or was reset. Nothing can stop wheels that turn now but the board and its\n"
        "power.\n"
        "The stop is written the moment the port is back.\n"
        "Next: use the POWER SWITCH if the wheels turn; look at the cable; journalctl -k shows what the kernel saw",
    ),
    "device_back": (
        "The board's port is back: @FAILSTOP_PATH@",
        "The first bytes on it were a stop. What is latched stays latched. If the entry says that this may not be the\n"
        "board, the stop proves nothing until the device answers: use the POWER SWITCH if the wheels turn.\n"
        "Next: failstop reset, then failstop enable, each with --name @FAILSTOP_NAME@",
    ),
    "restarted": (
        "The board restarted: @FAILSTOP_SIGN@",
        "It has forgotten its speed and its settings. While motion is enabled this is a stop of its own.\n"
        "Next: look at the battery, the motors' supply and the board's plugs, then failstop reset",
    ),
    "link": (
        "The board's link is @FAILSTOP_STATE@",
        "unproven: it has not answered a ping since the port was opened, so whether it hears is not known.\n"
        "alive: it answers.\n"
        "deaf: it answers no more, or it obeys zero although motion is written to it.\n"
        "silent: it had reported and says nothing any more. It has lost power, or hangs, or the wire from it is\n"
        "broken, which look the same from here.\n"
        "Deaf and silent stop the robot while motion is enabled: then use the POWER SWITCH.\n"
        "unheard: nothing has answered since the port came back, so it may be another device: use the POWER SWITCH.\n"
        "Next: failstop status --name @FAILSTOP_NAME@",
    ),
    "rights": (
        "Missing rights: @FAILSTOP_WHAT@",
        "On a busy machine stops come later, and some for no cause. The entry's own text has the command that gives\n"
        "them, as the unit's LimitRTPRIO=40 and LimitMEMLOCK=infinity do.\n"
        "Next: failstop doctor --name @FAILSTOP_NAME@",
    ),
    "pad": (
        "The gamepad",
        "Its mode changed, one of its buttons stopped the robot, or MODE was held to reset. The last raw frames are\n"
        "told with a button: they show whether somebody pressed it or the pad sent garbage.\n"
        "Next: failstop status --name @FAILSTOP_NAME@ shows the mode",
    ),
    "arm": (
        "The arm",
        "A servo does not answer, or answers again; one is hot, or short of supply, and would let go of what the arm\n"
        "holds; or the arm, left alone, is about to go to its tuck pose.\n"
        "Next: failstop arm --name @FAILSTOP_NAME@ shows each joint",
    ),
    "charger": (
        "The charger is @FAILSTOP_STATE@",
        "A step of the battery's voltage, to @FAILSTOP_BATTERY_MV@ mV, says so.\n"
        "Next: failstop config shows battery.step_mv, in case that it is wrong",
    ),
    "odd": (
        "The board reports an impossible @FAILSTOP_WHAT@",
        "It was @FAILSTOP_VALUE@. The value counts as not reported, and later ones of this kind are not logged.\n"
        "Next: check the wiring of what is measured, or the reader of your own board. On a bench with USB power\n"
        "alone, a battery of about 0 V is no fault.",
    ),
    "scan": (
        "The obstacle sensor is @FAILSTOP_STATE@",
        "While it is silent, software commands move nothing (no scan). That is not latched: motion resumes by itself,\n"
        "from zero speed, when the sensor delivers again.\n"
        "Next: does the sensor's driver run, and does its client call sensed()?",
    ),
    "scale": (
        "The wheels may not turn as fast as they are told",
        "Either nobody has confirmed how much of the board's unit is one turn of a wheel, and speeds are capped until\n"
        "then; or the board's reports, or the gyro, show another speed than the one that was told. The message names\n"
        "the setting.\n"
        "Next: failstop setup measures board.per_rps by a turn of a wheel",
    ),
    "gyro": (
        "The gyro's calibration",
        "The bias that was found at the start; or that the robot did not stand still for it.\n"
        "Next: after `not stationary`, leave the robot standing and restart the service",
    ),
    "disk": (
        "A file of the service",
        "A file in the state directory could not be read or written, or can be again. Stops do not depend on it.\n"
        "Next: df and ls -ld on the directory that the entry names",
    ),
    "command": (
        "still.command @FAILSTOP_STATE@",
        "The command that the settings name for wheels that do not come to rest.\n"
        "Next: did what it switches do its work? Its own output is in the journal too",
    ),
    "left_out": (
        "@FAILSTOP_COUNT@ events of the kind @FAILSTOP_OF@ were left out",
        "At most 64 KiB a minute are told of each kind, and 8 KiB of the stop requests of everybody while a stop is\n"
        "latched; what is more is counted. Every stop was written all the same.\n"
        "Next: journalctl FAILSTOP_EVENT=@FAILSTOP_OF@ FAILSTOP_NAME=@FAILSTOP_NAME@",
    ),
    "note": (
        "A remark",
        "News of no other kind; the entry's own text says all of it.",
    ),
    "incident": (
        "The record of a stop",
        "The last minute before a latched stop, and what followed, as a file; or why there is none.\n"
        "Next: failstop incident list --name @FAILSTOP_NAME@",
    ),
    "stopping": (
        "@FAILSTOP_NAME@ is stopping",
        "It was told to end. The stop is written first, then its processes end, then it is written once more.",
    ),
    "stopped": (
        "@FAILSTOP_NAME@ has ended",
        "Nothing watches the robot from here on. acknowledged: the board answered a ping that was sent after the\n"
        "first of the two stops (FAILSTOP_ACKNOWLEDGED_US from that). If it had answered before and did NOT\n"
        "acknowledge this one, or if the second could NOT be written, the exit code is 1: look at the wheels.\n"
        "unproven: it has not answered since its port was opened, so whether it hears is not known.\n"
        "Next: failstop stop writes a stop without any service; systemctl start starts the service",
    ),
}
