/* What the files of the library share. Nothing here is exported. */
#ifndef FS_INTERNAL_H
#define FS_INTERNAL_H

#include <pthread.h>
#include <semaphore.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stddef.h>
#include <stdint.h>
#include <string.h>
#include <sys/types.h>

#include "failstop.h"
#include "layout.h"

#if __BYTE_ORDER__ != __ORDER_LITTLE_ENDIAN__
#error "failstop's shared memory is little-endian"
#endif

/* The test library makes these visible too. */
#ifndef FSI
#define FSI __attribute__((visibility("hidden")))
#endif

#define CELL_BYTES(capacity) \
  (((size_t)CELL_HEADER_BYTES + (size_t)(capacity) + LINE_BYTES - 1) / LINE_BYTES * LINE_BYTES)

/* -- cell.c: values in shared memory ------------------------------------------------------------------------------- */

struct fsi_entry {
  uint64_t seq;
  uint64_t t_ns;
  const uint8_t *data;
  size_t size;
};

/* A segment of the service, mapped to read. */
struct fsi_segment {
  const uint8_t *map;
  size_t size;
};

/* Where a record is, and the newest number of it that was read. */
struct fsi_reader {
  const uint8_t *at;
  size_t cell;
  uint32_t seed;
  _Atomic uint64_t seen;
};

/* The one writer of a record of this client's slot. */
struct fsi_writer {
  int fd;
  off_t at;
  size_t capacity;
  uint32_t seed;
  uint64_t seq;
};

FSI uint32_t fsi_crc(const void *data, size_t size, uint32_t start);
FSI uint32_t fsi_seed(const char *record, uint64_t incarnation);
FSI size_t fsi_build(uint8_t *out, uint64_t seq, uint64_t t_ns, const void *payload, size_t size, uint32_t seed);
FSI bool fsi_check(const uint8_t *raw, size_t room, uint32_t seed, struct fsi_entry *found);
FSI bool fsi_newest(const uint8_t *raw, size_t cell, uint32_t seed, struct fsi_entry *found);
/* `buffer` has room for two cells; what is found points into it. */
FSI bool fsi_read(struct fsi_reader *reader, uint8_t *buffer, struct fsi_entry *found);
/* The payload has at most FSI_MOST_PAYLOAD bytes. 0, or an errno. */
FSI int fsi_put(struct fsi_writer *writer, const void *payload, size_t size, uint64_t t_ns);
#define FSI_MOST_PAYLOAD 512

static inline uint64_t fsi_u64(const uint8_t *at) {
  uint64_t value;
  memcpy(&value, at, sizeof value);
  return value;
}
static inline double fsi_double(const uint8_t *at) {
  double value;
  memcpy(&value, at, sizeof value);
  return value;
}
/* A word of a mapped segment, in one access. */
static inline uint64_t fsi_word(const uint8_t *at) {
  return __atomic_load_n((const uint64_t *)(const void *)at, __ATOMIC_RELAXED);
}

/* -- place.c: files of the service that nobody else can have put there --------------------------------------------- */

#define FSI_MOST_BASES 3
#define FSI_PATH 256
#define FSI_NAME 33

/* Where a service of this name may be. */
struct fsi_places {
  char base[FSI_MOST_BASES][FSI_PATH];
  int count;
  char name[FSI_NAME];
};

/* A descriptor that the library keeps, and the file that it has opened. A program may close descriptors that are not its
 * own, for example with closefrom(), and then another file of the program gets the number. -1: none. */
struct fsi_owned {
  _Atomic int fd;
  _Atomic uint64_t device, file, kind;
};
FSI void fsi_own(struct fsi_owned *owned, int fd);
/* Whether the descriptor `fd` still is the file that was opened as `owned`. Safe in a signal handler. */
FSI bool fsi_still(int fd, const struct fsi_owned *owned);
FSI bool fsi_owns(const struct fsi_owned *owned);
/* Close it, unless its number is another file's by now. */
FSI void fsi_disown(struct fsi_owned *owned);

/* Why a file was refused: 0, or an errno, or one of these with the user. */
enum { FSI_FOREIGN = 10000, FSI_OPEN_TO_OTHERS, FSI_LINK, FSI_OTHER_OWNER, FSI_OTHER_KIND };
struct fsi_refusal {
  int why;
  uid_t uid;
};

FSI int fsi_places(struct fsi_places *places, const char *name);
/* A descriptor or -1. Safe in a signal handler. */
FSI int fsi_open_in(const struct fsi_places *places, int which, const char *file, int flags, bool pipe,
                    struct fsi_refusal *refusal);
