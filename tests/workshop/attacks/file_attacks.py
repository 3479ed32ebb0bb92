"""Changed copies of all kinds of shipped YAML files, and hostile path files.

Loading a changed file gives one line (ValueError), or what the text states. A number that is
replaced must be read as Python's `float` reads it, or be refused; a repeated key is refused.
"""

import math
import random
import re
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path
from typing import Any, NamedTuple

from ampc_msgs_config.config import build, read
from ampc_msgs_config.parameters import SizeParameters
from ampc_msgs_config.paths.path_file import from_csv
from ampc_msgs_config.scenarios.scenario import load_scenario
from sim_vehicle.parameters import load_vehicle_file
from tests.workshop.attacks.attempts import Attempt, Choice, one_line, outcome_of
from tests.workshop.proofs.config_files import KINDS, ROOT, Kind

MUTANTS = 3000
"""Number of changed YAML files."""
NUMBER = re.compile(r"(?<![\w.])-?\d+\.?\d*(?:e[-+]?\d+)?(?![\w.])")
STRANGE = (
    *("0017", "1:30", "1_0", "0x1F", "yes", "off", "true", "'5'", ".nan", ".inf", "-.inf", "1e400"),
    *("", "~", "[]", "{}", "1e-320", "-0.0", "&a 1", "*a", "!!int 3", "!!python/name:os.system"),
    *("2026-11-28", "9" * 401, "9" * 5000, "1.5.2", "\t1", "\u0661", "1e5", "-1", "0", "[[[[1]]]]"),
)
"""Texts in the place of a number."""
SIZE = SizeParameters(width=1.8, front_overhang=0.9, rear_overhang=1.0)


class Mutant(NamedTuple):
    """A changed text."""

    what: str
    text: str
    number: str = ""
    """The text that replaced a number; empty: another change."""
    must_fail: bool = False


def attempts(choice: Choice) -> Iterator[Attempt]:
    """Load changed YAML files of all kinds, and hostile path files."""
    files = [(kind, file) for kind in KINDS for file in sorted((ROOT / kind.files).glob("*.yaml"))]
    for index in range(MUTANTS):
        kind = KINDS[index % len(KINDS)]
        name = f"{kind.name} {index}"
        if choice.has(name):
            rng = choice.rng(name)
            file = rng.choice([each for of_kind, each in files if of_kind is kind])
            mutant = mutate(file.read_text("utf-8"), rng)
            failure = outcome_of(partial(load_mutant, choice, kind, file, mutant))
            shown = f"{file.name}, {mutant.what}: {failure}"
            yield Attempt(choice.area, name, one_line(shown) if failure else "")
    attacks: dict[str, Callable[[], str]] = {
        f"path file {name}": partial(load_table, choice, text)
        for name, text in path_files(choice).items()
    }
    yield from choice.attempts(attacks)


def mutate(text: str, rng: random.Random) -> Mutant:
    """Return a changed copy of a text."""
    kind = rng.choice(["number", "number", "number", "line", "key", "bytes", "cut", "indent"])
    lines = text.split("\n")
    end = lines.index("provenance:") if "provenance:" in lines else len(lines)  # free text follows
    row = rng.choice([i for i, line in enumerate(lines[:end]) if ":" in line and line[0] != "#"])
    line = lines[row]
    places = list(NUMBER.finditer(line.partition("#")[0]))
    if kind == "number" and places:
        place, strange = rng.choice(places), rng.choice(STRANGE)
        lines[row] = line[: place.start()] + strange + line[place.end() :]
        return Mutant(f"line {row + 1}: {strange[:20]!r}", "\n".join(lines), strange)
    if kind == "line" and ": " in line and "{" not in line:  # its key occurs twice
        lines.insert(row, line)
        return Mutant(f"line {row + 1} twice", "\n".join(lines), must_fail="- " not in line)
    if kind == "key":
        lines[row] = line.replace(":", rng.choice(["x:", "::", " ", ": :", "\u00e4:"]), 1)
        return Mutant(f"key of line {row + 1}", "\n".join(lines))
    if kind == "cut":
        at = rng.randrange(len(text))
        return Mutant(f"cut at {at}", text[:at])
    if kind == "indent":
        lines[row] = rng.choice([" ", "\t", "  ", "- ", "? "]) + line
        return Mutant(f"indent of line {row + 1}", "\n".join(lines))
    characters, at = list(text), rng.randrange(len(text))
    for _ in range(rng.choice([1, 1, 3, 20])):
        characters[min(at + rng.randrange(20), len(text) - 1)] = rng.choice(
            "[]{}:,#&*!|>'\"%@`\0 \n9"
        )
    return Mutant(f"characters at {at}", "".join(characters))


