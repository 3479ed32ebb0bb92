"""Estimate all parameters of a vehicle from its data sheet, by published rules.

Yaw inertia:
    Cars: I_z = m l_f l_r, sports cars 0.9 of it. The dynamic index I_z / (m l_f l_r) of measured
    cars lies near 1: Heydinger et al., "Measured vehicle inertial parameters", SAE 1999-01-1336;
    MacInnis et al., "A comparison of moment of inertia estimation techniques", SAE 970951.
    Trucks and buses: a body of uniform density, I_z = m (length^2 + width^2) / 12. The city bus
    O 305 of Ackermann et al., "Robust control", Springer 1993, has i^2 = 10.85 m^2.
    Model cars carry battery and motor between the axles: 0.7 m l_f l_r, between 0.46 (F1TENTH) and
    0.97 (BARC).

Cornering stiffness over load:
    Cars: cornering compliance of an axle with suspension and steering, 57.3 deg / rad over the
    compliance in deg/g: Bundorf and Leffert, "The cornering compliance concept", SAE 760713: 3 to 7
    deg/g in front and 2 to 6 behind; here 4.2 and 3.0 (sports cars 3.4 and 2.7). The tyre alone
    has 2.6 deg/g (CommonRoad vehicles).
    Trucks and buses: 5 to 8 per rad for the loaded radial tyre: Fancher et al., "A factbook of the
    mechanical properties of the components for single-unit and articulated heavy trucks",
    UMTRI-86-12; 3.7 to 7.4 for the O 305.
    Model cars: F1TENTH, mu C_S = 4.9 and 5.7 per rad (O'Kelly et al., NeurIPS 2019 competition).

Height of the centre of gravity: static stability factor track / (2 h) of 1.42 for cars (NHTSA),
    0.85 for buses, 0.8 for loaded trucks (Fancher), 1.6 for sports and model cars.

Everything else is typical of the type: outline, actuator limits (a driver turns the steering wheel
with up to 640 deg/s), tyres, aerodynamics and powertrain.
"""

import math
from dataclasses import dataclass
from typing import Annotated, Any, NamedTuple

from ampc_msgs_config.parameters import GRAVITY
from ampc_msgs_config.validation import Checked, check_range, number

Range = tuple[float, float]
WHEEL_RATE = math.radians(640.0)
"""Rate of a steering wheel [rad/s]."""
DENSITY = (15.0, 250.0)
"""Range of mass / wheelbase^3 [kg/m^3]; 41 to 210 for known vehicles."""
DIGITS = 4
"""Significant digits of estimated numbers."""
UNKNOWN = -1.0
"""Lag of the steering: it is estimated while the vehicle is driven."""


@dataclass(frozen=True, kw_only=True)
class DataSheet(Checked):
    """Data sheet of a vehicle; None: estimated."""

    mass: Annotated[float, number(1.0, 30000.0, "kg")]
    wheelbase: Annotated[float, number(0.15, 9.0, "m")]
    front_share: Annotated[float, number(0.1, 0.9)] | None = None
    width: Annotated[float, number(0.1, 2.6, "m")] | None = None
    steering_ratio: Annotated[float, number(0.1, 100.0)] | None = None


class VehicleType(NamedTuple):
    """Rules of one type of vehicle; lengths are in wheelbases, forces in weights."""

    mass: Range
    """Range [kg]."""
    wheelbase: Range
    """Range [m]."""
    widths: Range
    """Range of the width [m]."""
    shares: Range
    """Range of the front share of the mass."""
    front_share: float
    width: Range
    """Width at 1 m of wheelbase [m], and its exponent over the wheelbase."""
    overhangs: tuple[float, float]
    height: float
    """Height over width."""
    inertia: float
    """I_z / (m l_f l_r); 0: body of uniform density."""
    stiffness: tuple[float, float]
    """Cornering stiffness over load of front and rear [1/rad]."""
    spreads: tuple[float, float]
    """Relative spreads of yaw inertia and cornering stiffness."""
    stability: float
    """track / (2 h)."""
    roll_share: float
    friction: float
    relaxation: float
    """Relaxation length [m]."""
    steering: tuple[float, float]
    """Largest road-wheel angle [rad], and steering ratio or 0 for a servo of 3.2 rad/s."""
    drag: float
    """Drag coefficient."""
    side: tuple[float, float]
    """Side coefficient, and its arm ahead of the middle of the body in lengths."""
    power: float
    """Power over mass [W/kg]."""
    drive: tuple[float, float]
    """Largest drive force, and its front share."""
    brake_share: float
    rolling: float


