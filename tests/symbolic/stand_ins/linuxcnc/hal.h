#include "kinematics.h"
