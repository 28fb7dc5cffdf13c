/* A component for LinuxCNC's HAL that runs the loaded kinematics module forth and back when it is itself loaded.

   Prints how many steps to the pose of readings nearby were refused, how many led to other readings of this pose, the largest
   difference of poses [mm, degrees] of all that remain, and how many of these are off by more than 1e-6 mm in their readings: beside a
   singularity of the inverse displacement readings are rounding times its condition. Where one lies between two readings, the
   legs' way and the platform's end on two branches. */

#include <hal.h>
#include <kinematics.h>
#include <rtapi.h>
#include <rtapi_app.h>
#include <rtapi_math.h>

static int count = 1000;
RTAPI_MP_INT(count, "how many points");
MODULE_LICENSE("GPL");

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

static double difference(const double *a, const double *b)
{
    double largest = 0.0;
    int i;
    for (i = 0; i < 6; ++i) {
        largest = fmax(largest, fabs(a[i] - b[i]));
    }
    return largest;
}

static double pose_difference(const EmcPose *p, const EmcPose *q)
{
    const double a[6] = {p->tran.x, p->tran.y, p->tran.z, p->a, p->b, p->c};
    const double b[6] = {q->tran.x, q->tran.y, q->tran.z, q->a, q->b, q->c};
    return difference(a, b);
}

/* Readings at random and others nearby: each to its pose and back, and from one to the pose of the other. */
static int walk(void)
{
    double here[6], there[6], reached[6], worst = 0.0;
    EmcPose pose, again;
    int i, k, refused = 0, others = 0, steep = 0;
    for (k = 0; k < count; ++k) {
        for (i = 0; i < 6; ++i) {
            here[i] = k % 100 == 0 ? 1300.0 + 199.0 * any() : there[i];
            there[i] = fmin(fmax(here[i] + any(), 1101.0), 1499.0);
        }
        if (forward(there, &pose) != 0 || inverse(&pose, reached) != 0) {
            return -1;
        }
        steep += !(difference(reached, there) <= 1e-6);
        if (forward(here, &again) != 0) {
            return -1;
        }
        if (inverse(&pose, reached) != 0) {
            ++refused;
        } else if (difference(reached, there) > 0.01) {
            ++others;
        } else if (forward(reached, &again) != 0) {
            return -1;
        } else {
            steep += !(difference(reached, there) <= 1e-6);
            worst = fmax(worst, pose_difference(&pose, &again));
        }
    }
    rtapi_print("refused %d others %d steep %d poses %.3e\n", refused, others, steep, worst);
    return 0;
}

/* Lose the state: nothing is commanded until there is one again. */
static int lose(void)
{
    double joints[6] = {1200.0, 1300.0, 1400.0, 1200.0, 1300.0, 1400.0}, reached[6];
    EmcPose world = {{0.0}}, kept;
    if (forward(joints, &world) != 0 || inverse(&world, reached) != 0) {
        return -1;
    }
    kept = world;
    joints[0] = -1.0;
    if (forward(joints, &world) == 0 || world.tran.x != kept.tran.x || inverse(&kept, reached) == 0) {
        return -1;
    }
    joints[0] = 1200.0;
    return forward(joints, &world) != 0 || inverse(&kept, reached) != 0 || fabs(world.tran.x - kept.tran.x) > 1e-9 ? -1 : 0;
}

static int component;

int rtapi_app_main(void)
{
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
