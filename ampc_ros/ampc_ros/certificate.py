"""Certificates of gain tables: identity, files, and whether a configuration is certified.

`launch_scripts/certify.py` writes certificates. A certificate holds for the chassis, steering and
further sections of one vehicle, the gains of one table, and the settings that act in the loop. It
is no signature: it protects against mistakes, not against forgery.
"""

import glob
import hashlib
import json
import math
import shlex
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated, Any, NamedTuple

import msgspec

from ampc_msgs_config.config import build, find, read_text, shipped
from ampc_msgs_config.validation import Checked, described, number
from ampc_msgs_config.vehicle_file import VehicleContent, read_vehicle
from ampc_ros.configuration import CERTIFIED_CONTROLLERS, Choices, Configuration, gain_file
from ampc_ros.mpc.gain_table import gain_table

CERTIFICATE_VERSION = 2
"""Version of the checks and of the control law. Incremented when either changes the results."""
SUFFIX = ".certificate.json"
FAILS = " fails: "
"""In the reason of a certificate of the right identity that is not certified."""
MAX_CERTIFICATE_BYTES = 1_000_000
MAX_CERTIFICATES = 100
"""Largest number of certificates that are read for one configuration."""
MOST_FAILURES, LONGEST_REASON, LONGEST_SENTENCE = 3, 200, 1200
"""Failed checks in a message, and longest texts [characters]."""
LARGEST_NUMBER = 1.0e300
"""Bound from which a whole number counts as infinite."""
CAR_SECTIONS = ("tyre", "body", "aerodynamics", "powertrain")
"""Sections of a vehicle file, besides chassis and steering, that determine the simulated car."""
NOT_IN_LOOP = {
    *("state_late", "state_lost", "state_prediction", "path_late", "path_lost", "resume"),
    *("max_deviation", "end_deceleration", "path_noise", "look_ahead_time", "min_look_ahead"),
    "adaptation",
}
"""Settings of supervision, path, pure pursuit and adaptation, which change nothing on the certified
drives."""


class Identity(NamedTuple):
    """Digests of everything that a certificate holds for."""

    controller: str
    vehicle: str
    gains: str
    settings: str


@dataclass(frozen=True, kw_only=True)
class Certificate(Checked):
    """Parts of a certificate file that a controller needs."""

    version: Annotated[float, number(1, 1.0e6, "", "Version of the checks.", whole=True)]
    certified: Annotated[bool, described("Whether all bounds hold.")]
    failures: tuple[str, ...]
    identity: Identity


def content_digest(content: Any) -> str:
    """Return a SHA-256 of JSON values; equal numbers give equal digests."""
    text = json.dumps(_floats(content), sort_keys=True, separators=(",", ":"))
    return hashlib.sha256(text.encode()).hexdigest()


def _floats(value: Any) -> Any:
    """Return JSON values whose integers are floats."""
    if isinstance(value, Mapping):
        return {str(key): _floats(part) for key, part in value.items()}
    if isinstance(value, list | tuple):
        return [_floats(part) for part in value]
    if isinstance(value, int) and not isinstance(value, bool):
        return float(value) if abs(value) < LARGEST_NUMBER else math.inf
    return value


def identity_of(config: Configuration, vehicle: VehicleContent) -> Identity:
    """Return what a certificate of a configuration must hold for.

    Args:
        config: Configuration of the controller.
        vehicle: Content of the vehicle file, after inheritance.
    """
    car: dict[str, Any] = {"chassis": asdict(config.chassis), "steering": asdict(config.steering)}
    car |= {name: vehicle.sections[name] for name in CAR_SECTIONS if name in vehicle.sections}
    car["estimated"] = vehicle.estimated
    table = gain_table(config.gains)
    gains: list[Any] = [table.table.speeds.tolist(), table.table.references.tolist(), table.nodes]
    if table.schedule:
        gains.append(msgspec.to_builtins(table.schedule))
    settings = {k: v for k, v in asdict(config.settings).items() if k not in NOT_IN_LOOP}
    return Identity(
        config.controller, content_digest(car), content_digest(gains), content_digest(settings)
    )


