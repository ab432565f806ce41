// Stand-in for hardware_interface 4.x and later: a system has to write.
#pragma once

#include "hardware_interface/hardware_component_interface.hpp"

namespace hardware_interface
{
class SystemInterface : public HardwareComponentInterface
{
public:
  return_type write(const rclcpp::Time &, const rclcpp::Duration &) override = 0;
};
}  // namespace hardware_interface
