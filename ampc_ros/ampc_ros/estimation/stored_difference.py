"""File with the last estimates of each vehicle, from which the next drive starts."""

import hashlib
import json
import os
import tempfile
from pathlib import Path

from ampc_msgs_config.config import build, read_text
from ampc_ros.configuration import CarDifference, Configuration


def difference_file(config: Configuration) -> Path:
    """Return the file of a vehicle: a changed chassis or steering has another one."""
    base = os.environ.get("XDG_STATE_HOME") or Path.home() / ".local" / "state"
    digest = hashlib.sha256(repr((config.chassis, config.steering)).encode()).hexdigest()
    return Path(base) / "ampc_ros" / f"{digest[:16]}.json"


def read_difference(config: Configuration) -> CarDifference | None:
    """Return the stored estimates of a vehicle; None: there are none.

    Raises:
        ValueError: The file is damaged.
    """
    file = difference_file(config)
    if not file.exists():
        return None
    try:
        content = json.loads(read_text(file, 10_000))
    except (RecursionError, ValueError) as error:
        raise ValueError(f"{file}: cannot be read: {error}") from error
    return build(CarDifference, content, str(file))


def store_difference(config: Configuration, difference: CarDifference) -> None:
    """Store the estimates of a vehicle; the file is replaced as a whole.

    Raises:
        OSError: The folder cannot be written.
    """
    file = difference_file(config)
    file.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.NamedTemporaryFile("w", dir=file.parent, suffix=".tmp", delete=False) as stream:
        json.dump(difference._asdict(), stream)
    Path(stream.name).replace(file)


def remove_difference(config: Configuration) -> None:
    """Remove the stored estimates of a vehicle.

    Raises:
        OSError: The file cannot be removed.
    """
    difference_file(config).unlink(missing_ok=True)
