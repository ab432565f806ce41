// Stand-in for rclcpp: a span of time.
#pragma once

#include <chrono>
#include <cstdint>

namespace rclcpp
{
class Duration
{
public:
  explicit Duration(std::chrono::nanoseconds span) : nanoseconds_(span.count()) {}
  int64_t nanoseconds() const { return nanoseconds_; }
  double seconds() const { return static_cast<double>(nanoseconds_) / 1e9; }

private:
  int64_t nanoseconds_;
};
}  // namespace rclcpp
