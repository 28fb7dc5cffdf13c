/* What the page calls: the header that it offers, with numbers that are double. */

#define STAGE_DOUBLE
#include "stage.h"

stage_geometry geometry;
stage_state state, other;
double asked[4]; /* a normal and a height, or three readings */
double balls[9]; /* one after the other */

int inverse(void)
{
    return stage_inverse(&geometry, asked, asked[3], &state);
}

/* From `state` to the readings in `asked`: into `other`. */
int forward(void)
{
    return stage_forward(&geometry, asked, &state, &other);
}

/* Into `asked` the readings of three balls in their legs' planes, rigid or not; 0 where one is out of reach. */
int readings(void)
{
    double arm[3], place[2];
    int i, reached = 1;
    for (i = 0; i < 3; ++i) {
        const stage_leg *leg = &geometry.legs[i];
        stage_minus(balls + 3 * i, leg->pivot, arm);
        place[0] = stage_dot(arm, leg->outward);
        place[1] = stage_dot(arm, leg->upward);
        reached = reached && stage_put_reading(geometry.kind, leg, place, &asked[i]);
    }
    return reached;
}
