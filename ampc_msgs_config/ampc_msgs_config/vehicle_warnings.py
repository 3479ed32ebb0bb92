"""Plausibility of a vehicle: sentences about values that look like a frequent mistake."""

import math
from collections.abc import Iterator
from pathlib import Path

from ampc_msgs_config.parameters import GRAVITY, ChassisParameters, SteeringParameters
from ampc_msgs_config.vehicle_file import read_vehicle

PER_DEGREE = 1.5
"""Cornering stiffness over load below which it is stated in N/deg: real tyres have 3 to 30 per rad,
0.05 to 0.5 per deg [1/rad]."""
SOFTEST = 2.5
"""Least plausible cornering stiffness over load [1/rad]."""
STIFFEST, STIFFEST_HEAVY = 26.0, 11.0
"""Largest plausible mean of both axles for cars and for heavy vehicles [1/rad]."""
HEAVY, LIGHT = 5000.0, 300.0
"""Mass of a heavy vehicle, whose tyres are softer, and of a model car or a robot [kg]."""
INERTIA, MODEL_INERTIA = (0.5, 2.3), (0.25, 1.7)
"""Range of I_z / (m l_f l_r): known cars have 0.8 to 1.2, buses 1.5, model cars 0.46 to 1, a robot
in Gazebo 1.4."""
SHARE = (0.22, 0.78)
"""Range of the front share of the mass."""
DENSITY, MODEL_DENSITY = (10.0, 500.0), (1.5, 500.0)
"""Range of mass / wheelbase^3 [kg/m^3]; 41 to 210 for known vehicles, 1.9 for hollow robots in
Gazebo."""
LARGEST_ANGLE = 1.25
"""Largest plausible road-wheel angle; the wheels of cars in CARLA turn by 70 deg [rad]."""
FASTEST, FASTEST_MODEL = 2.5, 20.0
"""Largest plausible rate of the road-wheel angle; model cars have servos of 3 to 10 [rad/s]."""
CRITICAL_SPEED = 100.0
"""Critical speed above which a car counts as neutral [m/s]."""


def vehicle_warnings(chassis: ChassisParameters, steering: SteeringParameters) -> list[str]:
    """Return one sentence for each implausible value, with key, value and usual range."""
    limits = steering_warnings(chassis, steering)
    return [*stiffness_warnings(chassis), *mass_warnings(chassis), *limits]


def file_warnings(file: Path) -> list[str]:
    """Return the warnings about a vehicle file, each with its name.

    Raises:
        ValueError: The file is missing or wrong.
    """
    vehicle = read_vehicle(file)
    chassis = vehicle.section(ChassisParameters, "chassis", "the controller")
    steering = vehicle.section(SteeringParameters, "steering", "the controller")
    return [f"{file}: {sentence}" for sentence in vehicle_warnings(chassis, steering)]


def stiffness_warnings(chassis: ChassisParameters) -> Iterator[str]:
    """Yield sentences about cornering stiffnesses, and about an oversteering car."""
    axle_load = chassis.mass * GRAVITY / chassis.wheelbase  # per metre of lever
    axles = {
        "front": (chassis.front_cornering_stiffness, 0.5 * axle_load * chassis.cg_to_rear_axle),
        "rear": (chassis.rear_cornering_stiffness, 0.5 * axle_load * chassis.cg_to_front_axle),
    }
    per_load = {axle: C / load for axle, (C, load) in axles.items()}
    for axle, (C, _) in axles.items():
        measure = (
            f"{C:g} N/rad is {per_load[axle]:.2g} times the load of the tyre, usual are 3 to 25"
        )
        sentence = f"chassis.{axle}_cornering_stiffness = {measure}"
        if per_load[axle] < PER_DEGREE:
            yield f"{sentence}: is it in N/deg? Then state {math.degrees(C):.6g}"
        elif per_load[axle] < SOFTEST:
            yield f"{sentence}: the tyre is very soft"
    mean = sum(per_load.values()) / 2
    most, usual = (STIFFEST, "8 to 21") if chassis.mass < HEAVY else (STIFFEST_HEAVY, "4 to 8")
    if mean > most:
        sentence = f"the cornering stiffnesses are {mean:.3g} times the loads of the tyres"
        remedy = "are they those of both tyres of an axle? Then halve them"
        yield f"chassis: {sentence}, usual are {usual}: {remedy}"
    gradient = chassis.understeer_gradient
    if min(per_load.values()) >= PER_DEGREE and gradient < 0.0:
        critical = math.sqrt(-chassis.wheelbase / gradient)
        if critical < CRITICAL_SPEED:
            sentence = f"the car oversteers (understeer gradient {gradient:.2g} rad s^2/m)"
            remedy = "are front and rear exchanged?"
            yield f"chassis: {sentence} and is unstable above {critical:.3g} m/s: {remedy}"


def mass_warnings(chassis: ChassisParameters) -> Iterator[str]:
    """Yield sentences about mass, centre of gravity and yaw inertia."""
    m, l_f, l_r = chassis.mass, chassis.cg_to_front_axle, chassis.cg_to_rear_axle
    L = chassis.wheelbase
    low, high = (bound * L**3 for bound in (DENSITY if m > LIGHT else MODEL_DENSITY))
    if not low <= m <= high:
        sentence = f"chassis.mass = {m:g} kg does not fit the wheelbase {L:g} m"
        yield f"{sentence}, usual are {low:.2g} to {high:.2g} kg"
    if not SHARE[0] <= l_r / L <= SHARE[1]:
        sentence = f"the front axle carries {100 * l_r / L:.0f} % of the mass, usual are 25 to 70 %"
        remedy = "are cg_to_front_axle and cg_to_rear_axle measured from the centre of gravity?"
        yield f"chassis: {sentence}: {remedy}"
    low, high = (bound * m * l_f * l_r for bound in (INERTIA if m > LIGHT else MODEL_INERTIA))
    if not low <= chassis.yaw_inertia <= high:
        sentence = f"chassis.yaw_inertia = {chassis.yaw_inertia:g} kg m^2"
        yield f"{sentence}, usual are {low:.3g} to {high:.3g} for this mass and wheelbase"


def steering_warnings(chassis: ChassisParameters, steering: SteeringParameters) -> Iterator[str]:
    """Yield sentences about steering limits that look like those of a steering wheel."""
    remedy = "road-wheel values are needed, those of the steering wheel divided by its ratio"
    if steering.max_angle > LARGEST_ANGLE:
        sentence = f"steering.max_angle = {steering.max_angle:g} rad is above {LARGEST_ANGLE:g}"
        yield f"{sentence}: {remedy}"
    most = FASTEST if chassis.mass > LIGHT else FASTEST_MODEL
    if most < steering.max_rate < math.inf:
        yield f"steering.max_rate = {steering.max_rate:g} rad/s is above {most:g}: {remedy}"
