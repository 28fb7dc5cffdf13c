/* Set-points of a stage from a serial line, and the commands of its actuators: C99 or C++, without a library.

   The protocol. The computer sends frames of 16 bytes, at 115200 baud in the sketch:

       0      0xA5
       1      a number that counts frames, modulo 256
       2-5    x of the platform's normal, a unit vector, times 1e6
       6-9    y of it, times 1e6; z is positive
       10-13  the height of the platform's centre above the plane of the pivots [micrometres]
       14-15  CRC-16/CCITT of bytes 0 to 13: polynomial 0x1021, begun at 0xFFFF

   The board answers each whole frame by 5 bytes:

       0      0x5A
       1      the frame's number
       2      a status: LINE_REPEATED, or that of `stage_inverse`, 255 for STAGE_BAD_INPUT; or where that is STAGE_OK, why the
              way to the set-point before was refused by `stage_forward`, such as STAGE_UNSAFE
       3-4    CRC of bytes 0 to 2

   Integers are signed, of 32 bits, and lowest byte first, as the CRC is. Nothing tells how old a set-point is: one that the line has
   delayed is followed when it comes.

   Whatever arrives, and whatever the times between the commands are: in a time t a reading changes by at most t times
   the rate, and its speed by at most t times the acceleration, up to rounding; a command is within the limits of the
   readings, or no farther beyond one than the state at which it began; and it belongs to a state that `stage_forward`
   has reached without a singularity. Where that refuses the next one the command stops at once, whatever the
   acceleration: braking would lead on into what it refuses. Limits of the readings within which the stage is regular
   keep this from happening. */

#ifndef SET_POINTS_H
#define SET_POINTS_H

#include <stdint.h>

#include "stage.h"

#define FRAME_SIZE 16
#define ANSWER_SIZE 5

enum {
    LINE_REPEATED = 16, /* the frame has come before, or a later one has */
    LINE_SILENT = 17    /* no new frame came for longer than the watchdog allows: the actuators stop */
};

typedef struct {
    const stage_geometry *machine;
    stage_real rate, acceleration; /* the most of each actuator, in units of its reading per s and s^2 */
    stage_real patience;           /* time without a new frame after which the actuators stop [s] */
    stage_state state;             /* of the command */
    stage_real speed[3];           /* of the readings */
    stage_real target[3];          /* readings of the last set-point */
    stage_real silence;            /* time since the last new frame [s] */
    int status;                    /* of the last set-point, LINE_SILENT, or that of a state refused on the way */
    int way;                       /* why the way to the last set-point was refused, or STAGE_OK */
    uint8_t frame[FRAME_SIZE], count, number;
} set_points;

static inline uint16_t crc16(const uint8_t *bytes, int count)
{
    uint16_t crc = 0xFFFF;
    int i, bit;
    for (i = 0; i < count; ++i) {
        crc = (uint16_t)(crc ^ (uint16_t)(bytes[i] << 8));
        for (bit = 0; bit < 8; ++bit) {
            crc = (uint16_t)(crc & 0x8000 ? (crc << 1) ^ 0x1021 : crc << 1);
        }
    }
    return crc;
}

/* Begin with the actuators at rest in a state. */
static inline void set_points_begin(set_points *s, const stage_geometry *machine, const stage_state *state,
        stage_real rate, stage_real acceleration, stage_real patience)
{
    int i;
    s->machine = machine;
    s->rate = rate;
    s->acceleration = acceleration;
    s->patience = patience;
    s->state = *state;
    s->silence = patience;
    s->status = LINE_SILENT;
    s->way = STAGE_OK;
    s->count = 0;
    s->number = 0;
    for (i = 0; i < 3; ++i) {
        s->speed[i] = 0;
        s->target[i] = state->readings[i];
    }
}

static inline stage_real number_at(const uint8_t *bytes)
{
    uint32_t x = bytes[0] | (uint32_t)bytes[1] << 8 | (uint32_t)bytes[2] << 16 | (uint32_t)bytes[3] << 24;
    return (stage_real)(int32_t)x / 1000000;
}

