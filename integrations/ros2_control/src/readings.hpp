// The state interfaces that a sensor of the URDF may list, each with what it shows of the service.
#pragma once

#include <failstop.hpp>

#include <string>

namespace failstop_ros2_control
{

/// A reading older than this, s, says nothing of now and is shown as NaN. The bridge to ROS 2 has the same bound.
constexpr double OLD_S = 0.5;
/// The battery is reported about once a second.
constexpr double BATTERY_OLD_S = 10.0;

/// One state interface of a sensor.
struct Reading
{
  const char * name;
  double (*of)(const failstop::State &);
};

/// The reading of that name, or nullptr.
const Reading * reading_of(const std::string & name);

/// All their names, for a message.
std::string reading_names();

}  // namespace failstop_ros2_control
