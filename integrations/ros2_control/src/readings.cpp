#include "readings.hpp"

#include <array>

#include "wheels.hpp"

namespace failstop_ros2_control
{

namespace
{
template <int axis>
double rate(const failstop::State & state)
{
  return state.imu_age_s <= OLD_S ? state.rate[axis] : NONE;
}

template <int axis>
double acceleration(const failstop::State & state)
{
  return state.imu_age_s <= OLD_S ? state.acceleration[axis] : NONE;
}

// imu_sensor_broadcaster asks for an orientation, and no board of failstop measures one.
double nothing(const failstop::State &) { return NONE; }

double voltage(const failstop::State & state)
{
  return state.battery_age_s <= BATTERY_OLD_S ? state.battery_v : NONE;
}

const std::array<Reading, 19> READINGS{{
  {"enabled", [](const failstop::State & state) { return static_cast<double>(state.enabled); }},
  {"latched", [](const failstop::State & state) { return static_cast<double>(state.latched); }},
  {"blocked", [](const failstop::State & state) { return static_cast<double>(state.block); }},
  {"cause", [](const failstop::State & state) { return static_cast<double>(state.cause); }},
  {"moving", [](const failstop::State & state) { return static_cast<double>(state.moving); }},
  {"ready", [](const failstop::State & state) { return static_cast<double>(state.ready); }},
  {"turning", [](const failstop::State & state) { return static_cast<double>(state.turning); }},
  {"link", [](const failstop::State & state) { return static_cast<double>(state.link); }},
  {"voltage", voltage},
  {"orientation.x", nothing},
  {"orientation.y", nothing},
  {"orientation.z", nothing},
  {"orientation.w", nothing},
  {"angular_velocity.x", rate<0>},
  {"angular_velocity.y", rate<1>},
  {"angular_velocity.z", rate<2>},
  {"linear_acceleration.x", acceleration<0>},
  {"linear_acceleration.y", acceleration<1>},
  {"linear_acceleration.z", acceleration<2>},
}};
}  // namespace

const Reading * reading_of(const std::string & name)
{
  for (const auto & reading : READINGS) {
    if (name == reading.name) {
      return &reading;
    }
  }
  return nullptr;
}

std::string reading_names()
{
  std::string text;
  for (const auto & reading : READINGS) {
    text += (text.empty() ? "" : ", ") + std::string(reading.name);
  }
  return text;
}

}  // namespace failstop_ros2_control
