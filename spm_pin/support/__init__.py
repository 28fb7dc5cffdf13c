"""Shared helpers that know no machine: checks of arguments, poses, files, tables, progress."""
