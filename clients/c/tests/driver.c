/* A client for the tests: it reads one command a line and prints one line for each. */
#include <fcntl.h>
#include <locale.h>
#include <pthread.h>
#include <signal.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/ioctl.h>
#include <sys/mman.h>
#include <sys/prctl.h>
#include <sys/stat.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "failstop.h"

#define MOST_HANDLES 8
static fs_robot *robots[MOST_HANDLES];
static fs_robot *robot;

/* In the handler, because a flag would be seen only after the next command. */
static void exec_at_signal(int number) {
  static char name[] = "sleep", seconds[] = "1000";
  char *const words[] = {name, seconds, NULL};
  (void)number;
  execv("/bin/sleep", words);
}

static void pause_s(double seconds) {
  struct timespec left = {(time_t)seconds, (long)((seconds - (double)(time_t)seconds) * 1e9)};
  while (nanosleep(&left, &left)) continue;
}

static void stop_at_signal(int number) {
  (void)number;
  fs_stop(robot, "from a signal handler");
}

static volatile sig_atomic_t told_to_leave;
static volatile uint64_t *clock_word; /* when it commanded last, for another process */

static void leave(int number) { told_to_leave = number; }

static int map_clock(const char *path) {
  int fd = open(path, O_RDWR | O_CLOEXEC);
  void *map = fd < 0 ? MAP_FAILED : mmap(NULL, 8, PROT_READ | PROT_WRITE, MAP_SHARED, fd, 0);
  if (fd >= 0) close(fd);
  if (map == MAP_FAILED) return -1;
  clock_word = map;
  return 0;
}

static void show_state(void) {
  fs_state state;
  state.size = sizeof state;
  int result = fs_get_state(robot, &state);
  printf("%d enabled=%d latched=%d cause=%d block=%d answer=%d answer_block=%d moving=%d ready=%d link=%d port_open=%d "
         "epoch=%llu vx=%.9g vy=%.9g wz=%.9g limit=%.9g battery=%.9g\n",
         result, state.enabled, state.latched, state.cause, state.block, state.answer, state.answer_block, state.moving,
         state.ready, state.link, state.port_open, (unsigned long long)state.epoch, state.velocity[0], state.velocity[1],
         state.velocity[2], state.speed_limit, state.battery_v);
}

static void show_text(int (*of)(const fs_robot *, char *, size_t)) {
  char text[1024] = "";
  int size = of(robot, text, sizeof text);
  printf("%d %s\n", size, text);
}

/* Drive every 20 ms for so long; negative: until something ends the program. */
static int drive_for(double seconds, double vx, double vy, double wz) {
  int result = FS_OK;
  for (double gone = 0; (seconds < 0 || gone < seconds) && !told_to_leave; gone += 0.02) {
    struct timespec now;
    fs_sensed(robot);
    clock_gettime(CLOCK_MONOTONIC, &now);
    result = fs_drive(robot, vx, vy, wz);
    if (clock_word) *clock_word = (uint64_t)now.tv_sec * 1000000000 + (uint64_t)now.tv_nsec;
    pause_s(0.02);
  }
  return result;
}

/* Close every descriptor but the first three, as a program that makes itself a daemon, and give their numbers to a file. */
static int close_all_for(const char *path) {
  for (int fd = 3; fd < 64; fd++) close(fd);
  int last = -1;
  while (last < 40 && (last = open(path, O_RDWR)) >= 0) continue;
  return last < 0;
}

/* 0 if a child has all files of close_all_for(). */
static int fork_and_look(void) {
  int status;
  pid_t child = fork();
  if (child == 0) {
    int closed = 0;
    for (int fd = 3; fd <= 40; fd++) closed += fcntl(fd, F_GETFD) < 0;
    _exit(closed);
  }
  return waitpid(child, &status, 0) == child && WIFEXITED(status) ? WEXITSTATUS(status) : -1;
}

static int close_all_for_pipes(void) {
  int ends[2] = {-1, -1};
  for (int fd = 3; fd < 64; fd++) close(fd);
  while (ends[1] < 40)
    if (pipe(ends)) return 1;
  return 0;
}

/* The bytes that are in the pipes of close_all_for_pipes(), or -1 if a number is no longer one of their ends. */
static int in_pipes(void) {
  int bytes = 0;
  for (int fd = 3; fd < 40; fd += 2) {
    int waiting;
    struct stat in, out;
    if (fstat(fd, &in) || fstat(fd + 1, &out) || in.st_ino != out.st_ino || ioctl(fd, FIONREAD, &waiting)) return -1;
    bytes += waiting;
  }
  return bytes;
}

static void *stop_cancelled(void *given) {
  pthread_cancel(pthread_self());
  *(int *)given = fs_stop(robot, "of a cancelled thread");
  return NULL;
}

