"""How a supervised controller is, in one sentence and in numbers; without ROS."""

from typing import Any, NamedTuple

from ampc_msgs_config.types import (
    ERROR,
    FEED_FORWARD,
    LIMITS,
    MODES,
    OK,
    OPTIMAL,
    REASONS,
    RUNGS,
    SHIFTED_PLAN,
    STALE,
    STANDSTILL,
    STOP,
    TRACKING,
    WARN,
)
from ampc_ros.supervision.supervisor import Decision, Supervisor


class Health(NamedTuple):
    """A level and why."""

    level: int = OK
    sentence: str = ""


def health(supervisor: Supervisor, decision: Decision | None, now_ns: int) -> Health:
    """Give the worst that is to be said now.

    Args:
        supervisor: With its inputs.
        decision: The newest one, if there is one.
        now_ns: Time of the node's clock [ns].
    """
    if supervisor.state is None:
        return Health(STALE, "waiting for odom")
    if supervisor.path is None:
        return Health(WARN, "waiting for reference_path")
    silence = max(supervisor.state.ages(now_ns))
    if silence > supervisor.config.settings.state_lost:
        return Health(STALE, f"odom is {silence:.1f} s old: a stop is requested")
    said = [
        _of_path(supervisor, now_ns),
        *([_of_ladder(decision), _of_guard(decision), _of_place(decision)] if decision else []),
        _of_table(supervisor, decision),
    ]
    if supervisor.stop_requested:
        said.append(Health(WARN, "a stop has been requested; the service ~/reset_stop ends that"))
    return max(said, key=lambda each: each.level)


class Condition(NamedTuple):
    """What is reported as soon as it changes."""

    rung: float = OPTIMAL
    reason: float = 0.0
    clipped: float = 0.0
    mode: float = TRACKING
    outside_table: float = 0.0
    path_is_old: bool = False
    stop_requested: bool = False


def condition(supervisor: Supervisor, decision: Decision) -> Condition:
    """Give the condition after a tick."""
    told, diagnosis = decision.supervision, decision.command.diagnosis
    config, age = supervisor.config, max(told.path_age, told.path_silence)
    return Condition(
        told.rung,
        told.reason,
        told.clipped,
        diagnosis.mode,
        diagnosis.outside_table,
        not config.static_path and age > config.settings.path_late,
        supervisor.stop_requested,
    )


def change(before: Condition, now: Condition) -> str:
    """Say what is worth a line of the log; empty: nothing."""
    if now.stop_requested and not before.stop_requested:
        return f"a stop is requested, because of {REASONS[int(now.reason)]}"
    if before[:2] == now[:2] or max(before.rung, now.rung) < SHIFTED_PLAN:
        return ""
    if now.rung < SHIFTED_PLAN:
        return "steering by the controller's solution again"
    return f"steering by {RUNGS[int(now.rung)]}, because of {REASONS[int(now.reason)]}"


def _of_path(supervisor: Supervisor, now_ns: int) -> Health:
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


def _of_ladder(decision: Decision) -> Health:
    rung, reason = int(decision.supervision.rung), REASONS[int(decision.supervision.reason)]
    if rung == OPTIMAL:
        return Health()
    level = ERROR if rung >= FEED_FORWARD else WARN
    stop = ": a stop is requested" if rung == STOP else ""
    return Health(level, f"steering by {RUNGS[rung]}, because of {reason}{stop}")


def _of_guard(decision: Decision) -> Health:
    limit = int(decision.supervision.clipped)
    return Health(WARN, f"the guard clips the command: {LIMITS[limit]}") if limit else Health()


def _of_place(decision: Decision) -> Health:
    mode = int(decision.command.diagnosis.mode)
    return Health(WARN, MODES[mode]) if mode > STANDSTILL else Health()


def _of_table(supervisor: Supervisor, decision: Decision | None) -> Health:
    """Say how far the speed lies outside what the gains were tuned for."""
    axis = supervisor.config.gains.get("speed", [])
    if not decision or not decision.command.diagnosis.outside_table or len(axis) < 2:
        return Health()
    assert supervisor.state is not None
    v_x = supervisor.state.value.v_x
    off = axis[0] - v_x if v_x < axis[0] else v_x - axis[-1]
    if off <= 0:
        return Health(WARN, "lateral reference outside the gain table: nearest edge in use")
    return Health(
        WARN,
        f"{v_x:.1f} m/s is {off:.1f} m/s outside the gain table, which holds from {axis[0]:g} to "
        f"{axis[-1]:g} m/s: nearest edge in use",
    )


def numbers(supervisor: Supervisor, decision: Decision | None) -> dict[str, float]:
    """Give what is worth a number: the newest tick, and all counts since the start."""
    values: dict[str, Any] = decision.supervision._asdict() if decision else {}
    clips = {f"clipped_{limit}": count for limit, count in supervisor.guard.count.items()}
    refused = {f"rejected_{cause}": n for cause, n in supervisor.filter.rejected.items() if n}
    return {**values, **{key: n for key, n in clips.items() if n}, **refused}
