/* Kinematics module of the 3RPS-3SPR manipulator for LinuxCNC 2.9.
 *
 * SPDX-License-Identifier: GPL-2.0-or-later
 *
 * Joints 0 to 5 are the readings of the legs r_b1, r_b2, r_b3, r_c1, r_c2, r_c3; X Y Z is the centre o of the platform in {B}; A, B, C
 * are roll, pitch and yaw in degrees: R = Rz(C) Ry(B) Rx(A). Lengths are in machine units, UNITS_PER_METRE to a metre.
 *
 * Install: spm-pin export c --out DIR; then halcompile --install spmkins.c with spm_kinematics.c and .h and read_machine.h beside it.
 * halcompile makes a module of this one file, which therefore includes the others. Only stand-ins for LinuxCNC's headers were tried.
 * loadrt spmkins machine=FILE takes the spm_machine.txt of another export, after a calibration, without compiling again.
 *
 * A level platform cannot be commanded, for there the pose leaves the legs undetermined: the inverse then returns -1, and
 * LinuxCNC stops. The machine is homed in joint mode, and leaves the level position there.
 */

#include "read_machine.h"
#include "spm_kinematics.c"

#include <hal.h>
#include <kinematics.h>
#include <rtapi.h>
#include <rtapi_app.h>
#include <rtapi_math.h>

#ifndef UNITS_PER_METRE
#define UNITS_PER_METRE 1000.0
#endif
#define DEGREE (3.14159265358979323846 / 180.0)

static spm_geometry geometry;

/* Where the machine was last; both displacements go on from there, so that no branch and no mode ever changes. */
static spm_state last;
static int is_known;

static char *machine = "";
RTAPI_MP_STRING(machine, "file with the numbers of the machine, spm_machine.txt of an export");

int kinematicsForward(const double *joint, EmcPose *world, const KINEMATICS_FORWARD_FLAGS *fflags,
        KINEMATICS_INVERSE_FLAGS *iflags)
{
    double readings[6];
    spm_state found;
    const double *r = found.rotation;
    int i;
    (void)fflags;
    (void)iflags;
    for (i = 0; i < 6; ++i) {
        readings[i] = joint[i] / UNITS_PER_METRE;
    }
    if (spm_forward(&geometry, readings, is_known ? &last : NULL, &found) != SPM_OK) {
        return -1;
    }
    last = found;
    is_known = 1;
    world->tran.x = found.position[0] * UNITS_PER_METRE;
    world->tran.y = found.position[1] * UNITS_PER_METRE;
    world->tran.z = found.position[2] * UNITS_PER_METRE;
    world->a = atan2(r[7], r[8]) / DEGREE;
    world->b = atan2(-r[6], sqrt(r[7] * r[7] + r[8] * r[8])) / DEGREE;
    world->c = atan2(r[3], r[0]) / DEGREE;
    return 0;
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
    int i;
    (void)iflags;
    (void)fflags;
    if (spm_inverse(&geometry, rotation, position, is_known ? &last : NULL, &found) != SPM_OK) {
        return -1;
    }
    for (i = 0; i < 6; ++i) {
        joint[i] = found.readings[i] * UNITS_PER_METRE;
    }
    return 0;
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
    if (machine[0] && !read_machine(machine, &geometry)) {
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
