"""A fleet: many cars with their controllers on many roads, in lock-step, in one compiled call.

Cars, controllers, driver and measurement are the same functions that the nodes call. A fleet is a
few matrices, so parts of it can be given to threads (the call does not hold Python's lock).
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampc_msgs_config.compiled import in_place, inlined
from ampc_msgs_config.frames import as_received
from ampc_msgs_config.paths.path import Path
from ampc_msgs_config.paths.path_frame import PathFrame
from ampc_msgs_config.scenarios.scenario import SpeedProfile, target_speed
from ampc_msgs_config.types import NANOSECONDS, Array, VehicleState
from ampc_ros.mpc.gain_table import Table
from ampc_ros.mpc.small_matrices import Scratch
from ampc_ros.paper.tick import Answer, paper_tick
from ampc_ros.preview.tick import SENT, preview_tick
from sim_vehicle.measurement import Deviations, measured, noisy
from sim_vehicle.parameters import numbers_of
from sim_vehicle.vehicle import drive

Integers = NDArray[np.int64]

CROSS_TRACK_ERROR, STEERING, CONVERGED, STATE, LOGGED = 0, 1, 2, 3, 9
"""What is logged of each tick: cross-track error, command, whether the QP was solved, and x, y,
yaw, v_x, v_y and yaw rate as measured at `base_link`."""


class Roads(NamedTuple):
    """The drives, one after the other in long rows: road k has the entries from first[k] on."""

    samples: Array
    """(4, n) x, y, heading and curvature of the paths."""
    framed: Array
    """(2, n) the same paths in their own inertial frames; zeros where there is none."""
    first_sample: Integers
    """(roads + 1,)."""
    shape: Array
    """(roads, 5) spacing, whether closed, and x, y, heading of the inertial frame."""
    speeds: Array
    """(2, p) place and speed of the profiles."""
    first_speed: Integers
    """(roads + 1,)."""
    profile: Array
    """(roads, 2) whether over distance, and period."""
    wind: Array
    """(w, 2) velocity of the air in each step of the integration."""
    first_wind: Integers
    """(roads + 1,)."""


class Fleet(NamedTuple):
    """The cars; one row each."""

    road: Integers
    """(n,) index of its drive."""
    ticks: Integers
    """(n,) how many it drives."""
    plant: Array
    """(n, 43) `flat_numbers` of the real car."""
    state: Array
    """(n, SIZE) of the real car."""
    waiting: Array
    """(n, most steps of delay) angles on their way through its steering."""
    delay: Integers
    """(n,) steps of the integration."""
    conditions: Array
    """(n, 3) friction, angle at which the wheels stand when straight ahead is commanded [rad],
    and cross-track error beyond which the drive ends [m]."""
    noise: Array
    """(n, 5) standard deviations of the measurement."""
    normal: Array
    """(n, most ticks, 6) standard normal numbers, or (n, 0, 6)."""
    numbers: Array
    """(n, 20) what its controller believes."""
    memory: Array
    """(n, m) what its controller remembers."""
    nodes: Array
    """(n, k, 6) gains of its controller."""
    speeds: Array
    """(a,) axis of the gains [m/s]."""
    references: Array
    """(b,) axis of the gains [m]."""


class FleetTiming(NamedTuple):
    """Time, and memory for one thread."""

    period_ns: int
    """Of the controllers [ns]."""
    step_ns: int
    """Of the integration [ns]."""
    scratch: Scratch
    work: Array
    """Of the real car."""
    places: Integers
    """(n,) index of each car's driver on the path."""
    predicted: Array
    """(0, 3): nobody looks at predictions."""


@inlined
def path_of(roads: Roads, k: int) -> Path:
    """Give the path of road k."""
    a, b = roads.first_sample[k], roads.first_sample[k + 1]
    x, y, heading = roads.samples[0, a:b], roads.samples[1, a:b], roads.samples[2, a:b]
    curvature, closed = roads.samples[3, a:b], roads.shape[k, 1] > 0.0
    return Path(roads.shape[k, 0], x, y, heading, curvature, closed)


@inlined
def frame_of(roads: Roads, k: int) -> PathFrame:
    """Give the path of road k in its inertial frame."""
    a, b = roads.first_sample[k], roads.first_sample[k + 1]
    x, y, heading = roads.shape[k, 2], roads.shape[k, 3], roads.shape[k, 4]
    return PathFrame(x, y, heading, roads.framed[0, a:b], roads.framed[1, a:b])


