// A ros2_control controller for a {{title}}: stamped poses of the platform become commands of its joints,
// within limits of rate and acceleration. Poses are solved where they arrive. What runs in the control loop, `update`,
// `on_activate` and `on_deactivate`, waits for nothing.
//
// SPDX-License-Identifier: BSD-2-Clause

#include <algorithm>
#include <array>
#include <atomic>
#include <cmath>
#include <cstdint>
#include <exception>
#include <limits>
#include <memory>
#include <mutex>
#include <string>
#include <vector>

#include "control_msgs/msg/joint_trajectory_controller_state.hpp"
#include "controller_interface/controller_interface.hpp"
#include "diagnostic_msgs/msg/diagnostic_status.hpp"
#include "geometry_msgs/msg/pose_stamped.hpp"
#include "pluginlib/class_list_macros.hpp"
#include "rclcpp/rclcpp.hpp"
#include "realtime_tools/realtime_buffer.hpp"
#include "realtime_tools/realtime_publisher.hpp"
#include "spm_set_points.hpp"

namespace {{package}}
{

// From Jazzy on an interface is read by `get_optional`, before by `get_value`.
template<typename Interface>
auto value_of(const Interface & interface, int) -> decltype(interface.get_optional().value_or(0.0))
{
  return interface.get_optional().value_or(std::numeric_limits<double>::quiet_NaN());
}

template<typename Interface>
double value_of(const Interface & interface, long) {return interface.get_value();}

// From Jazzy on a message is sent by `try_publish`, before by `tryPublish`.
template<typename Publisher, typename Message>
auto try_publish(Publisher & publisher, const Message & message, int) -> decltype(publisher.try_publish(message))
{
  return publisher.try_publish(message);
}

template<typename Publisher, typename Message>
bool try_publish(Publisher & publisher, const Message & message, long) {return publisher.tryPublish(message);}

class SpmController : public controller_interface::ControllerInterface
{
public:
  controller_interface::CallbackReturn on_init() override
  {
    try {
      auto_declare<std::string>("frame_id", "{{base}}");
      auto_declare<std::vector<std::string>>("joints", {});
      auto_declare<double>("timeout", 0.0);
      for (const char * name : {"zeros", "max_step", "max_velocity", "max_acceleration"}) {
        auto_declare<std::vector<double>>(name, {});
      }
      (void)read_machine(set_points_.machine, [this](const std::string & name, double *, std::size_t) {
          auto_declare<std::vector<double>>("machine." + name, {});
          return true;
        });
    } catch (const std::exception & error) {  // of another type, such as 1 for 1.0
      RCLCPP_ERROR(get_node()->get_logger(), "%s", error.what());
      return controller_interface::CallbackReturn::ERROR;
    }
    return controller_interface::CallbackReturn::SUCCESS;
  }

  controller_interface::CallbackReturn on_configure(const rclcpp_lifecycle::State &) override
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    Readings rate{}, acceleration{};
    set_points_.joints = get_node()->get_parameter("joints").as_string_array();
    set_points_.frame = get_node()->get_parameter("frame_id").as_string();
    set_points_.timeout = get_node()->get_parameter("timeout").as_double();
    Readings & step = set_points_.largest_step;
    const bool are_whole = read("zeros", zeros_.data(), LEGS) && read("max_step", step.data(), LEGS) &&
      read("max_velocity", rate.data(), LEGS) && read("max_acceleration", acceleration.data(), LEGS) &&
      read_machine(set_points_.machine, [this](const std::string & name, double * numbers, std::size_t count) {
          return read("machine." + name, numbers, count);
        });
    const auto is_positive = [](double x) {return x > 0.0 && std::isfinite(x);};
    const auto are_positive = [&](const Readings & x) {return std::all_of(x.begin(), x.end(), is_positive);};
    if (!are_whole || set_points_.joints.size() != LEGS || get_update_rate() == 0 || !is_positive(set_points_.timeout) ||
      !are_positive(step) || !are_positive(rate) || !are_positive(acceleration))
    {
      RCLCPP_ERROR(
        get_node()->get_logger(), "expected a rate of updates, {{zeros|length}} joints, and a positive max_step, timeout, max_velocity and "
        "max_acceleration: is config/spm_controller.yaml given?");
      return controller_interface::CallbackReturn::FAILURE;
    }
    set_points_.period = 1.0 / get_update_rate();
    limiter_.configure(rate, acceleration, set_points_.period);
    subscription_ = get_node()->create_subscription<geometry_msgs::msg::PoseStamped>(
      "~/reference", rclcpp::SystemDefaultsQoS(),
      [this](const geometry_msgs::msg::PoseStamped & message) {take(message);});
    status_publisher_ = get_node()->create_publisher<Status>("~/status", rclcpp::QoS(1).transient_local());
    state_publisher_ = std::make_unique<realtime_tools::RealtimePublisher<State>>(
      get_node()->create_publisher<State>("~/controller_state", rclcpp::SystemDefaultsQoS()));
    state_.joint_names = set_points_.joints;
    for (auto * point : {&state_.reference, &state_.feedback, &state_.error, &state_.output}) {point->positions.resize(LEGS);}
    return controller_interface::CallbackReturn::SUCCESS;
  }

