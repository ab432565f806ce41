/* Made from the service's own declarations by `make docs` (lab/failstop_lab/pages/c_layout.py). */
#ifndef FS_LAYOUT_H
#define FS_LAYOUT_H

#define CLIENT_HASH UINT64_C(0x0f1ab87a019971b7)
#define HEADER_BYTES 128
#define CELL_HEADER_BYTES 24
#define LINE_BYTES 64
#define CLIENT_SLOTS 8
#define RUN_DIGITS 16
#define ASKED_BYTES 180
#define WHO_BYTES 64
#define BY_HAND 1
#define SOURCE_BYTES 16
#define HELD_BYTES 200
#define SAID_BYTES 190
#define GOODBYES 64
#define MOST_WHEELS 4
#define MOST_SPEEDS 5
#define VERB_ENABLE 1
#define VERB_DISABLE 2
#define VERB_RESET 3
#define REPLY_REFUSED 0
#define REPLY_DONE 1
#define REPLY_UNDER_WAY 2
#define FOR_THE_LATCH 1
#define PORT_OPEN 1
#define WHEELS_STILL 1
#define WHEELS_TURNING 2
#define BY_ROLLING 1
#define CAUSE_NUMBER_BYTES 2
#define CAUSE_DIED 1
#define CAUSE_SILENT 21
#define CAUSE_UNKNOWN 22
#define ANSWER_WITHIN_NS 1000000000
#define OLD_READING_NS 500000000
#define TEXT_MAGIC "failstop"
#define TEXT_SHM "/dev/shm"
#define TEXT_SUPERVISOR "supervisor"
#define TEXT_PORT_OWNER "port_owner"
#define TEXT_GATE "gate"
#define TEXT_TELEMETRY "telemetry"
#define TEXT_DEFAULT_NAME "failstop"
#define TEXT_FIRST_SOURCE "cmd_vel"
#define TEXT_LEFT_OUT " ..."
#define TEXT_CAUSE_MARK "{cause}"
#define TEXT_BETWEEN "\037"
#define TEXT_NEXT_STEP "; next: "
#define TEXT_BLOCK_LATCHED "estop: "
#define TEXT_BLOCK_DISABLED "disabled"
#define TEXT_BLOCK_HELD "let go first"
#define TEXT_BLOCK_NO_COMMAND "cmd timeout"
#define TEXT_BLOCK_NO_SCAN "no scan"
#define TEXT_ACKERMANN "ackermann"
#define LINKS "unproven", "alive", "deaf", "unheard", "unasked", "silent"

/* AT_: where a record begins in its segment; CAP_: the most bytes of its payload; NAME_: what seeds its CRC.
 * F_: where a number is in a payload; N_: the bytes of all its numbers. */
