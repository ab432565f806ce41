// From the joints of a URDF to the wheels of failstop, and back. Pure: it knows neither ROS nor the service.
#pragma once

#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <string>
#include <vector>

namespace failstop_ros2_control
{

constexpr double NONE = std::numeric_limits<double>::quiet_NaN();
constexpr std::size_t MOST_WHEELS = 4;

/// What a joint moves, by its parameter `wheel`.
enum class Part { WHEEL, STEERING, STEERING_LEFT, STEERING_RIGHT };

/// One joint of the URDF.
struct Joint
{
  std::string name;
  /// The parameter `wheel`: a wheel of the service, `steering`, `steering_left` or `steering_right`.
  std::string wheel;
  bool commanded = false;
  Part part = Part::WHEEL;
  /// The wheel's number in the service's order. Only for a WHEEL, and only after plan().
  std::size_t number = 0;
};

/// `steering`, `steering_left`, `steering_right`, or a wheel.
inline Part part_of(const std::string & wheel)
{
  if (wheel == "steering") {
    return Part::STEERING;
  }
  if (wheel == "steering_left") {
    return Part::STEERING_LEFT;
  }
  return wheel == "steering_right" ? Part::STEERING_RIGHT : Part::WHEEL;
}

/// Give each joint the number of its wheel. Returns what is wrong in one sentence with the remedy, or an empty text.
/// `wheels`: the service's wheels in its order. `steers`: the base has a steered axle.
std::string plan(std::vector<Joint> & joints, const std::vector<std::string> & wheels, bool steers);

/// The angle of the middle of a steered axle, rad to the left, if one of its wheels stands at `angle`.
/// `ratio`: track divided by wheelbase.
double middle_angle(Part part, double angle, double ratio);

/// The angle of this part of the axle, rad to the left, if its middle stands at `middle`.
double part_angle(Part part, double middle, double ratio);

/// What the wheels of the service are told.
struct Command
{
  /// rad/s, positive forward, in the order of the service's wheels.
  std::array<double, MOST_WHEELS> radps{};
  /// rad to the left; NONE: the base does not steer.
  double steering_rad = NONE;

  bool is_zero() const;
};

/// What the joints' commands (rad/s, or rad for steering) tell the wheels. Several claimed joints of one wheel count by
/// their mean. A wheel of which no controller has claimed a joint stands still, and an axle that nobody steers points
/// straight ahead. Returns false if a claimed joint's command is not finite, or if none is claimed: then nobody commands.
bool combine(
  const std::vector<Joint> & joints, const std::vector<double> & values, const std::vector<bool> & claimed,
  double ratio, Command & command);

/// How far a wheel has turned since this was made, rad. It never jumps: not when the service starts again and counts
/// from zero, and not when a board begins to report.
class Turned
{
public:
  /// `turned`: the service's count, rad; NONE if its board reports nothing, and then the commanded speed is added up.
  void see(double turned, double commanded_radps, double seconds)
  {
    if (std::isnan(turned)) {
      shown_ += std::isnan(commanded_radps) ? 0.0 : commanded_radps * seconds;
    } else if (!std::isnan(last_)) {
      shown_ += turned - last_;
    }
    last_ = turned;
  }
  /// The next count is another service's.
  void forget() { last_ = NONE; }
  double shown() const { return shown_; }

private:
  double shown_ = 0.0;
  double last_ = NONE;
};

}  // namespace failstop_ros2_control
