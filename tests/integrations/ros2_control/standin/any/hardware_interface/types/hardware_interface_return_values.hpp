// Stand-in for hardware_interface: what read() and write() return.
#pragma once

#include <cstdint>

namespace hardware_interface
{
enum class return_type : uint8_t { OK = 0, ERROR = 1, DEACTIVATE = 2 };
}  // namespace hardware_interface
