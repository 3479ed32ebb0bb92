"""Damaged bags, against an oracle; and bags that claim, nest or decompress too much."""

import io
import struct
import subprocess
import sys
from collections.abc import Callable, Iterator
from functools import partial
from pathlib import Path

import zstandard

from tests.workshop.attacks.attempts import Attempt, Choice, one_line
from tests.workshop.proofs.damaged_bags import KINDS, PLACES, make_sample
from tests.workshop.proofs.prove_recovery import one_damage

DAMAGES = 420
"""Number of damaged bags."""
MEMORY = 2_000_000_000
"""Address space of a command that reads a special bag [bytes]."""
COMMANDS = ("recover", "report", "replay")
MAGIC = b"\x89MCAP0\r\n"
PATIENCE = 300.0
LIMITED = (
    "import resource, runpy, sys; "
    f"resource.setrlimit(resource.RLIMIT_DATA, ({MEMORY}, {MEMORY})); "
    "sys.argv = sys.argv[1:]; runpy.run_module(sys.argv[0], run_name='__main__')"
)
"""Program that runs a module with limited memory."""


def attempts(choice: Choice) -> Iterator[Attempt]:
    """Damage bags and recover them; read special bags by commands with limited memory."""
    for number in range(DAMAGES):
        kind, place = KINDS[number % len(KINDS)], PLACES[number // len(KINDS) % len(PLACES)]
        name = f"{number}: {kind} in {place}"
        if choice.has(name):
            result = one_damage(choice.rng(name).randrange(2**31), kind, place)
            lost = f"{result.lost} of {result.intact} intact messages lost {result.error}"
            yield Attempt(choice.area, name, "" if result.is_good else one_line(lost))
    attacks: dict[str, Callable[[], str]] = {}
    for name, make in special_bags(choice).items():
        for command in COMMANDS if name in DEEP else COMMANDS[:1]:
            attacks[f"{command}, {name}"] = partial(read, choice, command, name, make)
    yield from choice.attempts(attacks)


DEEP = ("bomb in a chunk", "nested metadata", "claims 4 GB", "empty folder")
"""Bags that all commands read."""


def special_bags(choice: Choice) -> dict[str, Callable[[Path], object]]:
    """Return functions that write special bags into a folder, by name."""
    content = make_sample(choice.rng("sample")).content
    claims = {"4 GB": 2**32 - 1, "2^63 bytes": 2**63, "2^64 bytes": 2**64 - 1}
    bags: dict[str, Callable[[Path], object]] = {
        f"claims {name}": writing(MAGIC + struct.pack("<BQ", 6, length) + b"x" * 17)
        for name, length in claims.items()
    }
    for opcode in (1, 3, 4, 5, 6, 11):
        record = struct.pack("<BQ", opcode, 2**40)
        bags[f"record {opcode} claims 1 TB"] = writing(content[:8] + record + content[8:])
    bags["bomb in a chunk"] = writing(content[:8] + bomb_chunk() + content[8:])
    bags["nested metadata"] = nested(content, "[" * 100_000)
    bags["metadata of maps"] = nested(content, "{a: " * 20_000)
    bags["metadata of aliases"] = nested(content, aliases())
    bags["metadata of bytes"] = nested(content, "\0\1\2")
    bags["file bomb"] = writing(zstandard.compress(bytes(2**29)), "bag_0.mcap.zstd")
    pair = zstandard.compress(content[:200]) + zstandard.compress(content[200:])
    bags["two frames"] = writing(pair, "bag_0.mcap.zstd")
    bags["cut frame"] = writing(zstandard.compress(content)[:-9], "bag_0.mcap.zstd")
    bags["magic only"] = writing(MAGIC)
    bags["empty file"] = writing(b"")
    bags["random bytes"] = writing(choice.rng("bytes").randbytes(10_000))
    bags["no database"] = writing(b"SQLite format 3\0" + bytes(500), "bag_0.db3")
    bags["empty folder"] = lambda _: None
    bags["link to itself"] = lambda bag: (bag / "bag_0.mcap").symlink_to("bag_0.mcap")
    bags["link to nowhere"] = lambda bag: (bag / "bag_0.mcap").symlink_to("nowhere")
    bags["link to a device"] = lambda bag: (bag / "bag_0.mcap").symlink_to("/dev/zero")
    bags["folder as file"] = lambda bag: (bag / "bag_0.mcap").mkdir()
    return bags


def writing(content: bytes, name: str = "bag_0.mcap") -> Callable[[Path], object]:
    """Return a function that writes one file into a bag."""
    return lambda bag: (bag / name).write_bytes(content)


def nested(content: bytes, metadata: str) -> Callable[[Path], object]:
    """Return a function that writes a complete bag with hostile metadata."""

    def write(bag: Path) -> None:
        (bag / "bag_0.mcap").write_bytes(content)
        (bag / "metadata.yaml").write_text(metadata, "utf-8")

    return write


def aliases() -> str:
    """Return YAML whose aliases stand for 2^60 values."""
    lines = ["a0: &a0 [1, 1]"]
    lines += [f"a{i}: &a{i} [*a{i - 1}, *a{i - 1}]" for i in range(1, 60)]
    return "\n".join(lines)


def bomb_chunk() -> bytes:
    """Return a chunk record of 1 GB that is compressed to some kilobytes."""
    buffer = io.BytesIO()
    with zstandard.ZstdCompressor().stream_writer(buffer, closefd=False, size=2**30) as writer:
        for _ in range(64):
            writer.write(bytes(2**24))
    data = buffer.getvalue()
    body = struct.pack("<QQQII", 0, 1, 2**30, 0, 4) + b"zstd" + struct.pack("<Q", len(data)) + data
    return struct.pack("<BQ", 6, len(body)) + body


def read(choice: Choice, command: str, name: str, make: Callable[[Path], object]) -> str:
    """Read a special bag by a command; return what is wrong with its end."""
    bag = choice.folder / f"{command}_{name.replace(' ', '_')}"
    bag.mkdir(exist_ok=True)
    if not any(bag.iterdir()):
        make(bag)
    module = f"launch_scripts.{command}"
    output = ["--output", str(choice.folder / f"new_{bag.name}")] if command == "recover" else []
    line = [sys.executable, "-c", LIMITED, module, str(bag), *output]
    try:
        done = subprocess.run(line, capture_output=True, text=True, timeout=PATIENCE)
    except subprocess.TimeoutExpired:
        return f"no end within {PATIENCE:g} s"
    if "Traceback" in done.stderr or done.returncode not in (0, 1, 2):
        return f"exit code {done.returncode}: {done.stderr[-250:]}"
    errors = [line for line in (done.stdout + done.stderr).splitlines() if "error: " in line]
    if done.returncode == 2 and len(errors) != 1:
        return f"{len(errors)} error lines: {done.stderr[-250:]}"
    return ""
