// Stand-in for rclcpp_lifecycle: a state with its label.
#pragma once

#include <cstdint>
#include <string>

namespace rclcpp_lifecycle
{
class State
{
public:
  State() : State(0, "unknown") {}
  State(uint8_t id, std::string label) : id_(id), label_(std::move(label)) {}
  uint8_t id() const { return id_; }
  std::string label() const { return label_; }

private:
  uint8_t id_;
  std::string label_;
};
}  // namespace rclcpp_lifecycle
