/**
 * libfailstop: drive and stop a robot from C, and from every language that can call C.
 *
 * It is the same client as Python's `Robot`: it talks to the service through shared memory, holds a client slot, and
 * when your program dies, the service knows at once and stops the wheels.
 *
 * Every function returns FS_OK (0) or a negative `fs_result`, unless its comment says otherwise. No function writes to
 * the terminal, raises a signal, or ends the program. All values are in SI units; x is forward, y is left, z is up, and
 * angles are counter-clockwise.
 *
 * Real-time: a function marked **real-time** makes no memory, takes no lock that another thread may hold for long, logs
 * nothing and never waits for the service. It makes a few short system calls, and needs up to 12 KB of stack.
 *
 * Threads: unless a function says otherwise, any thread may call it at any time. fs_connect(), fs_close() and
 * fs_abandon() are the exceptions: while one of them runs, no other thread may use the same handle, except for fs_stop()
 * during fs_connect(). A thread that is cancelled (pthread_cancel) while it stops, asks, connects or closes ends when the call
 * has returned.
 *
 * Fork and exec: a handle belongs to the process that opened it. In a child made by fork() every call that connects, drives,
 * asks or reads the state returns FS_FORKED, and the parent keeps its slot. fs_stop(), fs_close() and fs_abandon() work, and
 * so do the calls that only read the settings, such as fs_setting(). An exec() ends the client just as a kill does.
 *
 * Descriptors: a handle holds a few file descriptors, which are closed on exec. If your program closes them itself, for
 * example with closefrom(), every call returns FS_NO_SERVICE, but fs_stop() still works, and failstop neither writes to nor
 * closes a file or pipe of your program that gets one of their numbers later.
 */
#ifndef FAILSTOP_H
#define FAILSTOP_H

#include <stddef.h>
#include <stdint.h>

