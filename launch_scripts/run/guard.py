"""Ends a command that is run as a file in one line where a package is missing.

`launch_scripts/*.py` import this file before anything that is not of the standard library.
"""

import sys

try:
    from ampc_msgs_config.signals import guard_command
except ModuleNotFoundError:
    print(
        f"error: {sys.executable} does not find the packages of this workspace: "
        "run `make setup` in the workspace once, then `source setup.bash`",
        file=sys.stderr,
    )
    sys.exit(2)
guard_command()
