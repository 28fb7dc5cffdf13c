// Configure, activate and run the controller. The first file has its parameters, a name and numbers or texts in a line; the
// second the readings of the start, and a set-point near it: position, quaternion, and the readings it leads to.
#include <cstring>
#include <fstream>
#include <iostream>
#include <sstream>
#include "spm_controller.cpp"
using controller_interface::CallbackReturn;

static int failures = 0;

static void expect(bool holds, const char * what)
{
  if (!holds) {++failures; std::cout << "not so: " << what << "\n";}
}

static bool says(spm_robot::SpmController & controller, const char * text)
{
  const bool is_said = std::strstr(controller.node->said, text) != nullptr;
  if (!is_said) {std::cout << "said: " << controller.node->said << "\n";}
  controller.node->said[0] = '\0';
  return is_said;
}

int main(int, char ** names)
{
  spm_robot::SpmController controller;
  controller.on_init();
  expect(controller.on_configure({}) == CallbackReturn::FAILURE && says(controller, "spm_controller.yaml"), "no parameters");
  auto & parameters = controller.node->parameters;
  std::ifstream file(names[1]);
  std::string line;
  while (std::getline(file, line)) {
    std::istringstream words(line);
    std::string name, word;
    words >> name;
    expect(parameters.count(name) == 1, "the controller declares what the file gives");
    rclcpp::Parameter & parameter = parameters[name];
    std::vector<std::string> texts;
    while (words >> word) {texts.push_back(word);}
    std::vector<double> numbers;
    if (name != "frame_id" && name != "joints") {
      for (const auto & text : texts) {numbers.push_back(std::stod(text));}
    }
    if (name == "frame_id") {parameter.value = texts[0];} else if (name == "joints") {parameter.value = texts;} else if (
      std::holds_alternative<double>(parameter.value)) {parameter.value = numbers[0];} else {parameter.value = numbers;}
  }
  for (const auto & [name, parameter] : parameters) {
    if (name.rfind("machine.", 0) != 0) {continue;}
    const auto kept = parameter.value;
    parameters[name].value = std::vector<double>(2);
    expect(controller.on_configure({}) == CallbackReturn::FAILURE, name.c_str());
    parameters[name].value = kept;
  }
  expect(controller.on_configure({}) == CallbackReturn::SUCCESS, "the parameters are taken");
  const auto interfaces = controller.command_interface_configuration().names;
  expect(interfaces.size() == 6 && interfaces[3] == parameters["joints"].as_string_array()[3] + "/position", "six interfaces of positions");
  controller.command_interfaces_.resize(6);
  controller.state_interfaces_.resize(6);
  for (auto & joint : controller.state_interfaces_) {joint.value = NAN;}
  expect(controller.on_activate({}) == CallbackReturn::FAILURE && says(controller, "not finite"), "no state");

  const auto zeros = parameters["zeros"].as_double_array();
  std::ifstream poses(names[2]);
  double start[6];
  for (double & reading : start) {poses >> reading;}
  for (int i = 0; i < 6; ++i) {controller.state_interfaces_[i].value = start[i] - zeros[i];}
  expect(controller.on_activate({}) == CallbackReturn::SUCCESS, "it begins where the machine is");
  controller.update({}, {});
  for (int i = 0; i < 6; ++i) {
    expect(std::fabs(controller.command_interfaces_[i].value + zeros[i] - start[i]) < 1e-12, "it stays there");
  }
  geometry_msgs::msg::PoseStamped message{};
  auto & pose = message.pose;
  double readings[6];
  poses >> pose.position.x >> pose.position.y >> pose.position.z;
  poses >> pose.orientation.x >> pose.orientation.y >> pose.orientation.z >> pose.orientation.w;
  for (double & reading : readings) {poses >> reading;}
  const auto worst = [&] {
      double error = 0.0;
      for (int k = 0; k < 2000; ++k) {controller.update({}, {});}
      for (int i = 0; i < 6; ++i) {
        error = std::fmax(error, std::fabs(controller.command_interfaces_[i].value + zeros[i] - readings[i]));
      }
      return error;
    };
  message.header.frame_id = "map";
  controller.node->publish(message);
  expect(says(controller, "its frame is \"map\", not \"base\""), "another frame is refused");
  message.header.frame_id = "base";
  message.header.stamp.sec = 999999998;
  controller.node->publish(message);
  expect(says(controller, "stale"), "an old stamp is refused");
  expect(worst() > 1e-3, "what is refused is not followed");
  message.header.stamp.sec = 1000000000;
  controller.node->publish(message);
  expect(worst() < 1e-9, "it goes to the pose");
  controller.node->publish(message);
  expect(says(controller, "older than the last one"), "the same message again is refused");
  message.header.stamp.sec = 0;
  controller.node->clock.value += 1.0;
  controller.node->publish(message);
  expect(controller.node->said[0] == '\0', "no stamp is the time of arrival");
  controller.node->clock.value += 1.0;
  pose.position.z += 5.0;
  controller.node->publish(message);
  expect(says(controller, "the set-point is refused, the last one is held"), "a pose out of reach is refused");
  pose.position.z = NAN;
  controller.node->publish(message);
  expect(says(controller, "not finite"), "NaN is refused");
  pose.orientation.w = 3.0;
  controller.node->publish(message);
  expect(says(controller, "no unit quaternion"), "a quaternion off unit length is refused");
  expect(worst() < 1e-9, "the last one is held");
  controller.on_deactivate({});
  controller.node->publish(message);
  expect(controller.node->said[0] == '\0', "nothing is taken while it is not active");
  return failures;
}
