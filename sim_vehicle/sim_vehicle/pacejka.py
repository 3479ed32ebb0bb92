"""One tyre: steady-state lateral force, friction limit, transient slip. All angles left-positive.

Source: H. B. Pacejka, Tire and Vehicle Dynamics, 3rd ed.: Magic Formula and the influence of the
load (chapters 1 and 4), transient slip with relaxation length (chapter 7), standstill (chapter 8).

No function branches or calls the mathematical library: the loop over the wheels is SIMD code.
A `tyre` is (magic, C, E, k_D, p, sigma, T_d, C_alpha, F_z0); magic is 0 for a linear tyre.
"""

import math

from ampc_msgs_config.compiled import inlined
from sim_vehicle.elementary import arc_sine, arc_tangent, sine

LEAST_LOAD_FACTOR = 0.1
"""Where the straight line of the load sensitivity ends; no wheel of a car gets there."""
ANTI_LOCK = 0.98
"""Share of the friction that brakes and drive may use; a fifth of the lateral force is left."""
PARKING_SPEED = 2.0
"""Below this speed the tyre's own damping sets in [m/s]."""
LEAST_FORCE = 1.0e-9
"""Keeps the quotients of a lifted wheel finite [N]."""


@inlined
def load_factor(load: float, tyre: tuple[float, ...]) -> float:
    """Give the friction coefficient at this load over the one at static load."""
    _, _, _, k_D, _, _, _, _, F_z0 = tyre
    return max(1.0 - k_D * (load / F_z0 - 1.0), LEAST_LOAD_FACTOR)


@inlined
def peak_force(load: float, friction: float, tyre: tuple[float, ...]) -> float:
    """D = mu F_z (1 - k_D (F_z / F_z0 - 1)) [N]: what the tyre can transmit in any direction."""
    return friction * load * load_factor(load, tyre)


@inlined
def cornering_stiffness(load: float, tyre: tuple[float, ...]) -> float:
    """B C D [N/rad]: C_alpha at the static load, its largest value at p times the static load.

    The book's c_1 sin(2 atan(F_z / c_2)) = 2 c_1 c_2 F_z / (c_2^2 + F_z^2), with c_2 = p F_z0.
    """
    _, _, _, _, p, _, _, C_alpha, F_z0 = tyre
    return C_alpha * (p**2 + 1.0) * F_z0 * load / ((p * F_z0) ** 2 + load**2)


@inlined
def lateral_force(slip: float, load: float, friction: float, tyre: tuple[float, ...]) -> float:
    """Give the lateral force of pure side slip [N].

    Args:
        slip: Slip angle, positive where the force pushes to the left [rad].
        load: Wheel load, not negative [N].
        friction: Coefficient mu at the static load.
        tyre: See the head of the file. Linear tyres keep C_alpha at every load, up to D.
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
    """Give longitudinal and lateral force [N] inside the friction ellipse (here a circle).

    Args:
        slip: Slip angle [rad].
        demand: Longitudinal force that drive or brake ask for [N].
        load: Wheel load [N].
        friction: Coefficient mu.
        tyre: See the head of the file.
    """
    D = peak_force(load, friction, tyre)
    F_x = min(max(demand, -ANTI_LOCK * D), ANTI_LOCK * D)
    share = F_x / (D + LEAST_FORCE)
    left_over = math.sqrt(abs(1.0 - share**2))  # abs: else a check for negative numbers stays
    return F_x, left_over * lateral_force(slip, load, friction, tyre)


@inlined
def transient_slip(
    s: float, rolling: float, sliding: float, step: float, tyre: tuple[float, ...]
) -> tuple[float, float]:
    """Give the rate of the transient slip [1/s] and the slip angle that makes the force [rad].

    sigma ds/dt = -V_sy - |V| s with s = sin(alpha'): for small slip the book's relaxation equation,
    but bounded at any slip and any speed. At standstill it is a spring (the tyre's deflection is
    sigma s), so a parked car holds its place; the damping of that spring is proportional to ds/dt
    and therefore vanishes in every steady state.

    Args:
        s: Transient slip, sine of the lagged slip angle.
        rolling: Velocity of the wheel centre along the wheel [m/s].
        sliding: Velocity of the wheel centre to the wheel's left, V_sy [m/s].
        step: Of the integration [s]; the lag never falls below half of it, which keeps RK4 stable
            where sigma / |V| is shorter (sigma = 0.1 m, 5 ms: above 40 m/s).
        tyre: See the head of the file.
    """
    _, _, _, _, _, sigma, T_d, _, _ = tyre
    speed = math.sqrt(rolling**2 + sliding**2)
    rate = -(sliding + speed * s) / max(sigma, 0.5 * step * speed)
    damping = T_d * max(1.0 - speed / PARKING_SPEED, 0.0) ** 2
    return rate, arc_sine(min(max(s, -1.0), 1.0)) + damping * rate
