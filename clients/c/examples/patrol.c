#include <failstop.h>
#include <stdio.h>
#include <time.h>

int main(void) {
  char text[512];
  fs_state state = {.size = sizeof state};
  struct timespec pause = {0, 50 * 1000 * 1000};
  fs_robot *robot;

  if (fs_open(&robot, NULL, "patrol") || fs_connect(robot)) {
    fs_last_error(robot, text, sizeof text);
    fprintf(stderr, "patrol: %s\n", text);
    fs_close(robot);
    return 1;
  }
  while (!fs_get_state(robot, &state) && !state.enabled) /* until somebody types: failstop enable */
    nanosleep(&pause, NULL);
  while (!fs_get_state(robot, &state) && state.enabled) {
    fs_sensed(robot); /* when your obstacle sensor has delivered; here we pretend */
    fs_drive(robot, 0.1, 0, 0); /* m/s forward, m/s left, rad/s counter-clockwise */
    nanosleep(&pause, NULL);
  }
  fs_why(robot, text, sizeof text); /* what stopped it */
  printf("%s\n", text);
  fs_close(robot);
  return 0;
}
