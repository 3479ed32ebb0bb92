"""Replay of recorded inputs with the same or a changed configuration."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import fields, replace
from typing import NamedTuple

from ampc_msgs_config.config import find, parse
from ampc_msgs_config.types import RECORD_QUANTITIES, TickRecord
from ampc_msgs_config.validation import convert, hints
from ampc_ros.configuration import (
    CLASSIC_SPEED,
    DEFAULT_TABLES,
    PARTS,
    Configuration,
    check_controller,
)
from ampc_ros.mpc.gain_table import read_gain_table
from ampc_ros.supervision.memory import restore
from ampc_ros.supervision.received import Received
from ampc_ros.supervision.supervisor import Supervisor
from launch_scripts.replaying.recorded_run import RecordedTick

ConfigChange = Callable[[Configuration], Configuration]


class Difference(NamedTuple):
    """A quantity of a tick that differs from the recording."""

    quantity: str
    recorded: float
    replayed: float


def replay_ticks(
    ticks: Iterable[RecordedTick],
    config: Mapping[int, Configuration],
    *,
    synchronised: bool = False,
) -> Iterator[TickRecord]:
    """Compute the record of each tick of a run.

    Args:
        ticks: Recorded inputs.
        config: Configurations by the number that a tick refers to.
        synchronised: Each tick begins from the recorded angle in force: the answers of another
            controller to the recorded situations, not their consequences. Memories are not used.
    """
    supervisor, before = None, 0.0
    for tick in ticks:
        number = int(tick.values.get("configuration", min(config)))
        after, before = before, tick.values.get("commands", math.inf)
        if supervisor is None or before < after:  # another process: its commands count from 1
            resets = int(tick.values.get("resets", 0))
            supervisor = Supervisor(config[number], number=number, resets=resets)
        if tick.memory and not synchronised:
            supervisor = restore(tick.memory, config)
        if number != supervisor.number:
            supervisor.reconfigure(config[number])
        # inputs, as they were accepted
        values = tick.values
        state = Received(tick.state, tick.state.stamp_ns, tick.ago_ns("state_silence"))
        yaw_rate = values.get("corrected_yaw_rate", math.nan)
        if not math.isnan(started_from := values.get("started_from", math.nan)):
            supervisor.start_from(started_from)
        supervisor.replay_state(state, int(values.get("resets", 0)), yaw_rate)
        supervisor.take_path(tick.path.points, tick.path.stamp_ns, tick.ago_ns("path_silence"))
        if not math.isnan(values.get("measured_steering", math.nan)):
            supervisor.take_steering(values["measured_steering"])
        supervisor.inject_qp_fault(values.get("qp_fault", 0.0) > 0)
        if not values.get("stop_requested", 1.0) > 0:  # taken back by the service ~/reset_stop
            supervisor.clear_stop()
        # records without this quantity limited every command by one period
        interval = values.get("command_interval", supervisor.period)
        record = supervisor.tick(tick.now_ns, interval)
        assert record is not None  # state and path are set
        if synchronised:
            supervisor.correct(tick.values["steering"])
        yield record


def differences(tick: RecordedTick, record: TickRecord, tolerance: float) -> list[Difference]:
    """Compare a replayed tick with the recorded one.

    Args:
        tick: Recorded tick.
        record: Replayed tick.
        tolerance: 0: every recorded quantity must be equal bit for bit; else only the angle is
            compared, up to this difference [rad].
    """
    replayed = {
        **record.command.plan.diagnosis._asdict(),
        **dict(zip(RECORD_QUANTITIES, record.quantities, strict=True)),
    }
    tolerance = max(tolerance, tick.values.get("rounding", 0.0))
    if tolerance > 0 or "rung" not in tick.values:
        replayed = {"steering": replayed["steering"]}
    pairs = ((name, tick.values[name], replayed[name]) for name in replayed if name in tick.values)
    return [Difference(*pair) for pair in pairs if not is_same(pair[1], pair[2], tolerance)]


def is_same(a: float, b: float, tolerance: float) -> bool:
    """Return whether two numbers are equal within a tolerance, or both nan."""
    return a == b or abs(a - b) <= tolerance or (math.isnan(a) and math.isnan(b))


def with_controller(name: str) -> ConfigChange:
    """Return the change to another controller, with the gains for any car.

    Raises:
        ValueError: There is no controller of this name, or no such file.
    """
    name = check_controller(name)

    def change(config: Configuration) -> Configuration:
        table, settings = DEFAULT_TABLES.get(name), config.settings
        gains = read_gain_table(find("gains", table)) if table else {}
        if name == "classic":
            settings = replace(settings, nominal_speed=settings.nominal_speed or CLASSIC_SPEED)
        return config._replace(controller=name, gains=gains, settings=settings)

    return change


def with_gains(name: str) -> ConfigChange:
    """Return the change to another gain table, by shipped name or file."""
    gains = read_gain_table(find("gains", name))
    return lambda config: config._replace(gains=gains)


def with_value(text: str) -> ConfigChange:
    """Return the change of one value.

    Args:
        text: Such as `settings.max_increment=0.1`, `chassis.mass=1800` or `static_path=true`.

    Raises:
        ValueError: The key is unknown, or (from the change) the value is out of range.
    """
    key, equals, value_text = text.partition("=")
    part, _, name = key.rpartition(".")
    if not equals or (part, name) not in KEYS:
        names = ", ".join(".".join(filter(None, pair)) for pair in KEYS)
        raise ValueError(f"--set {text}: must be key=value; keys are {names}")
    value = parse(f"value: {value_text}", f"--set {text}")["value"]

    def change(config: Configuration) -> Configuration:
        try:
            if not part:
                kind = hints(Configuration)[name]
                return config._replace(**{name: convert(kind, value, name)})
            return config._replace(**{part: replace(getattr(config, part), **{name: value})})
        except ValueError as error:
            raise ValueError(f"--set {text}: {error}") from error

    return change


KEYS: list[tuple[str, str]] = [
    *((part, item.name) for part, cls in PARTS.items() for item in fields(cls)),
    ("", "base_link_to_cg"),
    ("", "static_path"),
]
"""Values that `with_value` can set: part of a configuration, and field."""
