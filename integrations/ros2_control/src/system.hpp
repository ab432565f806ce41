// failstop as a ros2_control system: one source for Humble (2.x), Jazzy (4.x), Kilted (5.x) and Lyrical (6.x).
#pragma once

#include <deque>
#include <failstop.hpp>
#include <string>
#include <vector>

#include "hardware_interface/hardware_info.hpp"
#include "hardware_interface/system_interface.hpp"
#include "hardware_interface/types/hardware_interface_return_values.hpp"
#include "rclcpp/duration.hpp"
#include "rclcpp/logger.hpp"
#include "rclcpp/time.hpp"
#include "rclcpp_lifecycle/state.hpp"
#include "readings.hpp"
#include "reporter.hpp"
#include "wheels.hpp"

// Since 4.38, on_init gets this struct, and the framework keeps the interfaces' values. In older releases we keep them.
#if __has_include("hardware_interface/types/hardware_component_interface_params.hpp")
#include "hardware_interface/types/hardware_component_interface_params.hpp"
#define FAILSTOP_FRAMEWORK_KEEPS_VALUES 1
#else
#define FAILSTOP_FRAMEWORK_KEEPS_VALUES 0
#endif

namespace failstop_ros2_control
{

using hardware_interface::CallbackReturn;
using hardware_interface::return_type;

/// The framework calls read() and write() in its real-time loop, and never while a lifecycle callback runs.
class System : public hardware_interface::SystemInterface
{
public:
  System();
  System(const System &) = delete;
  System & operator=(const System &) = delete;
  /// Stops the wheels, as on_deactivate() does, if on_deactivate() was not called.
  ~System() override;

#if FAILSTOP_FRAMEWORK_KEEPS_VALUES
  CallbackReturn on_init(const hardware_interface::HardwareComponentInterfaceParams & params) override;
#else
  CallbackReturn on_init(const hardware_interface::HardwareInfo & info) override;
  std::vector<hardware_interface::StateInterface> export_state_interfaces() override;
  std::vector<hardware_interface::CommandInterface> export_command_interfaces() override;
#endif

  /// Look for the service, for up to `wait_s`, and compare its wheels with the URDF's joints.
  CallbackReturn on_configure(const rclcpp_lifecycle::State & previous) override;
  /// Take a client slot. Motion is never enabled here: this runs again whenever the controller manager is respawned.
  CallbackReturn on_activate(const rclcpp_lifecycle::State & previous) override;
  /// Stop the wheels and disable motion. If the service does not answer, a stop is latched.
  CallbackReturn on_deactivate(const rclcpp_lifecycle::State & previous) override;
  CallbackReturn on_cleanup(const rclcpp_lifecycle::State & previous) override;
  CallbackReturn on_shutdown(const rclcpp_lifecycle::State & previous) override;
  /// As on_deactivate(), but without waiting, because the real-time loop calls it. The hardware can be configured again.
  CallbackReturn on_error(const rclcpp_lifecycle::State & previous) override;

  return_type perform_command_mode_switch(
    const std::vector<std::string> & start, const std::vector<std::string> & stop) override;

  /// Returns ERROR if the service has ended. With `on_latched` = error, also if a stop is latched.
  return_type read(const rclcpp::Time & time, const rclcpp::Duration & period) override;
  /// Returns ERROR if the service does not accept the command.
  return_type write(const rclcpp::Time & time, const rclcpp::Duration & period) override;

private:
  /// A state interface, and the value that it shows.
  struct Shown
  {
    std::string name;
    /// What a sensor's interface shows. nullptr for a joint's interface.
    const Reading * reading;
    /// The joint's number.
    std::size_t joint;
    bool position;
    double value = NONE;
  };

  CallbackReturn begin();
  std::string parse();
  bool look_for_service();
  double value_of(const Shown & shown, const failstop::State & state) const;
  void publish();
  void collect();
  /// Leave the joint without a command, so that nothing moves until a controller has written one.
  void forget(std::size_t at);
  int drive(const Command & command);
  void disable(double timeout_s);
  void ask_to_disable(double timeout_s);
  void close();
  void leave();

  rclcpp::Logger logger_;
  failstop::Robot robot_;
  Reporter reporter_;
  bool active_ = false;
  /// True if on_error() has asked to disable motion and did not wait for the answer.
  bool unanswered_ = false;

  std::string service_, source_, interlock_;
  double wait_s_ = 10.0;
  bool error_on_latched_ = false;

  std::vector<Joint> joints_;
  /// For each of joints_: its command interface's name (or empty), the value, and true if a controller has claimed it.
  std::vector<std::string> commands_;
  std::vector<double> values_;
  std::vector<bool> claimed_;
  /// A deque, because in old releases the framework points to the values in it.
  std::deque<Shown> shown_;

  std::vector<std::string> wheels_;
  double ratio_ = 0.0;
  std::array<Turned, MOST_WHEELS> turned_;
  double steering_rad_ = 0.0;
  /// True if the last command was not zero, so that a zero must follow.
  bool drove_ = false;
};

}  // namespace failstop_ros2_control
