/* Starts a program on the emulated board mps2-an386, a Cortex-M4F, whose memory the emulator has loaded. */

#include <stdint.h>
#include <stdlib.h>

extern void initialise_monitor_handles(void);
extern int main(void);

void reset(void)
{
    *(volatile uint32_t *)0xE000ED88 |= 0xF << 20; /* the floating-point unit on */
    __asm__ volatile("dsb\nisb");
    initialise_monitor_handles();
    exit(main());
}

static void fault(void)
{
    exit(99);
}

__attribute__((section(".vectors"), used)) static void (*const vectors[16])(void) = {
    (void (*)(void))0x20200000, reset, fault, fault, fault, fault, fault,
};

void _init(void) {}
void _fini(void) {}
