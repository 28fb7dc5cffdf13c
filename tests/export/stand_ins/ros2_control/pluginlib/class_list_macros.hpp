#include "controller_interface/controller_interface.hpp"
