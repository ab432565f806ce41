// Logs why nothing moves, whenever that changes. The real-time loop must not log, so a thread of its own does.
#pragma once

#include <condition_variable>
#include <failstop.hpp>
#include <mutex>
#include <string>
#include <thread>

#include "rclcpp/logger.hpp"

namespace failstop_ros2_control
{

class Reporter
{
public:
  explicit Reporter(rclcpp::Logger logger) : logger_(std::move(logger)) {}
  Reporter(const Reporter &) = delete;
  Reporter & operator=(const Reporter &) = delete;
  ~Reporter() { stop(); }

  /// `robot` must outlive stop(). Does nothing if the system has no thread left: then nothing is logged.
  void start(const failstop::Robot & robot);
  /// Returns when the thread has ended, which takes no longer than the line that it may be writing.
  void stop();

private:
  void follow(const failstop::Robot & robot);

  rclcpp::Logger logger_;
  std::thread thread_;
  std::mutex mutex_;
  std::condition_variable woken_;
  bool ending_ = false;
};

}  // namespace failstop_ros2_control
