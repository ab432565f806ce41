// Logs why nothing moves, whenever the reason changes. It has its own thread, because the real-time loop must not log.
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

  /// `robot` must exist until stop() has returned. `service`: its service's name, for the commands in the log; empty for
  /// the default one. If no thread can be started, nothing is logged.
  void start(const failstop::Robot & robot, const std::string & service);
  /// Ends the thread and waits for it. This takes no longer than the line that it may be logging.
  void stop();

private:
  void follow(const failstop::Robot & robot);

  rclcpp::Logger logger_;
  std::thread thread_;
  std::mutex mutex_;
  std::condition_variable woken_;
  bool ending_ = false;
  /// What a failstop command needs to mean this service.
  std::string option_;
};

}  // namespace failstop_ros2_control