#ifdef __cplusplus
extern "C" {
#endif

#define FS_VERSION_MAJOR 0
#define FS_VERSION_MINOR 1
#define FS_VERSION_PATCH 0

#if defined(__GNUC__)
#define FS_API __attribute__((visibility("default")))
#define FS_MUST_LOOK __attribute__((warn_unused_result))
#else
#define FS_API
#define FS_MUST_LOOK
#endif

/** A connection to the service of one name. */
typedef struct fs_robot fs_robot;

/** What a call returns. Numbers never change; later versions may add some. */
typedef enum fs_result {
  FS_OK = 0,
  /** No service of that name is running, or the one that this handle belongs to has ended. */
  FS_NO_SERVICE = -1,
  /** This user may stop the robot but not drive it: join the group `failstop`. */
  FS_NO_PERMISSION = -2,
  /** The service is of another version, whose shared memory this library can't read. fs_stop() still works. */
  FS_OTHER_LAYOUT = -3,
  /** Every client slot is taken. */
  FS_NO_SLOT = -4,
  /** Call fs_connect() first. */
  FS_NOT_CONNECTED = -5,
  /** The service answered, and said no. fs_last_error() has the reason. */
  FS_REFUSED = -6,
  /** The service is running but did not answer in time. */
  FS_NO_ANSWER = -7,
  /** A source or an interlock that the service's settings do not name. */
  FS_UNDECLARED = -8,
  /** An argument is out of range, not finite, too long, or NULL. Nothing was sent. */
  FS_INVALID = -9,
  /** This process is a fork of the one that opened the handle. */
  FS_FORKED = -10,
  /** Shared memory, or a file of the service, is damaged or belongs to somebody else. */
  FS_DAMAGED = -11,
  /** The system refused memory, a descriptor or a thread. */
  FS_SYSTEM = -12
} fs_result;

/** Why the wheels may not turn. The first reason that holds is given. */
typedef enum fs_block {
  FS_MAY_MOVE = 0,
  /** A stop is latched: `fs_state.cause`. It needs a reset. */
  FS_BLOCK_LATCHED = 1,
  /** Motion was not enabled since the start, the last stop or the last disable. */
  FS_BLOCK_DISABLED = 2,
  /** The source has commanded a velocity since before motion was enabled. It counts after a zero or a pause. */
  FS_BLOCK_HELD = 3,
  /** No source has a command that is younger than its timeout. */
  FS_BLOCK_NO_COMMAND = 4,
  /** The obstacle sensor is silent; without it only a person may drive. */
  FS_BLOCK_NO_SCAN = 5
} fs_block;

/** What becomes of this handle's newest command. */
typedef enum fs_answer {
  /** This handle has not commanded anything yet. */
  FS_ANSWER_NONE = 0,
  /** This command moves the wheels. */
  FS_DRIVING = 1,
  /** Another program drives, so this command moves nothing now: its source has a higher priority, or this command is older
   * than its timeout. It is not queued: go on commanding. */
  FS_PREEMPTED = 2,
  /** Nothing moves: `fs_state.block` says why. */
  FS_BLOCKED = 3
} fs_answer;

/** What is known about the wheels, whatever they were told. */
typedef enum fs_turning {
  /** Nothing was read about them for half a second, or ever. */
  FS_TURNING_UNKNOWN = 0,
  FS_STILL = 1,
  FS_TURNING = 2
} fs_turning;

/** Whether the board answers. */
typedef enum fs_link {
  /** It has not answered yet. */
  FS_LINK_UNPROVEN = 0,
  FS_LINK_ALIVE = 1,
  /** It does not hear, so a stop may not reach the wheels. */
  FS_LINK_DEAF = 2,
  /** It has not answered since its port came back. */
  FS_LINK_UNHEARD = 3,
  /** It can't answer, by design. */
  FS_LINK_UNASKED = 4,
  /** It says nothing any more. */
  FS_LINK_SILENT = 5
} fs_link;

/** Waits as long as the service promises to take for an answer: a second. */
#define FS_DEFAULT_TIMEOUT (-1.0)
/** A steering angle or another value that is not given, and a reading that does not exist. Use isnan() to test. */
#define FS_NONE ((double)__builtin_nanf(""))

#define FS_MOST_WHEELS 4

/** One snapshot. A reading that does not exist is NaN. New fields are only ever added at the end. */
typedef struct fs_state {
  /** Set this to sizeof(fs_state) before the call; the library fills no more than that. */
  uint32_t size;

  /** 1: motion is enabled. */
  int32_t enabled;
  /** 1: a stop is latched. */
  int32_t latched;
  /** The number of the latched cause (docs/reference/causes.md), or 0. fs_why() has its text. */
  int32_t cause;
  /** An `fs_block`. */
  int32_t block;
  /** An `fs_answer`: what the gate decided about this handle's newest command. It is about the command before until
   * the gate has taken the newest one, which takes 0.3 ms on an idle machine. */
  int32_t answer;
  /** An `fs_block`: why this handle's command moves nothing, if `answer` is FS_BLOCKED. It is FS_BLOCK_NO_COMMAND until
   * the gate has taken the command, and when the command is older than its source's timeout. */
  int32_t answer_block;
  /** 1: the gate commands a velocity. */
  int32_t moving;
  /** 1: every process of the service runs and the port is open, so motion could be enabled. */
  int32_t ready;
  /** An `fs_link`. */
  int32_t link;
  /** 1: the board's port is open; 0: it is closed, or the board was unplugged. */
  int32_t port_open;
  int32_t reserved1_;

  /** Raised by every stop. Pass it to fs_reset() as the newest stop that your user has seen. */
  uint64_t epoch;
  /** When motion was enabled (CLOCK_MONOTONIC, ns); 0 while it is not. */
  uint64_t enabled_ns;
  /** Age of the gate's decision, s: it publishes every 0.08 s at least. */
  double age_s;

  /** The velocity that the gate commands: m/s forward, m/s left, rad/s counter-clockwise. */
  double velocity[3];
  /** The speed that the gate commands for each wheel, rad/s, positive forward, in the order of fs_wheel_name(). */
  double wheels_radps[FS_MOST_WHEELS];
  /** Commanded angle of the steered wheels, rad, positive to the left; NaN if there are none, or at rest. */
  double steering_rad;
  /** The share of the settings' speeds that drivers may use, 0 to 1. */
  double speed_limit;

  /** An `fs_turning`. */
  int32_t turning;
  /** 1: the wheels turn although they were told zero for longer than the setting still.after_s allows. */
  int32_t turning_unexpected;
  /** Age of the newest reading of the wheels, s. */
  double measured_age_s;
  /** Measured speed of each wheel, rad/s, positive forward. All are NaN if the board reports none. */
  double measured_radps[FS_MOST_WHEELS];
  /** How far each wheel has turned since the service's first report, rad, positive forward. */
  double turned_rad[FS_MOST_WHEELS];

  /** m/s2: forward, left, up. */
  double acceleration[3];
  /** rad/s about these axes, less the gyro's bias. */
  double rate[3];
  /** Age of both, s. */
  double imu_age_s;

  /** V. */
  double battery_v;
  /** Age of that, s. */
  double battery_age_s;

  /** Pose since the service's start: m forward, m left, rad counter-clockwise. */
  double pose[3];
  /** m/s forward, m/s left, rad/s counter-clockwise. */
  double twist[3];
  /** 1: both come from the board's reports of the wheels; 0: only from the commands, which you should not trust. */
  int32_t odometry_measured;
  int32_t reserved2_;
  /** Age of both, s. */
  double odometry_age_s;
} fs_state;

/** One command, for fs_command(). */
typedef struct fs_velocity {
  /** Set this to sizeof(fs_velocity). */
  uint32_t size;
  /** 1: a person drives, so the obstacle sensor is not needed. */
  int32_t manual;
  /** m/s forward, m/s left, rad/s counter-clockwise. */
  double vx, vy, wz;
  /** A name of the settings' [sources], or NULL for `cmd_vel`. */
  const char *source;
  /** When the command was wanted (CLOCK_MONOTONIC, ns), or 0 for now. Use it for a command that a network delayed. */
  uint64_t wanted_ns;
} fs_velocity;

/* -- Opening ------------------------------------------------------------------------------------------------------ */

/**
 * Make a handle for the service of this name, and look for that service.
 *
 * `service`: NULL for the default one, `failstop`. `client`: the name that people see for this program; NULL for the
 * name of its file.
 *
 * You get a handle whenever there is memory for one, also when it returns FS_NO_SERVICE, FS_OTHER_LAYOUT or another
 * error, so that you can read fs_last_error() and call fs_stop(). Close it in any case. `*robot` is NULL only after
 * FS_INVALID, or FS_SYSTEM without memory.
 *
 * It opens files and maps memory, and waits for nobody.
 */
FS_API FS_MUST_LOOK int fs_open(fs_robot **robot, const char *service, const char *client);

/**
 * Take a client slot of the running service, which you need for everything but reading the state and stopping. From
 * now on the service watches this program: if it dies while it drives, the wheels stop.
 *
 * Call it again after FS_NO_SERVICE, to follow a service that was restarted. It does nothing while the slot is good.
 * A new run starts with motion disabled.
 *
 * It opens files, maps memory and starts a thread that only sleeps. No other thread may use the handle meanwhile.
 */
FS_API FS_MUST_LOOK int fs_connect(fs_robot *robot);

/**
 * Close the handle and give the slot back. If this handle was driving, the wheels stop at once. Motion that it enabled,
 * and that nobody else has enabled again since, is disabled, for which it waits up to a second; call fs_keep_enabled()
 * before if you don't want that.
 *
 * A program that ends without it has died, for the service: after it has driven, motion is disabled, or a stop is
 * latched (setting gate.driver_death). NULL is fine. No other thread may use the handle meanwhile, or afterwards.
 */
FS_API void fs_close(fs_robot *robot);

/**
 * As fs_close(), but for the service this program has died, as if it had crashed: after it has driven, motion is
 * disabled, or a stop is latched (setting gate.driver_death). Use it when your program fails and goes on. If the program
 * has not driven, or if that setting is `stay`, only motion that this handle enabled is disabled, as by fs_close().
 */
FS_API void fs_abandon(fs_robot *robot);

/** Leave motion enabled at fs_close(), for other programs. **Real-time.** */
FS_API int fs_keep_enabled(fs_robot *robot);

/* -- Driving ------------------------------------------------------------------------------------------------------ */

/**
 * Command a velocity: m/s forward, m/s left, rad/s counter-clockwise. It counts for 0.3 s unless the settings say
 * otherwise, so repeat it. Values beyond the limits are clamped. Only the newest command counts: a zero that another
 * command follows at once may never be seen.
 *
 * FS_OK means that the command was handed over; `fs_state.answer` says what became of it. FS_NO_SERVICE: the service
 * has ended; call fs_connect(), then have motion enabled again.
 *
 * **Real-time.** Call fs_drive(), fs_command() and fs_drive_wheels() from one thread at a time.
 */
FS_API int fs_drive(fs_robot *robot, double vx, double vy, double wz);

/** As fs_drive(), with a source, for a person at the controls, or for a command of an earlier time. **Real-time.** */
FS_API int fs_command(fs_robot *robot, const fs_velocity *command);

/**
 * Command the speed of each wheel, rad/s, positive forward, in the order of fs_wheel_name(). `count` must be
 * fs_wheel_count(). `steering_rad`: the angle of the steered wheels, positive to the left, or FS_NONE.
 *
 * It drives the base whose wheels turn like this, by the sizes of the service's settings, so limits, ramps and sources
 * are those of fs_drive(). `command` has the rest of the command (its velocity is not read), or is NULL.
 *
 * **Real-time.**
 */
FS_API int fs_drive_wheels(fs_robot *robot, const double *radps, size_t count, double steering_rad,
                           const fs_velocity *command);

/**
 * The obstacle sensor delivered just now. Software commands move the wheels only while this is called at least every
 * 0.5 s (setting scan.timeout_s). **Real-time.** From one thread at a time.
 */
FS_API int fs_sensed(fs_robot *robot);

/**
 * Assert that these interlocks of the settings hold now; repeat it within their timeout. An interlock that an earlier
 * call named and this one does not ends with its timeout. FS_UNDECLARED: the settings don't name one of them, and none
 * is asserted. **Real-time.** From one thread at a time.
 */
FS_API int fs_assert_interlocks(fs_robot *robot, const char *const *names, size_t count);

/** Tell people in one line what this program sees and, if anything is wrong, what (NULL: nothing). `failstop status`
 * shows it. At most 190 bytes each; more is cut. **Real-time.** From one thread at a time. */
FS_API int fs_say(fs_robot *robot, const char *sees, const char *wrong);

/* -- Requests ----------------------------------------------------------------------------------------------------- */

/*
 * These wait for the service's answer, for `timeout_s` seconds (FS_DEFAULT_TIMEOUT: one). With 0 they send the request
 * and don't wait, so they are **real-time**, and FS_OK means only that it was sent. Requests of several threads of one
 * handle go one after the other, and a request with 0 takes the place of one that waits.
 */

/**
 * Enable motion. It is better to let a person do it (`failstop enable`), because a program that enables motion by
 * itself drives off unattended when it is restarted after a crash. FS_REFUSED: fs_last_error() says why.
 */
FS_API int fs_enable(fs_robot *robot, double timeout_s);

/** Disable motion: the wheels stop at once. */
FS_API int fs_disable(fs_robot *robot, double timeout_s);

/**
 * Clear the latched stop; motion stays disabled. `seen`: the `fs_state.epoch` that the deciding person has looked at:
 * if a stop came after it, the reset is refused; 0 if you don't know it.
 */
FS_API int fs_reset(fs_robot *robot, uint64_t seen, double timeout_s);

/* -- Stopping ----------------------------------------------------------------------------------------------------- */

/**
 * Latch a stop. Motion stays off until somebody resets and enables it. `reason`: a few words for people, at most 180
 * bytes of UTF-8 (more is cut), or NULL.
 *
 * It needs no slot and no permission, works with a service of any version, in a forked child, and while another thread
 * is inside another function. It may be called from a signal handler. **Real-time.**
 *
 * FS_OK: the request is in the service's pipe; the service writes the stop within a millisecond. FS_NO_SERVICE: nobody
 * listens, so run `failstop stop`, which writes to the port itself. FS_SYSTEM: this program has no descriptor left, and
 * fs_open() had found no service, so nothing was sent; run `failstop stop`.
 */
FS_API int fs_stop(const fs_robot *robot, const char *reason);

/** As fs_stop(), without a handle. Not for signal handlers. `service` and `client` as in fs_open(). */
FS_API int fs_stop_service(const char *service, const char *client, const char *reason);

/* -- Looking ------------------------------------------------------------------------------------------------------ */

/**
 * Fill a snapshot. Set `state->size` before. FS_NO_SERVICE: the service has ended; `state` then shows that as a
 * latched stop, or, if this handle never saw the service, that nothing is known. It needs no slot. **Real-time.**
 */
FS_API int fs_get_state(const fs_robot *robot, fs_state *state);

/**
 * Write in words why nothing moves, with the latched cause, into `text`; an empty text if the wheels may turn. Returns
 * the length that the whole text has, as snprintf() does, or a negative `fs_result`. `failstop why` tells more.
 */
FS_API int fs_why(const fs_robot *robot, char *text, size_t size);

/** What a person should do first about the latched cause; an empty text if nothing is latched. Returns as fs_why(). */
FS_API int fs_remedy(const fs_robot *robot, char *text, size_t size);

/** How many wheels the base has; or a negative `fs_result`. **Real-time.** */
FS_API int fs_wheel_count(const fs_robot *robot);

/** `front_left`, `rear_left`, `front_right`, `rear_right`; or `left`, `rear`, `right`; or `left`, `right`. NULL for an
 * index that does not exist. **Real-time.** */
FS_API const char *fs_wheel_name(const fs_robot *robot, int index);

/**
 * One setting of the running service as text, by its full key (`failstop config` lists them), for example
 * `wheels.layout` (mecanum, differential, omni3 or ackermann). Returns as fs_why(); FS_UNDECLARED: no such setting.
 */
FS_API int fs_setting(const fs_robot *robot, const char *key, char *text, size_t size);

/** 1: the settings declare this source; 0: they don't; or a negative `fs_result`. */
FS_API int fs_has_source(const fs_robot *robot, const char *name);

/** 1: the settings declare this interlock; 0: they don't; or a negative `fs_result`. */
FS_API int fs_has_interlock(const fs_robot *robot, const char *name);

/* -- Text --------------------------------------------------------------------------------------------------------- */

/** The last error of this handle in one sentence, with the remedy; an empty text if none happened yet, or since
 * fs_connect() made a new connection. Returns as fs_why(). */
FS_API int fs_last_error(const fs_robot *robot, char *text, size_t size);

/** A few words for a result, for example `no service`. Never NULL. **Real-time.** */
FS_API const char *fs_result_text(int result);

/** The name of a cause by its number, for example `battery`; NULL if this library knows none. **Real-time.** */
FS_API const char *fs_cause_name(int cause);

/** The version of the library, for example `0.1.0`. **Real-time.** */
FS_API const char *fs_version(void);

#ifdef __cplusplus
}
#endif
#endif