def read_certificate(file: Path) -> Certificate:
    """Read a certificate.

    Raises:
        ValueError: The file cannot be read, is too large, damaged, or no certificate.
    """
    try:
        content = json.loads(read_text(file, MAX_CERTIFICATE_BYTES))
        if not isinstance(content, dict):
            raise ValueError(f"must hold a mapping, not {type(content).__name__}")
        expected = content.pop("sha256", None)
        if content_digest(content) != expected:
            raise ValueError("the digest sha256 does not fit the content")
    except (ValueError, RecursionError, OverflowError) as error:
        raise ValueError(f"{file.name}: damaged: {one_line(error)}") from error
    known = {key: content[key] for key in ("version", "certified", "failures", "identity")
             if key in content}  # fmt: skip
    return build(Certificate, known, file.name)


def one_line(text: object) -> str:
    """Return the printable characters of a text in one line of limited length."""
    words = " ".join(str(text).split())
    return "".join(c if c.isprintable() else "?" for c in words)[:LONGEST_REASON]


def certificate_files(choices: Choices, table: Path) -> list[Path]:
    """Return the certificates of a gain table: next to it, and next to the vehicle file.

    Those whose names begin with the full name of the table come first.
    """
    folders = dict.fromkeys((table.parent, find("vehicles", choices.vehicle).parent))
    pattern = f"{glob.escape(table.stem)}*{SUFFIX}"
    files = [file for folder in folders for file in sorted(folder.glob(pattern))]
    files.sort(key=lambda file: not is_named_after(file, table))
    return files[:MAX_CERTIFICATES]


def is_named_after(file: Path, table: Path) -> bool:
    """Return whether a file is named after this table, and not after one with a longer name."""
    return file.name.startswith(f"{table.stem}.")


def certify_command(choices: Choices, table: Path) -> str:
    """Return the command that certifies a configuration."""
    name = table.stem if table == shipped("gains").get(table.stem) else str(table)
    words = ["python", "launch_scripts/certify.py", "--vehicle", choices.vehicle]
    words += ["--gain-table", name]
    default = Choices()
    for option in ("controller", "settings"):
        if getattr(choices, option) != getattr(default, option):
            words += [f"--{option}", getattr(choices, option)]
    return shlex.join(words)


def certificate_problem(choices: Choices, config: Configuration, *, required: bool = False) -> str:
    """Return why a configuration is not certified, in one sentence with the command that helps.

    Empty: it is certified, or its controller has no certificates and none is required.

    Args:
        choices: Choices of the user.
        config: The configuration loaded from them.
        required: Whether a controller without certificates is a problem.

    Raises:
        ValueError: The vehicle file cannot be read.
    """
    table = gain_file(choices)
    if config.controller not in CERTIFIED_CONTROLLERS or table is None:
        return f"controller {one_line(config.controller)} has no certificate" if required else ""
    expected = identity_of(config, read_vehicle(find("vehicles", choices.vehicle)))
    reasons, is_certified = [], False
    for file in certificate_files(choices, table):
        reason = problem_of(file, expected)
        is_certified |= not reason
        if reason and (is_named_after(file, table) or FAILS in reason):
            reasons.append(reason)
    failed = [reason for reason in reasons if FAILS in reason]
    if is_certified and not failed:
        return ""
    cause = (failed or reasons or ["no certificate exists"])[:MOST_FAILURES]
    what = f"gain table {one_line(table.stem)} is not certified for this vehicle"
    command = certify_command(choices, table)
    sentence = f"{what}: {'; '.join(cause)}; see or repeat: {command}"
    return "".join(c if c.isprintable() else "?" for c in sentence)[:LONGEST_SENTENCE]


def problem_of(file: Path, expected: Identity) -> str:
    """Return why a certificate does not certify an identity; empty: it does."""
    try:
        actual = read_certificate(file)
    except ValueError as error:
        return one_line(error)
    name = one_line(file.name)
    if actual.version != CERTIFICATE_VERSION:
        version = f"version {actual.version:g}, not {CERTIFICATE_VERSION}"
        return f"{name} is of another version of the checks ({version})"
    pairs = zip(Identity._fields, actual.identity, expected, strict=True)
    if other := [key for key, a, b in pairs if a != b]:
        return f"{name} is of another {', '.join(other)}"
    if actual.certified and not actual.failures:
        return ""
    shown = [one_line(failure) for failure in actual.failures[:MOST_FAILURES]]
    rest = len(actual.failures) - len(shown)
    return f"{name}{FAILS}{'; '.join(shown)}" + (f"; and {rest} more" if rest > 0 else "")
