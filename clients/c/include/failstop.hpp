/**
 * libfailstop for C++11 and newer: a handle that closes itself. It adds nothing to failstop.h but types, so read the
 * comments there. Nothing here throws, except for std::string without memory.
 */
#ifndef FAILSTOP_HPP
#define FAILSTOP_HPP

#include <cstddef>
#include <cstdint>
#include <exception>
#include <string>
#include <utility>

#include "failstop.h"

namespace failstop {

/** What a call returned. False in a condition unless it is FS_OK. */
class Result {
public:
  Result(int code) noexcept : code_(code) {}  // NOLINT: a code is a result
  explicit operator bool() const noexcept { return code_ == FS_OK; }
  int code() const noexcept { return code_; }
  const char *text() const noexcept { return fs_result_text(code_); }
  friend bool operator==(Result one, fs_result other) noexcept { return one.code_ == other; }
  friend bool operator!=(Result one, fs_result other) noexcept { return one.code_ != other; }

private:
  int code_;
};

/** A snapshot, with its size set. */
struct State : fs_state {
  State() noexcept : fs_state() { size = sizeof(fs_state); }
};

/** A command, with its size set. */
struct Command : fs_velocity {
  explicit Command(double vx_mps = 0, double vy_mps = 0, double wz_radps = 0) noexcept : fs_velocity() {
    size = sizeof(fs_velocity);
    vx = vx_mps;
    vy = vy_mps;
    wz = wz_radps;
  }
};

/**
 * A handle. It can be moved, but not copied. Its destructor is fs_close(). If an exception destroys the handle, the
 * destructor is fs_abandon() instead, because the program has failed, even if something catches the exception later.
 */
class Robot {
public:
  /** No handle yet: every call returns FS_INVALID until open(). */
  Robot() noexcept = default;
  Robot(const Robot &) = delete;
  Robot &operator=(const Robot &) = delete;
  Robot(Robot &&other) noexcept : robot_(other.robot_) { other.robot_ = nullptr; }
  Robot &operator=(Robot &&other) noexcept {
    if (this != &other) {
      close();
      std::swap(robot_, other.robot_);
    }
    return *this;
  }
  ~Robot() {
    if (unwinding() > unwinding_) {
      fs_abandon(robot_);
    } else {
      fs_close(robot_);
    }
  }

  /** Opens in place of an earlier handle, which is closed. */
  Result open(const char *service = nullptr, const char *client = nullptr) noexcept {
    close();
    return fs_open(&robot_, service, client);
  }
  Result connect() noexcept { return fs_connect(robot_); }
  void close() noexcept {
    fs_close(robot_);
    robot_ = nullptr;
  }
  Result keep_enabled() noexcept { return fs_keep_enabled(robot_); }

  Result drive(double vx, double vy, double wz) noexcept { return fs_drive(robot_, vx, vy, wz); }
  Result drive(const Command &command) noexcept { return fs_command(robot_, &command); }
  Result drive_wheels(const double *radps, std::size_t count, double steering_rad = FS_NONE) noexcept {
    return fs_drive_wheels(robot_, radps, count, steering_rad, nullptr);
  }
  Result drive_wheels(const double *radps, std::size_t count, double steering_rad, const Command &command) noexcept {
    return fs_drive_wheels(robot_, radps, count, steering_rad, &command);
  }
  Result sensed() noexcept { return fs_sensed(robot_); }
  Result assert_interlocks(const char *const *names, std::size_t count) noexcept {
    return fs_assert_interlocks(robot_, names, count);
  }
  Result say(const char *sees, const char *wrong = nullptr) noexcept { return fs_say(robot_, sees, wrong); }

  Result enable(double timeout_s = FS_DEFAULT_TIMEOUT) noexcept { return fs_enable(robot_, timeout_s); }
  Result disable(double timeout_s = FS_DEFAULT_TIMEOUT) noexcept { return fs_disable(robot_, timeout_s); }
  Result reset(std::uint64_t seen = 0, double timeout_s = FS_DEFAULT_TIMEOUT) noexcept {
    return fs_reset(robot_, seen, timeout_s);
  }
  Result stop(const char *reason) const noexcept { return fs_stop(robot_, reason); }

  Result state(State &state) const noexcept { return fs_get_state(robot_, &state); }
  std::string why() const { return text(fs_why); }
  std::string remedy() const { return text(fs_remedy); }
  std::string last_error() const { return text(fs_last_error); }
  std::string setting(const char *key) const {
    char found[512] = "";
    return fs_setting(robot_, key, found, sizeof found) < 0 ? std::string() : std::string(found);
  }
  int wheel_count() const noexcept { return fs_wheel_count(robot_); }
  const char *wheel_name(int index) const noexcept { return fs_wheel_name(robot_, index); }
  bool has_source(const char *name) const noexcept { return fs_has_source(robot_, name) == 1; }
  bool has_interlock(const char *name) const noexcept { return fs_has_interlock(robot_, name) == 1; }

  /** For the C functions. */
  fs_robot *get() const noexcept { return robot_; }

private:
  /** How many exceptions are on their way in this thread; before C++17, only whether one is. */
  static int unwinding() noexcept {
#if defined(__cpp_lib_uncaught_exceptions)
    return std::uncaught_exceptions();
#else
    return std::uncaught_exception();
#endif
  }

  std::string text(int (*of)(const fs_robot *, char *, std::size_t)) const {
    char found[1024] = "";
    return of(robot_, found, sizeof found) < 0 ? std::string() : std::string(found);
  }

  fs_robot *robot_ = nullptr;
  /** Of unwinding(), when this object was made: a destructor may make one while an exception is on its way. */
  int unwinding_ = unwinding();
};

}  // namespace failstop
#endif
