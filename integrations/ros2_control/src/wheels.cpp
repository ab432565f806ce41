#include "wheels.hpp"

#include <algorithm>

namespace failstop_ros2_control
{

namespace
{
std::string listed(const std::vector<std::string> & names)
{
  std::string text;
  for (const auto & name : names) {
    text += (text.empty() ? "" : ", ") + name;
  }
  return text;
}
}  // namespace

std::string plan(std::vector<Joint> & joints, const std::vector<std::string> & wheels, bool steers)
{
  std::vector<bool> driven(wheels.size(), false);
  bool steered = false;
  const std::string has =
    "this robot has " + listed(wheels) + (steers ? ", and steering, steering_left or steering_right" : "");
  for (auto & joint : joints) {
    joint.part = part_of(joint.wheel);
    if (joint.part != Part::WHEEL) {
      if (!steers) {
        return "joint " + joint.name + " has the parameter wheel = " + joint.wheel +
               ", but the service's base does not steer (setting wheels.layout): " + has;
      }
      steered = steered || joint.commanded;
      continue;
    }
    const auto found = std::find(wheels.begin(), wheels.end(), joint.wheel);
    if (found == wheels.end()) {
      return "joint " + joint.name + " has the parameter wheel = " + joint.wheel + ": " + has;
    }
    joint.number = static_cast<std::size_t>(found - wheels.begin());
    driven[joint.number] = driven[joint.number] || joint.commanded;
  }
  for (std::size_t number = 0; number < wheels.size(); ++number) {
    if (!driven[number]) {
      return "no joint drives the wheel " + wheels[number] + ": give one the parameter wheel = " + wheels[number] +
             " and the command interface velocity";
    }
  }
  if (steers && !steered) {
    return "no joint steers: give one the parameter wheel = steering and the command interface position";
  }
  return "";
}

// Both wheels of the axle and its middle turn about one point on the line of the rear axle, so the cotangents of their
// angles differ by half of the ratio. This is that rule for tangents, which are finite straight ahead.
double middle_angle(Part part, double angle, double ratio)
{
  const double tangent = std::tan(angle);
  if (part == Part::STEERING_LEFT) {
    return std::atan(tangent / (1.0 + tangent * ratio / 2.0));
  }
  if (part == Part::STEERING_RIGHT) {
    return std::atan(tangent / (1.0 - tangent * ratio / 2.0));
  }
  return angle;
}

double part_angle(Part part, double middle, double ratio)
{
  const double tangent = std::tan(middle);
  if (part == Part::STEERING_LEFT) {
    return std::atan(tangent / (1.0 - tangent * ratio / 2.0));
  }
  if (part == Part::STEERING_RIGHT) {
    return std::atan(tangent / (1.0 + tangent * ratio / 2.0));
  }
  return middle;
}

bool Command::is_zero() const
{
  return std::all_of(radps.begin(), radps.end(), [](double each) { return each == 0.0; });
}

bool combine(
  const std::vector<Joint> & joints, const std::vector<double> & values, const std::vector<bool> & claimed,
  double ratio, Command & command)
{
  std::array<double, MOST_WHEELS> sums{};
  std::array<double, MOST_WHEELS> counts{};
  double angles = 0.0;
  double steering = 0.0;
  bool any = false, steers = false;
  for (std::size_t at = 0; at < joints.size(); ++at) {
    const Joint & joint = joints[at];
    if (!joint.commanded) {
      continue;
    }
    steers = steers || joint.part != Part::WHEEL;
    if (!claimed[at]) {
      continue;
    }
    const double value = values[at];
    if (!std::isfinite(value)) {
      return false;
    }
    any = true;
    if (joint.part == Part::WHEEL) {
      sums[joint.number] += value;
      counts[joint.number] += 1.0;
    } else {
      angles += middle_angle(joint.part, value, ratio);
      steering += 1.0;
    }
  }
  for (std::size_t number = 0; number < MOST_WHEELS; ++number) {
    command.radps[number] = counts[number] > 0.0 ? sums[number] / counts[number] : 0.0;
  }
  command.steering_rad = steering > 0.0 ? angles / steering : steers ? 0.0 : NONE;
  return any;
}

}  // namespace failstop_ros2_control
