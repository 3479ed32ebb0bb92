"""Rows of the tables of an identification, for terminal and page."""

import math
from collections.abc import Iterator

from ampc_ros.identification.result import Identification, Quantity
from launch_scripts.identifying.files import base_link_to_cg

TITLES: dict[str, tuple[str, str, float, str]] = {
    "delay": ("steering delay", "ms", 1e3, ".0f"),
    "lag": ("steering lag", "ms", 1e3, ".0f"),
    "total_latency": ("delay and lag together", "ms", 1e3, ".0f"),
    "max_rate": ("steering rate limit", "rad/s", 1.0, ".2f"),
    "ratio": ("steering ratio", "", 1.0, ".4g"),
    "offset": ("steering offset", "deg", math.degrees(1.0), ".2f"),
    "understeer_gradient": ("understeer gradient", "rad s^2/m", 1.0, ".5f"),
    "front_cornering_stiffness": ("cornering stiffness, one front tyre", "N/rad", 1.0, ",.4g"),
    "rear_cornering_stiffness": ("cornering stiffness, one rear tyre", "N/rad", 1.0, ",.4g"),
    "yaw_inertia": ("yaw inertia", "kg m^2", 1.0, ",.4g"),
    "measured_point": ("measured point ahead of the rear axle", "m", 1.0, ".2f"),
    "latency": ("latency of the odometry before its stamp", "ms", 1e3, ".0f"),
}
"""Title, unit, factor from SI units, and format by quantity."""


def quantity_rows(result: Identification) -> list[list[str]]:
    """Return title, value, 95 % interval and unit of each quantity."""
    rows = []
    for name, (title, unit, factor, pattern) in TITLES.items():
        quantity = result.quantities[name]
        if not quantity.is_identified:
            rows.append([title, "not identifiable", "", unit])
            continue
        value = plain(quantity.value * factor, pattern)
        low, high = (plain(end * factor, pattern) for end in quantity.interval)
        rows.append([title, value, f"{low} to {high}", unit])
    return rows


def plain(value: float, pattern: str) -> str:
    """Return a number without an exponent, and without the sign of a zero."""
    shown = format(value, pattern)
    shown = shown.lstrip("-") if float(shown.replace(",", "")) == 0.0 else shown
    return f"{float(shown.replace(',', '')):,.0f}" if "e" in shown else shown


def unknown_rows(result: Identification) -> Iterator[tuple[str, Quantity]]:
    """Yield title and quantity of what is not identifiable."""
    for name, (title, *_) in TITLES.items():
        if not result.quantities[name].is_identified:
            yield title, result.quantities[name]


def notes_of(result: Identification) -> list[str]:
    """Return what follows for the configuration, one sentence each."""
    notes, noise, excitation = [], result.noise, result.excitation
    point = result.quantities["measured_point"]
    if point.is_identified:
        value = base_link_to_cg(result).value
        notes.append(
            f"Parameter of the controller node: base_link_to_cg = {value:.2f} m: "
            f"ros2 run ampc_ros controller --ros-args -p base_link_to_cg:={value:.3f}"
        )
    notes.append(
        "Noise of the odometry, for the settings of the controller: "
        f"position_noise: {noise.position_noise:.3g}, heading_noise: {noise.heading_noise:.2g}, "
        f"yaw_rate_noise: {noise.yaw_rate_noise:.2g}, "
        f"lateral_velocity_noise: {noise.lateral_velocity_noise:.2g}"
    )
    if result.age is None:
        notes.append(
            "Age of the odometry: arrival and stamps are not on one clock, or were not recorded."
        )
    else:
        median, spread, most = (1e3 * each for each in result.age)
        notes.append(
            f"Age of the odometry at its arrival: {median:.1f} ms (median), spread {spread:.1f} ms,"
            f" 99 % below {most:.1f} ms. The delay is counted from the arrival of the command at "
            "the recorder: the controller continues each state to the time of its command."
        )
    shares = "; ".join(f"{why}: {100 * s:.1f} %" for why, s in excitation.left_out.items())
    low, high = excitation.speed
    notes.append(
        f"Used: {excitation.duration:.0f} s, speeds from {low:.1f} to {high:.1f} m/s, lateral "
        f"acceleration up to {excitation.lateral_acceleration:.1f} m/s^2 (95 %), "
        f"{100 * excitation.left:.0f} % in bends to the left, {100 * excitation.right:.0f} % to "
        f"the right. Left out: {shares or 'nothing'}."
    )
    return notes
