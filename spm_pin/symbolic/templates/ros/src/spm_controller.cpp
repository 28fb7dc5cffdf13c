// A ros2_control controller for the 3RPS-3SPR manipulator: each tick turns a reference pose into six slides, and the
// measured slides into a pose. Nothing in `update` allocates, locks or iterates without a bound, but for a warning where a
// reference is refused or the measured slides have no state, once a second at most.
//
// SPDX-License-Identifier: BSD-2-Clause

#include <array>
#include <cmath>
#include <cstddef>
#include <limits>
#include <string>

#include "controller_interface/controller_interface.hpp"
#include "geometry_msgs/msg/pose.hpp"
#include "pluginlib/class_list_macros.hpp"
#include "rclcpp/rclcpp.hpp"
#if __has_include("realtime_tools/realtime_buffer.hpp")
#include "realtime_tools/realtime_buffer.hpp"
#else
#include "realtime_tools/realtime_buffer.h"
#endif
#include "@PREFIX@kinematics.h"

namespace @PACKAGE@
{

constexpr std::array<const char *, 6> SLIDES = {@SLIDES@};
// What the encoders read where the slides of the description are at zero [m].
constexpr std::array<double, 6> ZEROS = {@ZEROS@};

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
  // A pose of {m} in {B}, the rotation row by row.
  struct Pose
  {
    std::array<double, 9> rotation{};
    std::array<double, 3> position{};
    bool is_given = false;
  };
  // The topic `~/reference` writes it; `update` reads it without waiting.
  realtime_tools::RealtimeBuffer<Pose> reference;

  // Where the platform is, from the measured slides; NaN and a status if that is not known.
  @PREFIX@state measured{};
  int measured_status = @PREFIX_UPPER@NOT_FINITE;
  // What became of the reference; commands are kept where it is not `@PREFIX_UPPER@OK`.
  int status = @PREFIX_UPPER@OK;

  controller_interface::CallbackReturn on_init() override {return controller_interface::CallbackReturn::SUCCESS;}

  controller_interface::CallbackReturn on_configure(const rclcpp_lifecycle::State &) override
  {
    subscription_ = get_node()->create_subscription<geometry_msgs::msg::Pose>(
      "~/reference", rclcpp::SystemDefaultsQoS(),
      [this](const geometry_msgs::msg::Pose & message) {reference.writeFromNonRT(pose_of(message));});
    return controller_interface::CallbackReturn::SUCCESS;
  }

  controller_interface::CallbackReturn on_activate(const rclcpp_lifecycle::State &) override
  {
    // A reference of before is not followed, and where the machine is now is found anew.
    reference.writeFromNonRT(Pose{});
    measured_status = @PREFIX_UPPER@NOT_FINITE;
    return controller_interface::CallbackReturn::SUCCESS;
  }

  controller_interface::InterfaceConfiguration command_interface_configuration() const override {return interfaces();}

  controller_interface::InterfaceConfiguration state_interface_configuration() const override {return interfaces();}

  controller_interface::return_type update(const rclcpp::Time &, const rclcpp::Duration &) override
  {
    std::array<double, 6> readings{};
    for (std::size_t i = 0; i < SLIDES.size(); ++i) {
      readings[i] = value_of(state_interfaces_[i], 0) + ZEROS[i];
    }
    // From where it was, so that the assembly mode never changes unnoticed; anew where that is not known.
    const @PREFIX@state * near = measured_status == @PREFIX_UPPER@OK ? &measured : nullptr;
    measured_status = @PREFIX@forward(&@PREFIX@machine, readings.data(), near, &measured);

    const Pose & wanted = *reference.readFromRT();
    if (wanted.is_given && measured_status == @PREFIX_UPPER@OK) {
      // On the branch that the machine is in: a pose may be held in two, and a jump from one to the other breaks it.
      @PREFIX@state state{};
      status = @PREFIX@inverse(
        &@PREFIX@machine, wanted.rotation.data(), wanted.position.data(), &measured, &state);
      for (std::size_t i = 0; i < SLIDES.size() && status == @PREFIX_UPPER@OK; ++i) {
        if (state.readings[i] < @PREFIX@machine.minimum[i] || state.readings[i] > @PREFIX@machine.maximum[i]) {
          status = @PREFIX_UPPER@UNREACHABLE;
        }
      }
      if (status != @PREFIX_UPPER@OK) {
        RCLCPP_WARN_THROTTLE(
          get_node()->get_logger(), *get_node()->get_clock(), 1000, "the reference is refused, commands are kept: %s",
          @PREFIX@status_name(status));
      }
      for (std::size_t i = 0; i < SLIDES.size() && status == @PREFIX_UPPER@OK; ++i) {
        (void)command_interfaces_[i].set_value(state.readings[i] - ZEROS[i]);
      }
    }
    if (measured_status != @PREFIX_UPPER@OK) {
      RCLCPP_WARN_THROTTLE(
        get_node()->get_logger(), *get_node()->get_clock(), 1000, "no state with the measured slides: %s",
        @PREFIX@status_name(measured_status));
    }
    return measured_status == @PREFIX_UPPER@OK ? controller_interface::return_type::OK :
           controller_interface::return_type::ERROR;
  }

  static Pose pose_of(const geometry_msgs::msg::Pose & message)
  {
    const auto & p = message.position;
    const auto & q = message.orientation;
    const double size = std::sqrt(q.x * q.x + q.y * q.y + q.z * q.z + q.w * q.w);
    const double x = q.x / size, y = q.y / size, z = q.z / size, w = q.w / size;
    Pose pose;
    pose.rotation = {
      1.0 - 2.0 * (y * y + z * z), 2.0 * (x * y - z * w), 2.0 * (x * z + y * w),
      2.0 * (x * y + z * w), 1.0 - 2.0 * (x * x + z * z), 2.0 * (y * z - x * w),
      2.0 * (x * z - y * w), 2.0 * (y * z + x * w), 1.0 - 2.0 * (x * x + y * y)};
    pose.position = {p.x, p.y, p.z};
    pose.is_given = true;
    return pose;
  }

private:
  rclcpp::Subscription<geometry_msgs::msg::Pose>::SharedPtr subscription_;

  static controller_interface::InterfaceConfiguration interfaces()
  {
    controller_interface::InterfaceConfiguration configuration{
      controller_interface::interface_configuration_type::INDIVIDUAL, {}};
    for (const char * slide : SLIDES) {
      configuration.names.push_back(std::string(slide) + "/position");
    }
    return configuration;
  }
};

}  // namespace @PACKAGE@

PLUGINLIB_EXPORT_CLASS(@PACKAGE@::SpmController, controller_interface::ControllerInterface)
