"""The command line, `explore_slam`; each command is a module."""
