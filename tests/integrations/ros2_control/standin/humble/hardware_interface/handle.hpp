// Stand-in for hardware_interface 2.x (Humble): a handle points to a double of the component's own.
#pragma once

#include <string>
#include <utility>

namespace hardware_interface
{
class ReadOnlyHandle
{
public:
  ReadOnlyHandle(std::string prefix, std::string interface, double * value = nullptr)
  : prefix_(std::move(prefix)), interface_(std::move(interface)), value_(value)
  {
  }
  virtual ~ReadOnlyHandle() = default;
  ReadOnlyHandle(const ReadOnlyHandle &) = default;
  ReadOnlyHandle(ReadOnlyHandle &&) = default;
  const std::string get_name() const { return prefix_ + "/" + interface_; }
  double get_value() const { return *value_; }

protected:
  std::string prefix_;
  std::string interface_;
  double * value_;
};

class StateInterface : public ReadOnlyHandle
{
public:
  using ReadOnlyHandle::ReadOnlyHandle;
};

class CommandInterface : public ReadOnlyHandle
{
public:
  using ReadOnlyHandle::ReadOnlyHandle;
  CommandInterface(const CommandInterface &) = delete;
  CommandInterface(CommandInterface &&) = default;
  void set_value(double value) { *value_ = value; }
};
}  // namespace hardware_interface
