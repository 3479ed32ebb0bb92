"""All that a supervised tick may need, run once before the first one."""

from ampc_msgs_config.paths.path_fitting import make_path
from ampc_msgs_config.types import NANOSECONDS, VehicleState
from ampc_ros.configuration import Configuration
from ampc_ros.supervision.supervisor import Supervisor


def rehearse(config: Configuration) -> None:
    """Go down the ladder once, so that nothing is compiled or loaded in a tick."""
    supervisor, path = Supervisor(config), make_path([(0.0, 0.0), (200.0, 0.0)])
    ticks = supervisor.ladder.plan_ticks + 2
    for tick in range(ticks):
        x, stamp_ns = 9.0 * tick * supervisor.period, round(tick * supervisor.period * NANOSECONDS)
        supervisor.take_steering(0.0)
        supervisor.step(VehicleState(stamp_ns, x, 0.1, 0.0, 9.0, 0.0, 0.0), path)
        supervisor.ladder.qp_fault = True
