// Run the controller for some ticks around a machine that follows its commands at once.
#include <cmath>
#include <cstdio>
#include "spm_controller.cpp"
int main()
{
  spm_controller::SpmController controller;
  using controller_interface::return_type;
  controller.on_init();
  const auto names = controller.command_interface_configuration().names;
  if (names.size() != 6 || names[3] != "leg_c1/position") {return 1;}
  controller.command_interfaces_.resize(6);
  controller.state_interfaces_.resize(6);
  double worst = 0.0;
  int solved = 0;
  for (int k = 0; k < 1000; ++k) {
    std::array<double, 6> lengths{};
    for (int i = 0; i < 6; ++i) {lengths[i] = 1.3 + 0.1 * std::sin(0.01 * (k + 50) * (i + 1));}
    for (int i = 0; i < 6; ++i) {controller.state_interfaces_[i].value = lengths[i];}
    if (controller.update({}, {}) != return_type::OK) {return 2;}
    for (int i = 0; i < 9; ++i) {controller.reference.rotation[i] = controller.measured.rotation[i];}
    for (int i = 0; i < 3; ++i) {controller.reference.position[i] = controller.measured.position[i];}
    controller.has_reference = true;
    if (controller.update({}, {}) != return_type::OK) {return 3;}
    if (controller.status != SPM_OK) {continue;}
    ++solved;
    for (int i = 0; i < 6; ++i) {worst = std::fmax(worst, std::fabs(controller.command_interfaces_[i].value - lengths[i]));}
  }
  if (solved < 900) {return 4;}
  const double kept = controller.command_interfaces_[0].value;
  controller.reference.position[2] += 5.0;
  controller.update({}, {});
  if (controller.status == SPM_OK || controller.command_interfaces_[0].value != kept) {return 5;}
  controller.state_interfaces_[2].value = -1.0;
  if (controller.update({}, {}) != return_type::ERROR) {return 6;}
  std::printf("%.3e\n", worst);
  return 0;
}
