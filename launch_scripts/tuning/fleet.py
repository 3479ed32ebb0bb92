"""Fleet: many cars with their controllers on many roads, in lock-step, in one compiled call.

Cars, controllers, driver and measurement are the functions that the nodes call. A fleet consists of
matrices with one row per car, so its parts can run in threads: the call releases Python's global
lock.
"""

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from ampc_msgs_config.compiled import in_place, inlined
from ampc_msgs_config.frames import as_received
from ampc_msgs_config.paths.path import NOT_CAUGHT, Path
from ampc_msgs_config.paths.path_frame import PathFrame
from ampc_msgs_config.scenarios.scenario import SpeedProfile, preview_speed
from ampc_msgs_config.types import NANOSECONDS, Array, VehicleState
from ampc_ros.mpc.gain_table import Table
from ampc_ros.mpc.internal_model import unpack_internal_model
from ampc_ros.mpc.small_matrices import Scratch
from ampc_ros.mpc.tick_result import TickResult
from ampc_ros.paper.tick import paper_tick
from ampc_ros.preview.tick import SENT, preview_tick
from sim_vehicle.measurement import Deviations, measured, noisy
from sim_vehicle.vehicle import drive_steps
from sim_vehicle.vehicle_row import unpack_vehicle

Integers = NDArray[np.int64]

CROSS_TRACK_ERROR, LOG_STEERING, CONVERGED, LOG_STATE, LOGGED = 0, 1, 2, 3, 9
"""Positions in a row (LOGGED,) of the log: cross-track error, command, whether the QP was solved,
and x, y, yaw, v_x, v_y and yaw rate as measured at `base_link`."""


class Roads(NamedTuple):
    """Roads of the drives, concatenated: road k has the entries from first[k] to first[k + 1]."""

    samples: Array
    """(4, n) x, y, heading and curvature of the paths."""
    framed: Array
    """(2, n) the same paths in their inertial frames; zeros if these are not needed."""
    first_sample: Integers
    """(roads + 1,)."""
    shape: Array
    """(roads, 5) spacing, whether closed, and x, y, heading of the inertial frame."""
    speeds: Array
    """(2, p) time or distance, and speed, of the profiles."""
    first_speed: Integers
    """(roads + 1,)."""
    profile: Array
    """(roads, 2) whether over distance, and period of the profiles."""
    wind: Array
    """(w, 3, 2) velocity of the air at begin, middle and end of each integration step [m/s]."""
    first_wind: Integers
    """(roads + 1,)."""


class Fleet(NamedTuple):
    """Cars and controllers; every array has one row per car."""

    road: Integers
    """(n,) index of the road."""
    ticks: Integers
    """(n,) number of ticks of the drive."""
    plant: Array
    """(n, 43) `pack_vehicle` of the simulated car."""
    state: Array
    """(n, SIZE) state of the simulated car."""
    waiting: Array
    """(n, largest delay in steps) commands in the delay of the steering [rad]."""
    delay: Integers
    """(n,) delay in integration steps."""
    friction: Array
    """(n,) coefficient mu."""
    misalignment: Array
    """(n,) road-wheel angle when straight ahead is commanded [rad]."""
    effect: Array
    """(n,) road-wheel angle that the steering demands for a commanded angle of 1 rad."""
    lost: Array
    """(n,) cross-track error beyond which the drive ends [m]."""
    noise: Array
    """(n, 5) standard deviations of the measurement noise."""
    normal: Array
    """(n, most ticks, 6) standard normal numbers; (n, 0, 6): no noise."""
    model: Array
    """(n, 20) `pack_internal_model` of the controller."""
    memory: Array
    """(n, m) memory of the controller."""
    nodes: Array
    """(n, k, 6) gains of the controller."""


class FleetContext(NamedTuple):
    """Values that all cars share, and the memory of one thread."""

    period_ns: int
    """Period of the controllers [ns]."""
    step_ns: int
    """Integration step [ns]."""
    speeds: Array
    """(a,) speeds of the gain tables [m/s]."""
    references: Array
    """(b,) lateral references of the gain tables [m]."""
    scratch: Scratch
    """Scratch of the controllers."""
    work: Array
    """Scratch of the simulated car."""
    places: Integers
    """(n,) index of each driver on its path."""
    predicted: Array
    """(0, 3): no predictions are stored."""


@inlined
def path_of(roads: Roads, k: int) -> Path:
    """Return the path of road k."""
    a, b = roads.first_sample[k], roads.first_sample[k + 1]
    x, y, heading = roads.samples[0, a:b], roads.samples[1, a:b], roads.samples[2, a:b]
    curvature, closed = roads.samples[3, a:b], roads.shape[k, 1] > 0.0
    return Path(roads.shape[k, 0], x, y, heading, curvature, closed, 0.0, NOT_CAUGHT)


@inlined
def frame_of(roads: Roads, k: int) -> PathFrame:
    """Return the path of road k in its inertial frame."""
    a, b = roads.first_sample[k], roads.first_sample[k + 1]
    x, y, heading = roads.shape[k, 2], roads.shape[k, 3], roads.shape[k, 4]
    return PathFrame(x, y, heading, roads.framed[0, a:b], roads.framed[1, a:b])


