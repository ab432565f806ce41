// Stand-in for hardware_interface 4.x and later: what on_init gets.
#pragma once

#include "hardware_interface/hardware_info.hpp"

namespace hardware_interface
{
struct HardwareComponentInterfaceParams
{
  HardwareInfo hardware_info;
};
}  // namespace hardware_interface
