"""What every room uses and no machine is in: checks of arguments, poses, files, tables, progress."""
