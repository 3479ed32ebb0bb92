"""Nominal steering of the horizon: the road's angle, limited so that feedback keeps authority."""

from typing import NamedTuple

from ampc_msgs_config.compiled import in_place, inlined
from ampc_msgs_config.parameters import FRICTION_SHARE
from ampc_msgs_config.types import Array
from ampc_ros.mpc.internal_model import InternalModel
from ampc_ros.mpc.model import BicycleParameters
from ampc_ros.mpc.small_matrices import Scratch, vector
from ampc_ros.preview.model import angle_bound, road_steering

NOMINAL_SHARE = 0.7
"""Share of the largest increment that the angles without correction use. The rest is left to the
feedback in both directions, at every step."""
CHANGE_TIME = 0.1
"""Time over which the rate of change of the curvature is taken, at least two ticks [s]."""
SWEEPS = 40
"""Sweeps of `limit_rate`."""
OVER_RELAXATION = 1.7
"""Factor of its steps. A chain of 20 increments that exceed the limit converges to 1e-6 of it."""


class Road(NamedTuple):
    """Speed and curvature along the prediction horizon; entry 0 lies one tick back."""

    speed: Array
    """(H + 1,) [m/s]."""
    curvature: Array
    """(H + 1,) mean over each step [1/m]."""
    behind: Array
    """(H,) mean over the steps before entry 0, the latest first [1/m]."""


@in_place
def nominal_steering(
    model: InternalModel, road: Road, u: float, nominal: Array, bounds: Array, scratch: Scratch
) -> None:
    """Fill the angles without correction: the angle in force plus the changes of the path's angle.

    Where the path demands more than `NOMINAL_SHARE` of the largest increment, its angle is replaced
    by the nearest sequence that does not, see `limit_rate`. The sequence respects angle bounds and
    the share. If the angle in force exceeds its bound, it returns at the share. The sequence is
    therefore feasible by construction and leaves the rest of the increment to the correction.

    Args:
        model: BicycleParameters and limits.
        road: Speed and curvature along the horizon.
        u: Angle in force [rad].
        nominal: Receives the angles (H,) [rad].
        bounds: Receives the bound of the angle at each step (H,) [rad].
        scratch: Auxiliary memory.
    """
    begin, vehicle, limits = scratch.used[0], model.vehicle, model.limits
    step, a_y_max = NOMINAL_SHARE * limits.Delta_u_max, FRICTION_SHARE * limits.mu_g
    now, angles = len(road.behind), vector(scratch, len(road.behind) + len(road.speed))
    demanded_angles(vehicle, road, limits.T, angles)
    limit_rate(angles, step, vector(scratch, len(angles)))
    before, offset = u, u - angles[now]
    for i in range(len(bounds)):
        bound = angle_bound(vehicle, road.speed[i + 1], limits.u_max, a_y_max)
        wanted = min(max(offset + angles[now + i + 1], -bound), bound)
        before = min(max(wanted, before - step), before + step)
        nominal[i], bounds[i] = before, bound
    scratch.used[0] = begin


@in_place
def demanded_angles(vehicle: BicycleParameters, road: Road, T: float, angles: Array) -> None:
    """Fill the angles that keep the car on the path, from the road behind to the horizon's end.

    Args:
        vehicle: m, I_z, l_f, l_r, C_f, C_r.
        road: Speed and curvature; the road behind is taken at the speed of entry 0.
        T: Step [s].
        angles: Receives the angles (2 H + 1,); entry H is entry 0 of the road [rad].
    """
    now = len(road.behind)
    for i in range(len(angles)):
        # The angle in force is held until the next tick: it belongs to the change over that tick
        first = 1 - change_ticks(T) if i == now else -now
        angles[i] = road_angle(vehicle, road, i - now, T, first)


@in_place
def limit_rate(angles: Array, step: float, pressure: Array) -> None:
    """Replace angles by the nearest sequence in least squares whose increments are within +-step.

    Angles whose increments are within the bound are not changed. Elsewhere the sequence starts
    before the demand and ends after it: each correction adds to one angle what it takes from its
    neighbour, so the sum of the angles, and with it the change of heading, is preserved.

    Note:
        Hildreth's procedure on the increments, with over-relaxation (Cryer, 1971). Angles still
        exceed the bound by the remaining error; the caller limits the increments from step to step.

    Args:
        angles: Changed in place (n,) [rad].
        step: Largest increment [rad].
        pressure: Multipliers of the increments, zeros before (n,) [rad].
    """
    for _ in range(SWEEPS):
        largest = 0.0
        for i in range(len(angles) - 1):
            increment = angles[i + 1] - angles[i]
            # Positive: increment at its upper bound, negative: at its lower bound
            upper = pressure[i] + OVER_RELAXATION * (increment - step) / 2.0
            lower = pressure[i] + OVER_RELAXATION * (increment + step) / 2.0
            change = max(upper, 0.0) + min(lower, 0.0) - pressure[i]
            if change != 0.0:
                pressure[i] += change
                angles[i] += change
                angles[i + 1] -= change
                largest = max(largest, abs(change))
        if largest <= 1e-9:
            return


@in_place
def road_angle(vehicle: BicycleParameters, road: Road, i: int, T: float, first: int) -> float:
    """Return the angle that keeps the car on the path at entry i, in [-H, H] [rad].

    The rate of change of the curvature is that over `CHANGE_TIME`: over a shorter time it would
    contain the steps of a curvature that is interpolated between samples of the path.

    Args:
        vehicle: m, I_z, l_f, l_r, C_f, C_r.
        road: Speed and curvature.
        i: Entry.
        T: Step [s].
        first: Earliest entry that is used.
    """
    reach, last = change_ticks(T), len(road.curvature) - 1
    before, after = max(i - reach, first), min(i + reach, last)
    change = (curvature_at(road, after) - curvature_at(road, before)) / ((after - before) * T)
    return road_steering(vehicle, road.speed[max(i, 0)], curvature_at(road, i), change)


@inlined
def change_ticks(T: float) -> int:
    """Return half of `CHANGE_TIME` in steps of T [s]."""
    return max(round(CHANGE_TIME / (2.0 * T)), 1)


@inlined
def curvature_at(road: Road, i: int) -> float:
    """Return the curvature of entry i, in [-H, H] [1/m]."""
    return float(road.curvature[i] if i >= 0 else road.behind[-i - 1])
