// A ros2_control controller for a @TITLE@: stamped poses of the platform become commands of six joints,
// within limits of rate and acceleration. `update` neither allocates nor waits; poses are solved where they arrive.
//
// SPDX-License-Identifier: BSD-2-Clause

#include <algorithm>
#include <cmath>
#include <limits>
#include <mutex>
#include <string>
#include <vector>

#include "controller_interface/controller_interface.hpp"
#include "geometry_msgs/msg/pose_stamped.hpp"
#include "pluginlib/class_list_macros.hpp"
#include "rclcpp/rclcpp.hpp"
#if __has_include("realtime_tools/realtime_buffer.hpp")
#include "realtime_tools/realtime_buffer.hpp"
#else
#include "realtime_tools/realtime_buffer.h"
#endif
#include "spm_set_points.hpp"

namespace @PACKAGE@
{

// From Jazzy on an interface is read by `get_optional`, before by `get_value`.
template<typename Interface>
auto value_of(const Interface & interface, int) -> decltype(interface.get_optional().value_or(0.0))
{
  return interface.get_optional().value_or(std::numeric_limits<double>::quiet_NaN());
}

template<typename Interface>
double value_of(const Interface & interface, long) {return interface.get_value();}

class SpmController : public controller_interface::ControllerInterface
{
public:
  controller_interface::CallbackReturn on_init() override
  {
    auto_declare<std::string>("frame_id", "@BASE@");
    auto_declare<std::vector<std::string>>("joints", {});
    auto_declare<double>("timeout", 0.0);
    for (const char * name : {"zeros", "max_step", "max_velocity", "max_acceleration"}) {
      auto_declare<std::vector<double>>(name, {});
    }
    (void)read_machine(set_points_.machine, [this](const std::string & name, double *, std::size_t) {
        auto_declare<std::vector<double>>("machine." + name, {});
        return true;
      });
    return controller_interface::CallbackReturn::SUCCESS;
  }

  controller_interface::CallbackReturn on_configure(const rclcpp_lifecycle::State &) override
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    Readings rate{}, acceleration{};
    joints_ = get_node()->get_parameter("joints").as_string_array();
    set_points_.frame = get_node()->get_parameter("frame_id").as_string();
    set_points_.timeout = get_node()->get_parameter("timeout").as_double();
    Readings & step = set_points_.largest_step;
    const bool are_whole = read("zeros", zeros_.data(), 6) && read("max_step", step.data(), 6) &&
      read("max_velocity", rate.data(), 6) && read("max_acceleration", acceleration.data(), 6) &&
      read_machine(set_points_.machine, [this](const std::string & name, double * numbers, std::size_t count) {
          return read("machine." + name, numbers, count);
        });
    const auto is_positive = [](double x) {return x > 0.0 && std::isfinite(x);};
    const auto are_positive = [&](const Readings & x) {return std::all_of(x.begin(), x.end(), is_positive);};
    if (!are_whole || joints_.size() != 6 || get_update_rate() == 0 || !is_positive(set_points_.timeout) ||
      !are_positive(step) || !are_positive(rate) || !are_positive(acceleration))
    {
      RCLCPP_ERROR(
        get_node()->get_logger(), "expected a rate of updates, six joints, and a positive max_step, timeout, max_velocity and "
        "max_acceleration: is config/spm_controller.yaml given?");
      return controller_interface::CallbackReturn::FAILURE;
    }
    set_points_.period = 1.0 / get_update_rate();
    limiter_.configure(rate, acceleration, set_points_.period);
    subscription_ = get_node()->create_subscription<geometry_msgs::msg::PoseStamped>(
      "~/reference", rclcpp::SystemDefaultsQoS(),
      [this](const geometry_msgs::msg::PoseStamped & message) {take(message);});
    return controller_interface::CallbackReturn::SUCCESS;
  }

  controller_interface::CallbackReturn on_activate(const rclcpp_lifecycle::State &) override
  {
    // A set-point of before is not followed: the machine stays where it is.
    const std::lock_guard<std::mutex> lock(mutex_);
    Readings readings{};
    for (std::size_t i = 0; i < 6; ++i) {readings[i] = value_of(state_interfaces_[i], 0) + zeros_[i];}
    const int status = set_points_.begin(readings);
    if (status != @PREFIX_UPPER@OK) {
      RCLCPP_ERROR(
        get_node()->get_logger(), "no state with the measured joints: %s", @PREFIX@status_name(status));
      return controller_interface::CallbackReturn::FAILURE;
    }
    limiter_.begin(readings, target_.serial);
    is_active_ = true;
    return controller_interface::CallbackReturn::SUCCESS;
  }

  controller_interface::CallbackReturn on_deactivate(const rclcpp_lifecycle::State &) override
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    is_active_ = false;
    return controller_interface::CallbackReturn::SUCCESS;
  }

  controller_interface::InterfaceConfiguration command_interface_configuration() const override {return interfaces();}

  controller_interface::InterfaceConfiguration state_interface_configuration() const override {return interfaces();}

  controller_interface::return_type update(const rclcpp::Time &, const rclcpp::Duration &) override
  {
    const Readings commands = limiter_.tick(*for_update_.readFromRT());
    for (std::size_t i = 0; i < 6; ++i) {(void)command_interfaces_[i].set_value(commands[i] - zeros_[i]);}
    return controller_interface::return_type::OK;
  }

private:
  std::mutex mutex_;  // of all that `update` does not touch
  SetPoints set_points_;
  Target target_;
  bool is_active_ = false;
  realtime_tools::RealtimeBuffer<Target> for_update_;
  Limiter limiter_;
  std::vector<std::string> joints_;
  Readings zeros_{};  // what the encoders read where the joints of the description are at zero
  rclcpp::Subscription<geometry_msgs::msg::PoseStamped>::SharedPtr subscription_;

  void take(const geometry_msgs::msg::PoseStamped & message)
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    if (!is_active_) {return;}
    const auto & p = message.pose.position;
    const auto & q = message.pose.orientation;
    const double stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec;
    const SetPoint wanted{message.header.frame_id, stamp, {p.x, p.y, p.z}, {q.x, q.y, q.z, q.w}};
    const std::string reason = set_points_.take(wanted, get_node()->now().seconds(), target_);
    if (reason.empty()) {
      for_update_.writeFromNonRT(target_);
      return;
    }
    RCLCPP_WARN_THROTTLE(
      get_node()->get_logger(), *get_node()->get_clock(), 1000, "the set-point is refused, the last one is held: %s",
      reason.c_str());
  }

  bool read(const std::string & name, double * numbers, std::size_t count)
  {
    const std::vector<double> values = get_node()->get_parameter(name).as_double_array();
    if (values.size() != count) {
      RCLCPP_ERROR(
        get_node()->get_logger(), "%s: expected %zu numbers, got %zu", name.c_str(), count, values.size());
      return false;
    }
    std::copy(values.begin(), values.end(), numbers);
    return true;
  }

  controller_interface::InterfaceConfiguration interfaces() const
  {
    controller_interface::InterfaceConfiguration configuration{
      controller_interface::interface_configuration_type::INDIVIDUAL, {}};
    for (const std::string & joint : joints_) {configuration.names.push_back(joint + "/position");}
    return configuration;
  }
};

}  // namespace @PACKAGE@

PLUGINLIB_EXPORT_CLASS(@PACKAGE@::SpmController, controller_interface::ControllerInterface)