TYPES = {
    "passenger": VehicleType(
        mass=(200.0, 4500.0),
        wheelbase=(1.3, 4.2),
        widths=(0.9, 2.3),
        shares=(0.35, 0.7),
        front_share=0.55,
        width=(1.1, 0.5),
        overhangs=(0.33, 0.37),
        height=0.8,
        inertia=1.0,
        stiffness=(13.6, 19.1),
        spreads=(0.25, 0.62),
        stability=1.42,
        roll_share=0.58,
        friction=1.0,
        relaxation=0.35,
        steering=(0.6, 16.0),
        drag=0.3,
        side=(0.68, 0.12),
        power=75.0,
        drive=(0.37, 1.0),
        brake_share=0.65,
        rolling=0.012,
    ),
    "sport": VehicleType(
        mass=(300.0, 2600.0),
        wheelbase=(1.5, 3.3),
        widths=(1.2, 2.3),
        shares=(0.3, 0.65),
        front_share=0.47,
        width=(1.16, 0.5),
        overhangs=(0.36, 0.34),
        height=0.65,
        inertia=0.9,
        stiffness=(16.9, 21.2),
        spreads=(0.3, 0.5),
        stability=1.6,
        roll_share=0.58,
        friction=1.1,
        relaxation=0.3,
        steering=(0.55, 14.0),
        drag=0.33,
        side=(0.6, 0.12),
        power=150.0,
        drive=(0.6, 0.0),
        brake_share=0.62,
        rolling=0.012,
    ),
    "truck": VehicleType(
        mass=(2500.0, 30000.0),
        wheelbase=(2.5, 8.0),
        widths=(1.6, 2.6),
        shares=(0.25, 0.65),
        front_share=0.38,
        width=(1.75, 0.2),
        overhangs=(0.29, 0.46),
        height=1.3,
        inertia=0.0,
        stiffness=(5.6, 7.2),
        spreads=(0.4, 0.5),
        stability=0.8,
        roll_share=0.42,
        friction=0.8,
        relaxation=0.6,
        steering=(0.65, 20.0),
        drag=0.7,
        side=(0.9, 0.05),
        power=14.0,
        drive=(0.25, 0.0),
        brake_share=0.45,
        rolling=0.007,
    ),
    "bus": VehicleType(
        mass=(2500.0, 30000.0),
        wheelbase=(3.0, 8.5),
        widths=(1.8, 2.6),
        shares=(0.25, 0.55),
        front_share=0.36,
        width=(1.8, 0.18),
        overhangs=(0.46, 0.53),
        height=1.2,
        inertia=0.0,
        stiffness=(5.5, 7.0),
        spreads=(0.3, 0.5),
        stability=0.85,
        roll_share=0.46,
        friction=0.8,
        relaxation=0.6,
        steering=(0.75, 20.0),
        drag=0.6,
        side=(0.9, 0.05),
        power=13.0,
        drive=(0.2, 0.0),
        brake_share=0.45,
        rolling=0.008,
    ),
    "model_car": VehicleType(
        mass=(1.0, 300.0),
        wheelbase=(0.2, 1.2),
        widths=(0.1, 1.0),
        shares=(0.3, 0.7),
        front_share=0.52,
        width=(0.94, 1.0),
        overhangs=(0.36, 0.4),
        height=0.5,
        inertia=0.7,
        stiffness=(5.0, 5.8),
        spreads=(0.5, 0.5),
        stability=1.6,
        roll_share=0.5,
        friction=1.0,
        relaxation=0.03,
        steering=(0.42, 0.0),
        drag=0.6,
        side=(0.7, 0.0),
        power=100.0,
        drive=(0.9, 0.5),
        brake_share=0.5,
        rolling=0.02,
    ),
}
"""Rules by type."""
ACTUATOR_RATE = 3.2
"""Rate of the servo of a model car (F1TENTH) [rad/s]."""
OTHER_SPREADS = {
    "chassis": {"cg_to_front_axle": 0.12, "cg_to_rear_axle": 0.12},
    "steering": {"max_angle": 0.25, "max_rate": 0.5, "delay": 0.2},
    "size": {"width": 0.1, "front_overhang": 0.3, "rear_overhang": 0.3},
    "tyre": {
        **{"friction": 0.2, "shape": 0.15, "load_sensitivity": 0.5, "stiffest_load": 0.3},
        "relaxation_length": 0.6,
    },
    "body": {"track": 0.1, "cg_height": 0.2, "front_roll_share": 0.25},
    "aerodynamics": {"drag_area": 0.3, "side_area": 0.3, "side_force_arm": 0.6},
    "powertrain": {
        **{"max_drive_force": 0.5, "max_power": 0.5, "max_brake_force": 0.3},
        "rolling_resistance": 0.4,
    },
}
"""Spreads (95 %) that are the same for all types: relative, but in s for the delay."""


class Template(NamedTuple):
    """Parameters of a vehicle, and the spread of those that are estimated."""

    type: str
    sections: dict[str, dict[str, Any]]
    estimated: dict[str, float]
    """By dotted key, as in the section `estimated` of a vehicle file."""


def type_of(mass: float, wheelbase: float) -> str:
    """Return the type of a vehicle by mass [kg] and wheelbase [m]."""
    if wheelbase <= TYPES["model_car"].wheelbase[1]:
        return "model_car"
    if mass <= 3500.0:
        return "passenger"
    return "bus" if wheelbase >= 5.4 else "truck"