@inlined
def profile_of(roads: Roads, k: int) -> SpeedProfile:
    """Give the speed profile of road k."""
    a, b = roads.first_speed[k], roads.first_speed[k + 1]
    over_distance, period = roads.profile[k, 0] > 0.0, roads.profile[k, 1]
    return SpeedProfile(over_distance, roads.speeds[0, a:b], roads.speeds[1, a:b], period)


@in_place
def measure(fleet: Fleet, c: int, tick: int, stamp_ns: int) -> VehicleState:
    """Give what the controller of car c receives."""
    l_r = fleet.plant[c, 3]
    state = measured(fleet.state[c], -l_r, stamp_ns)
    if fleet.normal.shape[1] > 0:
        noise = fleet.noise[c]
        deviations = Deviations(noise[0], noise[1], noise[2], noise[3], noise[4])
        state = noisy(state, deviations, fleet.normal[c, tick])
    return as_received(state)


@in_place
def note(log: Array, state: VehicleState, answer: Answer) -> None:
    """Fill one row of the log (LOGGED,)."""
    log[CROSS_TRACK_ERROR] = answer.diagnosis.cross_track_error
    log[STEERING], log[CONVERGED] = answer.steering, answer.diagnosis.converged
    _, log[3], log[4], log[5], log[6], log[7], log[8] = state


@in_place
def move(roads: Roads, fleet: Fleet, c: int, tick: int, log: Array, clock: FleetTiming) -> None:
    """Let car c drive on for a period, under its driver and the command in its log."""
    k, steps = fleet.road[c], clock.period_ns // clock.step_ns
    friction, misalignment = fleet.conditions[c, 0], fleet.conditions[c, 1]
    path, profile, elapsed = path_of(roads, k), profile_of(roads, k), tick * clock.period_ns
    speed, clock.places[c] = target_speed(
        profile, path, clock.places[c], elapsed / NANOSECONDS, log[3], log[4], log[5]
    )
    drive(
        fleet.state[c],
        fleet.waiting[c, : fleet.delay[c]],
        log[STEERING] + misalignment,
        speed,
        roads.wind,
        roads.first_wind[k] + tick * steps,
        steps,
        friction,
        clock.step_ns / NANOSECONDS,
        numbers_of(fleet.plant[c]),
        clock.work,
    )


@inlined
def drives(fleet: Fleet, c: int, tick: int, log: Array) -> bool:
    """Whether car c is still on its way: neither at the end of its drive nor lost."""
    if tick == 0:
        return bool(fleet.ticks[c] > 0)
    lost = not abs(log[c, tick - 1, CROSS_TRACK_ERROR]) <= fleet.conditions[c, 2]
    return tick < fleet.ticks[c] and not lost


@in_place
def drive_preview(roads: Roads, fleet: Fleet, log: Array, clock: FleetTiming) -> None:
    """Drive a fleet of `preview` controllers to its end.

    Args:
        roads: The drives.
        fleet: Changed in place: where cars and controllers end.
        log: Receives what happened, (n, most ticks, LOGGED), nan before: a car that is lost or
            done has no more rows.
        clock: Time and memory.
    """
    for tick in range(log.shape[1]):
        elapsed = clock.period_ns / NANOSECONDS if tick > 0 else math.nan
        for c in range(len(log)):
            if not drives(fleet, c, tick, log):
                continue
            state = measure(fleet, c, tick, tick * clock.period_ns)
            remembered = SENT + 1 + int(fleet.numbers[c, 15])
            answer = preview_tick(
                fleet.numbers[c],
                Table(fleet.speeds, fleet.references, fleet.nodes[c]),
                path_of(roads, fleet.road[c]),
                state,
                elapsed,
                fleet.memory[c, :remembered],
                clock.scratch,
                clock.predicted,
            )
            note(log[c, tick], state, answer)
            move(roads, fleet, c, tick, log[c, tick], clock)


@in_place
def drive_paper(roads: Roads, fleet: Fleet, log: Array, clock: FleetTiming) -> None:
    """Drive a fleet of `paper` or `classic` controllers to its end; see `drive_preview`."""
    for tick in range(log.shape[1]):
        for c in range(len(log)):
            if not drives(fleet, c, tick, log):
                continue
            k, state = fleet.road[c], measure(fleet, c, tick, tick * clock.period_ns)
            answer = paper_tick(
                fleet.numbers[c],
                Table(fleet.speeds, fleet.references, fleet.nodes[c]),
                path_of(roads, k),
                frame_of(roads, k),
                state,
                fleet.memory[c],
                clock.scratch,
                clock.predicted[:, 0],
            )
            note(log[c, tick], state, answer)
            move(roads, fleet, c, tick, log[c, tick], clock)
