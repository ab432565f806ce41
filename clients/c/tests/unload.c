/* A program that unloads the library while it drives, as a plugin's host does: `unload LIBRARY SERVICE`. */
#include <dlfcn.h>
#include <stdio.h>
#include <time.h>

#include "failstop.h"

#define CALL(name) ((__typeof__(&(name)))(void (*)(void))found(#name))

static void *library;

static void (*found(const char *name))(void) {
  void (*function)(void) = NULL;
  *(void **)(void *)&function = dlsym(library, name);
  return function;
}

int main(int count, char **words) {
  fs_robot *robot;
  if (count < 3 || !(library = dlopen(words[1], RTLD_NOW | RTLD_LOCAL))) return 2;
  int (*open_)(fs_robot **, const char *, const char *) = CALL(fs_open);
  int (*connect_)(fs_robot *) = CALL(fs_connect);
  int (*state_)(const fs_robot *, fs_state *) = CALL(fs_get_state);
  int (*sensed)(fs_robot *) = CALL(fs_sensed);
  int (*drive)(fs_robot *, double, double, double) = CALL(fs_drive);
  if (open_(&robot, words[2], "unload") || connect_(robot)) return 3;
  if (dlclose(library)) return 4;
  printf("unloaded\n");
  fflush(stdout);
  for (;;) {
    fs_state state = {.size = sizeof state};
    struct timespec pause = {0, 20 * 1000 * 1000};
    if (state_(robot, &state) || sensed(robot) || drive(robot, state.enabled ? 0.2 : 0, 0, 0)) return 5;
    nanosleep(&pause, NULL);
  }
}
