"""Health of a supervised controller as a sentence and as numbers; without ROS."""

from typing import NamedTuple

from ampc_msgs_config.types import (
    ERROR,
    FEED_FORWARD,
    LIMITS,
    MODES,
    OK,
    OPTIMAL,
    REASONS,
    RECORD_QUANTITIES,
    RUNGS,
    SHIFTED_PLAN,
    STALE,
    STANDSTILL,
    STOP,
    TRACKING,
    WARN,
    TickRecord,
)
from ampc_ros.supervision.fallback import OFF_PATH
from ampc_ros.supervision.supervisor import Supervisor

ROUGH_PATH = 0.03
"""Noise of a path that raises a warning [m]."""


class Health(NamedTuple):
    """A level of diagnostics and its reason."""

    level: int = OK
    sentence: str = ""


def health(supervisor: Supervisor, record: TickRecord | None, now_ns: int) -> Health:
    """Return the most severe condition.

    Args:
        supervisor: Supervisor with its inputs.
        record: Newest tick; None: there was none.
        now_ns: Time of the node's clock [ns].
    """
    if supervisor.state is None:
        return Health(STALE, "waiting for odom")
    if supervisor.path is None:
        return Health(WARN, "waiting for reference_path")
    silence, config = max(supervisor.state.ages(now_ns)), supervisor.config
    if silence > config.settings.state_lost:
        return Health(STALE, f"odom is {silence:.1f} s old: a stop is requested")
    conditions = [Health()]

    # The odometry has a lasting defect.
    problems = supervisor.odometry.problems(config.chassis, config.base_link_to_cg)
    if problems:
        conditions.append(Health(WARN, "; ".join(problems)))

    # The path is too old.
    age = max(supervisor.path.ages(now_ns))
    if not config.static_path and age > config.settings.path_lost:
        text = "a stop is requested; a path that is published once needs static_path = true"
        conditions.append(Health(ERROR, f"reference_path is {age:.1f} s old: {text}"))
    elif not config.static_path and age > config.settings.path_late:
        conditions.append(Health(WARN, f"reference_path is {age:.1f} s old"))

    # The path is empty, ends, or is rough.
    if supervisor.no_path:
        text = "reference_path is empty: a stop is requested until the next valid path"
        conditions.append(Health(ERROR, text))
    end, noise = supervisor.path_end, path_noise(supervisor)
    if end.is_due or end.is_near:
        stop = ": a stop is requested" if supervisor.stop_requested else " at this speed"
        text = f"reference_path ends in {end.remaining:.0f} m, within the braking distance{stop}"
        conditions.append(Health(WARN, text))
    if noise > ROUGH_PATH:
        conditions.append(Health(WARN, f"path noise {100 * noise:.1f} cm"))

    # The command comes from a fallback, or was clipped, or the mode is not normal.
    if record:
        command, diagnosis = record.command, record.command.diagnosis
        if command.reason == OFF_PATH and command.rung != STOP:
            error, bound = abs(diagnosis.cross_track_error), config.settings.max_deviation
            text = f"off_path: {error:.1f} m from the path, max_deviation = {bound:g} m"
            conditions.append(Health(ERROR, f"{text}: a stop is requested"))
        if command.rung != OPTIMAL:
            stop = ": a stop is requested" if command.rung == STOP else ""
            text = f"steering by {RUNGS[command.rung]}, reason: {REASONS[command.reason]}{stop}"
            level = ERROR if command.rung >= FEED_FORWARD else WARN
            conditions.append(Health(level, f"fallback: {text}"))
        if command.clipped:
            text = f"the guard clips the command: {LIMITS[command.clipped]}"
            conditions.append(Health(WARN, text))
        if diagnosis.mode > STANDSTILL:
            conditions.append(Health(WARN, MODES[int(diagnosis.mode)]))

        # The speed, or the lateral reference, lies outside the gain table.
        gains, v_x = config.gains, supervisor.state.value.v_x
        axis = (gains.get("schedule") or gains).get("speed", [])
        if diagnosis.outside_table and len(axis) > 1:
            off = axis[0] - v_x if v_x < axis[0] else v_x - axis[-1]
            text = "lateral reference outside the gain table"
            if off >= 0.05:
                text = f"{v_x:.1f} m/s is {off:.1f} m/s outside the gain table, valid from "
                text += f"{axis[0]:g} to {axis[-1]:g} m/s"
            conditions.append(Health(WARN, f"{text}: nearest edge in use"))

    if supervisor.stop_requested:
        text = "a stop is requested; the service ~/reset_stop takes it back"
        conditions.append(Health(WARN, text))
    return max(conditions, key=lambda each: each.level)


def path_noise(supervisor: Supervisor) -> float:
    """Return the noise of the points of the path in use [m]."""
    path = supervisor.path
    return float(getattr(path.value, "noise", 0.0)) if path else 0.0


class Condition(NamedTuple):
    """Values that are reported as soon as they change."""

    rung: float = OPTIMAL
    reason: float = 0.0
    clipped: float = 0.0
    mode: float = TRACKING
    outside_table: float = 0.0
    path_is_old: bool = False
    stop_requested: bool = False
    path_ends: bool = False
    yaw_rate_is_replaced: bool = False


def condition(supervisor: Supervisor, record: TickRecord) -> Condition:
    """Return the condition after a tick."""
    command, diagnosis = record.command, record.command.plan.diagnosis
    config, age = supervisor.config, max(record.path_age, record.path_silence)
    return Condition(
        command.rung,
        command.reason,
        command.clipped,
        diagnosis.mode,
        diagnosis.outside_table,
        not config.static_path and age > config.settings.path_late,
        supervisor.stop_requested,
        supervisor.path_end.is_near,
        supervisor.odometry.yaw_rate.is_replaced,
    )


def describe_change(before: Condition, now: Condition) -> str:
    """Return the line for the log; empty: the change needs none."""
    reason = REASONS[int(now.reason)]
    if now.stop_requested and not before.stop_requested:
        return f"a stop is requested, reason: {reason}"
    if before[:2] == now[:2] or max(before.rung, now.rung) < SHIFTED_PLAN:
        return ""
    if now.rung < SHIFTED_PLAN:
        return "fallback ended: steering by the solution of the controller"
    return f"fallback: steering by {RUNGS[int(now.rung)]}, reason: {reason}"


def health_numbers(supervisor: Supervisor, record: TickRecord | None) -> dict[str, float]:
    """Return the quantities of the newest tick, and all counts since the start."""
    quantities = record.quantities if record else ()
    values = dict(zip(RECORD_QUANTITIES, quantities, strict=False))
    clips = {f"clipped_{limit}": n for limit, n in supervisor.clips.items() if n}
    rejected = {f"rejected_{cause}": n for cause, n in supervisor.rejected.items() if n}
    replaced = {
        f"replaced_{cause}": n for cause, n in supervisor.odometry.yaw_rate.replaced.items() if n
    }
    noise = path_noise(supervisor)
    rough = {"path_noise": noise} if noise > 0 else {}
    return {**values, **clips, **rejected, **replaced, **rough}
