const char *{{prefix}}status_name(int status)
{
    switch (status) {
    case STAGE_OK: return "ok";
    case STAGE_UNREACHABLE: return "unreachable";
    case STAGE_SINGULAR: case STAGE_UNSAFE: return "singular";
    default: return "not finite, or more than a turn";
    }
}