static void *disable_long(void *given) {
  *(int *)given = fs_disable(robot, 0.1);
  return NULL;
}

/* What the thread's call returned, and the next request, which must not wait for a lock that nobody has any more. */
static void ask_cancelled(void) {
  pthread_t thread;
  int first = 1;
  pthread_create(&thread, NULL, disable_long, &first);
  pause_s(0.02);
  pthread_cancel(thread);
  pthread_join(thread, NULL);
  printf("%d %d\n", first, fs_disable(robot, 0.05));
}

static atomic_bool enough;
static char service[400];

static void *come_and_go(void *given) {
  (void)given;
  while (!enough) {
    fs_robot *other;
    int result = fs_open(&other, service, "comes and goes");
    if (result == FS_OK) result = fs_connect(other);
    fs_close(other);
  }
  return NULL;
}

static int has_claim(void) {
  char path[32], target[256];
  for (int fd = 3; fd < 64; fd++) {
    snprintf(path, sizeof path, "/proc/self/fd/%d", fd);
    ssize_t size = readlink(path, target, sizeof target - 1);
    if (size > 7 && !memcmp(target + size - 7, "/claims", 7)) return 1;
  }
  return 0;
}

/* How many of so many children got a claim with them, while another thread connects and closes. */
static int fork_meanwhile(int times) {
  pthread_t thread;
  int found = 0;
  enough = false;
  pthread_create(&thread, NULL, come_and_go, NULL);
  while (times--) {
    int status = 0;
    pid_t child = fork();
    if (child == 0) _exit(has_claim());
    waitpid(child, &status, 0);
    found += WEXITSTATUS(status);
  }
  enough = true;
  pthread_join(thread, NULL);
  return found;
}

/* The child drives by a handle of its own for as long as it lives. */
static void fork_with_own(void) {
  pid_t child = fork();
  if (child) return;
  prctl(PR_SET_PDEATHSIG, SIGKILL);
  fs_close(robot);
  int opened = fs_open(&robot, service, "child"), connected = fs_connect(robot);
  printf("child %d open=%d connect=%d drive=%d\n", (int)getpid(), opened, connected, fs_drive(robot, 0, 0, 0));
  for (;;) {
    fs_state state = {.size = sizeof state};
    fs_get_state(robot, &state);
    drive_for(0.02, state.enabled ? 0.2 : 0, 0, 0);
  }
}

