// What a controller uses of ros2_control, rclcpp, realtime_tools, messages and pluginlib (Humble to Jazzy), written anew for
// the tests.
#pragma once
#include <cstdint>
#include <cstdio>
#include <functional>
#include <map>
#include <memory>
#include <stdexcept>
#include <string>
#include <variant>
#include <vector>
namespace rclcpp
{
struct Time
{
  double value = 0.0;
  double seconds() const {return value;}
};
}  // namespace rclcpp
namespace builtin_interfaces::msg
{
struct Time
{
  std::int32_t sec;
  std::uint32_t nanosec;
  Time & operator=(const rclcpp::Time & time) {sec = static_cast<std::int32_t>(time.value); nanosec = 0; return *this;}
};
}  // namespace builtin_interfaces::msg
namespace std_msgs::msg
{
struct Header {builtin_interfaces::msg::Time stamp; std::string frame_id;};
}  // namespace std_msgs::msg
namespace diagnostic_msgs::msg
{
struct KeyValue {std::string key, value;};
struct DiagnosticStatus
{
  static constexpr unsigned char OK = 0, WARN = 1;
  unsigned char level;
  std::string name, message;
  std::vector<KeyValue> values;
};
}  // namespace diagnostic_msgs::msg
namespace control_msgs::msg
{
struct JointTrajectoryControllerState
{
  std_msgs::msg::Header header;
  std::vector<std::string> joint_names;
  struct {std::vector<double> positions;} reference, feedback, error, output;
};
}  // namespace control_msgs::msg
namespace geometry_msgs::msg
{
struct PoseStamped
{
  std_msgs::msg::Header header;
  struct
  {
    struct {double x, y, z;} position;
    struct {double x, y, z, w;} orientation;
  } pose;
};
}  // namespace geometry_msgs::msg
namespace rclcpp_lifecycle
{
struct State {};
}  // namespace rclcpp_lifecycle
namespace rclcpp
{
struct Duration {};
struct QoS
{
  int depth;
  bool keeps_last = false;
  explicit QoS(int size) : depth(size) {}
  QoS & transient_local() {keeps_last = true; return *this;}
};
struct SystemDefaultsQoS : QoS {SystemDefaultsQoS() : QoS(10) {}};
template<typename Message>
struct Publisher
{
  using SharedPtr = std::shared_ptr<Publisher>;
  void publish(const Message & message) {last = message; ++count;}
  inline static Message last{};
  inline static int count = 0;
};
template<typename Message>
struct Subscription
{
  using SharedPtr = std::shared_ptr<Subscription>;
  std::function<void(const Message &)> callback;
};
struct Parameter
{
  std::variant<double, std::string, std::vector<double>, std::vector<std::string>> value;
  double as_double() const {return std::get<double>(value);}
  std::string as_string() const {return std::get<std::string>(value);}
  std::vector<double> as_double_array() const {return std::get<std::vector<double>>(value);}
  std::vector<std::string> as_string_array() const {return std::get<std::vector<std::string>>(value);}
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
  template<typename Message>
  typename Publisher<Message>::SharedPtr create_publisher(const std::string & topic, const QoS & quality)
  {
    topics[topic] = quality.keeps_last;
    return std::make_shared<Publisher<Message>>();
  }
  const char * get_name() const {return "spm_controller";}
  struct Logger {char * text;};
  struct Clock {int ticks;};
  Logger get_logger() {return {said};}
  std::shared_ptr<Clock> get_clock() {return std::make_shared<Clock>();}
  Time now() {return clock;}
  Parameter get_parameter(const std::string & name) {return parameters.at(name);}
  std::map<std::string, bool> topics;  // of publishers, and whether they keep the last message
  char said[300] = "";
  Time clock{1e9};
  std::map<std::string, Parameter> parameters{{"update_rate", {0.0}}};
  std::function<void(const geometry_msgs::msg::PoseStamped &)> publish;
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
template<typename Message>
class RealtimePublisher
{
public:
  explicit RealtimePublisher(typename rclcpp::Publisher<Message>::SharedPtr publisher) : publisher_(publisher) {}
  bool try_publish(const Message & message) {publisher_->publish(message); return true;}
private:
  typename rclcpp::Publisher<Message>::SharedPtr publisher_;
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
  virtual CallbackReturn on_deactivate(const rclcpp_lifecycle::State &) = 0;
  virtual InterfaceConfiguration command_interface_configuration() const = 0;
  virtual InterfaceConfiguration state_interface_configuration() const = 0;
  virtual return_type update(const rclcpp::Time & time, const rclcpp::Duration & period) = 0;
  std::shared_ptr<rclcpp::Node> get_node() {return node;}
  unsigned int get_update_rate() const {return static_cast<unsigned int>(node->get_parameter("update_rate").as_double());}
  template<typename T>
  void auto_declare(const std::string & name, const T & value)
  {
    const auto [place, is_new] = node->parameters.try_emplace(name, rclcpp::Parameter{value});
    if (!is_new && !std::holds_alternative<T>(place->second.value)) {throw std::runtime_error(name + " is of another type");}
  }
  std::vector<LoanedInterface> command_interfaces_, state_interfaces_;
  std::shared_ptr<rclcpp::Node> node = std::make_shared<rclcpp::Node>();
};
}  // namespace controller_interface
#define PLUGINLIB_EXPORT_CLASS(derived, base) \
  std::unique_ptr<base> made_by_pluginlib() {return std::make_unique<derived>();}
#define RCLCPP_ERROR(logger, ...) std::snprintf((logger).text, 300, __VA_ARGS__)
#define RCLCPP_WARN_THROTTLE(logger, clock, milliseconds, ...) \
  ((void)(clock).ticks, (void)(milliseconds), std::snprintf((logger).text, 300, __VA_ARGS__))
