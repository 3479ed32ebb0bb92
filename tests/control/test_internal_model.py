"""The row of numbers of an internal model: every field arrives where it is read."""

from dataclasses import astuple, make_dataclass, replace

import numpy as np
import pytest

from ampc_msgs_config.config import find, load
from ampc_msgs_config.parameters import ChassisParameters, ControllerSettings, SteeringParameters
from ampc_msgs_config.types import Array
from ampc_msgs_config.vehicle_file import load_section
from ampc_ros.mpc.internal_model import (
    ROW_SIZE,
    Actuator,
    InternalModel,
    actuator_of,
    limits_of,
    pack_internal_model,
    unpack_internal_model,
)

CHASSIS = load_section(ChassisParameters, find("vehicles", "paper"), "chassis")
SETTINGS = load(ControllerSettings, find("controllers", "table3"))
STEERING = SteeringParameters(max_angle=0.4, max_rate=0.5, lag=0.07, delay=0.23)


@pytest.mark.parametrize("solver", ["active_set", "hildreth"])
@pytest.mark.parametrize("steering", [None, STEERING])
def test_internal_model_is_unpacked_as_it_was_packed(
    solver: str, steering: SteeringParameters | None
) -> None:
    settings = replace(SETTINGS, solver=solver, nominal_speed=8.0, max_output_error=0.6)
    actuator = actuator_of(steering, settings.sample_time) if steering else Actuator(0, 0.0, 0.0)
    expected = InternalModel(astuple(CHASSIS), limits_of(settings, steering), actuator, 0.9, 8.0)
    assert unpack_internal_model(pack_internal_model(CHASSIS, settings, steering, 0.9)) == expected


def test_every_number_of_the_row_is_read_once_and_in_order() -> None:
    row: Array = np.arange(1.0, ROW_SIZE + 1, dtype=np.float64)
    vehicle, limits, actuator, *rest = unpack_internal_model(row)
    numbers = [*vehicle, *limits, *actuator, *rest]
    numbers[len(vehicle) + limits._fields.index("exact")] = 12.0  # a boolean
    assert numbers == list(range(1, ROW_SIZE + 1))


def test_a_field_inserted_in_the_chassis_only_is_rejected() -> None:
    longer = make_dataclass("Longer", [*vars(CHASSIS), "wheel_inertia"])(*astuple(CHASSIS), 1.0)
    with pytest.raises(ValueError, match=f"{ROW_SIZE + 1} numbers.* {ROW_SIZE}"):
        pack_internal_model(longer, SETTINGS)