  controller_interface::CallbackReturn on_activate(const rclcpp_lifecycle::State &) override
  {
    // A set-point of before is not followed: the machine stays where it is.
    activation_ = 0;
    Readings readings{};
    for (std::size_t i = 0; i < LEGS; ++i) {start_[i] = readings[i] = measured(i) + zeros_[i];}
    {{prefix}}state state{};
    const int status = {{prefix}}forward(&set_points_.machine, readings.data(), nullptr, &state);
    if (status != {{PREFIX}}OK) {
      RCLCPP_ERROR(
        get_node()->get_logger(), "no state with the measured joints: %s", {{prefix}}status_name(status));
      return controller_interface::CallbackReturn::FAILURE;
    }
    const std::uint64_t serial = ++activations_ << 32;
    limiter_.begin(readings, serial);
    reached_ = serial;
    activation_ = serial;
    return controller_interface::CallbackReturn::SUCCESS;
  }

  controller_interface::CallbackReturn on_deactivate(const rclcpp_lifecycle::State &) override
  {
    activation_ = 0;
    return controller_interface::CallbackReturn::SUCCESS;
  }

  controller_interface::InterfaceConfiguration command_interface_configuration() const override {return interfaces();}

  controller_interface::InterfaceConfiguration state_interface_configuration() const override {return interfaces();}

  controller_interface::return_type update(const rclcpp::Time & time, const rclcpp::Duration &) override
  {
    const Readings commands = limiter_.tick(*for_update_.readFromRT());
    reached_ = limiter_.serial();
    for (std::size_t i = 0; i < LEGS; ++i) {
      const double command = commands[i] - zeros_[i], feedback = measured(i);
      (void)command_interfaces_[i].set_value(command);
      state_.reference.positions[i] = state_.output.positions[i] = command;
      state_.feedback.positions[i] = feedback;
      state_.error.positions[i] = command - feedback;
    }
    state_.header.stamp = time;
    (void)try_publish(*state_publisher_, state_, 0);
    return controller_interface::return_type::OK;
  }

private:
  using State = control_msgs::msg::JointTrajectoryControllerState;
  using Status = diagnostic_msgs::msg::DiagnosticStatus;

  // Of the control loop, after `on_configure`.
  Limiter limiter_;
  State state_;
  std::unique_ptr<realtime_tools::RealtimePublisher<State>> state_publisher_;
  std::uint64_t activations_ = 0;
  Readings zeros_{};  // what the encoders read where the joints of the description are at zero

  // Between the control loop and the subscription. Targets are numbered on from `activation_`; it is zero while the controller
  // is not active, and only then the readings of the start are written.
  std::atomic<std::uint64_t> activation_{0};
  std::array<std::atomic<double>, LEGS> start_{};
  std::atomic<std::uint64_t> reached_{0};  // the number of the target to which the legs move
  realtime_tools::RealtimeBuffer<Path> for_update_;

  // Of the subscription.
  std::mutex mutex_;  // held by it and by `on_configure`
  SetPoints set_points_;
  Path path_;
  std::uint64_t begun_ = 0;  // the activation that `set_points_` began with
  rclcpp::Publisher<Status>::SharedPtr status_publisher_;
  rclcpp::Subscription<geometry_msgs::msg::PoseStamped>::SharedPtr subscription_;

  double measured(std::size_t i) const {return value_of(state_interfaces_[i], 0);}

  void take(const geometry_msgs::msg::PoseStamped & message)
  {
    const std::lock_guard<std::mutex> lock(mutex_);
    const auto & p = message.pose.position;
    const auto & q = message.pose.orientation;
    const double stamp = message.header.stamp.sec + 1e-9 * message.header.stamp.nanosec;
    const std::string reason = refusal({message.header.frame_id, stamp, {p.x, p.y, p.z}, {q.x, q.y, q.z, q.w}});
    Status status;
    status.level = reason.empty() ? Status::OK : Status::WARN;
    status.name = get_node()->get_name();
    status.message = reason.empty() ? "taken" : reason;
    status.values.resize(1);
    status.values[0].key = "stamp";
    status.values[0].value = std::to_string(stamp);
    status_publisher_->publish(status);
    if (reason.empty()) {return;}
    RCLCPP_WARN_THROTTLE(
      get_node()->get_logger(), *get_node()->get_clock(), 1000, "the set-point is refused, the last one is held: %s",
      reason.c_str());
  }

  // Return why a set-point is refused, or nothing, and then the control loop has it.
  std::string refusal(const SetPoint & wanted)
  {
    const std::uint64_t activation = activation_;
    if (activation != 0 && activation != begun_) {
      Readings readings{};
      std::copy(start_.begin(), start_.end(), readings.begin());
      if (activation_ == activation) {  // else they may be those of two activations
        (void)set_points_.begin(readings);
        path_.serial = begun_ = activation;
      }
    }
    if (activation == 0 || activation != begun_) {return "not active";}
    const std::string reason = set_points_.take(wanted, get_node()->now().seconds(), reached_, path_);
    if (reason.empty()) {for_update_.writeFromNonRT(path_);}
    return reason;
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
    for (const std::string & joint : set_points_.joints) {configuration.names.push_back(joint + "/position");}
    return configuration;
  }
};

}  // namespace {{package}}

PLUGINLIB_EXPORT_CLASS({{package}}::SpmController, controller_interface::ControllerInterface)
