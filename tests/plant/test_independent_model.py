"""The simulated car against the second implementation of its equations, in six manoeuvres."""

from collections.abc import Mapping
from dataclasses import replace
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ampc_msgs_config import config
from ampc_msgs_config.types import Array
from sim_vehicle.car import Car
from sim_vehicle.parameters import Vehicle, load_vehicle_file
from sim_vehicle.vehicle import A_X, CAR_V_X, CAR_V_Y, CAR_YAW_RATE, CORNERING, SIZE
from tests.plant.independent_model import rates, simulate

CARS = {name: load_vehicle_file(config.find("vehicles", name)) for name in ("paper", "ordinary")}
both_cars = pytest.mark.parametrize("name", CARS)
STEP, STEPS, PERIODS = 0.005, 20, 30
TOLERANCE = 1e-8
"""Of each number of the state, in its SI unit, on a size of 1 at least."""


class Manoeuvre(NamedTuple):
    """Three seconds of driving."""

    speed: float
    """At the start [m/s]."""
    target: float
    """[m/s]."""
    steering: float
    """Amplitude of the commands [rad]."""
    wind: float
    """Mean of the gusts in x and y [m/s]."""
    friction: float
    actuator: Mapping[str, float] = MappingProxyType({})
    """Changed steering parameters."""
    powertrain: Mapping[str, float] = MappingProxyType({})
    """Changed powertrain parameters."""
    model: str = "pacejka"


MANOEUVRES = {
    "slalom in gusts": Manoeuvre(25.0, 25.0, 0.04, 12.0, 0.9, {"lag": 0.08, "delay": 0.037}),
    "full braking in a bend": Manoeuvre(18.0, 0.0, 0.06, -6.0, 0.6, {"max_rate": 0.3}),
    "full throttle at low power": Manoeuvre(
        2.0, 30.0, 0.1, 5.0, 1.0, {"lag": 0.2}, {"max_power": 12e3, "front_drive_share": 0.7}
    ),
    "spin on a wet road": Manoeuvre(30.0, 32.0, 0.3, 20.0, 0.35, {"delay": 0.1}),
    "linear tyre at its limit": Manoeuvre(15.0, 12.0, 0.2, -15.0, 0.8, {"lag": 0.1}, {}, "linear"),
    "stop and park in wind": Manoeuvre(1.6, 0.0, 0.4, 14.0, 0.9, {"lag": 0.15, "max_rate": 0.5}),
}


def modified(vehicle: Vehicle, manoeuvre: Manoeuvre) -> Vehicle:
    """Return the vehicle with the actuator, powertrain and tyre of a manoeuvre."""
    return vehicle._replace(
        steering=replace(vehicle.steering, **manoeuvre.actuator),
        powertrain=replace(vehicle.powertrain, **manoeuvre.powertrain),
        tyre=replace(vehicle.tyre, model=manoeuvre.model),
    )


@both_cars
@pytest.mark.parametrize("manoeuvre", MANOEUVRES.values(), ids=list(MANOEUVRES))
def test_simulated_car_drives_as_an_independent_implementation(
    manoeuvre: Manoeuvre, name: str
) -> None:
    vehicle, rng = modified(CARS[name], manoeuvre), np.random.default_rng(4)
    speed, target, amplitude, mean, friction, *_ = manoeuvre
    commands = amplitude * np.sin(0.35 * np.arange(PERIODS)) + 0.01 * rng.standard_normal(PERIODS)
    wind = mean + 4.0 * rng.standard_normal((PERIODS * STEPS, 2))
    car = Car(vehicle, (1.0, -2.0, 0.7), speed, friction=friction, step=STEP)
    start, states = car.state[: SIZE - 1].copy(), []
    for k, command in enumerate(commands):
        car.advance(float(command), target, wind[k * STEPS : (k + 1) * STEPS])
        states.append(car.state)
    held, targets = np.repeat(commands, STEPS), np.full(len(wind), target)
    expected = simulate(start, held, wind, targets, friction, STEP, vehicle)
    np.testing.assert_allclose(states, expected[STEPS - 1 :: STEPS], rtol=TOLERANCE, atol=TOLERANCE)


@both_cars
@pytest.mark.parametrize("wind", [(0.0, 0.0), (9.0, -14.0)])
def test_simulated_car_follows_the_exact_solution_of_the_equations(
    name: str, wind: tuple[float, float]
) -> None:
    """Angle and wind are constant for a whole period here, so SciPy may choose its own steps."""
    vehicle, air, step = modified(CARS[name], MANOEUVRES["slalom in gusts"]), np.array(wind), 0.001
    vehicle = vehicle._replace(steering=replace(vehicle.steering, lag=0.0, delay=0.0, max_rate=1e9))
    car = Car(vehicle, (0.0, 0.0, 0.3), 14.0, step=step)
    z = car.state[: SIZE - 1].copy()
    for k in range(PERIODS // 2):
        delta, mu = 0.08 * float(np.sin(k)), vehicle.tyre.friction
        car.advance(delta, 16.0, np.tile(air, (round(0.1 / step), 1)))

        def derivative(_: float, z: Array, delta: float = delta, mu: float = mu) -> Array:
            return np.asarray(rates(z, delta, air, 16.0, mu, step, vehicle))

        z = solve_ivp(derivative, (0.0, 0.1), z, method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(car.state[: SIZE - 1], z, rtol=1e-7, atol=1e-7)


@both_cars
def test_manoeuvres_reach_what_they_are_made_for(name: str) -> None:
    """Load transfer, slides, standstill and cornering drag occur, so the comparison covers them."""
    reached = {}
    for title, manoeuvre in MANOEUVRES.items():
        vehicle = modified(CARS[name], manoeuvre)
        car = Car(vehicle, (1.0, -2.0, 0.7), manoeuvre.speed, friction=manoeuvre.friction)
        rows = []
        for k in range(PERIODS):
            command = manoeuvre.steering * float(np.sin(0.35 * k))
            car.advance(command, manoeuvre.target, np.full((STEPS, 2), manoeuvre.wind))
            rows.append(car.state)
        reached[title] = np.abs(rows).max(axis=0), car.state
    assert reached["full braking in a bend"][0][A_X] > 4.0
    assert reached["spin on a wet road"][0][CAR_V_Y] > 4.0
    assert reached["slalom in gusts"][0][CAR_YAW_RATE] > 0.1
    assert reached["linear tyre at its limit"][0][CORNERING] > 500.0
    assert reached["stop and park in wind"][1][CAR_V_X] == 0.0
