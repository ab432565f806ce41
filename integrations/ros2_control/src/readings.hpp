// The state interfaces that a sensor of the URDF may list. Each shows one value of the service's state.
#pragma once

#include <failstop.hpp>

#include <string>

namespace failstop_ros2_control
{

/// A reading older than this, s, is shown as NaN, because it may not be true any more. The ROS 2 bridge does the same.
constexpr double OLD_S = 0.5;
/// The battery is reported about once a second.
constexpr double BATTERY_OLD_S = 10.0;

/// One state interface of a sensor.
struct Reading
{
  const char * name;
  double (*of)(const failstop::State &);
};

/// The reading with this name, or nullptr.
const Reading * reading_of(const std::string & name);

/// The names of all readings, for a message.
std::string reading_names();

}  // namespace failstop_ros2_control