int main(int count, char **words) {
  char line[512], text[400];
  double a, b, c, d;
  int number;
  setvbuf(stdout, NULL, _IOLBF, 0);
  /* Memory that the kernel has to free when this program dies. */
  if (count > 1) {
    size_t size = (size_t)atoi(words[1]) * 1024 * 1024;
    char *memory = malloc(size ? size : 1);
    if (!memory) return 1;
    memset(memory, 1, size);
  }
  while (!told_to_leave && fgets(line, sizeof line, stdin)) {
    line[strcspn(line, "\n")] = 0;
    if (sscanf(line, "open %399s %d", text, &number) == 2) {
      memcpy(service, text, sizeof service);
      printf("%d\n", fs_open(&robots[number], text, "driver.c"));
      robot = robots[number];
    } else if (sscanf(line, "use %d", &number) == 1) {
      robot = robots[number];
      printf("0\n");
    } else if (!strcmp(line, "connect")) {
      printf("%d\n", fs_connect(robot));
    } else if (!strcmp(line, "close") || !strcmp(line, "abandon")) {
      (*line == 'a' ? fs_abandon : fs_close)(robot);
      for (int at = 0; at < MOST_HANDLES; at++)
        if (robots[at] == robot) robots[at] = NULL;
      robot = NULL;
      printf("0\n");
    } else if ((number = sscanf(line, "for %lf %lf %lf %lf", &a, &b, &c, &d)) >= 2) {
      if (a < 0) printf("driving\n");
      number = drive_for(a, b, number > 2 ? c : 0, number > 3 ? d : 0);
      printf("%d\n", number);
    } else if (sscanf(line, "clock %399s", text) == 1) {
      printf("%d\n", map_clock(text));
    } else if (!strcmp(line, "leave-on-term")) {
      struct sigaction action = {.sa_handler = leave};
      printf("%d\n", sigaction(SIGTERM, &action, NULL));
    } else if (sscanf(line, "drive %lf %lf %lf", &a, &b, &c) == 3) {
      printf("%d\n", fs_drive(robot, a, b, c));
    } else if (sscanf(line, "as %399s %d %lf %lf %lf", text, &number, &a, &b, &c) == 5) {
      fs_velocity command = {sizeof command, number, a, b, c, text, 0};
      printf("%d\n", fs_command(robot, &command));
    } else if (sscanf(line, "wheels %d %lf %lf %lf %lf", &number, &a, &b, &c, &d) == 5) {
      double radps[4] = {a, b, c, d};
      printf("%d\n", fs_drive_wheels(robot, radps, (size_t)number, FS_NONE, NULL));
    } else if (!strcmp(line, "sensed")) {
      printf("%d\n", fs_sensed(robot));
    } else if (sscanf(line, "assert %399s", text) == 1) {
      const char *names[] = {text};
      printf("%d\n", fs_assert_interlocks(robot, names, 1));
    } else if (sscanf(line, "enable %lf", &a) == 1) {
      printf("%d\n", fs_enable(robot, a));
    } else if (sscanf(line, "disable %lf", &a) == 1) {
      printf("%d\n", fs_disable(robot, a));
    } else if (sscanf(line, "reset %d", &number) == 1) {
      printf("%d\n", fs_reset(robot, (uint64_t)number, FS_DEFAULT_TIMEOUT));
    } else if (!strncmp(line, "stop ", 5)) {
      printf("%d\n", fs_stop(robot, line + 5));
    } else if (!strncmp(line, "say ", 4)) {
      printf("%d\n", fs_say(robot, line + 4, NULL));
    } else if (!strcmp(line, "keep")) {
      printf("%d\n", fs_keep_enabled(robot));
    } else if (!strcmp(line, "state")) {
      show_state();
    } else if (!strcmp(line, "why")) {
      show_text(fs_why);
    } else if (!strcmp(line, "remedy")) {
      show_text(fs_remedy);
    } else if (!strcmp(line, "error")) {
      show_text(fs_last_error);
    } else if (sscanf(line, "setting %399s", text) == 1) {
      char found[400] = "";
      number = fs_setting(robot, text, found, sizeof found);
      printf("%d %s\n", number, found);
    } else if (sscanf(line, "on-signal %d", &number) == 1) {
      struct sigaction action = {.sa_handler = stop_at_signal};
      printf("%d\n", sigaction(number, &action, NULL));
    } else if (!strcmp(line, "fork")) {
      /* The child tries everything, prints it, and lives on. */
      pid_t child = fork();
      if (child == 0) {
        fs_state state = {.size = sizeof state};
        printf("child %d drive=%d enable=%d state=%d connect=%d stop=%d\n", (int)getpid(), fs_drive(robot, 0.1, 0, 0),
               fs_enable(robot, 1), fs_get_state(robot, &state), fs_connect(robot), 0);
        fs_close(robot);
        for (;;) pause();
      }
    } else if (!strcmp(line, "fork-with-own")) {
      fork_with_own();
    } else if (sscanf(line, "fork-meanwhile %d", &number) == 1) {
      printf("%d\n", fork_meanwhile(number));
    } else if (sscanf(line, "close-all-for %399s", text) == 1) {
      printf("%d\n", close_all_for(text));
    } else if (!strcmp(line, "fork-and-look")) {
      printf("%d\n", fork_and_look());
    } else if (!strcmp(line, "pipes-instead")) {
      printf("%d\n", close_all_for_pipes());
    } else if (!strcmp(line, "in-pipes")) {
      printf("%d\n", in_pipes());
    } else if (!strcmp(line, "stop-cancelled")) {
      pthread_t thread;
      number = 1;
      pthread_create(&thread, NULL, stop_cancelled, &number);
      pthread_join(thread, NULL);
      printf("%d\n", number);
    } else if (!strcmp(line, "ask-cancelled")) {
      ask_cancelled();
    } else if (sscanf(line, "state-of %d", &number) == 1) {
      static uint8_t room[4096];
      fs_state *state = (fs_state *)(void *)room;
      state->size = (uint32_t)number;
      printf("%d\n", fs_get_state(robot, state));
    } else if (!strcmp(line, "exec-on-usr1")) {
      struct sigaction action = {.sa_handler = exec_at_signal};
      printf("%d\n", sigaction(SIGUSR1, &action, NULL));
    } else if (!strcmp(line, "exec")) {
      printf("0\n");
      execl("/bin/sleep", "sleep", "1000", (char *)NULL);
    } else if (!strcmp(line, "crash")) {
      raise(SIGSEGV);
    } else if (!strcmp(line, "abort")) {
      abort();
    } else if (!strcmp(line, "exit")) {
      exit(0);
    } else if (!strcmp(line, "locale")) {
      printf("%d\n", setlocale(LC_ALL, "") ? 0 : -1);
    } else if (!strcmp(line, "no-descriptors")) {
      while (dup(0) >= 0) continue;
      printf("0\n");
    } else if (!strcmp(line, "pid")) {
      printf("%d\n", (int)getpid());
    } else {
      printf("what? %s\n", line);
    }
  }
  for (int at = 0; told_to_leave && at < MOST_HANDLES; at++) fs_close(robots[at]);
  return 0;
}
