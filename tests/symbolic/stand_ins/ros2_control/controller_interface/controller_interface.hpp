// What a controller uses of ros2_control, rclcpp, realtime_tools, geometry_msgs and pluginlib (Humble to Jazzy), written
// anew for the tests.
#pragma once
#include <cstdio>
#include <functional>
#include <memory>
#include <string>
#include <vector>
namespace geometry_msgs::msg
{
struct Pose
{
  struct {double x, y, z;} position;
  struct {double x, y, z, w;} orientation;
};
}  // namespace geometry_msgs::msg
namespace rclcpp_lifecycle
{
struct State {};
}  // namespace rclcpp_lifecycle
namespace rclcpp
{
struct Time {};
struct Duration {};
struct SystemDefaultsQoS {};
template<typename Message>
struct Subscription
{
  using SharedPtr = std::shared_ptr<Subscription>;
  std::function<void(const Message &)> callback;
};
struct Node
{
  template<typename Message, typename Callback>
  typename Subscription<Message>::SharedPtr create_subscription(
    const std::string & topic, const SystemDefaultsQoS &, Callback callback)
  {
    if (topic != "~/reference") {return nullptr;}
    publish = callback;
    return std::make_shared<Subscription<Message>>(Subscription<Message>{callback});
  }
  struct Logger {char * text;};
  struct Clock {int ticks;};
  Logger get_logger() {return {warned};}
  std::shared_ptr<Clock> get_clock() {return std::make_shared<Clock>();}
  char warned[200] = "";
  std::function<void(const geometry_msgs::msg::Pose &)> publish;
};
}  // namespace rclcpp
namespace realtime_tools
{
template<typename T>
class RealtimeBuffer
{
public:
  void writeFromNonRT(const T & value) {value_ = value;}
  T * readFromRT() {return &value_;}
private:
  T value_{};
};
}  // namespace realtime_tools
namespace controller_interface
{
enum class CallbackReturn { SUCCESS, FAILURE, ERROR };
enum class return_type { OK, ERROR };
enum class interface_configuration_type { ALL, INDIVIDUAL, NONE };
struct InterfaceConfiguration
{
  interface_configuration_type type;
  std::vector<std::string> names;
};
struct LoanedInterface
{
  double value = 0.0;
  double get_value() const {return value;}
  bool set_value(double wanted) {value = wanted; return true;}
};
class ControllerInterface
{
public:
  virtual ~ControllerInterface() = default;
  virtual CallbackReturn on_init() = 0;
  virtual CallbackReturn on_configure(const rclcpp_lifecycle::State &) = 0;
  virtual CallbackReturn on_activate(const rclcpp_lifecycle::State &) = 0;
  virtual InterfaceConfiguration command_interface_configuration() const = 0;
  virtual InterfaceConfiguration state_interface_configuration() const = 0;
  virtual return_type update(const rclcpp::Time & time, const rclcpp::Duration & period) = 0;
  std::shared_ptr<rclcpp::Node> get_node() {return node;}
  std::vector<LoanedInterface> command_interfaces_, state_interfaces_;
  std::shared_ptr<rclcpp::Node> node = std::make_shared<rclcpp::Node>();
};
}  // namespace controller_interface
#define PLUGINLIB_EXPORT_CLASS(derived, base) \
  std::unique_ptr<base> made_by_pluginlib() {return std::make_unique<derived>();}
#define RCLCPP_WARN_THROTTLE(logger, clock, milliseconds, ...) \
  ((void)(clock).ticks, (void)(milliseconds), std::snprintf((logger).text, 200, __VA_ARGS__))
