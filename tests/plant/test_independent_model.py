"""The simulated car against the second implementation of its equations, in six manoeuvres."""

import math
from collections.abc import Mapping
from dataclasses import replace
from itertools import pairwise
from types import MappingProxyType
from typing import NamedTuple

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ampc_msgs_config import config
from ampc_msgs_config.scenarios.wind import Wind, wind_of_steps
from ampc_msgs_config.types import NANOSECONDS, Array
from sim_vehicle.car import Car
from sim_vehicle.parameters import Vehicle, load_vehicle_file
from sim_vehicle.vehicle import A_X, CAR_V_X, CAR_V_Y, CAR_YAW_RATE, CORNERING, SIZE
from tests.plant.independent_model import rates, simulate

CARS = {name: load_vehicle_file(config.find("vehicles", name)) for name in ("paper", "ordinary")}
both_cars = pytest.mark.parametrize("name", CARS)
STEP, STEPS, PERIODS = 0.005, 20, 30
PERIOD_NS = 100_000_000
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
    wind = mean + 4.0 * rng.standard_normal((PERIODS * STEPS, 3, 2))
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
    vehicle = vehicle._replace(
        steering=replace(vehicle.steering, lag=0.0, delay=0.0, max_rate=math.inf)
    )
    car = Car(vehicle, (0.0, 0.0, 0.3), 14.0, step=step)
    z = car.state[: SIZE - 1].copy()
    for k in range(PERIODS // 2):
        delta, mu = 0.08 * float(np.sin(k)), vehicle.tyre.friction
        car.advance(delta, 16.0, np.tile(air, (round(0.1 / step), 1)))

        def derivative(_: float, z: Array, delta: float = delta, mu: float = mu) -> Array:
            return np.asarray(rates(z, delta, air, 16.0, mu, step, vehicle))

        z = solve_ivp(derivative, (0.0, 0.1), z, method="DOP853", rtol=1e-11, atol=1e-12).y[:, -1]
    np.testing.assert_allclose(car.state[: SIZE - 1], z, rtol=1e-7, atol=1e-7)


GUSTS = (
    Wind(kind="gust", start=0.1, end=1.3, speed=22.0),
    Wind(kind="gust", start=0.4, end=1.5, speed=-9.0),
)


def weave(vehicle: Vehicle, wind: tuple[Wind, ...], step_ns: int) -> Array:
    """Return the state after 1.2 s with a new command every 0.1 s, wind, and this step [ns]."""
    car = Car(vehicle, (0.0, 0.0, 0.4), 16.0, step=step_ns / NANOSECONDS)
    for k in range(12):
        air = wind_of_steps(wind, k * PERIOD_NS, step_ns, PERIOD_NS // step_ns)
        car.advance(0.05 * math.sin(0.9 * k), 17.0, air)
    return car.state[: SIZE - 1]


def exact_weave(vehicle: Vehicle, wind: tuple[Wind, ...], step: float) -> Array:
    """Return the state of `weave` by SciPy, with its own actuator and gusts in the equations."""
    lag, delay, limit = (getattr(vehicle.steering, key) for key in ("lag", "delay", "max_angle"))
    z: Array = np.zeros(SIZE)
    z[[2, CAR_V_X]] = 0.4, 16.0

    def derivative(t: float, z: Array, command: float) -> Array:
        side = sum(
            gust.speed * (1.0 - math.cos(math.tau * (t - gust.start) / (gust.end - gust.start))) / 2
            for gust in wind
            if gust.start < t < gust.end
        )
        angle, air = (z[-1] if lag else command), np.array([0.0, side])
        turn = (min(max(command, -limit), limit) - z[-1]) / lag if lag else 0.0
        car = rates(z[:-1], angle, air, 17.0, vehicle.tyre.friction, step, vehicle)
        return np.append(car, turn)

    edges = sorted(
        {0.1 * k + delay for k in range(13)} | {x for g in wind for x in (g.start, g.end)}
    )
    times = [0.0, *(t for t in edges if 0.0 < t < 1.2), 1.2]
    for begin, end in pairwise(times):
        k = math.floor((0.5 * (begin + end) - delay) / 0.1)
        command = 0.05 * math.sin(0.9 * k) if k >= 0 else 0.0
        solved = solve_ivp(
            derivative, (begin, end), z, args=(command,), method="DOP853", rtol=1e-11, atol=1e-12
        )
        z = solved.y[:, -1]
    return np.asarray(z[:-1])


@both_cars
@pytest.mark.parametrize(
    ("lag", "wind"),
    [(0.2, ()), (0.0, GUSTS), (0.07, GUSTS), (0.5, GUSTS[:1])],
    ids=["lag", "wind", "lag and wind", "slow steering in one gust"],
)
def test_integration_is_of_fourth_order_with_lag_and_wind(
    lag: float, wind: tuple[Wind, ...], name: str
) -> None:
    """The state approaches that of SciPy by a factor of 2^3.5 at least for half the step."""
    vehicle = CARS[name]
    steering = replace(vehicle.steering, lag=lag, delay=0.04, max_rate=math.inf)
    vehicle = vehicle._replace(steering=steering)
    exact = exact_weave(vehicle, wind, 0.005)
    errors = [
        float(np.abs(weave(vehicle, wind, step_ns) - exact)[:6].max())
        for step_ns in (10_000_000, 5_000_000, 2_500_000)
    ]
    assert errors[1] < 1e-6
    assert math.log2(errors[0] / errors[2]) / 2 > 3.5


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