#define AT_SUPERVISOR_BEAT_NS 128
#define AT_SUPERVISOR_EPOCH 512
#define AT_SUPERVISOR_READY 576
#define AT_SUPERVISOR_LINK 1408
#define CAP_SUPERVISOR_LINK 32
#define NAME_SUPERVISOR_LINK "supervisor.link"
#define AT_SUPERVISOR_RULES 1536
#define CAP_SUPERVISOR_RULES 512
#define NAME_SUPERVISOR_RULES "supervisor.rules"
#define AT_SUPERVISOR_SETTINGS 2688
#define CAP_SUPERVISOR_SETTINGS 16384
#define NAME_SUPERVISOR_SETTINGS "supervisor.settings"
#define AT_SUPERVISOR_LATCH 640
#define CAP_SUPERVISOR_LATCH 306
#define NAME_SUPERVISOR_LATCH "supervisor.latch"
#define AT_PORT_OWNER_PORT 512
#define CAP_PORT_OWNER_PORT 317
#define NAME_PORT_OWNER_PORT "port_owner.port"
#define AT_GATE_STATE 512
#define CAP_GATE_STATE 4096
#define NAME_GATE_STATE "gate.state"
#define AT_GATE_REPLY 8832
#define CAP_GATE_REPLY 592
#define NAME_GATE_REPLY "gate.reply.0"
#define AT_TELEMETRY_IMU 512
#define CAP_TELEMETRY_IMU 48
#define NAME_TELEMETRY_IMU "telemetry.imu"
#define AT_TELEMETRY_WHEELS 768
#define CAP_TELEMETRY_WHEELS 84
#define NAME_TELEMETRY_WHEELS "telemetry.wheels"
#define AT_TELEMETRY_BATTERY 1024
#define CAP_TELEMETRY_BATTERY 5
#define NAME_TELEMETRY_BATTERY "telemetry.battery"
#define AT_TELEMETRY_ODOMETRY 1152
#define CAP_TELEMETRY_ODOMETRY 113
#define NAME_TELEMETRY_ODOMETRY "telemetry.odometry"
#define AT_CLIENT_LEFT 128
#define CAP_CLIENT_LEFT 512
#define NAME_CLIENT_LEFT "client.0.left"
#define AT_CLIENT_HELD 1280
#define AT_CLIENT_HELLO 1344
#define CAP_CLIENT_HELLO 84
#define NAME_CLIENT_HELLO "client.0.hello"
#define AT_CLIENT_COMMAND 1600
#define CAP_CLIENT_COMMAND 49
#define NAME_CLIENT_COMMAND "client.0.command"
#define AT_CLIENT_SENSED 1856
#define CAP_CLIENT_SENSED 64
#define NAME_CLIENT_SENSED "client.0.sensed"
#define AT_CLIENT_INTERLOCKS 2112
#define CAP_CLIENT_INTERLOCKS 208
#define NAME_CLIENT_INTERLOCKS "client.0.interlocks"
#define AT_CLIENT_REQUEST 2880
#define CAP_CLIENT_REQUEST 17
#define NAME_CLIENT_REQUEST "client.0.request"
#define AT_CLIENT_SEEN 3136
#define CAP_CLIENT_SEEN 16
#define NAME_CLIENT_SEEN "client.0.seen"
#define AT_CLIENT_SAID 3264
#define CAP_CLIENT_SAID 389
#define NAME_CLIENT_SAID "client.0.said"
#define REPLY_STRIDE 1280
#define F_LATCH_EPOCH 0
#define F_LATCH_NOTICED_NS 8
#define F_LATCH_RAISED_NS 16
#define N_LATCH 24
#define F_PORT_NUMBER 0
#define F_PORT_SINCE_NS 8
#define F_PORT_STATE 16
#define N_PORT 17
#define F_REPLY_SESSION 0
#define F_REPLY_NUMBER 8
#define F_REPLY_DONE 16
#define F_REPLY_REFUSED_FOR 17
#define N_REPLY 18
#define F_IMU_ACCELERATION 0
#define F_IMU_RATE 24
#define N_IMU 48
#define F_WHEELS_DOES 0
#define F_WHEELS_BY 1
#define F_WHEELS_UNEXPECTED 2
#define F_WHEELS_COUNT 3
#define F_WHEELS_SINCE_NS 4
#define F_WHEELS_READ_NS 12
#define F_WHEELS_RPS 20
#define F_WHEELS_TURNS 52
#define N_WHEELS 84
#define F_BATTERY_MV 0
#define F_BATTERY_PLUGGED 4
#define N_BATTERY 5
#define F_ODOMETRY_POSE 0
#define F_ODOMETRY_TWIST 24
#define F_ODOMETRY_STD 48
#define F_ODOMETRY_SOURCE 64
#define N_ODOMETRY 113
#define F_HELLO_SESSION 0
#define F_HELLO_PID 8
#define F_HELLO_NAMESPACE 12
#define N_HELLO 20
#define F_COMMAND_SESSION 0
#define F_COMMAND_VX 8
#define F_COMMAND_VY 16
#define F_COMMAND_WZ 24
#define F_COMMAND_FLAGS 32
#define N_COMMAND 33
#define F_ASSERTED_SESSION 0
#define N_ASSERTED 8
#define F_REQUEST_SESSION 0
#define F_REQUEST_NUMBER 8
#define F_REQUEST_VERB 16
#define N_REQUEST 17
#define F_SEEN_SESSION 0
#define F_SEEN_EPOCH 8
#define N_SEEN 16
#define F_SAID_SESSION 0
#define N_SAID 8
#define F_HEADER_MAGIC 0
#define F_HEADER_LAYOUT 8
#define F_HEADER_SIZE 16
#define F_HEADER_INCARNATION 24
#define F_HEADER_NAME 32
#define F_HEADER_CLIENT 48
#define F_HEADER_VERSION 56
#define N_HEADER 80

