"""Tyre: steady-state lateral force, friction limit, transient slip. Angles: positive to the left.

Source: H. B. Pacejka, Tire and Vehicle Dynamics, 3rd ed.: Magic Formula and the influence of the
load (chapters 1 and 4), transient slip with relaxation length (chapter 7), standstill (chapter 8).

The functions have no branches and do not call the mathematical library, so that the loop over the
wheels becomes SIMD code. A `tyre` is (magic, C, E, k_D, p, sigma, T_d, C_alpha, F_z0), see
`vehicle_row`; magic is 0 for a linear tyre.
"""

import math

from ampc_msgs_config.compiled import inlined
from sim_vehicle.elementary import arc_sine, arc_tangent, sine

LEAST_LOAD_FACTOR = 0.1
"""Lower bound of the load sensitivity; no wheel of a car reaches it."""
ANTI_LOCK = 0.98
"""Largest share of the friction for brakes and drive; a fifth of the lateral force remains."""
PARKING_SPEED = 2.0
"""Speed below which the damping of the tyre acts [m/s]."""
LEAST_FORCE = 1.0e-9
"""Added to denominators, so that the quotients of a lifted wheel are finite [N]."""


@inlined
def load_factor(load: float, tyre: tuple[float, ...]) -> float:
    """Return the friction coefficient at this load relative to that at static load."""
    _, _, _, k_D, _, _, _, _, F_z0 = tyre
    return max(1.0 - k_D * (load / F_z0 - 1.0), LEAST_LOAD_FACTOR)


@inlined
def peak_force(load: float, friction: float, tyre: tuple[float, ...]) -> float:
    """Return D = mu F_z (1 - k_D (F_z / F_z0 - 1)) [N], the largest force in any direction."""
    return friction * load * load_factor(load, tyre)


@inlined
def cornering_stiffness(load: float, tyre: tuple[float, ...]) -> float:
    """Return B C D [N/rad]: C_alpha at the static load, largest at p times the static load.

    In the book: c_1 sin(2 atan(F_z / c_2)) = 2 c_1 c_2 F_z / (c_2^2 + F_z^2), with c_2 = p F_z0.
    """
    _, _, _, _, p, _, _, C_alpha, F_z0 = tyre
    return C_alpha * (p**2 + 1.0) * F_z0 * load / ((p * F_z0) ** 2 + load**2)


@inlined
def lateral_force(slip: float, load: float, friction: float, tyre: tuple[float, ...]) -> float:
    """Return the lateral force of pure side slip [N].

    Args:
        slip: Slip angle, positive if the force acts to the left [rad].
        load: Wheel load, not negative [N].
        friction: Coefficient mu at the static load.
        tyre: See the head of the file. A linear tyre has C_alpha at every load, up to D.
    """
    magic, C, E, _, _, _, _, C_alpha, _ = tyre
    D = peak_force(load, friction, tyre)
    x = cornering_stiffness(load, tyre) / (C * D + LEAST_FORCE) * slip  # B alpha
    curve = D * sine(C * arc_tangent(x - E * (x - arc_tangent(x))))
    return min(max(C_alpha * slip, -D), D) if magic == 0.0 else curve


@inlined
def tyre_forces(
    slip: float, demand: float, load: float, friction: float, tyre: tuple[float, ...]
) -> tuple[float, float]:
    """Return longitudinal and lateral force [N] inside the friction circle.

    Args:
        slip: Slip angle [rad].
        demand: Longitudinal force demanded by drive or brake [N].
        load: Wheel load [N].
        friction: Coefficient mu.
        tyre: See the head of the file.
    """
    D = peak_force(load, friction, tyre)
    F_x = min(max(demand, -ANTI_LOCK * D), ANTI_LOCK * D)
    share = F_x / (D + LEAST_FORCE)
    remaining = math.sqrt(abs(1.0 - share**2))  # abs: removes the check for negative numbers
    return F_x, remaining * lateral_force(slip, load, friction, tyre)


@inlined
def transient_slip(
    s: float, rolling: float, sliding: float, step: float, tyre: tuple[float, ...]
) -> tuple[float, float]:
    """Return the rate of the transient slip [1/s] and the effective slip angle [rad].

    sigma ds/dt = -V_sy - |V| s with s = sin(alpha'). For small slip this is the relaxation equation
    of the book, but it is bounded at any slip and speed. At standstill it is a spring with the
    deflection sigma s, so a parked car stays in place. The damping of that spring is proportional
    to ds/dt and therefore vanishes in every steady state.

    Args:
        s: Transient slip, sine of the lagged slip angle.
        rolling: Velocity of the wheel centre along the wheel [m/s].
        sliding: Velocity of the wheel centre to the left of the wheel, V_sy [m/s].
        step: Integration step [s]. The relaxation time is at least half of it, which keeps RK4
            stable if sigma / |V| is shorter (sigma = 0.1 m, 5 ms: above 40 m/s).
        tyre: See the head of the file.
    """
    _, _, _, _, _, sigma, T_d, _, _ = tyre
    speed = math.sqrt(rolling**2 + sliding**2)
    rate = -(sliding + speed * s) / max(sigma, 0.5 * step * speed)
    damping = T_d * max(1.0 - speed / PARKING_SPEED, 0.0) ** 2
    return rate, arc_sine(min(max(s, -1.0), 1.0)) + damping * rate
