static {% include "stage_status.c" %}

/* From the level platform. */
static int begin(const double *readings)
{
    int i, status;
    for (i = 0; i < JOINTS; ++i) { /* limits are LinuxCNC's */
        geometry.legs[i].minimum = -STAGE_NO_LIMIT;
        geometry.legs[i].maximum = STAGE_NO_LIMIT;
    }
    status = stage_tilt(&geometry, 0.0, 0.0, geometry.home_height, &last);
    return status == STAGE_OK ? stage_forward(&geometry, readings, &last, &last) : status;
}

/* Shift and twist are the machine's: X, Y and C stay as they are. */
static void put_world(EmcPose *world)
{
    const double x = last.rotation[2], y = last.rotation[5], z = last.rotation[8];
    world->tran.z = last.position[2] * UNITS_PER_METRE;
    world->a = atan2(-y, z) / DEGREE;
    world->b = atan2(x, sqrt(y * y + z * z)) / DEGREE;
}

/* In closed form: of this normal and height there is one state in the home assembly region. */
static int solve_pose(const EmcPose *world, stage_state *state)
{
    const double a = world->a * DEGREE, b = world->b * DEGREE;
    const double normal[3] = {sin(b), -sin(a) * cos(b), cos(a) * cos(b)};
    return stage_inverse(&geometry, normal, world->tran.z / UNITS_PER_METRE, state);
}
