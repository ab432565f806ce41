#include "system.hpp"

#include <algorithm>
#include <chrono>
#include <cmath>
#include <locale>
#include <sstream>
#include <thread>
#include <utility>

#include "hardware_interface/types/hardware_interface_type_values.hpp"
#include "pluginlib/class_list_macros.hpp"
#include "rclcpp/logging.hpp"

namespace failstop_ros2_control
{

namespace
{
constexpr std::chrono::milliseconds LOOK_EVERY{100};
constexpr double MOST_WAIT_S = 600.0;
const char * const PARAMETERS[] = {"service", "source", "interlock", "wait_s", "on_latched"};

const char * or_null(const std::string & text) { return text.empty() ? nullptr : text.c_str(); }

std::string parameter(const std::unordered_map<std::string, std::string> & parameters, const std::string & name)
{
  const auto found = parameters.find(name);
  return found == parameters.end() ? "" : found->second;
}

/// Whether the text is a number as the URDF and the service write it, whatever the program's locale is.
bool is_number(const std::string & text, double & value)
{
  std::istringstream in(text);
  in.imbue(std::locale::classic());
  char more = 0;
  return in >> value && !(in >> more) && std::isfinite(value);
}
}  // namespace

System::System() : logger_(rclcpp::get_logger("failstop")), reporter_(logger_) {}

System::~System() { leave(); }

#if FAILSTOP_FRAMEWORK_KEEPS_VALUES
CallbackReturn System::on_init(const hardware_interface::HardwareComponentInterfaceParams & params)
{
  const CallbackReturn found = hardware_interface::SystemInterface::on_init(params);
  return found == CallbackReturn::SUCCESS ? begin() : found;
}

void System::publish()
{
  for (const auto & each : shown_) {
    set_state(each.name, each.value);
  }
}

void System::collect()
{
  for (std::size_t at = 0; at < joints_.size(); ++at) {
    if (joints_[at].commanded) {
      values_[at] = get_command(commands_[at]);
    }
  }
}

void System::forget(std::size_t at)
{
  values_[at] = NONE;
  set_command(commands_[at], NONE);
}
#else
CallbackReturn System::on_init(const hardware_interface::HardwareInfo & info)
{
  const CallbackReturn found = hardware_interface::SystemInterface::on_init(info);
  return found == CallbackReturn::SUCCESS ? begin() : found;
}

std::vector<hardware_interface::StateInterface> System::export_state_interfaces()
{
  std::vector<hardware_interface::StateInterface> found;
  for (auto & each : shown_) {
    const auto slash = each.name.rfind('/');
    found.emplace_back(each.name.substr(0, slash), each.name.substr(slash + 1), &each.value);
  }
  return found;
}

std::vector<hardware_interface::CommandInterface> System::export_command_interfaces()
{
  std::vector<hardware_interface::CommandInterface> found;
  for (std::size_t at = 0; at < joints_.size(); ++at) {
    if (joints_[at].commanded) {
      found.emplace_back(joints_[at].name, commands_[at].substr(joints_[at].name.size() + 1), &values_[at]);
    }
  }
  return found;
}

// The interfaces point to our values.
void System::publish() {}
void System::collect() {}
void System::forget(std::size_t at) { values_[at] = NONE; }
#endif

CallbackReturn System::begin()
{
  const std::string wrong = parse();
  if (!wrong.empty()) {
    RCLCPP_ERROR(logger_, "%s: %s", info_.name.c_str(), wrong.c_str());
    return CallbackReturn::ERROR;
  }
  return CallbackReturn::SUCCESS;
}

std::string System::parse()
{
  const auto & given = info_.hardware_parameters;
  for (const auto & [name, value] : given) {
    if (std::find(std::begin(PARAMETERS), std::end(PARAMETERS), name) == std::end(PARAMETERS)) {
      // It may be one of the framework's own.
      RCLCPP_WARN(logger_, "%s: the parameter %s has no effect on failstop", info_.name.c_str(), name.c_str());
    }
  }
  service_ = parameter(given, "service");
  source_ = parameter(given, "source");
  interlock_ = parameter(given, "interlock");
  const std::string wait = parameter(given, "wait_s");
  if (!wait.empty() && (!is_number(wait, wait_s_) || wait_s_ < 0.0 || wait_s_ > MOST_WAIT_S)) {
    return "the parameter wait_s = " + wait + ": give the seconds to wait for the service, 0 to 600";
  }
  const std::string latched = parameter(given, "on_latched");
  if (!latched.empty() && latched != "hold" && latched != "error") {
    return "the parameter on_latched = " + latched + ": allowed is hold or error";
  }
  error_on_latched_ = latched == "error";

  for (const auto & each : info_.joints) {
    Joint joint;
    joint.name = each.name;
    joint.wheel = parameter(each.parameters, "wheel");
    if (joint.wheel.empty()) {
      return "joint " + each.name + " needs the parameter wheel: a wheel of the service such as left or front_right, "
             "or steering, steering_left, steering_right";
    }
    joint.part = part_of(joint.wheel);
    const bool turns = joint.part == Part::WHEEL;
    const std::string wanted = turns ? hardware_interface::HW_IF_VELOCITY : hardware_interface::HW_IF_POSITION;
    std::string command;
    for (const auto & interface : each.command_interfaces) {
      if (interface.name != wanted || !command.empty()) {
        return "joint " + each.name + " has the command interface " + interface.name + ": only one is possible, " +
               wanted;
      }
      command = each.name + "/" + wanted;
    }
    joint.commanded = !command.empty();
    for (const auto & interface : each.state_interfaces) {
      const bool position = interface.name == hardware_interface::HW_IF_POSITION;
      if (!position && !(turns && interface.name == hardware_interface::HW_IF_VELOCITY)) {
        return "joint " + each.name + " has the state interface " + interface.name + ": possible " +
               (turns ? "are position and velocity" : "is position");
      }
      shown_.push_back({each.name + "/" + interface.name, nullptr, joints_.size(), position, position ? 0.0 : NONE});
    }
    joints_.push_back(joint);
    commands_.push_back(command);
  }
  values_.assign(joints_.size(), NONE);
  claimed_.assign(joints_.size(), false);

  for (const auto & each : info_.sensors) {
    for (const auto & interface : each.state_interfaces) {
      const Reading * const reading = reading_of(interface.name);
      if (reading == nullptr) {
        return "sensor " + each.name + " has the state interface " + interface.name + ": possible are " +
               reading_names();
      }
      shown_.push_back({each.name + "/" + interface.name, reading, 0, false});
    }
  }
  if (!info_.gpios.empty()) {
    return "gpio " + info_.gpios.front().name + ": failstop has no gpio; declare it as a sensor";
  }
  return "";
}

bool System::look_for_service()
{
  const auto until = std::chrono::steady_clock::now() + std::chrono::duration<double>(wait_s_);
  bool waited = false;
  close();
  for (;;) {
    const failstop::Result found = robot_.open(or_null(service_), info_.name.c_str());
    if (found) {
      return true;
    }
    if (found != FS_NO_SERVICE || std::chrono::steady_clock::now() >= until) {
      // Without a handle there is no last error.
      const std::string wrong = found == FS_INVALID
                                  ? "the parameter service = " + service_ + ": use 1 to 32 of a-z, 0-9, _ and -"
                                  : robot_.last_error();
      RCLCPP_ERROR(logger_, "%s: %s", info_.name.c_str(), wrong.empty() ? found.text() : wrong.c_str());
      return false;
    }
    if (!std::exchange(waited, true)) {
      RCLCPP_INFO(
        logger_, "%s: waiting up to %g s for the service: %s", info_.name.c_str(), wait_s_,
        robot_.last_error().c_str());
    }
    std::this_thread::sleep_for(LOOK_EVERY);
  }
}

CallbackReturn System::on_configure(const rclcpp_lifecycle::State &)
{
  if (!look_for_service()) {
    return CallbackReturn::FAILURE;
  }
  wheels_.clear();
  for (int number = 0; number < robot_.wheel_count(); ++number) {
    wheels_.emplace_back(robot_.wheel_name(number));
  }
  const bool steers = robot_.setting("wheels.layout") == "ackermann";
  double track = 0.0, base = 0.0;
  std::string wrong = plan(joints_, wheels_, steers);
  if (steers) {
    const bool known = is_number(robot_.setting("wheels.track_m"), track) &&
                       is_number(robot_.setting("wheels.wheelbase_m"), base) && base > 0.0;
    ratio_ = known ? track / base : 0.0;
    if (!known && wrong.empty()) {
      wrong = "the service's settings wheels.track_m and wheels.wheelbase_m can't be read: restart the service";
    }
  }
  if (wrong.empty() && !source_.empty() && !robot_.has_source(source_.c_str())) {
    wrong = "the parameter source = " + source_ + ": the service's settings declare no such source; add [sources." +
            source_ + "]";
  }
  if (wrong.empty() && !interlock_.empty() && !robot_.has_interlock(interlock_.c_str())) {
    wrong = "the parameter interlock = " + interlock_ +
            ": the service's settings declare no such interlock; add [interlocks." + interlock_ + "]";
  }
  if (!wrong.empty()) {
    RCLCPP_ERROR(logger_, "%s: %s", info_.name.c_str(), wrong.c_str());
    robot_.close();
    return CallbackReturn::FAILURE;
  }
  for (auto & each : turned_) {
    each.forget();
  }
  failstop::State state;
  if (robot_.state(state) && std::isnan(state.turned_rad[0])) {
    RCLCPP_WARN(
      logger_, "%s: the board has reported no wheels yet; until it does, positions are added up from the commands",
      info_.name.c_str());
  }
  return CallbackReturn::SUCCESS;
}

CallbackReturn System::on_activate(const rclcpp_lifecycle::State &)
{
  const failstop::Result connected = robot_.connect();
  if (!connected) {
    RCLCPP_ERROR(logger_, "%s: %s", info_.name.c_str(), robot_.last_error().c_str());
    return CallbackReturn::FAILURE;
  }
  for (std::size_t at = 0; at < joints_.size(); ++at) {
    if (joints_[at].commanded) {
      forget(at);
    }
  }
  drove_ = false;
  active_ = true;
  RCLCPP_INFO(logger_, "%s: connected; nothing moves before somebody enables motion", info_.name.c_str());
  reporter_.start(robot_, service_);
  return CallbackReturn::SUCCESS;
}

CallbackReturn System::on_deactivate(const rclcpp_lifecycle::State &)
{
  disable(FS_DEFAULT_TIMEOUT);
  return CallbackReturn::SUCCESS;
}

CallbackReturn System::on_cleanup(const rclcpp_lifecycle::State &)
{
  leave();
  return CallbackReturn::SUCCESS;
}

CallbackReturn System::on_shutdown(const rclcpp_lifecycle::State &)
{
  leave();
  return CallbackReturn::SUCCESS;
}

CallbackReturn System::on_error(const rclcpp_lifecycle::State &)
{
  // The handle stays open: closing it would take back a request that the service has not heard yet.
  disable(0.0);
  return CallbackReturn::SUCCESS;
}

void System::leave()
{
  if (active_) {
    disable(FS_DEFAULT_TIMEOUT);
  }
  close();
}

void System::close()
{
  if (std::exchange(unanswered_, false)) {
    ask_to_disable(FS_DEFAULT_TIMEOUT);
  }
  robot_.close();
}

void System::disable(double timeout_s)
{
  if (!std::exchange(active_, false)) {
    return;
  }
  // The zero first: it needs no answer.
  drive({});
  ask_to_disable(timeout_s);
  unanswered_ = timeout_s == 0.0;
  reporter_.stop();
}

void System::ask_to_disable(double timeout_s)
{
  const failstop::Result result = robot_.disable(timeout_s);
  // A service that has ended has stopped the wheels itself, and a stop now would latch its successor.
  if (!result && result != FS_NO_SERVICE) {
    robot_.stop("ros2_control was deactivated, and motion could not be disabled");
  }
}

return_type System::perform_command_mode_switch(
  const std::vector<std::string> & start, const std::vector<std::string> & stop)
{
  for (std::size_t at = 0; at < joints_.size(); ++at) {
    if (!joints_[at].commanded) {
      continue;
    }
    if (std::find(stop.begin(), stop.end(), commands_[at]) != stop.end()) {
      claimed_[at] = false;
    }
    if (std::find(start.begin(), start.end(), commands_[at]) != start.end()) {
      // Not every controller sets its interfaces to zero when it leaves them, so the old value may be a speed.
      forget(at);
      claimed_[at] = true;
    }
  }
  return return_type::OK;
}

double System::value_of(const Shown & shown, const failstop::State & state) const
{
  if (shown.reading != nullptr) {
    return shown.reading->of(state);
  }
  const Joint & joint = joints_[shown.joint];
  if (joint.part != Part::WHEEL) {
    return part_angle(joint.part, steering_rad_, ratio_);
  }
  if (shown.position) {
    return turned_[joint.number].shown();
  }
  if (std::isnan(state.turned_rad[joint.number])) {
    return state.wheels_radps[joint.number];
  }
  return state.measured_age_s <= OLD_S ? state.measured_radps[joint.number] : NONE;
}

return_type System::read(const rclcpp::Time &, const rclcpp::Duration & period)
{
  failstop::State state;
  if (!robot_.state(state)) {
    return return_type::ERROR;
  }
  for (std::size_t number = 0; number < wheels_.size(); ++number) {
    turned_[number].see(state.turned_rad[number], state.wheels_radps[number], period.seconds());
  }
  // At rest no velocity determines an angle, and the servo keeps the last one.
  if (!std::isnan(state.steering_rad)) {
    steering_rad_ = state.steering_rad;
  }
  for (auto & each : shown_) {
    each.value = value_of(each, state);
  }
  publish();
  return error_on_latched_ && active_ && state.latched != 0 ? return_type::ERROR : return_type::OK;
}

int System::drive(const Command & command)
{
  failstop::Command rest;
  rest.source = or_null(source_);
  drove_ = !command.is_zero();
  return robot_.drive_wheels(command.radps.data(), wheels_.size(), command.steering_rad, rest).code();
}

return_type System::write(const rclcpp::Time &, const rclcpp::Duration &)
{
  // Humble writes to an inactive hardware too.
  if (!active_) {
    return return_type::OK;
  }
  int result = FS_OK;
  if (!interlock_.empty()) {
    const char * const names[] = {interlock_.c_str()};
    result = failstop::Result(robot_.assert_interlocks(names, 1)).code();
  }
  collect();
  Command command;
  if (combine(joints_, values_, claimed_, ratio_, command)) {
    result = result == FS_OK ? drive(command) : result;
  } else if (drove_) {
    // Nobody commands any more. One zero stops the wheels at once; after it the service hears nothing from here, so
    // another source may drive.
    result = result == FS_OK ? drive({}) : result;
  }
  return result == FS_OK ? return_type::OK : return_type::ERROR;
}

}  // namespace failstop_ros2_control

PLUGINLIB_EXPORT_CLASS(failstop_ros2_control::System, hardware_interface::SystemInterface)
