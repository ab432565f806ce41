// Stand-in for hardware_interface 2.x (Humble): a system has all of it, and exports its interfaces itself.
#pragma once

#include <string>
#include <vector>

#include "hardware_interface/handle.hpp"
#include "hardware_interface/hardware_info.hpp"
#include "hardware_interface/types/hardware_interface_return_values.hpp"
#include "lifecycle_msgs/msg/state.hpp"
#include "rclcpp/duration.hpp"
#include "rclcpp/time.hpp"
#include "rclcpp_lifecycle/node_interfaces/lifecycle_node_interface.hpp"
#include "rclcpp_lifecycle/state.hpp"

namespace hardware_interface
{
using CallbackReturn = rclcpp_lifecycle::node_interfaces::LifecycleNodeInterface::CallbackReturn;

class SystemInterface : public rclcpp_lifecycle::node_interfaces::LifecycleNodeInterface
{
public:
  SystemInterface() = default;
  SystemInterface(const SystemInterface &) = delete;
  SystemInterface(SystemInterface &&) = default;

  virtual CallbackReturn on_init(const HardwareInfo & info)
  {
    info_ = info;
    return CallbackReturn::SUCCESS;
  }
  virtual std::vector<StateInterface> export_state_interfaces() = 0;
  virtual std::vector<CommandInterface> export_command_interfaces() = 0;
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
  virtual return_type write(const rclcpp::Time &, const rclcpp::Duration &) = 0;
  virtual std::string get_name() const { return info_.name; }
  const rclcpp_lifecycle::State & get_state() const { return state_; }
  void set_state(const rclcpp_lifecycle::State & state) { state_ = state; }

protected:
  HardwareInfo info_;
  rclcpp_lifecycle::State state_;
};
}  // namespace hardware_interface
