"""Real Python message packages, built from `.msg` texts with the rosidl generators.

A package is one folder with a Python package, its `.msg` files and one shared library, which holds
all that rclpy and rmw_fastrtps_cpp need. The folder is built on first use below build/, under a
lock, and used again as long as texts, generators and this file stay the same.

A test that needs a package in child processes starts them with `environment_with(["carla_msgs"])`;
one that imports packages uses the fixture `foreign_messages`.

rosidl_typesupport_c opens the libraries of the two type supports by name, which finds them outside
LD_LIBRARY_PATH if they are loaded already. Therefore the extension module depends on both names.
"""

import fcntl
import hashlib
import importlib.util
import os
import shutil
import subprocess
import sys
import sysconfig
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from functools import cache
from importlib import metadata
from pathlib import Path
from textwrap import dedent

import numpy
import pytest

from launch_scripts.run.processes import ros_environment
from tests.foreign_messages import PACKAGES

CACHE = Path(__file__).resolve().parents[1] / "build" / "message_packages"
ROS = Path(importlib.util.find_spec("rclpy").origin).parents[4]  # type: ignore[union-attr, arg-type]
"""Prefix of the ROS installation: .venv, or /opt/ros/jazzy."""
DEPENDENCIES = ("builtin_interfaces", "std_msgs", "geometry_msgs")
"""Installed packages whose messages may be inside ours."""
RUNTIME = (
    "rosidl_runtime_c",
    "rosidl_typesupport_c",
    "rosidl_typesupport_fastrtps_c",
    "rosidl_typesupport_fastrtps_cpp",
    "rosidl_typesupport_introspection_c",
    "rcutils",
    "fastcdr",
)
"""Libraries that generated code uses."""
SUPPORTS = ["rosidl_typesupport_fastrtps_c", "rosidl_typesupport_introspection_c"]
"""Type supports that rmw_fastrtps_cpp uses: for the bytes, and for the type objects of DDS."""
PARTS = ("rosidl_generator_c", "rosidl_generator_py", *SUPPORTS)
"""Libraries of each dependency that generated code uses."""
FOLDERS = ("share", "code", "introspection", "python")
"""Folders of a built package; those of C code are apart, because two generators write one name."""


def environment_with(packages: Iterable[str]) -> dict[str, str]:
    """Return the environment of a child process that can import message packages, built or not.

    Raises:
        RuntimeError: A package cannot be built.
    """
    environment = ros_environment()
    for folder in map(built, packages):
        for name, value in (("PYTHONPATH", folder / "python"), ("AMENT_PREFIX_PATH", folder)):
            environment[name] = os.pathsep.join(filter(None, [str(value), environment.get(name)]))
    return environment


@contextmanager
def importable(packages: Iterable[str]) -> Iterator[None]:
    """Make message packages importable here and in child processes, inside the block."""
    packages = list(packages)
    environment = environment_with(packages)
    with pytest.MonkeyPatch.context() as patch:
        for name in ("PYTHONPATH", "AMENT_PREFIX_PATH"):
            patch.setenv(name, environment[name])
        for name in packages:
            patch.syspath_prepend(built(name) / "python")
        importlib.invalidate_caches()
        try:
            yield
        finally:
            for module in [m for m in sys.modules if m.split(".")[0] in packages]:
                del sys.modules[module]


@cache
def built(package: str) -> Path:
    """Return the folder of a package of PACKAGES; build it if no process has done so before.

    Raises:
        RuntimeError: The package cannot be built; the message is one line.
    """
    texts = PACKAGES[package]
    folder = CACHE / f"{package}-{digest(texts)}"
    CACHE.mkdir(parents=True, exist_ok=True)
    with folder.with_suffix(".lock").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        if not folder.exists():
            partial = folder.with_suffix(".partial")
            shutil.rmtree(partial, ignore_errors=True)
            build(package, texts, partial)
            partial.rename(folder)
    return folder


def digest(texts: Mapping[str, str]) -> str:
    """Return a digest of all that a build depends on: texts, generators, Python, this file."""
    inputs = [
        repr(sorted(texts.items())),
        *(version(name) for name in (*RUNTIME, *PARTS, *DEPENDENCIES, "rosidl_adapter", "numpy")),
        str(sysconfig.get_config_var("EXT_SUFFIX")),
        Path(__file__).read_text(encoding="utf-8"),
    ]
    return hashlib.sha256("\n".join(inputs).encode()).hexdigest()[:16]


def version(package: str) -> str:
    """Return the version of an installed package, `-` if its metadata are elsewhere."""
    try:
        return metadata.version(package)
    except metadata.PackageNotFoundError:
        return "-"


