/* Go from leg lengths to a pose and back with the module, as the motion controller does. */
#include <kinematics.h>
#include <math.h>
#include <stdio.h>
int hal_init(const char *name) { return name[0] == 's' ? 7 : -1; }
int hal_ready(int component) { return component == 7 ? 0 : -1; }
int hal_exit(int component) { return component == 7 ? 0 : -1; }
void rtapi_print_msg(int level, const char *format, ...) { (void)level; (void)format; }
int main(int count, char **names)
{
    double worst = 0.0, joint[6], again[6];
    EmcPose world = {{0.0, 0.0, 0.0}, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0}, level = {{0.0, 0.0, 2200.0}, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0};
    KINEMATICS_FORWARD_FLAGS forward = 0;
    KINEMATICS_INVERSE_FLAGS inverse = 0;
    int i, k;
    *parameter_machine = "no such file";
    if (rtapi_app_main() != -1) return 5;
    *parameter_machine = count > 1 ? names[1] : "";
    if (rtapi_app_main() != 0 || kinematicsType() != KINEMATICS_BOTH) return 1;
    for (k = 0; k < 1000; ++k) {
        for (i = 0; i < 6; ++i) joint[i] = 1300.0 + 100.0 * sin(0.01 * (k + 50) * (i + 1));
        if (kinematicsForward(joint, &world, &forward, &inverse) != 0) return 2;
        if (kinematicsInverse(&world, again, &inverse, &forward) != 0) continue;
        for (i = 0; i < 6; ++i) worst = fmax(worst, fabs(again[i] - joint[i]));
    }
    if (kinematicsInverse(&level, again, &inverse, &forward) != -1) return 3;
    joint[0] = -1.0;
    if (kinematicsForward(joint, &world, &forward, &inverse) != -1) return 4;
    rtapi_app_exit();
    printf("%.3e\n", worst);
    return 0;
}
