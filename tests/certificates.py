"""Certificates for tests, written without certifying anything."""

import json
from pathlib import Path
from typing import Any

from ampc_msgs_config.config import find
from ampc_msgs_config.vehicle_file import read_vehicle
from ampc_ros.certificate import CERTIFICATE_VERSION, SUFFIX, content_digest, identity_of
from ampc_ros.configuration import Choices, configuration, gain_file


def certificate_of(choices: Choices, failures: tuple[str, ...] = ()) -> dict[str, Any]:
    """Return the content of a certificate for these choices."""
    vehicle = read_vehicle(find("vehicles", choices.vehicle))
    content = {
        "version": CERTIFICATE_VERSION,
        "certified": not failures,
        "failures": list(failures),
        "identity": identity_of(configuration(choices), vehicle)._asdict(),
    }
    return {**content, "sha256": content_digest(content)}


def write_certificate(choices: Choices, failures: tuple[str, ...] = ()) -> Path:
    """Write a certificate next to the gain table of these choices."""
    table = gain_file(choices)
    assert table
    file = table.with_name(f"{table.stem}.{Path(choices.vehicle).stem}{SUFFIX}")
    file.write_text(json.dumps(certificate_of(choices, failures)), encoding="utf-8")
    return file
