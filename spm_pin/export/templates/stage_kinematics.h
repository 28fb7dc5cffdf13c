/* A {{title}} with the functions of a manipulator's header, for the programs that call both.
   {{origin}}

   Metres and radians. A pose requests no more than its height and its normal: shift and torsion follow.

   SPDX-License-Identifier: BSD-2-Clause */

#ifndef {{PREFIX}}KINEMATICS_H
#define {{PREFIX}}KINEMATICS_H

#ifdef __cplusplus
extern "C" {
#endif

/* Other statuses have a name, and a result is not written. */
enum { {{PREFIX}}OK = 0, {{PREFIX}}BAD_NEAR = -1 };

typedef struct {
    double up, home_height;                  /* as in a stage_geometry */
    double legs[3][{{fields.leg_1.size}}];                      /* of a stage_leg the numbers from `pivot` to `offset` */
    double minimum[3], maximum[3], middle[3]; /* of the readings */
    double frames[3][{{fields.frame_1.size}}];                    /* of each leg, for the joints of the description */
} {{prefix}}geometry;

/* Names of the members of a geometry and how many numbers each has, in their order. */
#define {{PREFIX}}FIELDS {% for name, x in fields.items() %}{"{{name}}", {{x.size}}}{{", " if not loop.last}}{% endfor %}


/* First the members of a stage_state. */
typedef struct {
    double rotation[9], position[3], readings[3];
    double joints[9]; /* the balls in {B} */
} {{prefix}}state;

/* Return the name of a status, such as "unreachable". */
const char *{{prefix}}status_name(int status);

/* The state with the height and the normal of a pose, in the home assembly region; `near` is not used. */
int {{prefix}}inverse(const {{prefix}}geometry *geometry, const double rotation[9], const double position[3],
        const {{prefix}}state *near, {{prefix}}state *state);

/* The state of readings, on the straight way of the legs from `near`, or with NULL from the level platform. */
int {{prefix}}forward(const {{prefix}}geometry *geometry, const double readings[3], const {{prefix}}state *near,
        {{prefix}}state *state);

/* Return 0 where all readings are within the limits, or the number from 1 to 3 of the first that is beyond. */
int {{prefix}}beyond_limits(const {{prefix}}geometry *geometry, const double readings[3]);

/* The values of the description's nine joints [rad, m] in a state of these functions, in the order of its tree. */
int {{prefix}}joint_values(const {{prefix}}geometry *geometry, const {{prefix}}state *state, double values[9]);

#ifdef __cplusplus
}
#endif

#endif
