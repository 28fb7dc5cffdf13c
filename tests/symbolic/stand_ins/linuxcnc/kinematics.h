/* What a module uses of LinuxCNC 2.9's kinematics.h, hal.h and rtapi.h, written anew for the tests. */
#ifndef STAND_IN_KINEMATICS_H
#define STAND_IN_KINEMATICS_H
typedef struct { double x, y, z; } PmCartesian;
typedef struct { PmCartesian tran; double a, b, c, u, v, w; } EmcPose;
typedef unsigned long int KINEMATICS_FORWARD_FLAGS;
typedef unsigned long int KINEMATICS_INVERSE_FLAGS;
typedef enum { KINEMATICS_IDENTITY = 1, KINEMATICS_FORWARD_ONLY, KINEMATICS_INVERSE_ONLY, KINEMATICS_BOTH } KINEMATICS_TYPE;
int kinematicsForward(const double *joint, EmcPose *world, const KINEMATICS_FORWARD_FLAGS *fflags,
        KINEMATICS_INVERSE_FLAGS *iflags);
int kinematicsInverse(const EmcPose *world, double *joint, const KINEMATICS_INVERSE_FLAGS *iflags,
        KINEMATICS_FORWARD_FLAGS *fflags);
KINEMATICS_TYPE kinematicsType(void);
int kinematicsSwitchable(void);
int kinematicsSwitch(int type);
#define KINS_NOT_SWITCHABLE \
    int kinematicsSwitchable(void) { return 0; } \
    int kinematicsSwitch(int type) { (void)type; return 0; }
#define EXPORT_SYMBOL(name) extern int exported_##name
#define RTAPI_MP_STRING(name, text) char **const parameter_##name = &name
#define RTAPI_MSG_ERR 1
void rtapi_print_msg(int level, const char *format, ...);
extern char **const parameter_machine;
#define MODULE_LICENSE(text) extern const char license_of_module[sizeof text]
int hal_init(const char *name);
int hal_ready(int component);
int hal_exit(int component);
int rtapi_app_main(void);
void rtapi_app_exit(void);
#endif
