{% import "linuxcnc/axes.jinja" as of_axes with context %}
/* Kinematics module of a {{title}} for LinuxCNC 2.9.

   {{origin}}

   SPDX-License-Identifier: BSD-2-Clause
   The module that halcompile makes of it with LinuxCNC's headers is under LinuxCNC's licence, GPL-2.0-or-later.

   Joints {{joints_meaning}}.
   {{of_axes.meaning}}
   Lengths are in millimetres, angles in degrees.

   Install: sudo halcompile --install {{name}}kins.c, with {{sources}} beside it.
   Load: loadrt {{name}}kins machine=FILE. The file is the {{name}}_machine.txt of an export; after a calibration another file
   takes its place, and nothing is compiled again. Without `machine` the module is that of this export. Limits are LinuxCNC's.

   The forward displacement goes on from the last state, and begins in the home assembly region: LinuxCNC's estimate
   in `world` is not needed. Where it has no solution the state is lost, and the inverse displacement is refused
   until the forward one, begun anew, finds one: without this LinuxCNC would command the joints of an old pose. */

{% if name == "spm" %}
#include "spm_read_machine.h"

/* halcompile makes a module of one source. The largest frame on the stack, 2.6 kB, is just above its warning. */
#pragma GCC diagnostic ignored "-Wframe-larger-than="
#include "spm_kinematics.c"
{% else %}
#define STAGE_DOUBLE
#include "stage_read_machine.h"
{% endif %}

#include <hal.h>
#include <kinematics.h>
#include <rtapi.h>
#include <rtapi_app.h>
#include <rtapi_math.h>
#include <unistd.h>

#define UNITS_PER_METRE 1000.0
#define DEGREE (3.14159265358979323846 / 180.0)
#define JOINTS {{joints}}

static const double units[JOINTS] = { {{- units|join(", ") -}} }; /* of a joint in one of its reading */
static {{prefix}}geometry geometry;
static {{prefix}}state last;
static int is_known;

static char *machine = "";
RTAPI_MP_STRING(machine, "file with the numbers of the machine, {{name}}_machine.txt of an export");

{% include "linuxcnc/" ~ name ~ "_poses.c" %}

/* Say why a function fails, where LinuxCNC only says that it does; returns what LinuxCNC expects. */
static int result_of(int status, int is_said, const char *function)
{
    if (status != {{PREFIX}}OK && is_said) {
        rtapi_print_msg(RTAPI_MSG_ERR, "{{name}}kins: %s: %s\n", function, {{prefix}}status_name(status));
    }
    return status == {{PREFIX}}OK ? 0 : -1;
}

int kinematicsForward(const double *joint, EmcPose *world, const KINEMATICS_FORWARD_FLAGS *fflags,
        KINEMATICS_INVERSE_FLAGS *iflags)
{
    double readings[JOINTS];
    const int was_known = is_known;
    int i, status;
    (void)fflags;
    (void)iflags;
    for (i = 0; i < JOINTS; ++i) {
        readings[i] = joint[i] / units[i];
    }
    status = is_known ? {{prefix}}forward(&geometry, readings, &last, &last) : begin(readings);
    is_known = status == {{PREFIX}}OK;
    if (is_known) {
        put_world(world);
    }
    return result_of(status, was_known, "kinematicsForward"); /* once: LinuxCNC calls on, and before homing too */
}

int kinematicsInverse(const EmcPose *world, double *joint, const KINEMATICS_INVERSE_FLAGS *iflags,
        KINEMATICS_FORWARD_FLAGS *fflags)
{
    {{prefix}}state found;
    int i, status;
    (void)iflags;
    (void)fflags;
    if (!is_known) {
        rtapi_print_msg(RTAPI_MSG_ERR, "{{name}}kins: kinematicsInverse: the joints are in no pose: is HOME_OFFSET where they stand?\n");
        return -1;
    }
    status = solve_pose(world, &found);
    for (i = 0; i < JOINTS && status == {{PREFIX}}OK; ++i) {
        joint[i] = found.readings[i] * units[i];
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
    const char *error = NULL;
    char folder[256];
    geometry = {{prefix}}machine;
    if (machine[0]) {
        error = {{prefix}}read_machine(machine, &geometry);
    }
    if (error) {
        rtapi_print_msg(RTAPI_MSG_ERR, "{{name}}kins: machine=%s, seen from %s: %s\n", machine,
            getcwd(folder, sizeof folder) ? folder : "a directory that cannot be read", error);
        return -1;
    }
    component = hal_init("{{name}}kins");
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
