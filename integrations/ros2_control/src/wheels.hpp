// Converts between the joints of a URDF and failstop's wheels. Pure: it uses neither ROS nor the service.
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

/// What a joint moves. Its parameter `wheel` says so.
enum class Part { WHEEL, STEERING, STEERING_LEFT, STEERING_RIGHT };

/// One joint of the URDF.
struct Joint
{
  std::string name;
  /// The parameter `wheel`: the name of a wheel of the service, `steering`, `steering_left` or `steering_right`.
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

/// Give each joint the number of its wheel. If that fails, returns the reason and the remedy, else an empty text.
/// `wheels`: the service's wheels in its order. `steers`: the base has a steered axle.
std::string plan(std::vector<Joint> & joints, const std::vector<std::string> & wheels, bool steers);

/// The angle of the middle of a steered axle, rad to the left, if one of its wheels has the angle `angle`.
/// `ratio`: track divided by wheelbase.
double middle_angle(Part part, double angle, double ratio);

/// The angle of this part of the axle, rad to the left, if the axle's middle has the angle `middle`.
double part_angle(Part part, double middle, double ratio);

/// A command for the wheels of the service.
struct Command
{
  /// rad/s, positive forward, in the order of the service's wheels.
  std::array<double, MOST_WHEELS> radps{};
  /// rad to the left. NONE if the base does not steer.
  double steering_rad = NONE;

  bool is_zero() const;
};

/// Turn the joints' commands (rad/s, or rad for steering) into a command for the wheels. If several claimed joints move
/// one wheel, their mean is used. A wheel without a claimed joint stands still, and an axle that nobody steers points
/// straight ahead. Returns false if a claimed joint's command is not finite, or if no joint is claimed.
bool combine(
  const std::vector<Joint> & joints, const std::vector<double> & values, const std::vector<bool> & claimed,
  double ratio, Command & command);

/// How far a wheel has turned since this object was made, rad. The value never jumps, even if the service is restarted
/// and counts from zero, or if a board begins to report.
class Turned
{
public:
  /// `turned`: the service's count, rad. NONE if its board reports nothing. Then the commanded speed is added up.
  void see(double turned, double commanded_radps, double seconds)
  {
    if (std::isnan(turned)) {
      shown_ += std::isnan(commanded_radps) ? 0.0 : commanded_radps * seconds;
    } else if (!std::isnan(last_)) {
      shown_ += turned - last_;
    }
    last_ = turned;
  }
  /// Call this if the next count comes from another service.
  void forget() { last_ = NONE; }
  double shown() const { return shown_; }

private:
  double shown_ = 0.0;
  double last_ = NONE;
};

}  // namespace failstop_ros2_control
