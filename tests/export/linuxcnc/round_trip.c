/* A component for LinuxCNC's HAL that runs the loaded kinematics module forth and back when it is itself loaded.

   Prints how many steps to the pose of readings nearby were refused, how many led to other readings of this pose, the largest
   difference of poses [mm, degrees] of all that remain, and how many of these are off by more than 1e-6 mm in their readings: beside a
   singularity of the inverse displacement readings are rounding times its condition. Where one lies between two readings, the
   legs' way and the platform's end on two branches. The least and the largest reading of each joint are in `ranges.txt`. */

#include <hal.h>
#include <kinematics.h>
#include <rtapi.h>
#include <rtapi_app.h>
#include <rtapi_math.h>
#include <stdio.h>

static int count = 1000;
RTAPI_MP_INT(count, "how many points");
MODULE_LICENSE("GPL");

static int joints;
static double low[6], high[6];
static KINEMATICS_FORWARD_FLAGS forward_flags;
static KINEMATICS_INVERSE_FLAGS inverse_flags;

static int forward(const double *joints, EmcPose *world)
{
    return kinematicsForward(joints, world, &forward_flags, &inverse_flags);
}

static int inverse(const EmcPose *world, double *joints)
{
    return kinematicsInverse(world, joints, &inverse_flags, &forward_flags);
}

/* A number in (-1, 1): Marsaglia's xorshift64. */
static double any(void)
{
    static unsigned long long x = 88172645463325252ULL;
    x ^= x << 13, x ^= x >> 7, x ^= x << 17;
    return (double)(x >> 11) / 4503599627370496.0 - 1.0;
}

static double difference(const double *a, const double *b, int size)
{
    double largest = 0.0;
    int i;
    for (i = 0; i < size; ++i) {
        largest = fmax(largest, fabs(a[i] - b[i]));
    }
    return largest;
}

static double pose_difference(const EmcPose *p, const EmcPose *q)
{
    const double a[6] = {p->tran.x, p->tran.y, p->tran.z, p->a, p->b, p->c};
    const double b[6] = {q->tran.x, q->tran.y, q->tran.z, q->a, q->b, q->c};
    return difference(a, b, 6);
}

/* Readings at random and others nearby: each to its pose and back, and from one to the pose of the other. */
static int walk(void)
{
    double here[6], there[6], reached[6], worst = 0.0;
    EmcPose pose = {{0.0}}, again = {{0.0}};
    int i, k, refused = 0, others = 0, steep = 0;
    for (k = 0; k < count; ++k) {
        for (i = 0; i < joints; ++i) {
            here[i] = k % 100 == 0 ? low[i] + 0.5 * (high[i] - low[i]) * (1.0 + any()) : there[i];
            there[i] = fmin(fmax(here[i] + 0.0025 * (high[i] - low[i]) * any(), low[i]), high[i]);
        }
        if (forward(there, &pose) != 0 || inverse(&pose, reached) != 0) {
            return -1;
        }
        steep += !(difference(reached, there, joints) <= 1e-6);
        if (forward(here, &again) != 0) {
            return -1;
        }
        if (inverse(&pose, reached) != 0) {
            ++refused;
        } else if (difference(reached, there, joints) > 0.01) {
            ++others;
        } else if (forward(reached, &again) != 0) {
            return -1;
        } else {
            steep += !(difference(reached, there, joints) <= 1e-6);
            worst = fmax(worst, pose_difference(&pose, &again));
        }
    }
    rtapi_print("refused %d others %d steep %d poses %.3e\n", refused, others, steep, worst);
    return 0;
}

/* Lose the state: nothing is commanded until there is one again. */
static int lose(void)
{
    double joint[6], reached[6];
    EmcPose world = {{0.0}}, kept;
    int i;
    for (i = 0; i < joints; ++i) {
        joint[i] = low[i] + 0.25 * (i % 3 + 1) * (high[i] - low[i]);
    }
    if (forward(joint, &world) != 0 || inverse(&world, reached) != 0) {
        return -1;
    }
    kept = world;
    joint[0] = NAN;
    if (forward(joint, &world) == 0 || pose_difference(&world, &kept) != 0.0 || inverse(&kept, reached) == 0) {
        return -1;
    }
    joint[0] = low[0] + 0.25 * (high[0] - low[0]);
    return forward(joint, &world) != 0 || inverse(&kept, reached) != 0 || pose_difference(&world, &kept) > 1e-9 ? -1 : 0;
}

static int component;

int rtapi_app_main(void)
{
    FILE *file = fopen("ranges.txt", "r");
    while (file && joints < 6 && fscanf(file, "%lf %lf", &low[joints], &high[joints]) == 2) {
        ++joints;
    }
    component = hal_init("round_trip");
    rtapi_set_msg_level(RTAPI_MSG_NONE); /* the module says each refusal */
    if (component < 0 || walk() != 0 || lose() != 0) {
        return -1;
    }
    rtapi_set_msg_level(RTAPI_MSG_ERR);
    hal_ready(component);
    return 0;
}

void rtapi_app_exit(void)
{
    hal_exit(component);
}