#define WHEEL_NAMES \
    {1, {"rear"}}, \
    {2, {"left", "right"}}, \
    {3, {"left", "rear", "right"}}, \
    {4, {"front_left", "rear_left", "front_right", "rear_right"}}, \

#define AXES \
    {"mecanum", {1.0, 1.0, 1.0}}, \
    {"differential", {1.0, 0.0, 1.0}}, \
    {"omni3", {1.0, 1.0, 1.0}}, \
    {"ackermann", {1.0, 0.0, 1.0}}, \

/* Number, name, text, what to do first. In a text, braces hold an argument, and what is in brackets is left
 * out when its arguments are empty. */
#define CAUSES \
    {1, "died", \
     "{process} died", \
     "if this is not the first time, look at what happened before it (`failstop events`)"}, \
    {2, "hangs", \
     "{process} hangs: {ms:d} ms silent", \
     "check the computer's load and failstop's real-time rights (`failstop doctor`), because something held it up"}, \
    {3, "starved", \
     "{process} hangs: {ms:d} ms silent (the machine is starved)", \
     "give the service real-time rights (`failstop doctor` has the command), or the machine less to do"}, \
    {4, "held_up", \
     "supervisor was held up for {ms:d} ms", \
     "check the computer's load and failstop's real-time rights (`failstop doctor`), because something held it up"}, \
    {5, "mute", \
     "gate runs but has sent nothing for {ms:d} ms", \
     "report it with its incident (`failstop incident list`), because either failstop has a bug or memory was damaged"}, \
    {6, "bad_frame", \
     "the gate's frame was refused: {fault}", \
     "report it with its incident (`failstop incident list`), because either failstop has a bug or memory was damaged"}, \
    {7, "suspended", \
     "the machine was suspended for {s:.1f} s", \
     "keep the computer from sleeping while the robot is on (`systemctl mask sleep.target`)"}, \
    {8, "removed", \
     "{what} was removed: restart the service", \
     "run `failstop doctor`: with RemoveIPC=yes, logind removes it when the service's user logs out"}, \
    {9, "device_lost", \
     "device lost", \
     "check the cable, the plug and the board's power"}, \
    {10, "stuck", \
     "port does not drain", \
     "turn the robot's POWER SWITCH off and on, because a stop may not have reached the wheels; then check the board and the cable to it"}, \
    {11, "deaf", \
     "the board is deaf", \
     "turn the robot's POWER SWITCH off and on, because a stop may not have reached the wheels; then check the cable to the board; `failstop doctor` shows whether a login or another program takes the answers from the port"}, \
    {12, "unstill", \
     "the wheels do not come to rest", \
     "turn the robot's POWER SWITCH off and on, because a stop may not have reached the wheels; then check whether somebody carried or pushed the robot, because that looks the same"}, \
    {13, "not_finite", \
     "command from {who} is not finite", \
     "fix that program before it drives again; a division by zero is a usual reason"}, \
    {14, "two_publishers", \
     "multiple {source} publishers: {who}, {rival}", \
     "end one of them (in one program, use one Robot for everything), or give it its own source in the settings (sources.NAME.priority)"}, \
    {15, "button", \
     "gamepad button 0x{buttons:04X}", \
     "ask the person who holds it"}, \
    {16, "key", \
     "key{key:d}", \
     "ask the people near the robot"}, \
    {17, "requested", \
     "stop request[: {words}] (says it is {who}, pid {pid:d})", \
     "make sure that the reason for the stop is gone"}, \
    {18, "piped", \
     "stop request[: {words}]", \
     "make sure that the reason for the stop is gone"}, \
    {19, "stopping", \
     "service is stopping", \
     "start the service again"}, \
    {20, "all_died", \
     "the whole service died", \
     "if this is not the first time, look at what happened before it (`failstop events`)"}, \
    {21, "silent", \
     "the supervisor is silent", \
     "check the computer's load and failstop's real-time rights (`failstop doctor`), because something held it up"}, \
    {22, "unknown", \
     "stopped by the supervisor", \
     "look at `failstop events`, which may still show it"}, \
    {23, "battery", \
     "the battery is at {volts:.2f} V", \
     "charge it; you may reset and drive to the charger, because failstop stops for this again only after the battery has been charged or swapped, or the service was restarted"}, \
    {24, "fleet", \
     "stop request[: {words}] (says it is the fleet, for {who})", \
     "make sure that the reason for the stop is gone"}, \
    {27, "supervisor_suspended", \
     "supervisor was suspended for {s:.1f} s by a signal", \
     "leave the service running in its terminal, or end it with Ctrl-C"}, \
    {28, "defect", \
     "internal error: {process}: {event} while {state}", \
     "report it with its incident (`failstop incident list`), because either failstop has a bug or memory was damaged"}, \
    {30, "two_move_the_arm", \
     "multiple arm/goal publishers: {who}, {rival}", \
     "end one of them, because only one program may move the arm at a time"}, \
    {40, "operator_gone", \
     "operator gone: {who}, {how}", \
     "have somebody attend again, on the page or with `failstop attend`"}, \
    {41, "driver_died", \
     "driver died: {who}", \
     "look at that program's log"}, \
    {42, "driver_silent", \
     "driver silent: {who}, {ms:d} ms", \
     "check that program: it may hang, or be suspended (Ctrl-Z)"}, \
    {43, "runaway", \
     "the {wheel} wheel ran away: commanded {told:.2f} turns a second, it turned {seen:.2f}", \
     "check that wheel's motor, encoder and wiring, wheels.sign_* and board.per_rps, and whether the robot is on a slope"}, \
    {44, "board_silent", \
     "the board is silent", \
     "turn the robot's POWER SWITCH off and on, because a stop may not have reached the wheels; then check the board's power and its cable; `failstop doctor` shows whether a login or another program takes the answers from the port"}, \
    {45, "restarted", \
     "the board restarted: {sign}", \
     "check the battery, the motors' supply and the board's plugs, because a dip in the voltage is the usual reason"}, \
    {46, "ros_publishers", \
     "stop request: multiple cmd_vel publishers: {words} (says it is {who}, pid {pid:d})", \
     "remap cmd_vel of all but one of them: for a node of Nav2 to cmd_vel_nav, for another node to an input of twist_mux (docs/ros2.md, Nav2), and start it again; a node that was killed counts for up to 20 s"}, \
    {47, "ros_arm_publishers", \
     "stop request: multiple arm/goal publishers: {words} (says it is {who}, pid {pid:d})", \
     "end all but one of these nodes, because only one may move the arm; a node that was killed counts for up to 20 s"}, \
    {48, "not_heard", \
     "no answer from the board for {ms:d} ms (the machine is starved)", \
     "turn the robot's POWER SWITCH off and on, because a stop may not have reached the wheels; then give the service real-time rights (`failstop doctor` has the command), or the machine less to do"}, \
    {49, "ros_not_finite", \
     "stop request: command from {words} is not finite (says it is {who}, pid {pid:d})", \
     "fix that node before it drives again; a division by zero is a usual reason"}, \
    {50, "ros_arm_not_held", \
     "stop request: the arm could not be held: {words} (says it is {who}, pid {pid:d})", \
     "look at the arm, because it may have moved on to its goal, and at `failstop status`"}, \
    {51, "ros_no_answer", \
     "stop request: no answer from the gate in {words}: wheels stopped (says it is {who}, pid {pid:d})", \
     "check the computer's load and failstop's real-time rights (`failstop doctor`), because something held it up"}, \
    {52, "wheel_missing", \
     "wheel lost: {wheel} does not answer", \
     "check its plug on the bus, its power and its id; if that wheel still turns, use the POWER SWITCH"}, \
    {53, "ros_stranger", \
     "stop request: stranger on cmd_vel: {words} (says it is {who}, pid {pid:d})", \
     "end that node, or add its name to the bridge's allowed_publishers and start the bridge again"}, \
    {54, "uncounted", \
     "the {wheel} wheel is not counted: commanded {told:.2f} turns a second", \
     "check that wheel's encoder and its plugs, and whether the wheel is blocked"}, \

#endif