def load_mutant(choice: Choice, kind: Kind, original: Path, mutant: Mutant) -> str:
    """Load a changed file as the product does; return what is wrong."""
    file = choice.folder / "mutant.yaml"
    file.write_text(mutant.text, "utf-8")
    before = load_as(kind, original)
    try:
        loaded = load_as(kind, file)
    except ValueError as error:
        return f"{len(str(error).splitlines())} lines: {error}" if "\n" in str(error) else ""
    if mutant.must_fail:
        return "a repeated key is accepted"
    if mutant.number and repr(loaded) != repr(before):
        return "" if is_plain(mutant.number) else f"{mutant.number[:20]!r} is read as something"
    return ""


def is_plain(text: str) -> bool:
    """Return whether a text is a number as Python and YAML 1.2 read it, or stands for one."""
    if text in ("", "~", "[]", "{}", ".inf", "-.inf", "&a 1", "!!int 3"):
        return True  # a default value, infinity, or an anchored or tagged number
    try:
        return text == "0" or (math.isfinite(float(text)) and "_" not in text and text[0] != "0")
    except ValueError:
        return False


def load_as(kind: Kind, file: Path) -> Any:
    """Load a file of a kind by all functions of the product that read it."""
    if kind.name == "vehicle":
        return load_vehicle_file(file)
    content: Any = build(kind.content, read(file), str(file))
    if kind.name == "scenario":
        drive = load_scenario(str(file), SIZE)
        return content, drive.duration, drive.speed, drive.wind
    return content


def path_files(choice: Choice) -> dict[str, bytes]:
    """Return the contents of hostile path files, by name."""
    circle = [(30 * math.sin(k / 57), 30 - 30 * math.cos(k / 57)) for k in range(300)]
    head, rows = "x_m,y_m,v_mps\n", [f"{x},{y},8.0" for x, y in circle]
    plain = head + "\n".join(rows) + "\n"
    rng = choice.rng("path files")
    texts = {
        "empty": "",
        "head only": head,
        "one row": head + rows[0],
        "nan": plain.replace(rows[50], "nan,1,8"),
        "inf": plain.replace(rows[50], "1,inf,8"),
        "1e308": plain.replace(rows[50], "1e308,-1e308,8"),
        "words": plain.replace(rows[50], "a,b,c"),
        "short row": plain.replace(rows[50], "1.0"),
        "long row": plain.replace(rows[50], ",".join(["1"] * 5000)),
        "quoted line break": plain.replace(rows[50], '"1\n2",3,8'),
        "open quote": plain.replace(rows[50], '"1,2,8'),
        "underscore": plain.replace(rows[50], "1_0,2,8"),
        "negative speed": plain.replace(",8.0", ",-8.0"),
        "huge speed": plain.replace(",8.0", ",1e30"),
        "huge digits": plain.replace(rows[50], f"{'9' * 5000},1,8"),
        "head twice": head + plain,
        "columns twice": plain.replace("x_m,y_m", "x_m,x_m"),
        "no head": "\n".join(rows),
        "semicolons": plain.replace(",", ";"),
        "decimal commas": plain.replace(",", ";").replace(".", ","),
        "one line": plain.replace("\n", " "),
        "carriage returns": plain.replace("\n", "\r"),
        "equal points": head + "1,1,8\n" * 500,
        "1,000,000 lines": head + "1,1,8\n" * 1_000_000,
        "50,000 points": head + "".join(f"{0.25 * k},0,8\n" for k in range(50_000)),
        "random walk": head
        + "".join(f"{rng.uniform(-9, 9)},{rng.uniform(-9, 9)},8\n" for _ in range(300)),
        "comment lines only": "# x\n" * 1000,
    }
    contents: dict[str, bytes] = {name: text.encode() for name, text in texts.items()}
    contents["null characters"] = plain.encode().replace(b",8.0", b",\0", 9)
    contents["latin-1"] = plain.encode() + b"\xe4,1,8\n"
    contents["utf-16"] = plain.encode("utf-16")
    contents["byte order mark"] = b"\xef\xbb\xbf" + plain.encode()
    contents["random bytes"] = rng.randbytes(5000)
    for number in range(40):
        content = bytearray(plain.encode())
        for _ in range(rng.choice([1, 3, 20])):
            content[rng.randrange(len(content))] = rng.randrange(256)
        contents[f"flipped {number}"] = bytes(content)
    return contents


def load_table(choice: Choice, content: bytes) -> str:
    """Load a path file; return what is wrong: an error of several lines, or a number that is none.

    Raises:
        Exception: Any other than a ValueError is a failure.
    """
    file = choice.folder / "path.csv"
    file.write_bytes(content)
    try:
        drive = from_csv(file)
    except ValueError as error:
        return f"{len(str(error).splitlines())} lines: {error}" if "\n" in str(error) else ""
    speeds = drive.speed.speed.tolist()
    return "" if all(map(math.isfinite, speeds)) and min(speeds) >= 0.0 else "speeds are wrong"
