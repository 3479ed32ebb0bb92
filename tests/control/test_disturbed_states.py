"""Slow, late, noisy and missing odometry of a car with a misaligned wheel or an unknown lag."""

import math
from collections import deque
from contextlib import suppress
from dataclasses import replace
from typing import Any, NamedTuple

import numpy as np
import pytest

from ampc_msgs_config.config import find, load
from ampc_msgs_config.frames import at_distance
from ampc_msgs_config.parameters import ControllerSettings
from ampc_msgs_config.paths.path import Progress
from ampc_msgs_config.scenarios.scenario import load_scenario
from ampc_msgs_config.types import NANOSECONDS, Array, VehicleState
from ampc_ros.configuration import Choices, configuration
from ampc_ros.supervision.supervisor import Supervisor
from ampc_ros.supervision.tick_policy import Action, TickPolicy
from sim_vehicle.car import Car
from sim_vehicle.parameters import MeasurementNoise, load_vehicle_file

ORDINARY = load_vehicle_file(find("vehicles", "ordinary"))
X1 = load(MeasurementNoise, find("noise", "x1"))
STEP_NS = NANOSECONDS // 200
TABLES = {"table3": "preview_ordinary", "50hz": "preview_50hz", "100hz": "preview_100hz"}


class Case(NamedTuple):
    """A drive on a sine at constant speed."""

    settings: str = "100hz"
    speed: float = 15.0
    odometry: int = 1
    """Steps of 5 ms from one state to the next."""
    late: tuple[float, float] = (0.0, 0.0)
    """Shortest and longest age of a state at its arrival [s]."""
    offset_deg: float = 0.0
    """Angle of the wheels when straight ahead is commanded."""
    noise: float = 0.0
    """Factor on the noise `x1`."""
    gap: tuple[float, float] = (math.inf, math.inf)
    """Begin and end of a time without odometry [s]."""
    lag: float = 0.0
    delay: float = 0.0
    """Delay of the actual steering [s]."""
    duration: float = 12.0


def drive(case: Case, **noises: Any) -> tuple[Array, Supervisor]:
    """Return the cross-track errors of the true centre of gravity from 4 s on, and the controller.

    Args:
        case: Car, odometry and disturbances.
        noises: Settings of the state filter.
    """
    scenario = load_scenario("sine", ORDINARY.size, case.speed)
    table = TABLES[case.settings]
    choices = Choices("preview", "ordinary", case.settings, table, "track", static_path=True)
    config = configuration(choices)
    steering = replace(config.steering, lag=case.lag)
    settings: ControllerSettings = replace(config.settings, max_deviation=math.inf, **noises)
    supervisor = Supervisor(config._replace(steering=steering, settings=settings))
    supervisor.take_path(scenario.points, 0, 0)
    policy, rng = TickPolicy(supervisor), np.random.default_rng(4)
    actuator = replace(ORDINARY.steering, delay=case.delay)
    car = Car(ORDINARY._replace(steering=actuator), scenario.start, case.speed, step=0.005)
    period_ns, underway, errors = (
        round(supervisor.period * NANOSECONDS),
        deque[tuple[int, VehicleState]](),
        list[float](),
    )
    progress, wind = Progress(scenario.path), np.zeros((1, 2))
    for step in range(round(case.duration * 200)):
        now_ns = NANOSECONDS + step * STEP_NS
        t, true = step / 200, car.measure(now_ns)
        if step % case.odometry == 0 and not case.gap[0] <= t < case.gap[1]:
            underway.append((now_ns + round(rng.uniform(*case.late) * 1e9), noisy(true, case, rng)))
        while underway and underway[0][0] <= now_ns:
            with suppress(ValueError):  # rejected, as implausible
                policy.take_state(underway.popleft()[1], now_ns)
            if policy.on_input() is Action.TICK:
                policy.tick(now_ns)
        is_due = (now_ns - NANOSECONDS) % period_ns == 0
        if is_due and policy.on_timer(now_ns, period_ns) is Action.TICK:
            policy.tick(now_ns)
        centre = at_distance(true, ORDINARY.chassis.cg_to_rear_axle)
        if t >= 4.0:
            errors.append(abs(progress.errors(centre)[0]))
        car.advance(supervisor.steering + math.radians(case.offset_deg), case.speed, wind)
    return np.array(errors), supervisor


