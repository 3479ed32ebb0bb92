"""Recorded inputs through a supervisor again: the same, or a changed one."""

import math
from collections.abc import Callable, Iterable, Iterator, Mapping
from dataclasses import fields, replace
from typing import NamedTuple

from ampc_msgs_config.config import find, parse
from ampc_msgs_config.validation import convert, hints
from ampc_ros.configuration import (
    CLASSIC_SPEED,
    DEFAULT_TABLES,
    PARTS,
    Configuration,
    check_controller,
)
from ampc_ros.mpc.gain_table import read_gain_table
from ampc_ros.supervision.received import Received
from ampc_ros.supervision.supervisor import Decision, Supervisor
from launch_scripts.replaying.recorded_run import RecordedTick

Change = Callable[[Configuration], Configuration]


class Difference(NamedTuple):
    """A quantity of a tick that is not what was recorded."""

    quantity: str
    recorded: float
    repeated: float


def repeat(
    ticks: Iterable[RecordedTick],
    config: Mapping[int, Configuration],
    *,
    synchronised: bool = False,
) -> Iterator[Decision]:
    """Give what a supervisor decides at each tick of a run.

    Args:
        ticks: Recorded inputs.
        config: What the controller is made of, by the number that a tick names.
        synchronised: Each tick begins from the recorded angle in force: what another controller
            would have done then, not what would have come of it.
    """
    supervisor, before = None, 0.0
    for tick in ticks:
        number = int(tick.values.get("configuration", min(config)))
        after, before = before, tick.values.get("commands", math.inf)
        if supervisor is None or before < after:
            supervisor = Supervisor(config[number], number=number)
            supervisor.resets = int(tick.values.get("resets", 0))
        elif number != supervisor.number:
            supervisor.reconfigure(config[number])
        feed(supervisor, tick)
        decision = supervisor.tick(tick.now_ns)
        assert decision is not None  # a state and a path have been fed
        if synchronised:
            supervisor.correct(tick.values["steering"])
        yield decision


def feed(supervisor: Supervisor, tick: RecordedTick) -> None:
    """Give a supervisor the inputs of a tick, as they have been accepted."""
    values = tick.values
    if values.get("resets", 0) > supervisor.resets:
        supervisor.start_anew_at(tick.state)
        supervisor.resets = int(values["resets"])
    arrival_ns = tick.ago_ns("state_silence")
    supervisor.state = Received(tick.state, tick.state.stamp_ns, arrival_ns)
    supervisor.take_path(tick.path.points, tick.path.stamp_ns, tick.ago_ns("path_silence"))
    if not math.isnan(values.get("measured_steering", math.nan)):
        supervisor.take_steering(values["measured_steering"])
    supervisor.ladder.qp_fault = values.get("qp_fault", 0.0) > 0
    supervisor.stop_requested &= values.get("stop_requested", 1.0) > 0  # somebody took it back


def differences(tick: RecordedTick, decision: Decision, tolerance: float) -> list[Difference]:
    """Compare a decision with the recorded one.

    Args:
        tick: As recorded.
        decision: As repeated.
        tolerance: 0: every quantity that was recorded has to be the same, bit for bit; else only
            the angle counts, up to this difference [rad].
    """
    told = {**decision.command.diagnosis._asdict(), **decision.supervision._asdict()}
    if tolerance > 0 or "rung" not in tick.values:
        told = {"steering": told["steering"]}
    pairs = ((name, tick.values[name], told[name]) for name in told if name in tick.values)
    return [Difference(*pair) for pair in pairs if not is_same(pair[1], pair[2], tolerance)]


def is_same(a: float, b: float, tolerance: float) -> bool:
    """Whether two numbers agree; nan agrees with nan."""
    return a == b or abs(a - b) <= tolerance or (math.isnan(a) and math.isnan(b))


def with_controller(name: str) -> Change:
    """Put another controller in place, with the gains that hold for any car."""
    check_controller(name)

    def change(config: Configuration) -> Configuration:
        table, settings = DEFAULT_TABLES.get(name), config.settings
        gains = read_gain_table(find("gains", table)) if table else {}
        if name == "classic":
            settings = replace(settings, nominal_speed=settings.nominal_speed or CLASSIC_SPEED)
        return config._replace(controller=name, gains=gains, settings=settings)

    return change


def with_gains(name: str) -> Change:
    """Put another gain table in place, by shipped name or file."""
    gains = read_gain_table(find("gains", name))
    return lambda config: config._replace(gains=gains)


def with_value(text: str) -> Change:
    """Put one value in place.

    Args:
        text: Such as `settings.max_increment=0.1`, `chassis.mass=1800` or `static_path=true`.

    Raises:
        ValueError: There is no such key, or (in the change) the value is out of range.
    """
    key, equals, value_text = text.partition("=")
    part, _, name = key.rpartition(".")
    if not equals or (part, name) not in KEYS:
        known = ", ".join(".".join(filter(None, pair)) for pair in KEYS)
        raise ValueError(f"--set {text}: must be key=value; keys are {known}")
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
"""What `with_value` can set: part of a configuration, and field."""
