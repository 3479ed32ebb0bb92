"""Shipped schemas and parameter tables equal the declarations; shipped files carry their schema."""

import json
import re
import subprocess
import sys
from pathlib import Path
from typing import Any

import pytest

from ampc_msgs_config.config import build, read, schema_line, shipped_schema
from tests.workshop.proofs.config_files import KINDS, PAGE, ROOT, Kind, schema_text, tables

NAMES = [kind.name for kind in KINDS]
FILES = [(kind, file) for kind in KINDS for file in sorted((ROOT / kind.files).glob("*.yaml"))]


@pytest.mark.parametrize("kind", KINDS, ids=NAMES)
def test_shipped_schema_is_the_exported_one(kind: Kind) -> None:
    assert (ROOT / kind.schema).read_text(encoding="utf-8") == schema_text(kind)


def test_committed_parameter_tables_are_the_generated_ones() -> None:
    assert (ROOT / PAGE).read_text(encoding="utf-8") == tables()


@pytest.mark.parametrize(("kind", "file"), FILES, ids=[file.stem for _, file in FILES])
def test_shipped_file_names_its_schema_in_the_first_line_and_loads(kind: Kind, file: Path) -> None:
    first = file.read_text(encoding="utf-8").partition("\n")[0]
    assert first == schema_line(ROOT / kind.schema, file)
    assert build(kind.content, read(file), str(file))


def violations(schema: dict[str, Any], value: Any, root: dict[str, Any]) -> list[str]:
    """Return what a value violates, for the keywords that our schemas use."""
    if "$ref" in schema:
        schema = root["$defs"][schema["$ref"].rpartition("/")[2]]
    if "anyOf" in schema:
        actual = [violations(each, value, root) for each in schema["anyOf"]]
        return [] if [] in actual else actual[0]
    kinds: dict[str, Any] = {"object": dict, "array": list, "number": (int, float), "integer": int}
    kinds |= {"string": str, "boolean": bool, "null": type(None)}
    if "type" in schema and not isinstance(value, kinds[schema["type"]]):
        return [f"{value!r} is no {schema['type']}"]
    if "enum" in schema and value not in schema["enum"]:
        return [f"{value!r} is not in {schema['enum']}"]
    if isinstance(value, dict) and "properties" in schema:
        known = schema["properties"]
        actual = [[f"unknown {key}"] for key in value if key not in known]
        actual += [[f"missing {key}"] for key in schema.get("required", ()) if key not in value]
        actual += [violations(known[k], part, root) for k, part in value.items() if k in known]
        return [each for several in actual for each in several]
    if isinstance(value, list):
        items = schema.get("prefixItems") or [schema["items"]] * len(value)
        pairs = zip(items, value, strict=True)
        return [each for item, part in pairs for each in violations(item, part, root)]
    if isinstance(value, (int, float)) and not isinstance(value, bool):
        low, high = schema.get("minimum", -float("inf")), schema.get("maximum", float("inf"))
        return [] if low <= value <= high else [f"{value} is not in [{low}, {high}]"]
    return []


@pytest.mark.parametrize(("kind", "file"), FILES, ids=[file.stem for _, file in FILES])
def test_shipped_file_satisfies_its_schema_and_a_wrong_one_does_not(kind: Kind, file: Path) -> None:
    schema = json.loads((ROOT / kind.schema).read_text(encoding="utf-8"))
    content = read(file)
    assert violations(schema, content, schema) == []
    assert violations(schema, {**content, "colour": 1}, schema) == ["unknown colour"]
    assert violations(schema, {key: [{}] for key in content}, schema)


@pytest.mark.parametrize("kind", KINDS, ids=NAMES)
def test_every_parameter_has_a_meaning_and_every_number_bounds(kind: Kind) -> None:
    section = tables().split(f"## {kind.name}\n")[1].split("\n## ")[0]
    rows = [line.split(" | ") for line in section.splitlines() if line.startswith("| `")]
    assert rows
    for _, what, _, bounds, _, meaning in rows:
        assert kind.name == "thresholds" or meaning.strip(" |")
        assert bounds or "number" not in what


def test_the_command_writes_schemas_and_tables_to_a_folder(tmp_path: Path) -> None:
    command = [sys.executable, "-m", "tests.workshop.proofs.config_files"]
    options = ["--schemas", "--tables", "--output", str(tmp_path)]
    subprocess.run([*command, *options], check=True, cwd=ROOT, stdout=subprocess.DEVNULL)
    for file in (PAGE, *(kind.schema for kind in KINDS)):
        assert (tmp_path / file).read_bytes() == (ROOT / file).read_bytes()


def test_schema_of_the_package_is_found_by_name() -> None:
    assert shipped_schema("gains").is_file()


WRONG_NUMBERS = ["0017", "1:30", "1_0", "0x1F", "yes", "no", "on", "off", "true", "'1'", ".nan"]
WRONG_NUMBERS += [f"1{'0' * 400}", "~", "[]", "{}", "2026-11-28"]
ONE_OF_EACH = {kind.name: (kind, file) for kind, file in FILES if file.stem != "sine"}


@pytest.mark.parametrize("value", WRONG_NUMBERS)
@pytest.mark.parametrize("name", ONE_OF_EACH)
def test_wrong_number_is_rejected_in_every_kind_of_file(
    name: str, value: str, tmp_path: Path
) -> None:
    kind, shipped_file = ONE_OF_EACH[name]
    text, count = re.subn(
        r"^([^#\n]*?\b(\w+): +\[*)-?[0-9][0-9.e+-]*",
        rf"\g<1>{value}",
        shipped_file.read_text(encoding="utf-8"),
        count=1,
        flags=re.MULTILINE,
    )
    assert count == 1
    file = tmp_path / "mine.yaml"
    file.write_text(text, encoding="utf-8")
    with pytest.raises(ValueError, match=r"mine\.yaml: \S+ = .* must (be|lie|in)\b.*") as error:
        build(kind.content, read(file), str(file))
    assert "\n" not in str(error.value)
    assert "[" in str(error.value).partition(" must ")[2]


@pytest.mark.parametrize("name", ONE_OF_EACH)
def test_key_that_occurs_twice_is_rejected_in_every_kind_of_file(name: str, tmp_path: Path) -> None:
    _, shipped_file = ONE_OF_EACH[name]
    key = next(iter(read(shipped_file)))
    file = tmp_path / "mine.yaml"
    file.write_text(shipped_file.read_text(encoding="utf-8") + f"\n{key}: 1\n", encoding="utf-8")
    with pytest.raises(ValueError, match=rf"mine\.yaml: {key} = 1 in line \d+ repeats the key of"):
        read(file)
