// What a controller uses of ros2_control's controller_interface (Humble to Jazzy), written anew for the tests.
#pragma once
#include <string>
#include <vector>
namespace rclcpp
{
struct Time {};
struct Duration {};
}  // namespace rclcpp
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
  virtual InterfaceConfiguration command_interface_configuration() const = 0;
  virtual InterfaceConfiguration state_interface_configuration() const = 0;
  virtual return_type update(const rclcpp::Time & time, const rclcpp::Duration & period) = 0;
  std::vector<LoanedInterface> command_interfaces_, state_interfaces_;
};
}  // namespace controller_interface
