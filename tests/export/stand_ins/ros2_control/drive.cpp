// Configure, activate and run the controller. The first file has its parameters, a name and numbers or texts in a line; the
// second the readings of the start, and a set-point near it: position, quaternion, and the readings it leads to. Then why a
// pose five metres higher is refused.
#include <cstring>
#include <fstream>
#include <iostream>
#include <sstream>
#include "../../count_allocations.hpp"
#include "spm_controller.cpp"
using controller_interface::CallbackReturn;
using spm_robot::LEGS;

using States = rclcpp::Publisher<control_msgs::msg::JointTrajectoryControllerState>;
using Statuses = rclcpp::Publisher<diagnostic_msgs::msg::DiagnosticStatus>;

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

// Whether a set-point is refused with a reason, in the log and on the topic, or taken where there is none.
static bool answers(spm_robot::SpmController & controller, const geometry_msgs::msg::PoseStamped & message, const char * text)
{
  const int count = Statuses::count;
  controller.node->publish(message);
  const auto & status = Statuses::last;
  const char * expected = *text ? text : "taken";
  const bool is_so = Statuses::count == count + 1 && status.message.rfind(expected, 0) == 0 &&
    status.level == (*text ? status.WARN : status.OK) && status.values[0].key == "stamp";
  if (!is_so) {std::cout << "status: " << status.message << "\n";}
  const bool is_silent = controller.node->said[0] == '\0';
  return is_so && (*text ? says(controller, text) : is_silent);
}

int main(int, char ** names)
{
  spm_robot::SpmController controller;
  controller.node->parameters["timeout"].value = std::string("soon");
  expect(controller.on_init() == CallbackReturn::ERROR && says(controller, "timeout is of another type"), "a wrong type");
  controller.node->parameters.erase("timeout");
  expect(controller.on_init() == CallbackReturn::SUCCESS, "parameters are declared");
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
  expect(interfaces.size() == LEGS && interfaces.back() == parameters["joints"].as_string_array().back() + "/position", "interfaces of positions");
  expect(controller.node->topics.at("~/status") && controller.node->topics.count("~/controller_state") == 1, "two topics");
  controller.command_interfaces_.resize(LEGS);
  controller.state_interfaces_.resize(LEGS);
  for (auto & joint : controller.state_interfaces_) {joint.value = NAN;}
  expect(controller.on_activate({}) == CallbackReturn::FAILURE && says(controller, "not finite"), "no state");

  const auto zeros = parameters["zeros"].as_double_array();
  std::ifstream poses(names[2]);
  double start[LEGS];
  for (double & reading : start) {poses >> reading;}
  for (std::size_t i = 0; i < LEGS; ++i) {controller.state_interfaces_[i].value = start[i] - zeros[i];}
  expect(controller.on_activate({}) == CallbackReturn::SUCCESS, "it begins where the machine is");
  controller.update({}, {});
  for (std::size_t i = 0; i < LEGS; ++i) {
    expect(std::fabs(controller.command_interfaces_[i].value + zeros[i] - start[i]) < 1e-12, "it stays there");
  }
  geometry_msgs::msg::PoseStamped message{};
  auto & pose = message.pose;
  double readings[LEGS];
  poses >> pose.position.x >> pose.position.y >> pose.position.z;
  poses >> pose.orientation.x >> pose.orientation.y >> pose.orientation.z >> pose.orientation.w;
  for (double & reading : readings) {poses >> reading;}
  const auto worst = [&] {
      const auto & state = States::last;
      double error = 0.0;
      const long allocated = allocations;
      for (int k = 0; k < 2000; ++k) {controller.update({5.0}, {});}
      expect(allocations == allocated && state.header.stamp.sec == 5, "updates send states and allocate nothing");
      for (std::size_t i = 0; i < LEGS; ++i) {
        const double command = controller.command_interfaces_[i].value, feedback = controller.state_interfaces_[i].value;
        expect(
          state.reference.positions[i] == command && state.output.positions[i] == command &&
          state.feedback.positions[i] == feedback && state.error.positions[i] == command - feedback, "the state is sent");
        error = std::fmax(error, std::fabs(controller.command_interfaces_[i].value + zeros[i] - readings[i]));
      }
      return error;
    };
  message.header.frame_id = "map";
  expect(answers(controller, message, "wrong frame: \"map\" instead of \"base\""), "another frame is refused");
  message.header.frame_id = "base";
  message.header.stamp.sec = 999999998;
  expect(answers(controller, message, "stale: stamped 2.0"), "an old stamp is refused");
  message.header.stamp.sec = 1000000002;
  expect(answers(controller, message, "in the future: by 2.0"), "a stamp to come is refused");
  expect(worst() > 1e-3, "what is refused is not followed");
  message.header.stamp.sec = 1000000000;
  expect(answers(controller, message, ""), "a pose nearby is taken");
  expect(worst() < 1e-9, "it goes to the pose");
  expect(answers(controller, message, "out of order"), "the same message again is refused");
  message.header.stamp.sec = 0;
  controller.node->clock.value += 1.0;
  expect(answers(controller, message, ""), "no stamp is the time of arrival");
  controller.node->clock.value += 1.0;
  const auto near = message;
  pose.position.z += 5.0;
  expect(answers(controller, message, names[3]), "a pose out of reach is refused");
  pose.position.z = NAN;
  expect(answers(controller, message, "not finite"), "NaN is refused");
  pose.orientation.w = 3.0;
  expect(answers(controller, message, "no unit quaternion"), "a quaternion off unit length is refused");
  expect(worst() < 1e-9, "the last one is held");
  controller.on_deactivate({});
  expect(answers(controller, near, "not active"), "nothing is taken while it is not active");
  expect(controller.on_activate({}) == CallbackReturn::SUCCESS, "it begins again");
  expect(worst() > 1e-3, "where the machine is, and not at the last set-point");
  expect(answers(controller, near, ""), "stamps begin anew");
  expect(worst() < 1e-9, "it goes there again");
  controller.on_deactivate({});
  parameters["max_step"].value = std::vector<double>(LEGS, 1e-4);
  expect(controller.on_configure({}) == CallbackReturn::SUCCESS && controller.on_activate({}) == CallbackReturn::SUCCESS, "again");
  expect(answers(controller, near, "jump: leg_"), "a jump is refused");
  return failures;
}
