// Stand-in for hardware_interface 4.x (Jazzy), 5.x (Kilted) and 6.x (Lyrical): the framework makes the interfaces that the
// URDF lists, and the component sets and gets their values by name. RELEASE is the first number of its version.
#pragma once

#include <cmath>
#include <map>
#include <memory>
#include <mutex>
#include <stdexcept>
#include <string>
#include <vector>

#include "hardware_interface/hardware_info.hpp"
#include "hardware_interface/types/hardware_component_interface_params.hpp"
#include "hardware_interface/types/hardware_interface_return_values.hpp"
#include "lifecycle_msgs/msg/state.hpp"
#include "rclcpp/duration.hpp"
#include "rclcpp/logger.hpp"
#include "rclcpp/time.hpp"
#include "rclcpp_lifecycle/node_interfaces/lifecycle_node_interface.hpp"
#include "rclcpp_lifecycle/state.hpp"

#if RELEASE >= 5
namespace control_msgs::msg
{
struct HardwareStatus
{
};
}  // namespace control_msgs::msg
#endif

namespace hardware_interface
{
using CallbackReturn = rclcpp_lifecycle::node_interfaces::LifecycleNodeInterface::CallbackReturn;

class HardwareComponentInterface : public rclcpp_lifecycle::node_interfaces::LifecycleNodeInterface
{
public:
  HardwareComponentInterface() = default;
  HardwareComponentInterface(const HardwareComponentInterface &) = delete;
  HardwareComponentInterface(HardwareComponentInterface &&) = delete;

#if RELEASE == 4
  [[deprecated("Use on_init(const HardwareComponentInterfaceParams & params) instead.")]]
  virtual CallbackReturn on_init(const HardwareInfo & info)
  {
    info_ = info;
    return CallbackReturn::SUCCESS;
  }
#endif
#if RELEASE >= 5
  virtual CallbackReturn init_hardware_status_message(control_msgs::msg::HardwareStatus &)
  {
    return CallbackReturn::SUCCESS;
  }
  virtual return_type update_hardware_status_message(control_msgs::msg::HardwareStatus &)
  {
    return return_type::OK;
  }
#endif
  virtual CallbackReturn on_init(const HardwareComponentInterfaceParams & params)
  {
    info_ = params.hardware_info;
    for (const auto * components : {&info_.joints, &info_.sensors, &info_.gpios}) {
      for (const auto & component : *components) {
        for (const auto & each : component.state_interfaces) {
          states_[component.name + "/" + each.name] = NAN;
        }
        for (const auto & each : component.command_interfaces) {
          commands_[component.name + "/" + each.name] = NAN;
        }
      }
    }
    return CallbackReturn::SUCCESS;
  }
  virtual return_type prepare_command_mode_switch(
    const std::vector<std::string> &, const std::vector<std::string> &)
  {
    return return_type::OK;
  }
  virtual return_type perform_command_mode_switch(
    const std::vector<std::string> &, const std::vector<std::string> &)
  {
    return return_type::OK;
  }
  virtual return_type read(const rclcpp::Time &, const rclcpp::Duration &) = 0;
  virtual return_type write(const rclcpp::Time &, const rclcpp::Duration &) { return return_type::OK; }

  const std::string & get_name() const { return info_.name; }
  const rclcpp_lifecycle::State & get_lifecycle_state() const { return state_; }
  void set_lifecycle_state(const rclcpp_lifecycle::State & state) { state_ = state; }
  rclcpp::Logger get_logger() const { return rclcpp::Logger("standin"); }
  const HardwareInfo & get_hardware_info() const { return info_; }

  template <typename T>
  void set_state(const std::string & name, const T & value)
  {
    std::lock_guard<std::mutex> lock(values_);
    of(states_, name) = value;
  }
  template <typename T = double>
  T get_state(const std::string & name) const
  {
    std::lock_guard<std::mutex> lock(values_);
    return of(states_, name);
  }
  template <typename T>
  void set_command(const std::string & name, const T & value)
  {
    std::lock_guard<std::mutex> lock(values_);
    of(commands_, name) = value;
  }
  template <typename T = double>
  T get_command(const std::string & name) const
  {
    std::lock_guard<std::mutex> lock(values_);
    return of(commands_, name);
  }

protected:
  HardwareInfo info_;

private:
  template <typename Values>
  static auto & of(Values & values, const std::string & name)
  {
    auto found = values.find(name);
    if (found == values.end()) {
      throw std::runtime_error("The requested interface not found: " + name);
    }
    return found->second;
  }

  rclcpp_lifecycle::State state_;
  mutable std::mutex values_;
  std::map<std::string, double> states_;
  std::map<std::string, double> commands_;
};
}  // namespace hardware_interface