/* The same file under a number after those of the standard streams. A program may run without these, and then whatever
 * it prints goes to the next file that it opens: into the stop pipe, or over its slot. Closes `fd` if it moves it; -1
 * and errno if no number is left. Safe in a signal handler. */
FSI int fsi_above_streams(int fd);
/* The stop pipe, to write. `which`: where it is. Safe in a signal handler. */
FSI int fsi_open_stop(const struct fsi_places *places, int *which, struct fsi_refusal *refusal);
FSI void fsi_describe(char *text, size_t size, const struct fsi_places *places, int which, const char *file,
                      const struct fsi_refusal *refusal);

/* -- pack.c: msgpack ------------------------------------------------------------------------------------------------ */

enum fsi_kind { FSI_NIL, FSI_BOOL, FSI_INT, FSI_FLOAT, FSI_STR, FSI_BIN, FSI_ARRAY, FSI_MAP, FSI_OTHER };

struct fsi_value {
  enum fsi_kind kind;
  int64_t integer; /* of a bool too */
  uint64_t natural;
  double number; /* of an integer too */
  const char *text;
  uint32_t count; /* bytes of a text, members of an array, pairs of a map */
};

struct fsi_packed {
  const uint8_t *at, *end;
  bool bad;
};

/* The next value; of an array or a map, only its head. */
FSI struct fsi_value fsi_next(struct fsi_packed *in);
/* Skip what is inside of a value that was just read. */
FSI void fsi_skip(struct fsi_packed *in, const struct fsi_value *value);
FSI bool fsi_is(const struct fsi_value *value, const char *text);
/* The value of a key in a packed map of texts; false if it has none. */
FSI bool fsi_find(const uint8_t *data, size_t size, const char *key, struct fsi_value *found, struct fsi_packed *rest);

/* -- text.c ---------------------------------------------------------------------------------------------------------- */

/* A text that is cut where its room ends; `whole` counts on. */
struct fsi_text {
  char *at;
  size_t size;
  size_t whole;
};
FSI void fsi_add(struct fsi_text *text, const char *from, size_t count);
FSI void fsi_adds(struct fsi_text *text, const char *from);
/* As fsi_adds(); each failstop command in backquotes gets the option that names this service, unless it is the default
 * one, because a computer may have several. */
FSI void fsi_add_named(struct fsi_text *text, const char *from, const char *service);
FSI int fsi_end(struct fsi_text *text);
/* The number of a packed cause; CAUSE_UNKNOWN if it is damaged. */
FSI int fsi_cause_number(const uint8_t *packed, size_t size);
FSI void fsi_add_cause(struct fsi_text *text, const uint8_t *packed, size_t size);
FSI const char *fsi_cause_remedy(int number);
FSI void fsi_add_number(struct fsi_text *text, double number);
/* As many bytes of UTF-8 as fit into `room`, cut between characters, without what is not UTF-8, and with one space for
 * each run of white space. Returns the bytes; *whole says whether all of it fitted. Safe in a signal handler. */
FSI size_t fsi_clean(char *out, size_t room, const char *text, bool *whole);
/* As many bytes of a UTF-8 text as fit, cut between characters. */
FSI size_t fsi_cut(const char *text, size_t size, size_t room);

/* -- wheels.c ---------------------------------------------------------------------------------------------------------- */

struct fsi_wheels {
  int count;
  int speeds;
  int id[MOST_WHEELS];
  int sign[MOST_WHEELS];
  const char *names[MOST_WHEELS];
  bool known; /* the wheels tell the velocity of the base */
  bool steered;
  double back[3][MOST_SPEEDS];
  double wheelbase_m, most_rad;
};
FSI bool fsi_wheels(struct fsi_wheels *wheels, const uint8_t *settings, size_t size);
FSI void fsi_of_wheels(const struct fsi_wheels *wheels, const double *radps, double steering_rad, double *velocity);

/* -- life.c ------------------------------------------------------------------------------------------------------------- */

struct fsi_life;
/* A thread that holds the futex of this slot until fsi_let_go(). NULL without a thread or memory: then the service
 * learns of a death later. */
FSI struct fsi_life *fsi_hold(int fd, off_t at);
FSI void fsi_let_go(struct fsi_life *life);
/* In a fork, whose thread is the parent's: the first at once, the second when the handle is closed. */
FSI void fsi_in_child(struct fsi_life *life);
FSI void fsi_forget(struct fsi_life *life);

/* -- run.c: a run of the service that is mapped to read ------------------------------------------------------------------- */

/* As many as the rules have room for: a name of one character has two bytes there. */
#define FSI_MOST_NAMES (CAP_SUPERVISOR_RULES / 2)