def build(package: str, texts: Mapping[str, str], folder: Path) -> None:
    """Generate and compile a message package.

    Raises:
        RuntimeError: No compiler, no header of Python, or code that cannot be compiled.
    """
    check_tools()
    share = folder / "share" / package
    (share / "msg").mkdir(parents=True)
    for name, text in texts.items():
        (share / "msg" / f"{name}.msg").write_text(dedent(text).strip() + "\n", encoding="utf-8")
    index = folder / "share" / "ament_index" / "resource_index" / "packages" / package
    index.parent.mkdir(parents=True)
    index.touch()
    generate(package, [f"{share}:msg/{name}.msg" for name in texts], folder)
    compile_library(package, folder)


def check_tools() -> None:
    """Check that a compiler and the headers of Python are installed.

    Raises:
        RuntimeError: One is missing.
    """
    if shutil.which("gcc") is None or shutil.which("g++") is None:
        raise RuntimeError("message packages of the tests need gcc and g++: apt install g++")
    if not Path(sysconfig.get_path("include"), "Python.h").exists():
        raise RuntimeError("message packages of the tests need Python.h: apt install python3-dev")


def generate(package: str, messages: list[str], folder: Path) -> None:
    """Generate the sources of a package: C in two folders, Python modules in `python`."""
    # Imported here: the tests of a session that builds nothing need no parser.
    from rosidl_cli.command.translate.api import translate
    from rosidl_generator_c.cli import GenerateC
    from rosidl_generator_py.cli import GeneratePython
    from rosidl_typesupport_c.cli import GenerateCTypesupport
    from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport
    from rosidl_typesupport_introspection_c.cli import GenerateIntrospectionCTypesupport

    share, code, introspection, python = (folder / part / package for part in FOLDERS)
    include = [str(ROS / "share" / name) for name in DEPENDENCIES]
    with pytest.MonkeyPatch.context() as patch:
        patch.setenv("AMENT_PREFIX_PATH", str(ROS))  # the generators look for their templates
        files = translate(
            package_name=package,
            interface_files=messages,
            include_paths=include,
            output_format="idl",
            output_path=share,
        )
        for generator, output in (
            (GenerateC("c"), code),
            (GenerateFastRTPSCTypesupport("fastrtps_c"), code),
            (GenerateIntrospectionCTypesupport("introspection_c"), introspection),
            (GenerateCTypesupport("c", typesupport_implementations=SUPPORTS), code),
            (GeneratePython("py", typesupport_implementations=["rosidl_typesupport_c"]), python),
        ):
            (output / "msg").mkdir(parents=True, exist_ok=True)
            generator.generate(package, files, include, output)
    (python / "__init__.py").touch()


def compile_library(package: str, folder: Path) -> None:
    """Compile all sources of a package into one library, the extension module that rclpy imports.

    Raises:
        RuntimeError: The compiler reports an error.
    """
    _, code, introspection, python = (folder / part / package for part in FOLDERS)
    together = code / "all.cpp"  # the headers of the middleware are read once
    together.write_text("".join(f'#include "{file}"\n' for file in sorted(code.rglob("*.cpp"))))
    sources = [
        together,
        *(file for each in (code, introspection, python) for file in each.rglob("*.c")),
    ]
    headers = [code.parent, introspection.parent, ROS / "include", *(ROS / "include").iterdir()]
    headers += [Path(sysconfig.get_path("include")), Path(numpy.get_include())]
    used = [*RUNTIME, *(f"{name}__{part}" for name in DEPENDENCIES for part in PARTS), "stdc++"]
    first, second = (python / f"lib{package}__{support}.so" for support in SUPPORTS)
    extension = python / f"{package}_s__rosidl_typesupport_c.so"
    options = ["-O0", "-w", *(f"-I{path}" for path in headers), f"-L{ROS / 'lib'}"]
    options += [f"-Wl,-rpath,{ROS / 'lib'}", "-Wl,--as-needed", *(f"-l{name}" for name in used)]
    link(first, sources, options)
    link(second, [first])
    link(extension, [first, second])


def link(library: Path, inputs: list[Path], options: Iterable[str] = ()) -> None:
    """Compile or link a shared library that finds others in its own folder.

    Raises:
        RuntimeError: The compiler reports an error.
    """
    output = ["-o", str(library), f"-Wl,-soname,{library.name}", "-Wl,-rpath,$ORIGIN"]
    command = [
        "gcc",
        "-shared",
        "-fPIC",
        "-Wl,--no-as-needed",
        *map(str, inputs),
        *options,
        *output,
    ]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode:
        errors = [line for line in result.stderr.splitlines() if "error" in line or "ld:" in line]
        raise RuntimeError(f"{library.name} cannot be compiled: {(errors or ['no message'])[0]}")
