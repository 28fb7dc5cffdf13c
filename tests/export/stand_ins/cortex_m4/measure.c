/* Prints instructions of an inverse and of a forward displacement, of the mean call and the longest, and the most stack
   that they take. The emulator counts a nanosecond for each instruction, the timer a tick for each 40. */

#include <stdint.h>
#include <stdio.h>

#include "stage.h"

#define CALLS 256
#define PAINTED 4096

static volatile uint32_t *const timer = (volatile uint32_t *)0xE000E010;

/* Return by how much a call lowers the stack: down to where it changes what was painted there. */
static int stack_of(int (*call)(void), int *status)
{
    volatile uint8_t *top;
    int k;
    __asm__ volatile("mov %0, sp" : "=r"(top));
    for (k = 1; k <= PAINTED; ++k) {
        top[-k] = 0xA5;
    }
    *status = call();
    for (k = PAINTED; k > 0 && top[-k] == 0xA5; --k) {
    }
    return k;
}

static stage_state state, near;
static int turn;

static int inverse(void)
{
    return stage_tilt(&stage_machine, (stage_real)0.1f, (stage_real)turn * 6.28f / CALLS, stage_machine.home_height, &state);
}

static int forward(void)
{
    stage_state next;
    return stage_forward(&stage_machine, state.readings, &near, &next);
}

int main(void)
{
    uint32_t inverses = 0, forwards = 0, longest = 0;
    int status, stack[2];
    timer[1] = 0xFFFFFF;
    timer[2] = 0;
    timer[0] = 5; /* the processor's clock, without interrupts */
    stack[0] = stack_of(inverse, &status);
    if (status != STAGE_OK) {
        return 1;
    }
    near = state;
    stack[1] = stack_of(forward, &status);
    for (turn = 0; turn < CALLS; ++turn) {
        uint32_t start = timer[2], middle, end;
        status = inverse();
        middle = timer[2];
        status = status == STAGE_OK ? forward() : status;
        end = timer[2];
        if (status != STAGE_OK) {
            return 2;
        }
        near = state;
        inverses += (start - middle) & 0xFFFFFF;
        forwards += (middle - end) & 0xFFFFFF;
        longest = ((middle - end) & 0xFFFFFF) > longest ? (middle - end) & 0xFFFFFF : longest;
    }
    printf("%lu %lu %lu %d %d\n", (unsigned long)(inverses * 40 / CALLS), (unsigned long)(forwards * 40 / CALLS),
            (unsigned long)longest * 40, stack[0], stack[1]);
    return 0;
}
