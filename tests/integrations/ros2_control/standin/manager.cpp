// Stand-in for a controller manager: it loads the plugin, takes it through its lifecycle and calls read() and write() in a
// loop, as ros2_control does by release. The hardware's description comes as lines on stdin up to `end`, then commands:
//
//   claim, unclaim [NAME ...] a controller takes all command interfaces or these, or leaves them after setting 0.0
//   abandon [NAME ...]        a controller leaves them as they are, as forward_command_controller does
//   set JOINT VALUE           the controller's command, from the next turn on
//   to STATE                  configure, activate, deactivate, cleanup or shutdown
//   values                    at the end of a turn, print the number of turns and every state interface
//   fail                      the next read() counts as an ERROR, whatever it returned
//   segv, abort, spin, exit   in the loop: crash, hang, or exit(0) without any callback
//
// SIGINT and SIGTERM deactivate and shut down, as since 2025; with FAILSTOP_STANDIN_OLD they only end the program.
// Each callback and each state is a line on stdout.

#include <dlfcn.h>

#include <algorithm>
#include <atomic>
#include <chrono>
#include <clocale>
#include <csignal>
#include <cstdio>
#include <cstdlib>
#include <iostream>
#include <map>
#include <memory>
#include <mutex>
#include <sstream>
#include <string>
#include <thread>
#include <vector>

#include "hardware_interface/hardware_info.hpp"
#include "hardware_interface/system_interface.hpp"
#if RELEASE >= 4
#include "hardware_interface/types/hardware_component_interface_params.hpp"
#endif

using hardware_interface::CallbackReturn;
using hardware_interface::return_type;
using Primary = lifecycle_msgs::msg::State;
using rclcpp_lifecycle::State;

namespace
{
std::atomic<bool> ending{false};

void say(const std::string & line)
{
  std::printf("%s\n", line.c_str());
  std::fflush(stdout);
}

const char * word(CallbackReturn result)
{
  return result == CallbackReturn::SUCCESS ? "SUCCESS" : result == CallbackReturn::FAILURE ? "FAILURE" : "ERROR";
}

/// One hardware component, by the state machine of hardware_interface (system.cpp, hardware_component.cpp).
class Component
{
public:
  explicit Component(hardware_interface::SystemInterface * made) : system_(made) {}

  CallbackReturn init(const hardware_interface::HardwareInfo & info)
  {
#if RELEASE >= 4
    const auto result = system_->on_init(hardware_interface::HardwareComponentInterfaceParams{info});
#else
    const auto result = system_->on_init(info);
#endif
    say(std::string("on_init ") + word(result));
    go(result == CallbackReturn::SUCCESS ? Primary::PRIMARY_STATE_UNCONFIGURED : Primary::PRIMARY_STATE_FINALIZED);
#if RELEASE < 4
    states_ = system_->export_state_interfaces();
    commands_ = system_->export_command_interfaces();
#endif
    for (const auto & joint : info.joints) {
      for (const auto & each : joint.command_interfaces) {
        command_names_.push_back(joint.name + "/" + each.name);
      }
      for (const auto & each : joint.state_interfaces) {
        state_names_.push_back(joint.name + "/" + each.name);
      }
    }
    for (const auto & sensor : info.sensors) {
      for (const auto & each : sensor.state_interfaces) {
        state_names_.push_back(sensor.name + "/" + each.name);
      }
    }
    return result;
  }

  void to(const std::string & target)
  {
    using Node = rclcpp_lifecycle::node_interfaces::LifecycleNodeInterface;
    if (target == "configure" && at_ == Primary::PRIMARY_STATE_UNCONFIGURED) {
      step("on_configure", &Node::on_configure, Primary::PRIMARY_STATE_INACTIVE, at_);
    } else if (target == "activate" && at_ == Primary::PRIMARY_STATE_INACTIVE) {
      step("on_activate", &Node::on_activate, Primary::PRIMARY_STATE_ACTIVE, at_);
    } else if (target == "deactivate" && at_ == Primary::PRIMARY_STATE_ACTIVE) {
      step("on_deactivate", &Node::on_deactivate, Primary::PRIMARY_STATE_INACTIVE, at_);
    } else if (target == "cleanup" && at_ == Primary::PRIMARY_STATE_INACTIVE) {
      step("on_cleanup", &Node::on_cleanup, Primary::PRIMARY_STATE_UNCONFIGURED, at_);
    } else if (target == "shutdown") {
      step("on_shutdown", &Node::on_shutdown, Primary::PRIMARY_STATE_FINALIZED, at_);
    } else {
      say("no transition " + target);
    }
  }

