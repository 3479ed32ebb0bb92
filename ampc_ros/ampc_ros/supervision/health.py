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
from ampc_ros.supervision.supervisor import Supervisor


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
    silence = max(supervisor.state.ages(now_ns))
    if silence > supervisor.config.settings.state_lost:
        return Health(STALE, f"odom is {silence:.1f} s old: a stop is requested")
    conditions = [_path_health(supervisor, now_ns)]
    if record:
        conditions += [_fallback_health(record), _guard_health(record), _mode_health(record)]
        conditions += [_table_health(supervisor, record)]
    if supervisor.stop_requested:
        text = "a stop is requested; the service ~/reset_stop takes it back"
        conditions.append(Health(WARN, text))
    return max(conditions, key=lambda each: each.level)


class Condition(NamedTuple):
    """Values that are reported as soon as they change."""

    rung: float = OPTIMAL
    reason: float = 0.0
    clipped: float = 0.0
    mode: float = TRACKING
    outside_table: float = 0.0
    path_is_old: bool = False
    stop_requested: bool = False


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


def _path_health(supervisor: Supervisor, now_ns: int) -> Health:
    assert supervisor.path is not None
    age, settings = max(supervisor.path.ages(now_ns)), supervisor.config.settings
    if supervisor.config.static_path or age <= settings.path_late:
        return Health()
    if age <= settings.path_lost:
        return Health(WARN, f"reference_path is {age:.1f} s old")
    return Health(
        ERROR,
        f"reference_path is {age:.1f} s old: a stop is requested; a path that is published once "
        "needs the parameter static_path = true",
    )


def _fallback_health(record: TickRecord) -> Health:
    rung, reason = int(record.command.rung), REASONS[int(record.command.reason)]
    if rung == OPTIMAL:
        return Health()
    level = ERROR if rung >= FEED_FORWARD else WARN
    stop = ": a stop is requested" if rung == STOP else ""
    return Health(level, f"fallback: steering by {RUNGS[rung]}, reason: {reason}{stop}")


def _guard_health(record: TickRecord) -> Health:
    limit = int(record.command.clipped)
    return Health(WARN, f"the guard clips the command: {LIMITS[limit]}") if limit else Health()


def _mode_health(record: TickRecord) -> Health:
    mode = int(record.command.plan.diagnosis.mode)
    return Health(WARN, MODES[mode]) if mode > STANDSTILL else Health()


def _table_health(supervisor: Supervisor, record: TickRecord) -> Health:
    """Return by how much the speed lies outside the gain table."""
    axis = supervisor.config.gains.get("speed", [])
    if not record.command.plan.diagnosis.outside_table or len(axis) < 2:
        return Health()
    assert supervisor.state is not None
    v_x = supervisor.state.value.v_x
    off = axis[0] - v_x if v_x < axis[0] else v_x - axis[-1]
    if off <= 0:
        return Health(WARN, "lateral reference outside the gain table: nearest edge in use")
    return Health(
        WARN,
        f"{v_x:.1f} m/s is {off:.1f} m/s outside the gain table, valid from {axis[0]:g} to "
        f"{axis[-1]:g} m/s: nearest edge in use",
    )


def health_numbers(supervisor: Supervisor, record: TickRecord | None) -> dict[str, float]:
    """Return the quantities of the newest tick, and all counts since the start."""
    quantities = record.quantities if record else ()
    values = dict(zip(RECORD_QUANTITIES, quantities, strict=False))
    clips = {f"clipped_{limit}": n for limit, n in supervisor.clips.items() if n}
    rejected = {f"rejected_{cause}": n for cause, n in supervisor.rejected.items() if n}
    return {**values, **clips, **rejected}
