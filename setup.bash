# Environment of this workspace for bash:   source setup.bash
#
# Run `make setup` (or `make demo`) once before. Then python, ros2-style executables in install/ and the scripts in
# launch_scripts/ find each other:
#   * .venv is activated (where `make setup` made one);
#   * install/local_setup.bash sets AMENT_PREFIX_PATH, PYTHONPATH and PATH;
#   * topics stay on this machine, unless ROS_AUTOMATIC_DISCOVERY_RANGE is set already (SUBNET is ROS 2's own default);
#   * where ROS 2 itself is not installed, RMW_IMPLEMENTATION names the only middleware that the ROS wheels bring, and
#     launch_scripts/run/fastdds.xml makes its discovery quick.
# On a machine with ROS 2 Jazzy source its setup.bash first; its middleware is left as it is.

_ampc_root="$(cd "$(dirname "${BASH_SOURCE[0]}")" && pwd)"

if [ ! -f "$_ampc_root/install/local_setup.bash" ]; then
  echo "setup.bash: nothing is built yet, run 'make setup' in $_ampc_root first" >&2
  unset _ampc_root
  return 1
fi
[ -f "$_ampc_root/.venv/bin/activate" ] && . "$_ampc_root/.venv/bin/activate"
export ROS_AUTOMATIC_DISCOVERY_RANGE="${ROS_AUTOMATIC_DISCOVERY_RANGE:-LOCALHOST}"
if [ -z "${ROS_DISTRO:-}" ]; then
  unset _ROS_WHEELS_BOOTSTRAP_COMPLETE LD_LIBRARY_PATH # the wheels set both again for every process
  export RMW_IMPLEMENTATION=rmw_fastrtps_cpp
  export FASTRTPS_DEFAULT_PROFILES_FILE="${FASTRTPS_DEFAULT_PROFILES_FILE:-$_ampc_root/launch_scripts/run/fastdds.xml}"
  export AMENT_PREFIX_PATH="$VIRTUAL_ENV"
fi
. "$_ampc_root/install/local_setup.bash"
unset _ampc_root
