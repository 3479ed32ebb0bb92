"""The steering actuator against closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from ampc_msgs_config import config
from ampc_msgs_config.parameters import SteeringParameters
from ampc_msgs_config.types import Array
from sim_vehicle.actuator import angle_after, lag_share
from sim_vehicle.car import Car
from sim_vehicle.parameters import load_vehicle_file

PAPER = load_vehicle_file(config.find("vehicles", "paper"))
STEP = 0.005


def angles(command: float, steps: int, **steering: float) -> list[float]:
    """Return the road-wheel angle after each integration step under a constant command."""
    actuator = SteeringParameters(**{"max_angle": 0.5, "lag": 0.0} | steering)
    car = Car(PAPER._replace(steering=actuator), speed=10.0, step=STEP)
    history = []
    for _ in range(steps):
        car.advance(command, 10.0, np.zeros((1, 2)))
        history.append(car.steering)
    return history


both_sides = pytest.mark.parametrize("command", [0.1, -0.1])


@both_sides
def test_ideal_actuator_is_at_its_command(command: float) -> None:
    assert angles(command, 3) == [command] * 3


@both_sides
def test_angle_is_limited(command: float) -> None:
    assert angles(10 * command, 2) == [5 * command] * 2


@both_sides
def test_lag_follows_the_exponential_exactly(command: float) -> None:
    time = STEP * np.arange(1, 101)
    expected = command * (1 - np.exp(-time / 0.12))
    assert angles(command, 100, lag=0.12) == pytest.approx(expected, abs=1e-12)


@both_sides
def test_rate_limit_makes_a_ramp(command: float) -> None:
    ramp = math.copysign(0.7, command) * STEP * np.arange(1, 41)
    expected = np.clip(ramp, -0.1, 0.1)
    assert angles(command, 40, max_rate=0.7) == pytest.approx(expected, abs=1e-12)


@both_sides
@pytest.mark.parametrize(("delay", "steps"), [(0.005, 1), (0.037, 7), (0.05, 10), (0.26, 52)])
def test_delay_is_pure_and_rounded_to_the_step(command: float, delay: float, steps: int) -> None:
    history = angles(command, steps + 3, delay=delay)
    assert history == [0.0] * steps + [command] * 3


@both_sides
@pytest.mark.parametrize(("lag", "rate"), [(0.05, 0.5), (0.05, 0.43), (0.3, 0.11), (0.004, 1.9)])
def test_delay_lag_and_rate_act_one_after_the_other(
    command: float, lag: float, rate: float
) -> None:
    """The rate limit ends within a step, except in the first case."""

    def turning(_: float, angle: Array) -> Array:
        return np.clip((command - angle) / lag, -rate, rate)

    solved = solve_ivp(
        turning,
        (0.0, 0.301),
        [0.0],
        t_eval=STEP * np.arange(1, 61),
        rtol=1e-10,
        atol=1e-12,
        max_step=STEP,
    )
    history = angles(command, 70, delay=0.05, lag=lag, max_rate=rate)
    assert history[:10] == [0.0] * 10
    assert history[10:] == pytest.approx(solved.y[0], abs=1e-8)


@both_sides
@pytest.mark.parametrize(
    ("lag", "rate"), [(0.0, math.inf), (0.0, 0.7), (0.07, math.inf), (0.07, 0.4)]
)
def test_angle_does_not_depend_on_how_the_time_is_divided(
    command: float, lag: float, rate: float
) -> None:
    servo = (0.5, rate, lag, 0.0)

    def after(time: float, angle: float) -> float:
        return angle_after(time, angle, command, lag_share(time, servo), servo)

    rng = np.random.default_rng(6)
    for _ in range(100):
        angle, (first, second) = float(rng.uniform(-0.5, 0.5)), rng.exponential(0.1, 2).tolist()
        at_once, in_parts = after(first + second, angle), after(second, after(first, angle))
        assert in_parts == pytest.approx(at_once, abs=1e-14)
        assert after(0.0, angle) == (command if lag == 0.0 and math.isinf(rate) else angle)


def test_every_command_passes_the_delay_in_its_turn_however_long_the_periods_are() -> None:
    steering = replace(PAPER.steering, delay=0.13)
    fine, coarse = (Car(PAPER._replace(steering=steering), speed=10.0) for _ in range(2))
    for i in range(12):
        command = 0.05 * math.sin(i)
        coarse.advance(command, 10.0, np.zeros((20, 2)))
        for steps in (3, 1, 11, 5):
            fine.advance(command, 10.0, np.zeros((steps, 2)))
        assert np.array_equal(fine.state, coarse.state)
