#include "reporter.hpp"

#include <signal.h>

#include <chrono>
#include <system_error>

#include "rclcpp/logging.hpp"

namespace failstop_ros2_control
{

namespace
{
constexpr std::chrono::milliseconds EVERY{200};
constexpr const char * DEFAULT_SERVICE = "failstop";

/// Why nothing moves, and what to do; empty if the wheels may turn, or if only nobody commands, which is no news.
std::string reason(const failstop::Robot & robot, const failstop::State & state, const std::string & option)
{
  switch (state.block) {
    case FS_BLOCK_LATCHED: {
      const std::string remedy = robot.remedy();
      return robot.why() + "; next: " + (remedy.empty() ? "failstop why" + option : remedy);
    }
    case FS_BLOCK_DISABLED:
      return "motion is disabled; next: failstop enable" + option;
    case FS_BLOCK_HELD:
      return "a controller commanded a speed before motion was enabled; next: let it command zero";
    case FS_BLOCK_NO_SCAN:
      return "the obstacle sensor is silent; next: let a program report it to failstop, or set scan.gate = \"off\"";
    default:
      return "";
  }
}
}  // namespace

void Reporter::start(const failstop::Robot & robot, const std::string & service)
{
  stop();
  option_ = service.empty() || service == DEFAULT_SERVICE ? "" : " --name " + service;
  ending_ = false;
  // Signals are for the program's own threads.
  sigset_t all, before;
  sigfillset(&all);
  pthread_sigmask(SIG_SETMASK, &all, &before);
  try {
    thread_ = std::thread(&Reporter::follow, this, std::cref(robot));
  } catch (const std::system_error & error) {
    RCLCPP_WARN(logger_, "can't log why motion is blocked: %s", error.what());
  }
  pthread_sigmask(SIG_SETMASK, &before, nullptr);
}

void Reporter::stop()
{
  {
    std::lock_guard<std::mutex> lock(mutex_);
    ending_ = true;
  }
  woken_.notify_all();
  if (thread_.joinable()) {
    thread_.join();
  }
}

void Reporter::follow(const failstop::Robot & robot)
{
  // The thread of the real-time loop may have made this one, which must not compete with it.
  const sched_param ordinary{};
  pthread_setschedparam(pthread_self(), SCHED_OTHER, &ordinary);
  std::string before = "at the start";
  std::unique_lock<std::mutex> lock(mutex_);
  while (!ending_) {
    lock.unlock();
    failstop::State state;
    if (robot.state(state)) {
      const std::string why = reason(robot, state, option_);
      if (why != before) {
        if (!why.empty()) {
          RCLCPP_WARN(logger_, "motion is blocked: %s", why.c_str());
        } else if (before != "at the start") {
          RCLCPP_INFO(logger_, "motion is no longer blocked");
        }
        before = why;
      }
    }
    lock.lock();
    woken_.wait_for(lock, EVERY, [this] { return ending_; });
  }
}

}  // namespace failstop_ros2_control
