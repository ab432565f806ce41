/* From wheel speeds to the velocity of the base, by the service's settings (failstop/policy/kinematics.py). */
#include "internal.h"

#include <math.h>
#include <stdio.h>

#define LEAST_PIVOT 1e-9
#define PI 3.14159265358979323846

static const struct {
  int count;
  const char *name[MOST_WHEELS];
} NAMES[] = {WHEEL_NAMES};
static const struct {
  const char *layout;
  double factor[3];
} FOLLOWS[] = {AXES};

struct settings {
  const uint8_t *data;
  size_t size;
  bool missing;
};

static double number(struct settings *settings, const char *key) {
  struct fsi_value found;
  if (!fsi_find(settings->data, settings->size, key, &found, NULL) ||
      (found.kind != FSI_INT && found.kind != FSI_FLOAT)) {
    settings->missing = true;
    return 0;
  }
  return found.number;
}

static double numbered(struct settings *settings, const char *before, int wheel, const char *after) {
  char key[40];
  snprintf(key, sizeof key, "wheels.%s_%d%s", before, wheel, after);
  return number(settings, key);
}

/* The pseudo-inverse of the rows, without the directions whose factor is 0. False if the wheels can't tell them
 * apart. */
static bool least_squares(double back[3][MOST_SPEEDS], double rows[MOST_SPEEDS][3], int speeds, const double *axes) {
  double table[3][3 + MOST_SPEEDS] = {{0}};
  int used[3], count = 0;
  for (int axis = 0; axis < 3; axis++)
    if (axes[axis] != 0) used[count++] = axis;
  double least = 0;
  for (int a = 0; a < count; a++) {
    for (int b = 0; b < count; b++) {
      for (int row = 0; row < speeds; row++) table[a][b] += rows[row][used[a]] * rows[row][used[b]];
      least = fmax(least, fabs(table[a][b]));
    }
    for (int row = 0; row < speeds; row++) table[a][count + row] = rows[row][used[a]];
  }
  least *= LEAST_PIVOT;
  int width = count + speeds;
  for (int at = 0; at < count; at++) {
    int best = at;
    for (int line = at + 1; line < count; line++)
      if (fabs(table[line][at]) > fabs(table[best][at])) best = line;
    for (int column = 0; column < width; column++) {
      double swapped = table[at][column];
      table[at][column] = table[best][column];
      table[best][column] = swapped;
    }
    double pivot = table[at][at];
    if (fabs(pivot) <= least) return false;
    for (int column = 0; column < width; column++) table[at][column] /= pivot;
    for (int line = 0; line < count; line++) {
      double share = table[line][at];
      if (line == at || share == 0) continue;
      for (int column = 0; column < width; column++) table[line][column] -= share * table[at][column];
    }
  }
  for (int at = 0; at < count; at++)
    for (int row = 0; row < speeds; row++) back[used[at]][row] = table[at][count + row];
  return true;
}

static double rounded(double value) { return round(value * 1e15) / 1e15; }

/* What one driven wheel follows: its axle gives no turn. */
static const double AHEAD[3] = {1, 0, 0};

bool fsi_wheels(struct fsi_wheels *wheels, const uint8_t *data, size_t size) {
  struct settings settings = {data, size, false};
  struct fsi_value layout;
  memset(wheels, 0, sizeof *wheels);
  for (int wheel = 1; wheel <= MOST_WHEELS; wheel++) {
    struct fsi_value found;
    char key[40];
    snprintf(key, sizeof key, "wheels.id_%d", wheel);
    if (!fsi_find(data, size, key, &found, NULL)) continue;
    if (!(found.number >= 0 && found.number < MOST_SPEEDS)) return false; /* nor is it NaN */
    wheels->id[wheels->count] = (int)found.number;
    wheels->sign[wheels->count++] = numbered(&settings, "sign", wheel, "") < 0 ? -1 : 1;
    wheels->speeds = wheels->speeds > (int)found.number ? wheels->speeds : (int)found.number + 1;
  }
  for (size_t at = 0; at < sizeof NAMES / sizeof *NAMES; at++)
    if (NAMES[at].count == wheels->count) memcpy(wheels->names, NAMES[at].name, sizeof wheels->names);
  if (!wheels->names[0] || !fsi_find(data, size, "wheels.layout", &layout, NULL)) return false;

  const double *axes = NULL;
  for (size_t at = 0; at < sizeof FOLLOWS / sizeof *FOLLOWS; at++)
    if (fsi_is(&layout, FOLLOWS[at].layout)) axes = FOLLOWS[at].factor;
  if (!axes) return false;
  double rim[MOST_WHEELS][3], turns_per_m = 1 / (PI * number(&settings, "wheels.diameter_m"));
  if (fsi_is(&layout, "omni3")) {
    double lever_m = number(&settings, "wheels.lever_m");
    for (int wheel = 0; wheel < wheels->count; wheel++) {
      double way = numbered(&settings, "angle", wheel + 1, "_deg") * PI / 180;
      rim[wheel][0] = rounded(cos(way));
      rim[wheel][1] = rounded(sin(way));
      rim[wheel][2] = lever_m;
    }
  } else {
    bool mecanum = fsi_is(&layout, "mecanum");
    double track_m = number(&settings, "wheels.track_m");
    double lever_m = (mecanum ? number(&settings, "wheels.wheelbase_m") + track_m : track_m) / 2;
    for (int wheel = 0; wheel < wheels->count; wheel++) {
      double side = wheel * 2 < wheels->count ? -1 : 1;
      rim[wheel][0] = 1;
      rim[wheel][1] = mecanum ? (wheel % 2 ? -side : side) : 0;
      rim[wheel][2] = wheels->count == 1 ? 0 : side * lever_m;
    }
  }
  if (wheels->count == 1) axes = AHEAD;
  double rows[MOST_SPEEDS][3] = {{0}};
  for (int wheel = 0; wheel < wheels->count; wheel++)
    for (int axis = 0; axis < 3; axis++)
      rows[wheels->id[wheel]][axis] = wheels->sign[wheel] * turns_per_m * rim[wheel][axis];
  if (fsi_is(&layout, TEXT_ACKERMANN)) {
    wheels->steered = true;
    wheels->wheelbase_m = number(&settings, "wheels.wheelbase_m");
    wheels->most_rad = number(&settings, "steering.most_deg") * PI / 180;
  }
  wheels->known = !settings.missing && least_squares(wheels->back, rows, wheels->speeds, axes);
  return true;
}

void fsi_of_wheels(const struct fsi_wheels *wheels, const double *radps, double steering_rad, double *velocity) {
  double rps[MOST_SPEEDS] = {0};
  for (int wheel = 0; wheel < wheels->count; wheel++)
    rps[wheels->id[wheel]] = wheels->sign[wheel] * radps[wheel] / (2 * PI);
  for (int axis = 0; axis < 3; axis++) {
    velocity[axis] = 0;
    for (int at = 0; at < wheels->speeds; at++) velocity[axis] += wheels->back[axis][at] * rps[at];
  }
  if (!isnan(steering_rad)) {
    double angle = fmax(-wheels->most_rad, fmin(steering_rad, wheels->most_rad));
    velocity[2] = velocity[0] * tan(angle) / wheels->wheelbase_m;
  }
}
