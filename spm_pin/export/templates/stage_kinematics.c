/* {{origin}}

   SPDX-License-Identifier: BSD-2-Clause */

#include "{{prefix}}kinematics.h"

#include <string.h>

#define STAGE_DOUBLE
#include "stage.h"

#define larger(a, b) stage_larger(a, b)
#define smaller(a, b) -stage_larger(-(a), -(b))

{{joint_values}}
/* Without limits, which are asked for by {{prefix}}beyond_limits. */
static stage_geometry unlimited(const {{prefix}}geometry *geometry)
{
    stage_geometry stage = stage_machine;
    int i;
    stage.up = geometry->up;
    stage.home_height = geometry->home_height;
    for (i = 0; i < 3; ++i) {
        memcpy(&stage.legs[i], geometry->legs[i], sizeof geometry->legs[i]);
        stage.legs[i].minimum = -STAGE_NO_LIMIT;
        stage.legs[i].maximum = STAGE_NO_LIMIT;
        stage.legs[i].middle = geometry->middle[i];
    }
    return stage;
}

static int put(int status, const stage_geometry *stage, const stage_state *from, {{prefix}}state *to)
{
    int i;
    if (status == STAGE_OK) {
        memcpy(to, from, sizeof *from);
        for (i = 0; i < 9; ++i) {
            to->joints[i] = to->position[i % 3] + stage_dot(to->rotation + i % 3 * 3, stage->legs[i / 3].ball);
        }
    }
    return status;
}

{% include "stage_status.c" %}

int {{prefix}}inverse(const {{prefix}}geometry *geometry, const double rotation[9], const double position[3],
        const {{prefix}}state *near, {{prefix}}state *state)
{
    const stage_geometry stage = unlimited(geometry);
    const double normal[3] = {rotation[2], rotation[5], rotation[8]};
    stage_state found;
    (void)near;
    return put(stage_inverse(&stage, normal, position[2], &found), &stage, &found, state);
}

int {{prefix}}forward(const {{prefix}}geometry *geometry, const double readings[3], const {{prefix}}state *near,
        {{prefix}}state *state)
{
    const stage_geometry stage = unlimited(geometry);
    stage_state from;
    int status = STAGE_OK;
    if (near) {
        memcpy(&from, near, sizeof from);
    } else {
        status = stage_tilt(&stage, 0.0, 0.0, stage.home_height, &from);
    }
    if (status == STAGE_OK) {
        status = stage_forward(&stage, readings, &from, &from);
    }
    return put(status, &stage, &from, state);
}

int {{prefix}}beyond_limits(const {{prefix}}geometry *geometry, const double readings[3])
{
    stage_geometry stage = unlimited(geometry);
    int i;
    for (i = 0; i < 3; ++i) {
        stage.legs[i].minimum = geometry->minimum[i];
        stage.legs[i].maximum = geometry->maximum[i];
    }
    return stage_beyond_limits(&stage, readings);
}

int {{prefix}}joint_values(const {{prefix}}geometry *geometry, const {{prefix}}state *state, double values[9])
{
    const double *arguments[2] = {state->joints, geometry->frames[0]};
    double *results[1] = {values};
    joint_values_of(arguments, results);
    return STAGE_OK;
}
