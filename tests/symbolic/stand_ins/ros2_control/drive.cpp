// Run the controller for some ticks around a machine that follows its commands at once.
#include <cmath>
#include <cstdio>
#include <cstring>
#include "spm_controller.cpp"
int main()
{
  spm_robot::SpmController controller;
  using controller_interface::return_type;
  controller.on_init();
  controller.on_configure({});
  controller.on_activate({});
  const auto names = controller.command_interface_configuration().names;
  if (names.size() != 6 || names[3] != "leg_c1_slide/position") {return 1;}
  controller.command_interfaces_.resize(6);
  controller.state_interfaces_.resize(6);
  double worst = 0.0;
  int solved = 0;
  geometry_msgs::msg::Pose pose{};
  for (int k = 0; k < 1000; ++k) {
    std::array<double, 6> slides{};
    for (int i = 0; i < 6; ++i) {slides[i] = 0.1 * std::sin(0.01 * (k + 50) * (i + 1));}
    for (int i = 0; i < 6; ++i) {controller.state_interfaces_[i].value = slides[i];}
    if (controller.update({}, {}) != return_type::OK) {return 2;}
    const auto & r = controller.measured.rotation;
    const double w = 0.5 * std::sqrt(1.0 + r[0] + r[4] + r[8]), scale = 3.0 * 0.25 / w;  // a quaternion of length 3
    pose.orientation = {scale * (r[7] - r[5]), scale * (r[2] - r[6]), scale * (r[3] - r[1]), 3.0 * w};
    const auto & o = controller.measured.position;
    pose.position = {o[0], o[1], o[2]};
    controller.node->publish(pose);
    if (controller.update({}, {}) != return_type::OK) {return 3;}
    if (controller.status != SPM_OK) {continue;}
    ++solved;
    for (int i = 0; i < 6; ++i) {worst = std::fmax(worst, std::fabs(controller.command_interfaces_[i].value - slides[i]));}
  }
  if (solved < 900) {return 4;}
  std::strcpy(controller.node->warned, "");
  const double kept = controller.command_interfaces_[0].value;
  pose.position.z += 5.0;
  controller.node->publish(pose);
  controller.update({}, {});
  if (controller.status == SPM_OK || controller.command_interfaces_[0].value != kept) {return 5;}
  if (!std::strstr(controller.node->warned, spm_status_name(controller.status))) {return 8;}
  pose.orientation.w = NAN;
  controller.node->publish(pose);
  controller.update({}, {});
  if (controller.status != SPM_NOT_FINITE) {return 7;}
  controller.state_interfaces_[2].value = -2.0;
  if (controller.update({}, {}) != return_type::ERROR) {return 6;}
  if (!std::strstr(controller.node->warned, spm_status_name(controller.measured_status))) {return 9;}
  std::printf("%.3e\n", worst);
  return 0;
}
