"""The steering actuator against closed forms."""

import math
from dataclasses import replace

import numpy as np
import pytest

from ampc_msgs_config import config
from ampc_msgs_config.parameters import SteeringParameters
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
def test_delay_lag_and_rate_act_one_after_the_other(command: float) -> None:
    expected, angle = [0.0] * 10, 0.0
    for _ in range(60):
        turn = (command - angle) * -math.expm1(-STEP / 0.05)
        angle += math.copysign(min(abs(turn), 0.5 * STEP), turn)
        expected.append(angle)
    history = angles(command, 70, delay=0.05, lag=0.05, max_rate=0.5)
    assert history == pytest.approx(expected, abs=1e-12)


def test_every_command_passes_the_delay_in_its_turn_however_long_the_periods_are() -> None:
    steering = replace(PAPER.steering, delay=0.13)
    fine, coarse = (Car(PAPER._replace(steering=steering), speed=10.0) for _ in range(2))
    for i in range(12):
        command = 0.05 * math.sin(i)
        coarse.advance(command, 10.0, np.zeros((20, 2)))
        for steps in (3, 1, 11, 5):
            fine.advance(command, 10.0, np.zeros((steps, 2)))
        assert np.array_equal(fine.state, coarse.state)
