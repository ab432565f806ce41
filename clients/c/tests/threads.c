/* For the sanitizers: one thread drives, others look, ask, assert and stop at the same time, and handles come and go. */
#include <pthread.h>
#include <stdatomic.h>
#include <stdbool.h>
#include <stdio.h>
#include <stdlib.h>
#include <sys/wait.h>
#include <time.h>
#include <unistd.h>

#include "failstop.h"

static fs_robot *robot;
static atomic_bool ended;

static void pause_ms(long ms) {
  struct timespec left = {0, ms * 1000000};
  while (nanosleep(&left, &left)) continue;
}

static void *drives(void *given) {
  (void)given;
  while (!ended) {
    double radps[] = {1, 1, 1, 1};
    fs_drive(robot, 0.1, 0, 0);
    fs_drive_wheels(robot, radps, (size_t)fs_wheel_count(robot), FS_NONE, NULL);
    fs_sensed(robot);
    pause_ms(2);
  }
  return NULL;
}

static void *looks(void *given) {
  (void)given;
  while (!ended) {
    char text[256];
    fs_state state = {.size = sizeof state};
    fs_get_state(robot, &state);
    fs_why(robot, text, sizeof text);
    fs_remedy(robot, text, sizeof text);
    fs_last_error(robot, text, sizeof text);
    fs_setting(robot, "wheels.layout", text, sizeof text);
    pause_ms(1);
  }
  return NULL;
}

static void *asks(void *given) {
  (void)given;
  while (!ended) {
    fs_reset(robot, 0, FS_DEFAULT_TIMEOUT);
    fs_enable(robot, FS_DEFAULT_TIMEOUT);
    fs_disable(robot, 0);
    pause_ms(5);
  }
  return NULL;
}

static void *stops(void *given) {
  (void)given;
  while (!ended) {
    fs_stop(robot, "of a thread");
    pause_ms(50);
  }
  return NULL;
}

int main(int count, char **words) {
  if (count < 2 || fs_open(&robot, words[1], "threads") || fs_connect(robot)) {
    fprintf(stderr, "no service\n");
    return 1;
  }
  void *(*const works[])(void *) = {drives, looks, looks, asks, asks, stops};
  enum { MOST = sizeof works / sizeof *works };
  pthread_t threads[MOST];
  for (int at = 0; at < MOST; at++)
    if (pthread_create(&threads[at], NULL, works[at], NULL)) return 1;
  for (int turn = 0; turn < 20; turn++) {
    fs_robot *other;
    if (fs_open(&other, words[1], "other") == FS_OK && fs_connect(other) == FS_OK) fs_say(other, "here", "nothing");
    pid_t child = turn % 5 ? 0 : fork();
    if (turn % 5 == 0 && child == 0) {
      int result = fs_drive(other, 0, 0, 0);
      _exit(result == FS_FORKED ? 0 : 1);
    }
    int status = 0;
    if (child > 0 && (waitpid(child, &status, 0) != child || status)) return 2;
    fs_close(other);
    pause_ms(20);
  }
  ended = true;
  for (int at = 0; at < MOST; at++) pthread_join(threads[at], NULL);
  fs_close(robot);
  return 0;
}
