/* Kinematics module of the 3RPS-3SPR manipulator for LinuxCNC 2.9.
 *
 * SPDX-License-Identifier: GPL-2.0-or-later
 *
 * Joints 0 to 5 are the leg lengths r_b1, r_b2, r_b3, r_c1, r_c2, r_c3; X Y Z is the centre o of the platform in {B}; A, B, C
 * are roll, pitch and yaw in degrees: R = Rz(C) Ry(B) Rx(A). Lengths are in machine units, UNITS_PER_METRE to a metre.
 *
 * Install: spm-pin export c --out DIR; then halcompile --install spmkins.c with spm_kinematics.c and .h beside it.
 *
 * A level platform cannot be commanded, for there the pose leaves the legs undetermined: both functions then return -1, and
 * LinuxCNC stops. The machine is homed in joint mode, and leaves the level position there.
 */

#include "spm_kinematics.h"

#include <hal.h>
#include <kinematics.h>
#include <rtapi.h>
#include <rtapi_app.h>
#include <rtapi_math.h>

#ifndef UNITS_PER_METRE
#define UNITS_PER_METRE 1000.0
#endif
#define DEGREE (3.14159265358979323846 / 180.0)

/* Where the machine was last; the forward displacement goes on from there, so that it never changes the assembly mode. */
static spm_state last;
static int is_known;

/* The largest change of a leg from where the machine was. */
static double distance(const double *lengths)
{
    double largest = 0.0;
    int i;
    for (i = 0; i < 6; ++i) {
        double change = fabs(lengths[i] - last.lengths[i]);
        largest = change > largest ? change : largest;
    }
    return largest;
}

int kinematicsForward(const double *joint, EmcPose *world, const KINEMATICS_FORWARD_FLAGS *fflags,
        KINEMATICS_INVERSE_FLAGS *iflags)
{
    double lengths[6];
    spm_state found;
    const double *r = found.rotation;
    int i;
    (void)fflags;
    (void)iflags;
    for (i = 0; i < 6; ++i) {
        lengths[i] = joint[i] / UNITS_PER_METRE;
    }
    if (spm_forward_physical(&spm_machine, lengths, is_known ? &last : 0, &found) != SPM_OK) {
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
    spm_branches found;
    int i, branch;
    (void)iflags;
    (void)fflags;
    if (spm_inverse(&spm_machine, rotation, position, &found) != SPM_OK || !found.real[0]) {
        return -1;
    }
    /* A pose may be held in both TT+ and TT-; the machine stays in the one that it is in. */
    branch = is_known && distance(found.lengths[1]) < distance(found.lengths[0]) ? 1 : 0;
    for (i = 0; i < 6; ++i) {
        joint[i] = found.lengths[branch][i] * UNITS_PER_METRE;
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
