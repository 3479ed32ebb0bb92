"""Files of an identification: vehicle YAML and JSON."""

import json
from dataclasses import asdict
from pathlib import Path
from typing import Any

from ampc_msgs_config import __version__
from ampc_msgs_config.config import dump, schema_line, shipped_schema
from ampc_ros.identification.result import Identification, Quantity
from launch_scripts.identifying.bag_recording import StartVehicle
from launch_scripts.reporting.pages import to_json

STEERING_KEYS = ("ratio", "offset", "max_rate")
CHASSIS_KEYS = ("front_cornering_stiffness", "rear_cornering_stiffness", "yaw_inertia")


def vehicle_content(result: Identification, vehicle: StartVehicle) -> dict[str, Any]:
    """Return the content of the identified vehicle file.

    Values that are not identifiable keep the start value and its mark as estimated. Delay and lag
    are also written where only their sum is identified, because the loop depends on the sum.
    """
    found = result.quantities
    chassis = vehicle.sections["chassis"] | {
        key: value
        for key, value in asdict(result.chassis).items()
        if value != getattr(vehicle.chassis, key)
    }
    steering = dict(vehicle.sections["steering"])
    steering |= {key: found[key].value for key in STEERING_KEYS if found[key].is_identified}
    written = {f"chassis.{k}" for k in CHASSIS_KEYS if found[k].is_identified}
    written |= {f"steering.{k}" for k in STEERING_KEYS if found[k].is_identified}
    estimated = {key: spread for key, spread in vehicle.estimated.items() if key not in written}
    for key in ("delay", "lag"):
        if found["total_latency"].is_identified or found[key].is_identified:
            steering[key] = found[key].value
            estimated.pop(f"steering.{key}", None)
            if not found[key].is_identified:
                estimated[f"steering.{key}"] = found[key].half_width
    content = {**vehicle.sections, "chassis": chassis, "steering": steering}
    content = {name: {k: six_digits(v) for k, v in part.items()} for name, part in content.items()}
    return content | ({"estimated": estimated} if estimated else {})


def six_digits(value: Any) -> Any:
    """Return a number with six significant digits, anything else unchanged."""
    return float(f"{value:.6g}") if isinstance(value, float) else value


def write_vehicle(file: Path, result: Identification, vehicle: StartVehicle, origin: str) -> None:
    """Write the identified vehicle as YAML; `origin` is a comment of one line."""
    text = f"{schema_line(shipped_schema('vehicle'), file)}\n# {origin}\n"
    file.write_text(text + dump(vehicle_content(result, vehicle)), encoding="utf-8")


def base_link_to_cg(result: Identification) -> Quantity:
    """Return the distance from the measured point forward to the centre of gravity [m]."""
    point = result.quantities["measured_point"]
    return point._replace(value=result.chassis.cg_to_rear_axle - point.value)


def write_json(file: Path, result: Identification, vehicle: StartVehicle, bag: Path) -> None:
    """Write all results in SI units."""
    content = {
        "version": __version__,
        "bag": str(bag),
        "start": vehicle.name,
        "quantities": {
            name: quantity._asdict()
            | {"interval": quantity.interval, "identified": quantity.is_identified}
            for name, quantity in result.quantities.items()
        },
        "base_link_to_cg": base_link_to_cg(result).value,
        "noise": result.noise._asdict(),
        "age": result.age._asdict() if result.age else None,
        "excitation": result.excitation._asdict(),
    }
    text = json.dumps(to_json(content), indent=2, allow_nan=False)
    file.write_text(text + "\n", encoding="utf-8")
