/* The floor of the guard's answers: what a pseudo-terminal and two programs that sleep cost on this machine. It opens one,
 * prints its path, and answers each line at once, as a board at rest would.
 *
 * usage: answers */
#define _GNU_SOURCE
#include <fcntl.h>
#include <poll.h>
#include <stdio.h>
#include <stdlib.h>
#include <string.h>
#include <termios.h>
#include <unistd.h>

int main(void) {
  int port = posix_openpt(O_RDWR | O_NOCTTY);
  if (port < 0 || grantpt(port) < 0 || unlockpt(port) < 0) return 1;
  /* Held open, so that a driver that comes or goes is no hang-up. */
  int held = open(ptsname(port), O_RDWR | O_NOCTTY);
  struct termios options;
  if (held < 0 || tcgetattr(held, &options) < 0) return 1;
  cfmakeraw(&options);
  if (tcsetattr(held, TCSANOW, &options) < 0) return 1;
  printf("%s\n", ptsname(port));
  fflush(stdout);
  char text[256], first = 0;
  for (;;) {
    ssize_t got = read(port, text, sizeof text);
    if (got <= 0) return 1;
    for (ssize_t at = 0; at < got; at++) {
      if (text[at] != '\r') {
        if (!first) first = text[at];
        continue;
      }
      const char *answer = first == 'e' ? "0 0\r\n" : "OK\r\n";
      if (write(port, answer, strlen(answer)) < 0) return 1;
      first = 0;
    }
  }
}
