/* A client for the tests: it reads one command a line and prints one line for each. */
#include <fcntl.h>
#include <signal.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <sys/mman.h>
#include <time.h>
#include <unistd.h>

#include "failstop.h"

#define MOST_HANDLES 8
static fs_robot *robots[MOST_HANDLES];
static fs_robot *robot;

static volatile sig_atomic_t execs;

static void exec_at_signal(int number) { execs = number; }

static void pause_s(double seconds) {
  struct timespec left = {(time_t)seconds, (long)((seconds - (double)(time_t)seconds) * 1e9)};
  while (nanosleep(&left, &left)) {
    if (execs) execl("/bin/sleep", "sleep", "1000", (char *)NULL);
  }
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
      printf("%d\n", fs_open(&robots[number], text, "driver.c"));
      robot = robots[number];
    } else if (sscanf(line, "use %d", &number) == 1) {
      robot = robots[number];
      printf("0\n");
    } else if (!strcmp(line, "connect")) {
      printf("%d\n", fs_connect(robot));
    } else if (!strcmp(line, "close")) {
      fs_close(robot);
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
    } else if (!strcmp(line, "pid")) {
      printf("%d\n", (int)getpid());
    } else {
      printf("what? %s\n", line);
    }
  }
  for (int at = 0; told_to_leave && at < MOST_HANDLES; at++) fs_close(robots[at]);
  return 0;
}