def vehicle_template(sheet: DataSheet, kind: str = "") -> Template:
    """Estimate the parameters of a vehicle.

    Args:
        sheet: What is known.
        kind: One of TYPES; empty: by mass and wheelbase.

    Raises:
        ValueError: Key, value and bound of what does not fit the type.
    """
    kind = kind or type_of(sheet.mass, sheet.wheelbase)
    rules = TYPES[kind]
    check(sheet, kind)
    # Outline
    m, L = sheet.mass, sheet.wheelbase
    factor, exponent = rules.width
    low, high = rules.widths
    width = sheet.width or min(max(factor * L**exponent, low), high)
    front_overhang, rear_overhang = (share * L for share in rules.overhangs)
    length, height = L + front_overhang + rear_overhang, rules.height * width
    # Chassis
    share = sheet.front_share or rules.front_share
    l_f = round((1.0 - share) * L, 4)
    l_r = round(L - l_f, 6)
    uniform = m * (length**2 + width**2) / 12.0
    load = 0.5 * m * GRAVITY / L
    c_f, c_r = rules.stiffness
    # Steering
    max_angle, usual_ratio = rules.steering
    rate = WHEEL_RATE / (sheet.steering_ratio or usual_ratio) if usual_ratio else ACTUATOR_RATE
    # Body and air
    track = 0.86 * width
    coefficient, arm = rules.side
    middle = l_f + front_overhang - 0.5 * length
    drive, front_drive = rules.drive
    sections: dict[str, dict[str, Any]] = {
        "chassis": {
            "mass": m,
            "yaw_inertia": rules.inertia * m * l_f * l_r or uniform,
            "cg_to_front_axle": l_f,
            "cg_to_rear_axle": l_r,
            "front_cornering_stiffness": c_f * load * l_r,
            "rear_cornering_stiffness": c_r * load * l_f,
        },
        "steering": {"max_angle": max_angle, "max_rate": rate, "lag": UNKNOWN, "delay": 0.0},
        "size": {"width": width, "front_overhang": front_overhang, "rear_overhang": rear_overhang},
        "tyre": {
            **{"model": "pacejka", "friction": rules.friction, "shape": 1.4, "curvature": -0.5},
            **{"load_sensitivity": 0.12, "stiffest_load": 2.0},
            "relaxation_length": rules.relaxation,
        },
        "body": {
            "track": track,
            "cg_height": track / (2.0 * rules.stability),
            "front_roll_share": rules.roll_share,
        },
        "aerodynamics": {
            "drag_area": rules.drag * 0.83 * width * height,
            "side_area": coefficient * length * height,
            "side_force_arm": middle + arm * length,
        },
        "powertrain": {
            "max_drive_force": drive * m * GRAVITY,
            "max_power": rules.power * m,
            "max_brake_force": 1.2 * rules.friction * m * GRAVITY,
            "front_drive_share": front_drive,
            "front_brake_share": rules.brake_share,
            "rolling_resistance": rules.rolling,
        },
    }
    if sheet.steering_ratio:
        sections["steering"]["ratio"] = sheet.steering_ratio
    estimated = spreads(rules, sheet)
    for key in estimated:
        section, _, name = key.partition(".")
        if not name.startswith("cg_to"):  # their sum is the wheelbase
            sections[section][name] = float(f"{sections[section][name]:.{DIGITS}g}")
    return Template(kind, sections, estimated)


def spreads(rules: VehicleType, sheet: DataSheet) -> dict[str, float]:
    """Return the spread of each estimated value by its dotted key; see `Template`."""
    inertia, stiffness = rules.spreads
    result = {
        "chassis.yaw_inertia": inertia,
        "chassis.front_cornering_stiffness": stiffness,
        "chassis.rear_cornering_stiffness": stiffness,
    }
    result |= {
        f"{part}.{name}": s for part, rows in OTHER_SPREADS.items() for name, s in rows.items()
    }
    known = {"size.width"} if sheet.width else set()
    known |= {"chassis.cg_to_front_axle", "chassis.cg_to_rear_axle"} if sheet.front_share else set()
    return {key: spread for key, spread in result.items() if key not in known}


def check(sheet: DataSheet, kind: str) -> None:
    """Raise a ValueError with key, value and bound where a data sheet does not fit a type."""
    rules = TYPES[kind]
    low, high = (bound * sheet.wheelbase**3 for bound in DENSITY)
    bounds = {
        "wheelbase": rules.wheelbase,
        "mass": (max(rules.mass[0], low), min(rules.mass[1], high)),
        "width": rules.widths,
        "front_share": rules.shares,
    }
    for key, (least, most) in bounds.items():
        if (value := getattr(sheet, key)) is not None:
            try:
                check_range(key, value, number(least, most))
            except ValueError as error:
                at = f" with a wheelbase of {sheet.wheelbase:g} m" * (key == "mass")
                raise ValueError(f"{error} for the type {kind}{at}") from error