  void error()
  {
    const auto result = system_->on_error(State(at_, ""));
    say(std::string("on_error ") + word(result));
    go(result == CallbackReturn::SUCCESS ? Primary::PRIMARY_STATE_UNCONFIGURED : Primary::PRIMARY_STATE_FINALIZED);
  }

  void read(const rclcpp::Duration & period, bool fails)
  {
    if (at_ != Primary::PRIMARY_STATE_INACTIVE && at_ != Primary::PRIMARY_STATE_ACTIVE) {
      return;
    }
    if (system_->read(rclcpp::Time(), period) == return_type::ERROR || fails) {
      say("read ERROR");
      error();
    }
  }

  void write(const rclcpp::Duration & period)
  {
    // Humble writes to an inactive hardware too, later releases only to an active one.
    const bool inactive = at_ == Primary::PRIMARY_STATE_INACTIVE && RELEASE < 4;
    if (!inactive && at_ != Primary::PRIMARY_STATE_ACTIVE) {
      return;
    }
    if (system_->write(rclcpp::Time(), period) == return_type::ERROR) {
      say("write ERROR");
      error();
    }
  }

  void claim(bool start, bool halts, const std::vector<std::string> & given)
  {
    const std::vector<std::string> none, & names = given.empty() ? command_names_ : given;
    if (halts) {
      for (const auto & name : names) {
        set(name, 0.0);  // as halt() of diff_drive_controller
      }
    }
    system_->prepare_command_mode_switch(start ? names : none, start ? none : names);
    system_->perform_command_mode_switch(start ? names : none, start ? none : names);
  }

  void set(const std::string & name, double value)
  {
#if RELEASE >= 4
    system_->set_command(name, value);
#else
    for (auto & each : commands_) {
      if (each.get_name() == name) {
        each.set_value(value);
      }
    }
#endif
  }

  void print(int turns)
  {
    std::ostringstream line;
    line << "values turns=" << turns;
    for (const auto & name : state_names_) {
      line << " " << name << "=" << value(name);
    }
    say(line.str());
  }

private:
  using Callback = CallbackReturn (rclcpp_lifecycle::node_interfaces::LifecycleNodeInterface::*)(const State &);

  double value(const std::string & name)
  {
#if RELEASE >= 4
    return system_->get_state(name);
#else
    for (const auto & each : states_) {
      if (each.get_name() == name) {
        return each.get_value();
      }
    }
    return -1e9;
#endif
  }

  void step(const char * name, Callback callback, uint8_t next, uint8_t otherwise)
  {
    const auto result = (system_.get()->*callback)(State(at_, ""));
    say(std::string(name) + " " + word(result));
    if (result == CallbackReturn::ERROR) {
      error();
    } else {
      go(result == CallbackReturn::SUCCESS ? next : otherwise);
    }
  }

  void go(uint8_t next)
  {
    static const char * const NAMES[] = {"unknown", "unconfigured", "inactive", "active", "finalized"};
    at_ = next;
    say(std::string("state ") + NAMES[next]);
  }

  std::unique_ptr<hardware_interface::SystemInterface> system_;
  uint8_t at_ = 0;
  std::vector<std::string> command_names_, state_names_;
#if RELEASE < 4
  std::vector<hardware_interface::StateInterface> states_;
  std::vector<hardware_interface::CommandInterface> commands_;
#endif
};

hardware_interface::HardwareInfo described()
{
  hardware_interface::HardwareInfo info;
  info.type = "system";
  hardware_interface::ComponentInfo * component = nullptr;
  for (std::string line; std::getline(std::cin, line) && line != "end";) {
    std::istringstream words(line);
    std::string what, name, value;
    words >> what >> name;
    std::getline(words >> std::ws, value);
    if (what == "name") {
      info.name = name;
    } else if (what == "param") {
      (component ? component->parameters : info.hardware_parameters)[name] = value;
    } else if (what == "command" || what == "state") {
      hardware_interface::InterfaceInfo interface;
      interface.name = name;
      (what == "command" ? component->command_interfaces : component->state_interfaces).push_back(interface);
    } else {
      auto & components = what == "joint" ? info.joints : what == "sensor" ? info.sensors : info.gpios;
      components.emplace_back();
      component = &components.back();
      component->name = name;
      component->type = what;
    }
  }
  return info;
}
}  // namespace

