"""Convert a drive to simple shapes in `map`: car, paths, wind, text; without compiled code."""

import math
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.parameters import REAR_AXLE, ChassisParameters, SizeParameters
from ampc_msgs_config.types import Array, VehicleState

MAX_DRAWN_POINTS = 500
"""Largest number of points of a path that is drawn."""
WHEEL_LENGTH, WHEEL_WIDTH = 0.64, 0.22
"""Size of a usual tyre, whose height equals its length [m]."""
CLEARANCE, BODY_HEIGHT = 0.25, 0.9
"""Height of the lower edge of the body above the ground, and height of the body [m]."""
LABEL_HEIGHT = 2.0
"""Height of wind arrow and text above the ground [m]."""
WIND_TIME = 0.5
"""Length of the arrow per wind speed [s]."""
CALM = 0.1
"""Slowest wind that is drawn [m/s]."""

Colour = tuple[float, float, float, float]
# Colours by Okabe and Ito, distinguishable with colour blindness; red, green, blue, opacity
CAR_COLOUR: Colour = (0.0, 0.45, 0.70, 0.6)
STOP_COLOUR: Colour = (0.84, 0.37, 0.0, 0.9)
PREDICTION_COLOUR: Colour = (0.90, 0.62, 0.0, 1.0)
WIND_COLOUR: Colour = (0.34, 0.71, 0.91, 1.0)
LINE_COLOUR: Colour = (0.6, 0.6, 0.6, 1.0)
WHEEL_COLOUR: Colour = (0.05, 0.05, 0.05, 1.0)
EMPTY_PATH = np.empty((0, 2))


class Outline(NamedTuple):
    """Dimensions of a car [m]."""

    wheelbase: float
    width: float
    front_overhang: float
    rear_overhang: float
    rear_axle: float = 0.0
    """Position of the rear axle ahead of the point that `odom` describes [m]."""


class Shape(NamedTuple):
    """One marker; name and number stay the same, so that a viewer moves it."""

    name: str
    number: int
    kind: str
    """`cube`, `line`, `arrow` (from the first point to the second) or `text`."""
    colour: Colour
    size: tuple[float, float, float]
    """Cube: its size; line: width; arrow: shaft, head, length of head; text: height [m]."""
    position: tuple[float, float, float] = (0.0, 0.0, 0.0)
    yaw: float = 0.0
    points: Array = EMPTY_PATH
    """Points of a line or an arrow (n, 2) [m]."""
    height: float = 0.0
    """Height of the points above the ground [m]."""
    text: str = ""


class View(NamedTuple):
    """Current values of a drive."""

    state: VehicleState
    steering: float = 0.0
    """Road-wheel angle [rad]."""
    wind: tuple[float, float] = (0.0, 0.0)
    """Wind velocity in `map` [m/s]."""
    reference: Array = EMPTY_PATH
    prediction: Array = EMPTY_PATH
    stop: bool = False
    """Whether the controller requests a stop."""


def car_of(chassis: ChassisParameters, size: SizeParameters, base_link_to_cg: float) -> Outline:
    """Return the car of a vehicle file; with REAR_AXLE, `odom` is at the rear axle."""
    to_rear = 0.0 if base_link_to_cg == REAR_AXLE else base_link_to_cg - chassis.cg_to_rear_axle
    overhangs = size.front_overhang, size.rear_overhang
    return Outline(chassis.wheelbase, size.width, *overhangs, rear_axle=to_rear)


def shapes(view: View, car: Outline) -> list[Shape]:
    """Return all shapes; those without values are left out."""
    state, colour = view.state, STOP_COLOUR if view.stop else CAR_COLOUR

    def placed(ahead: float, left: float) -> tuple[float, float]:  # from the car's frame to `map`
        cos, sin = math.cos(state.yaw), math.sin(state.yaw)
        return state.x + ahead * cos - left * sin, state.y + ahead * sin + left * cos

    # body
    length = car.rear_overhang + car.wheelbase + car.front_overhang
    middle = placed(car.rear_axle + length / 2 - car.rear_overhang, 0.0)
    body = *middle, CLEARANCE + BODY_HEIGHT / 2
    size = length, car.width, BODY_HEIGHT
    drawn = [Shape("car", 0, "cube", colour, size, body, state.yaw)]
    # wheels
    track, front = car.width - WHEEL_WIDTH, car.rear_axle + car.wheelbase
    left, right = wheel_angles(view.steering, car.wheelbase, track)
    wheels = ((front, 1, left), (front, -1, right), (car.rear_axle, 1, 0), (car.rear_axle, -1, 0))
    size = WHEEL_LENGTH, WHEEL_WIDTH, WHEEL_LENGTH
    for number, (x, side, angle) in enumerate(wheels, start=1):
        at = *placed(x, side * track / 2), WHEEL_LENGTH / 2
        drawn.append(Shape("car", number, "cube", WHEEL_COLOUR, size, at, state.yaw + angle))
    # speed and steering angle as text
    text = f"{state.v_x:.1f} m/s, {math.degrees(view.steering):+.1f} deg"
    text, colour = (f"STOP\n{text}", STOP_COLOUR) if view.stop else (text, LINE_COLOUR)
    at = state.x, state.y, LABEL_HEIGHT + 0.5
    drawn.append(Shape("text", 0, "text", colour, (0, 0, 0.7), at, text=text))
    # paths and wind
    if len(view.reference) > 1:
        line = Shape("reference_path", 0, "line", LINE_COLOUR, (0.15, 0, 0))
        drawn.append(line._replace(points=view.reference))
    if len(view.prediction) > 1:
        line = Shape("predicted_path", 0, "line", PREDICTION_COLOUR, (0.2, 0, 0), height=0.05)
        drawn.append(line._replace(points=view.prediction))
    if math.hypot(*view.wind) > CALM:
        tail = np.array((state.x, state.y))
        points = np.stack((tail, tail + WIND_TIME * np.array(view.wind)))
        arrow = Shape("wind", 0, "arrow", WIND_COLOUR, (0.15, 0.4, 0.5), points=points)
        drawn.append(arrow._replace(height=LABEL_HEIGHT))
    return drawn


def thin_points(points: Array, most: int = MAX_DRAWN_POINTS) -> Array:
    """Return at most `most` evenly selected points of a path (n, 2), with its first and its last.

    Raises:
        ValueError: A number is not finite.
    """
    if not np.isfinite(points).all():
        raise ValueError(f"{np.count_nonzero(~np.isfinite(points))} numbers are not finite")
    if len(points) <= most:
        return points
    return np.asarray(points[np.linspace(0, len(points) - 1, most).round().astype(int)])


def wheel_angles(steering: float, wheelbase: float, track: float) -> tuple[float, float]:
    """Return the angles of left and right front wheel for a common centre of rotation [rad].

    Args:
        steering: Angle of the equivalent single wheel [rad].
        wheelbase: Distance between the axles [m].
        track: Distance between the two wheels [m].
    """
    across, along = wheelbase * math.sin(steering), wheelbase * math.cos(steering)
    inside = track / 2 * math.sin(steering)
    return math.atan2(across, along - inside), math.atan2(across, along + inside)
