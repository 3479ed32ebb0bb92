"""Where the parts meet: set-up, start and the scripts around a run."""

from ampc_msgs_config.startup import COMMAND_PROGRAM, guard_command, program_of

if program_of(COMMAND_PROGRAM):
    guard_command()