def noisy(state: VehicleState, case: Case, rng: np.random.Generator) -> VehicleState:
    """Return a measured state."""
    n = case.noise * rng.standard_normal(6)
    return state._replace(
        x=state.x + X1.position * n[0],
        y=state.y + X1.position * n[1],
        yaw=state.yaw + X1.heading * n[2],
        v_x=state.v_x + X1.speed * n[3],
        v_y=state.v_y + X1.lateral_velocity * n[4],
        yaw_rate=state.yaw_rate + X1.yaw_rate * n[5],
    )


OFF = {"position_noise": 0.0, "heading_noise": 0.0}


@pytest.mark.parametrize(
    ("settings", "odometry"), [("100hz", 4), ("100hz", 10), ("50hz", 8), ("table3", 40)]
)
def test_a_misaligned_wheel_is_learnt_from_odometry_slower_than_the_controller(
    settings: str, odometry: int
) -> None:
    case = Case(settings, 20.0, odometry, offset_deg=2.0, duration=10.0)
    errors, _ = drive(case)
    assert errors.max() < 0.25


@pytest.mark.parametrize("noises", [{}, OFF])
def test_noise_with_odometry_out_of_phase_keeps_the_car_on_its_path(noises: Any) -> None:
    case = Case(late=(0.0075, 0.0125), odometry=2, noise=1.0, speed=20.0)
    assert drive(case, **noises)[0].max() < 0.35


@pytest.mark.parametrize("noise", [2.0, 3.0])
def test_more_noise_than_configured_loses_no_car(noise: float) -> None:
    assert drive(Case(noise=noise, odometry=2, speed=10.0))[0].max() < 0.6


@pytest.mark.parametrize("offset_deg", [0.5, -0.5, 1.0])
def test_a_gap_is_driven_with_the_disturbance_that_is_known(offset_deg: float) -> None:
    case = Case("table3", 20.0, 20, offset_deg=offset_deg, gap=(6.0, 8.0), duration=9.0)
    assert drive(case)[0].max() < drive(case, state_prediction=0.0)[0].max()


@pytest.mark.parametrize("late", [0.05, 0.1, 0.15])
def test_late_odometry_does_not_feed_the_disturbance_back(late: float) -> None:
    case = Case("50hz", 15.0, 4, (late, late), offset_deg=1.0)
    assert drive(case)[0].max() < 0.15


@pytest.mark.parametrize("offset_deg", [2.0, -2.0])
def test_a_misaligned_wheel_is_not_taken_for_a_lag(offset_deg: float) -> None:
    errors, supervisor = drive(Case("table3", 15.0, 20, offset_deg=offset_deg, lag=-1.0))
    assert errors.max() < 0.2
    assert sum(supervisor.assumed_car.response) < 0.12


@pytest.mark.parametrize("delay", [0.0, 0.1, 0.2])
@pytest.mark.parametrize("settings", ["table3", "50hz"])
def test_an_unknown_delay_is_estimated(settings: str, delay: float) -> None:
    errors, supervisor = drive(Case(settings, 12.0, 4, delay=delay, lag=-1.0))
    assert sum(supervisor.assumed_car.response) == pytest.approx(delay, abs=0.04)
    assert errors.max() < 0.1


def test_an_estimate_needs_a_moving_wheel() -> None:
    case = Case("table3", 2.0, 20, delay=0.1, lag=-1.0, duration=6.0)
    _, supervisor = drive(case)
    assert supervisor.adaptation
    assert not supervisor.adaptation.is_latency_known
