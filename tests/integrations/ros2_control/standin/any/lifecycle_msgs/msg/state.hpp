// Stand-in for lifecycle_msgs: the numbers of the primary states.
#pragma once

#include <cstdint>

namespace lifecycle_msgs::msg
{
struct State
{
  static constexpr uint8_t PRIMARY_STATE_UNKNOWN = 0;
  static constexpr uint8_t PRIMARY_STATE_UNCONFIGURED = 1;
  static constexpr uint8_t PRIMARY_STATE_INACTIVE = 2;
  static constexpr uint8_t PRIMARY_STATE_ACTIVE = 3;
  static constexpr uint8_t PRIMARY_STATE_FINALIZED = 4;
};
}  // namespace lifecycle_msgs::msg