struct fsi_run {
  uint64_t incarnation;
  uid_t owner;
  char memory[FSI_NAME + 20];
  int which;             /* of the places */
  struct fsi_owned life; /* whose lock says whether it still runs */
  struct fsi_segment supervisor, gate, telemetry, port_owner;
  struct fsi_reader latch, link, state, imu, wheels_seen, battery, odometry, port;
  struct fsi_reader reply[CLIENT_SLOTS];
  uint64_t lease_ns;
  uint64_t began_ns;
  uint8_t *settings;
  size_t settings_size;
  uint8_t rules[CAP_SUPERVISOR_RULES];
  size_t rules_size;
  /* The sources, as they are in `rules`. */
  struct {
    const char *text;
    uint32_t size;
    uint64_t timeout_ns; /* how long a command of it counts; 0: not known */
  } source[FSI_MOST_NAMES];
  int sources;
  int first_source;
  struct fsi_wheels wheels;
};

/* -- robot.c ------------------------------------------------------------------------------------------------------------ */

struct fs_robot {
  pid_t owner;
  atomic_bool forked;
  struct fs_robot *next; /* of all handles of this process */
  struct fsi_places places;
  char client[WHO_BYTES + 1];
  /* Kept for a program that has no descriptor left. The second is only there while it replaces the first. */
  struct fsi_owned stop, newer_stop;

  struct fsi_run *run;
  int unattached; /* without a run: why */

  /* The slot; -1: none. */
  int slot;
  struct fsi_owned claims, bell, segment;
  uint64_t session;
  struct fsi_life *life;
  struct fsi_writer left, hello, command, sensed, interlocks, request, seen, said;
  uint8_t commanded[CAP_CLIENT_COMMAND];
  uint64_t commanded_ns;
  _Atomic uint64_t wanted_ns; /* from when the newest command counts */
  _Atomic int source; /* of the newest command; -1: none */

  pthread_mutex_t turn;    /* one request at a time waits for its answer */
  pthread_mutex_t writing; /* of the request's records */
  uint64_t number;
  atomic_bool enabled; /* this handle has enabled motion, as far as it knows */
  atomic_ullong enabled_ns; /* when motion was enabled, as its own enable was granted; 0: not known */
  atomic_bool keep_enabled;

  _Atomic int last; /* the last error */
  pthread_mutex_t texts;
  int told; /* the error that `error` is about */
  char error[640];
};

FSI uint64_t fsi_now_ns(void);
/* Write what may be about a dead service's pipe without a SIGPIPE. 0, or an errno. Safe in a signal handler. */
FSI int fsi_send(int fd, const void *data, size_t size);
FSI bool fsi_over(const struct fsi_run *run);
FSI bool fsi_held(int fd, off_t byte, bool by_writer);
/* Why there is no such service, with the command that starts it. */
FSI void fsi_no_service(char *why, size_t room, const struct fsi_places *places);
/* FS_OK, or an error and why in `why`. */
FSI int fsi_attach(struct fsi_run **run, const struct fsi_places *places, int which, char *why, size_t size);
FSI void fsi_detach(struct fsi_run *run);
FSI int fsi_check_segment(int fd, const char *name, uint64_t incarnation, uint64_t *size, char *why, size_t room);
FSI int fsi_open_segment(const struct fsi_run *run, const char *name, bool write, char *why, size_t room);
/* Note an error; of the functions that never wait, without a text. Returns it. */
FSI int fsi_fail(const fs_robot *robot, int code);
/* Whether this process is a fork of the one that opened the handle. */
FSI bool fsi_is_forked(const fs_robot *robot);
/* The same with a text, whose commands get the service's name. */
FSI int fsi_fail_with(fs_robot *robot, int code, const char *why);
FSI size_t fsi_stop_line(char *out, const char *reason, const char *client, pid_t pid);
#define FSI_STOP_LINE (ASKED_BYTES + WHO_BYTES + 32)

/* What the gate has decided (state.c). */
struct fsi_decided {
  bool dead;
  bool enabled;
  uint64_t enabled_ns;
  uint64_t t_ns;
  uint64_t epoch;
  int limit;
  int block;
  int cause;
  const uint8_t *packed; /* the cause, in `buffer` or `latched`; NULL with `cause`: one without arguments */
  size_t packed_size;
  double velocity[3];
  double speeds[MOST_SPEEDS];
  int speed_count;
  int answer, answer_block;
  bool taken; /* the gate has taken this handle's newest command, which may be too old by now */
  bool expired; /* that command was too old when the gate decided */
  const char *by;
  uint32_t by_size;
  uint8_t latched[2 * CELL_BYTES(CAP_SUPERVISOR_LATCH)];
  uint8_t buffer[2 * CELL_BYTES(CAP_GATE_STATE)];
};
FSI void fsi_decide(const fs_robot *robot, struct fsi_decided *decided);

#endif
