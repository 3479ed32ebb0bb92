"""Where the parts meet: set-up, start and the scripts around a run."""

import sys

if any(
    each.startswith("launch_scripts.") or "/lib/launch_scripts/" in each
    for each in sys.orig_argv[1:4]
):  # run as a module or as an executable; a command that is run as a file imports run.guard
    from ampc_msgs_config.signals import guard_command

    guard_command()