int main(int count, char ** arguments)
{
  if (count != 3) {
    std::fprintf(stderr, "usage: manager PLUGIN HZ\n");
    return 2;
  }
  const locale_t plain = newlocale(LC_ALL_MASK, "C", locale_t{});
  if (std::getenv("FAILSTOP_STANDIN_LOCALE") && !std::setlocale(LC_ALL, std::getenv("FAILSTOP_STANDIN_LOCALE"))) {
    return 2;
  }
  void * const library = dlopen(arguments[1], RTLD_NOW);
  if (library == nullptr) {
    std::fprintf(stderr, "%s\n", dlerror());
    return 2;
  }
  using Make = hardware_interface::SystemInterface * (*)();
  const Make make = reinterpret_cast<Make>(dlsym(library, "standin_make"));
  const auto end = [](int) { ending = true; };
  std::signal(SIGINT, end);
  std::signal(SIGTERM, end);

  Component component(make());
  // As in all releases, no callback runs while read() or write() does.
  std::recursive_mutex mutex;
  if (component.init(described()) != CallbackReturn::SUCCESS) {
    return 1;
  }
  component.to("configure");
  component.to("activate");

  const std::chrono::duration<double> period(1.0 / std::atof(arguments[2]));
  std::map<std::string, double> wanted;
  std::string fault;
  bool fails = false, asked = false;
  int turns = 0;
  std::thread loop([&] {
    while (!ending) {
      {
        std::lock_guard<std::recursive_mutex> lock(mutex);
        const rclcpp::Duration span(std::chrono::duration_cast<std::chrono::nanoseconds>(period));
        component.read(span, fails);
        fails = false;
        for (const auto & [name, value] : wanted) {
          component.set(name, value);
        }
        component.write(span);
        ++turns;
        if (asked) {
          component.print(turns);
          asked = false;
        }
        if (fault == "segv") {
          std::raise(SIGSEGV);
        } else if (fault == "abort") {
          std::abort();
        } else if (fault == "exit") {
          std::exit(0);
        }
        while (fault == "spin") {
        }
      }
      std::this_thread::sleep_for(period);
    }
  });
  std::thread told([&] {
    for (std::string line; std::getline(std::cin, line);) {
      std::lock_guard<std::recursive_mutex> lock(mutex);
      std::istringstream words(line);
      std::string verb, name;
      double value = 0.0;
      words >> verb;
      if (verb == "set") {
        words >> name >> line;
        value = strtod_l(line.c_str(), nullptr, plain);
        wanted[name] = value;
      } else if (verb == "claim" || verb == "unclaim" || verb == "abandon") {
        std::vector<std::string> names;
        while (words >> name) {
          names.push_back(name);
        }
        for (auto each = wanted.begin(); verb != "claim" && each != wanted.end();) {
          const bool left = names.empty() || std::find(names.begin(), names.end(), each->first) != names.end();
          each = left ? wanted.erase(each) : std::next(each);
        }
        component.claim(verb == "claim", verb == "unclaim", names);
        say(verb);
      } else if (verb == "to") {
        words >> name;
        component.to(name);
      } else if (verb == "values") {
        asked = true;
      } else if (verb == "fail") {
        fails = true;
      } else {
        fault = verb;
      }
    }
  });
  told.detach();
  loop.join();
  const std::lock_guard<std::recursive_mutex> lock(mutex);
  if (std::getenv("FAILSTOP_STANDIN_OLD") == nullptr) {
    component.to("deactivate");
    component.to("shutdown");
  }
  say("ends");
  return 0;
}
