
int @PREFIX@@NAME@(@PARAMETERS@)
{
    int status = check_state(geometry, state);
@CHECKS@    status = status != @PREFIX_UPPER@OK ? status : check_legs(geometry, state, @MOVES@);
    if (status == @PREFIX_UPPER@OK && @SINGULAR_CALL@) {
        status = @PREFIX_UPPER@SINGULAR;
    }
    if (status == @PREFIX_UPPER@OK) {
        const double *const in[] = {state->joints, state->rotation, state->position@ARGUMENTS@, LEGS(geometry)};
        double *const out[] = {@RESULT@};
        @NAME@_of(in, out);
        status = are_within(@RESULT@, @COUNT@, DBL_MAX) ? status : @PREFIX_UPPER@OUT_OF_RANGE;
    }
    if (status != @PREFIX_UPPER@OK) {
        put_nan(@RESULT@, @COUNT@);
    }
    return status;
}
