// A sensor whose read() does what a faulty driver in the same controller manager may do, when a test asks for it: it
// takes the order from a file, in the thread of the real-time loop.
#include <cstdio>
#include <cstdlib>
#include <fstream>
#include <stdexcept>
#include <string>
#include <vector>

#include "hardware_interface/hardware_info.hpp"
#include "hardware_interface/sensor_interface.hpp"
#include "hardware_interface/types/hardware_interface_return_values.hpp"
#include "pluginlib/class_list_macros.hpp"
#include "rclcpp/duration.hpp"
#include "rclcpp/time.hpp"

namespace failstop_hurt
{

using hardware_interface::return_type;

class Hurt : public hardware_interface::SensorInterface
{
public:
  // Before 4.38 the interfaces are the component's own.
#if !__has_include("hardware_interface/types/hardware_component_interface_params.hpp")
  std::vector<hardware_interface::StateInterface> export_state_interfaces() override
  {
    std::vector<hardware_interface::StateInterface> found;
    found.emplace_back(info_.sensors.front().name, info_.sensors.front().state_interfaces.front().name, &value_);
    return found;
  }
#endif

  return_type read(const rclcpp::Time &, const rclcpp::Duration &) override
  {
    const std::string & path = info_.hardware_parameters.at("orders");
    std::string order;
    if (!(std::ifstream(path) >> order)) {
      return return_type::OK;
    }
    std::remove(path.c_str());
    if (order == "segv") {
      volatile int * nowhere = nullptr;
      *nowhere = 1;
    } else if (order == "abort") {
      std::abort();
    } else if (order == "exit") {
      std::exit(3);
    } else if (order == "throw") {
      throw std::runtime_error("a test");
    } else if (order == "spin") {
      for (volatile bool more = true; more;) {
      }
    }
    return return_type::ERROR;
  }

private:
  double value_ = 0.0;
};

}  // namespace failstop_hurt

PLUGINLIB_EXPORT_CLASS(failstop_hurt::Hurt, hardware_interface::SensorInterface)