@inlined
def profile_of(roads: Roads, k: int) -> SpeedProfile:
    """Return the speed profile of road k."""
    a, b = roads.first_speed[k], roads.first_speed[k + 1]
    over_distance, period = roads.profile[k, 0] > 0.0, roads.profile[k, 1]
    return SpeedProfile(over_distance, roads.speeds[0, a:b], roads.speeds[1, a:b], period)


@in_place
def measured_state(fleet: Fleet, c: int, tick: int, stamp_ns: int) -> VehicleState:
    """Return the state that the controller of car c receives."""
    _, _, _, l_r, _, _ = unpack_vehicle(fleet.plant[c]).chassis
    state = measured(fleet.state[c], -l_r, stamp_ns)
    if fleet.normal.shape[1] > 0:
        noise = fleet.noise[c]
        deviations = Deviations(noise[0], noise[1], noise[2], noise[3], noise[4])
        state = noisy(state, deviations, fleet.normal[c, tick])
    return as_received(state)


@in_place
def write_log(log: Array, state: VehicleState, result: TickResult) -> None:
    """Fill one row of the log (LOGGED,)."""
    log[CROSS_TRACK_ERROR] = result.diagnosis.cross_track_error
    log[LOG_STEERING], log[CONVERGED] = result.steering, result.diagnosis.converged
    log[LOG_STATE], log[LOG_STATE + 1], log[LOG_STATE + 2] = state.x, state.y, state.yaw
    log[LOG_STATE + 3], log[LOG_STATE + 4], log[LOG_STATE + 5] = (
        state.v_x,
        state.v_y,
        state.yaw_rate,
    )


@in_place
def drive_period(
    roads: Roads, fleet: Fleet, c: int, tick: int, log: Array, context: FleetContext
) -> None:
    """Drive car c for one period with its driver and the command in its row of the log."""
    k, steps = fleet.road[c], context.period_ns // context.step_ns
    path, profile, elapsed = path_of(roads, k), profile_of(roads, k), tick * context.period_ns
    x, y, yaw = log[LOG_STATE], log[LOG_STATE + 1], log[LOG_STATE + 2]
    speed, context.places[c] = preview_speed(
        profile, path, context.places[c], elapsed / NANOSECONDS, x, y, yaw
    )
    drive_steps(
        fleet.state[c],
        fleet.waiting[c, : fleet.delay[c]],
        fleet.effect[c] * log[LOG_STEERING] + fleet.misalignment[c],
        speed,
        roads.wind,
        roads.first_wind[k] + tick * steps,
        steps,
        fleet.friction[c],
        context.step_ns / NANOSECONDS,
        unpack_vehicle(fleet.plant[c]),
        context.work,
    )


@inlined
def is_driving(fleet: Fleet, c: int, tick: int, log: Array) -> bool:
    """Return whether the drive of car c has neither ended nor failed."""
    if tick == 0:
        return bool(fleet.ticks[c] > 0)
    lost = not abs(log[c, tick - 1, CROSS_TRACK_ERROR]) <= fleet.lost[c]
    return tick < fleet.ticks[c] and not lost


@in_place
def drive_preview(roads: Roads, fleet: Fleet, log: Array, context: FleetContext) -> None:
    """Drive a fleet of `preview` controllers to its end.

    Args:
        roads: Roads of the drives.
        fleet: Cars and controllers; changed in place to their final states.
        log: Log (n, most ticks, LOGGED), nan before the call; a car that is lost or has finished
            has no more rows.
        context: Shared values and memory.
    """
    for tick in range(log.shape[1]):
        elapsed = context.period_ns / NANOSECONDS if tick > 0 else math.nan
        for c in range(len(log)):
            if not is_driving(fleet, c, tick, log):
                continue
            state = measured_state(fleet, c, tick, tick * context.period_ns)
            memory_size = SENT + 1 + unpack_internal_model(fleet.model[c]).actuator.ticks
            result = preview_tick(
                fleet.model[c],
                Table(context.speeds, context.references, fleet.nodes[c]),
                path_of(roads, fleet.road[c]),
                state,
                elapsed,
                fleet.memory[c, :memory_size],
                context.scratch,
                context.predicted,
            )
            write_log(log[c, tick], state, result)
            drive_period(roads, fleet, c, tick, log[c, tick], context)


@in_place
def drive_paper(roads: Roads, fleet: Fleet, log: Array, context: FleetContext) -> None:
    """Drive a fleet of `paper` or `classic` controllers to its end; see `drive_preview`."""
    for tick in range(log.shape[1]):
        for c in range(len(log)):
            if not is_driving(fleet, c, tick, log):
                continue
            k, state = fleet.road[c], measured_state(fleet, c, tick, tick * context.period_ns)
            result = paper_tick(
                fleet.model[c],
                Table(context.speeds, context.references, fleet.nodes[c]),
                path_of(roads, k),
                frame_of(roads, k),
                state,
                fleet.memory[c],
                context.scratch,
                context.predicted[:, 0],
            )
            write_log(log[c, tick], state, result)
            drive_period(roads, fleet, c, tick, log[c, tick], context)
