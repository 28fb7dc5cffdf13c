static int begin(const double *readings)
{
    return spm_forward(&geometry, readings, NULL, &last);
}

static void put_world(EmcPose *world)
{
    const double *r = last.rotation;
    world->tran.x = last.position[0] * UNITS_PER_METRE;
    world->tran.y = last.position[1] * UNITS_PER_METRE;
    world->tran.z = last.position[2] * UNITS_PER_METRE;
    world->a = atan2(r[7], r[8]) / DEGREE;
    world->b = atan2(-r[6], sqrt(r[7] * r[7] + r[8] * r[8])) / DEGREE;
    world->c = atan2(r[3], r[0]) / DEGREE;
}

#define FAR 1e-3 /* metres, and of the rotation's components: farther than a servo cycle leads */

static int is_far(const double *rotation, const double *position)
{
    double most = 0.0;
    int i;
    for (i = 0; i < 9; ++i) {
        most = fmax(most, fabs(rotation[i] - last.rotation[i]));
    }
    for (i = 0; i < 3; ++i) {
        most = fmax(most, fabs(position[i] - last.position[i]));
    }
    return most > FAR;
}

/* In a servo cycle from the last state: on the branch that the machine is in. LinuxCNC also asks for the ends of the moves of
   a program, while the machine is still at the first: of these the physical branch, in closed form. */
static int solve_pose(const EmcPose *world, spm_state *state)
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
    return spm_inverse(&geometry, rotation, position, is_far(rotation, position) ? NULL : &last, state);
}
