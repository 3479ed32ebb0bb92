"""Where the parts meet: set-up, start and the scripts around a run."""

from ampc_msgs_config.startup import COMMAND_PROGRAM, guard_command, runs

if runs(COMMAND_PROGRAM):
    guard_command()
