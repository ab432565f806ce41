// Stand-in for rclcpp: a point in time.
#pragma once

#include <cstdint>

namespace rclcpp
{
class Time
{
public:
  explicit Time(int64_t nanoseconds = 0) : nanoseconds_(nanoseconds) {}
  int64_t nanoseconds() const { return nanoseconds_; }
  double seconds() const { return static_cast<double>(nanoseconds_) / 1e9; }

private:
  int64_t nanoseconds_;
};
}  // namespace rclcpp