/* Take a byte of the line; return whether it ends a frame, to which `answer` is then to be sent. */
static inline int set_points_take(set_points *s, uint8_t byte, uint8_t answer[ANSWER_SIZE])
{
    uint16_t crc;
    int i, is_new;
    if (s->count == FRAME_SIZE) { /* no frame has begun where it seemed to: look on from the next byte */
        for (i = 1; i < FRAME_SIZE; ++i) {
            s->frame[i - 1] = s->frame[i];
        }
        --s->count;
    }
    s->frame[s->count++] = byte;
    if (s->count < FRAME_SIZE || s->frame[0] != 0xA5
            || (s->frame[FRAME_SIZE - 2] | s->frame[FRAME_SIZE - 1] << 8) != crc16(s->frame, FRAME_SIZE - 2)) {
        return 0;
    }
    s->count = 0;
    /* After a silence any other number is new: the sender may have begun again. */
    is_new = (uint8_t)(s->frame[1] - s->number - 1) < (s->silence < s->patience ? 127 : 255);
    answer[0] = 0x5A;
    answer[1] = s->frame[1];
    answer[2] = LINE_REPEATED;
    if (is_new) {
        stage_state goal;
        stage_real normal[3];
        normal[0] = number_at(s->frame + 2);
        normal[1] = number_at(s->frame + 6);
        normal[2] = 1 - normal[0] * normal[0] - normal[1] * normal[1];
        normal[2] = normal[2] > 0 ? STAGE_M(sqrt)(normal[2]) : 0;
        s->number = s->frame[1];
        s->silence = 0;
        s->status = stage_inverse(s->machine, normal, number_at(s->frame + 10), &goal);
        for (i = 0; i < 3 && s->status == STAGE_OK; ++i) {
            /* `stage_inverse` takes readings that are beyond a limit by rounding. */
            const stage_leg *leg = &s->machine->legs[i];
            stage_real most = goal.readings[i] > leg->maximum ? leg->maximum : goal.readings[i];
            s->target[i] = most < leg->minimum ? leg->minimum : most;
        }
        answer[2] = (uint8_t)(s->status == STAGE_OK ? s->way : s->status);
        s->way = STAGE_OK;
    }
    crc = crc16(answer, 3);
    answer[3] = (uint8_t)(crc & 0xFF);
    answer[4] = (uint8_t)(crc >> 8);
    return 1;
}

/* Move the command, s->state.readings, on by a time: towards the target, all actuators in proportion. A time that is not
   positive and finite moves nothing. */
static inline void set_points_move(set_points *s, stage_real time)
{
    stage_real wanted[3], next[3], most = s->acceleration * time, share = 1 / time;
    int i, status;
    if (!(time > 0 && time - time == 0)) {
        return;
    }
    s->silence = s->silence < s->patience ? s->silence + time : s->patience;
    if (s->silence >= s->patience) {
        s->status = LINE_SILENT;
    }
    for (i = 0; i < 3; ++i) {
        /* The largest speed v that leaves, after this time, a way of v^2 / (2 acceleration): on that the actuator can
           stop in further steps of any times. Speeds are taken over the way, which may be zero. */
        stage_real way = STAGE_M(fabs)(s->target[i] - s->state.readings[i]);
        stage_real own = 2 * s->acceleration / (most + STAGE_M(sqrt)(most * most + 2 * s->acceleration * way));
        own = own * way > s->rate ? s->rate / way : own;
        share = own < share ? own : share;
    }
    for (i = 0; i < 3; ++i) {
        wanted[i] = s->status == LINE_SILENT ? 0 : share * (s->target[i] - s->state.readings[i]);
    }
    for (i = 0, share = 1; i < 3; ++i) { /* all speed up in proportion, and each brakes as it can */
        stage_real change = STAGE_M(fabs)(wanted[i] - s->speed[i]);
        share = wanted[i] * s->speed[i] >= 0 && STAGE_M(fabs)(wanted[i]) > STAGE_M(fabs)(s->speed[i])
                && most < share * change ? most / change : share;
    }
    for (i = 0; i < 3; ++i) {
        const stage_leg *leg = &s->machine->legs[i];
        stage_real change = share * (wanted[i] - s->speed[i]);
        if (STAGE_M(fabs)(wanted[i]) <= STAGE_M(fabs)(s->speed[i]) || wanted[i] * s->speed[i] < 0) {
            change = wanted[i] - s->speed[i];
        }
        change = change > most ? most : change < -most ? -most : change;
        s->speed[i] += change;
        next[i] = s->state.readings[i] + s->speed[i] * time;
        /* Beyond a limit by rounding, or on the way back from where it began. */
        if (next[i] > leg->maximum && s->speed[i] > 0) {
            next[i] = stage_larger(s->state.readings[i], leg->maximum);
        } else if (next[i] < leg->minimum && s->speed[i] < 0) {
            next[i] = -stage_larger(-s->state.readings[i], -leg->minimum);
        }
    }
    status = stage_forward(s->machine, next, &s->state, &s->state);
    if (status != STAGE_OK) {
        s->status = s->way = status;
        for (i = 0; i < 3; ++i) {
            s->speed[i] = 0;
            s->target[i] = s->state.readings[i];
        }
    }
}

#endif
