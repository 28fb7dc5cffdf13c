/* Kinematics module of the 3RPS-3SPR manipulator for LinuxCNC 2.9.

   @ORIGIN@

   SPDX-License-Identifier: BSD-2-Clause
   The module that halcompile makes of it with LinuxCNC's headers is under LinuxCNC's licence, GPL-2.0-or-later.

   Joints 0 to 5 are the readings of the legs r_b1, r_b2, r_b3, r_c1, r_c2, r_c3; X Y Z is the centre o of the platform
   in {B}, and R = Rz(C) Ry(B) Rx(A) its rotation. Lengths are in millimetres, angles in degrees.

   Install: sudo halcompile --install spmkins.c, with spm_kinematics.c, spm_kinematics.h and spm_read_machine.h beside it.
   Load: loadrt spmkins machine=FILE. The file is the spm_machine.txt of an export; after a calibration another file
   takes its place, and nothing is compiled again. Without `machine` the module is that of this export.

   The forward displacement goes on from the last state, and begins in the aspect of the machine's home: LinuxCNC's estimate
   in `world` is not needed. Where it has no solution the state is lost, and the inverse displacement is refused
   until the forward one, begun anew, finds one: without this LinuxCNC would command the joints of an old pose. */

#include "spm_read_machine.h"

/* halcompile makes a module of one source. The largest frame on the stack, 2.6 kB, is just above its warning. */
#pragma GCC diagnostic ignored "-Wframe-larger-than="
#include "spm_kinematics.c"

#include <hal.h>
#include <kinematics.h>
#include <rtapi.h>
#include <rtapi_app.h>
#include <rtapi_math.h>

#define UNITS_PER_METRE 1000.0
#define DEGREE (3.14159265358979323846 / 180.0)

static spm_geometry geometry;
static spm_state last;
static int is_known;

static char *machine = "";
RTAPI_MP_STRING(machine, "file with the numbers of the machine, spm_machine.txt of an export");

/* Say why a function fails, where LinuxCNC only says that it does; returns what LinuxCNC expects. */
static int result_of(int status, int is_said, const char *function)
{
    if (status != SPM_OK && is_said) {
        rtapi_print_msg(RTAPI_MSG_ERR, "spmkins: %s: %s\n", function, spm_status_name(status));
    }
    return status == SPM_OK ? 0 : -1;
}

int kinematicsForward(const double *joint, EmcPose *world, const KINEMATICS_FORWARD_FLAGS *fflags,
        KINEMATICS_INVERSE_FLAGS *iflags)
{
    double readings[6];
    const double *r = last.rotation;
    const int was_known = is_known;
    int i, status;
    (void)fflags;
    (void)iflags;
    for (i = 0; i < 6; ++i) {
        readings[i] = joint[i] / UNITS_PER_METRE;
    }
    status = spm_forward(&geometry, readings, is_known ? &last : NULL, &last);
    is_known = status == SPM_OK;
    if (is_known) {
        world->tran.x = last.position[0] * UNITS_PER_METRE;
        world->tran.y = last.position[1] * UNITS_PER_METRE;
        world->tran.z = last.position[2] * UNITS_PER_METRE;
        world->a = atan2(r[7], r[8]) / DEGREE;
        world->b = atan2(-r[6], sqrt(r[7] * r[7] + r[8] * r[8])) / DEGREE;
        world->c = atan2(r[3], r[0]) / DEGREE;
    }
    return result_of(status, was_known, "kinematicsForward"); /* once: LinuxCNC calls on, and before homing too */
}

int kinematicsInverse(const EmcPose *world, double *joint, const KINEMATICS_INVERSE_FLAGS *iflags,
        KINEMATICS_FORWARD_FLAGS *fflags)
{
    const double ca = cos(world->a * DEGREE), sa = sin(world->a * DEGREE), cb = cos(world->b * DEGREE);
    const double sb = sin(world->b * DEGREE), cc = cos(world->c * DEGREE), sc = sin(world->c * DEGREE);
    const double rotation[9] = {
        cc * cb, cc * sb * sa - sc * ca, cc * sb * ca + sc * sa,
        sc * cb, sc * sb * sa + cc * ca, sc * sb * ca - cc * sa,
        -sb, cb * sa, cb * ca
    };
    const double position[3] = {
        world->tran.x / UNITS_PER_METRE, world->tran.y / UNITS_PER_METRE, world->tran.z / UNITS_PER_METRE
    };
    spm_state found;
    int i, status;
    (void)iflags;
    (void)fflags;
    if (!is_known) {
        rtapi_print_msg(RTAPI_MSG_ERR, "spmkins: kinematicsInverse: the state of the machine is not known\n");
        return -1;
    }
    status = spm_inverse(&geometry, rotation, position, &last, &found);
    for (i = 0; i < 6 && status == SPM_OK; ++i) {
        joint[i] = found.readings[i] * UNITS_PER_METRE;
    }
    return result_of(status, 1, "kinematicsInverse");
}

KINEMATICS_TYPE kinematicsType(void)
{
    return KINEMATICS_BOTH;
}

KINS_NOT_SWITCHABLE
EXPORT_SYMBOL(kinematicsType);
EXPORT_SYMBOL(kinematicsForward);
EXPORT_SYMBOL(kinematicsInverse);
MODULE_LICENSE("GPL");

static int component;

int rtapi_app_main(void)
{
    geometry = spm_machine;
    if (machine[0] && !spm_read_machine(machine, &geometry)) {
        rtapi_print_msg(RTAPI_MSG_ERR, "spmkins: %s describes no machine\n", machine);
        return -1;
    }
    component = hal_init("spmkins");
    if (component < 0) {
        return component;
    }
    hal_ready(component);
    return 0;
}

void rtapi_app_exit(void)
{
    hal_exit(component);
}
