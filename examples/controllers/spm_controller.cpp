// A ros2_control controller for the 3RPS-3SPR manipulator: each tick turns a reference pose into six leg lengths, and the
// measured lengths into a pose. Nothing in `update` allocates, locks or iterates without a bound.
//
// SPDX-License-Identifier: BSD-2-Clause

#include <array>
#include <cmath>
#include <cstddef>
#include <string>

#include "controller_interface/controller_interface.hpp"
#include "spm_kinematics.h"

namespace spm_controller
{

constexpr std::array<const char *, 6> LEGS = {"leg_b1", "leg_b2", "leg_b3", "leg_c1", "leg_c2", "leg_c3"};

class SpmController : public controller_interface::ControllerInterface
{
public:
  // A pose, row by row, and where it comes from: a real-time buffer that a subscription fills in a real controller.
  struct Pose
  {
    std::array<double, 9> rotation;
    std::array<double, 3> position;
  };
  Pose reference{};
  bool has_reference = false;

  // Where the platform is, from the measured lengths; NaN and `SPM_...` if that is not known.
  spm_state measured{};
  int measured_status = SPM_NOT_FINITE;
  // What became of the reference; commands are kept where it is not `SPM_OK`.
  int status = SPM_OK;

  controller_interface::CallbackReturn on_init() override {return controller_interface::CallbackReturn::SUCCESS;}

  controller_interface::InterfaceConfiguration command_interface_configuration() const override {return interfaces();}

  controller_interface::InterfaceConfiguration state_interface_configuration() const override {return interfaces();}

  controller_interface::return_type update(const rclcpp::Time &, const rclcpp::Duration &) override
  {
    std::array<double, 6> readings{};
    for (std::size_t i = 0; i < LEGS.size(); ++i) {
      readings[i] = state_interfaces_[i].get_value();
    }
    // From where it was, so that the assembly mode never changes unnoticed; anew where that is not known.
    const spm_state * near = measured_status == SPM_OK ? &measured : nullptr;
    measured_status = spm_forward(&spm_machine, readings.data(), near, &measured);

    if (has_reference) {
      // On the branch that the machine is in: a pose may be held in two, and a jump from one to the other breaks it.
      spm_state wanted{};
      near = measured_status == SPM_OK ? &measured : nullptr;
      status = spm_inverse(&spm_machine, reference.rotation.data(), reference.position.data(), near, &wanted);
      for (std::size_t i = 0; i < LEGS.size() && status == SPM_OK; ++i) {
        if (wanted.readings[i] < spm_machine.minimum[i] || wanted.readings[i] > spm_machine.maximum[i]) {
          status = SPM_UNREACHABLE;
        }
      }
      for (std::size_t i = 0; i < LEGS.size() && status == SPM_OK; ++i) {
        (void)command_interfaces_[i].set_value(wanted.readings[i]);
      }
    }
    return measured_status == SPM_OK ? controller_interface::return_type::OK : controller_interface::return_type::ERROR;
  }

private:
  static controller_interface::InterfaceConfiguration interfaces()
  {
    controller_interface::InterfaceConfiguration found{
      controller_interface::interface_configuration_type::INDIVIDUAL, {}};
    for (const char * leg : LEGS) {
      found.names.push_back(std::string(leg) + "/position");
    }
    return found;
  }
};

}  // namespace spm_controller
