"""Section "tyres": the lateral acceleration that a road asks for, and that the car reaches.

The simulated car reaches less than friction times gravity: the front tyres saturate first, their
friction falls with the load, and drive forces and load transfer take their shares.
"""

from dataclasses import replace

import numpy as np

from ampc_msgs_config.frames import at_distance
from ampc_msgs_config.metrics import ticks
from ampc_msgs_config.paths.path import Progress
from ampc_msgs_config.scenarios.scenario import speed_at
from sim_vehicle.car import Car
from sim_vehicle.parameters import Vehicle
from sim_vehicle.vehicle import A_Y
from tests.workshop.acceptance.trials import Trial, assumed_vehicle, plant, run, scenario_of

RAMP_RATE = 0.02
"""Rate of the road-wheel angle in the ramp [rad/s]; half or twice of it changes 0.001 m/s^2."""
PERIOD, PERIOD_STEPS = 0.1, 20


def reached_acceleration(vehicle: Vehicle, v: float, friction: float | None) -> float:
    """Return the largest lateral acceleration while the wheels turn slowly to their stop [m/s^2].

    Args:
        vehicle: Car; delay and lag of its steering play no part.
        v: Speed that the driver keeps [m/s].
        friction: Coefficient mu; None: that of the tyres.
    """
    steering = replace(vehicle.steering, delay=0.0, lag=0.0)
    car = Car(vehicle._replace(steering=steering), speed=v, friction=friction)
    calm, most = np.zeros((PERIOD_STEPS, 2)), 0.0
    for angle in np.arange(0.0, steering.max_angle, RAMP_RATE * PERIOD).tolist():
        car.advance(angle, v, calm)
        most = max(most, float(car.state[A_Y]))
    return most


def asked_acceleration(trial: Trial, name: str) -> tuple[float, float]:
    """Return the largest speed squared times curvature of a road [m/s^2], and the speed there.

    The speed is that of the profile. Where it depends on time, the time is that of a drive with
    the controller.
    """
    driven = run(trial, name)
    to_cg, path = driven.vehicle.chassis.cg_to_rear_axle, driven.path
    progress, profile = Progress(path), driven.scenario.speed
    centres = [at_distance(state, to_cg) for state in driven.drive.states]
    s = np.array([progress.advance(centre.x, centre.y, centre.yaw) for centre in centres])
    along = np.arange(len(path.x)) * path.spacing
    on_road = along[(along >= s[0]) & (along <= s.max())]
    time = np.interp(on_road, np.maximum.accumulate(s), ticks(driven.drive))
    places = on_road if profile.over_distance else time
    speed = np.array([speed_at(profile, place) for place in places.tolist()])
    asked = speed**2 * np.abs(np.interp(on_road, along, path.curvature))
    worst = int(np.argmax(asked))
    return float(asked[worst]), float(speed[worst])


def tyre_demand(trial: Trial, name: str) -> dict[str, float]:
    """Return the lateral acceleration asked for and reached [m/s^2], and their ratio [%]."""
    vehicle = assumed_vehicle(trial)
    car = plant(trial, vehicle, scenario_of(trial, vehicle)).vehicle
    asked, v = asked_acceleration(trial, name)
    reached = reached_acceleration(car, v, trial.friction)
    return {"asked": asked, "reached": reached, "demand": 100.0 * asked / reached}
