"""Real Python message packages, built from `.msg` texts with the rosidl generators.

A package is one folder with a Python package, its `.msg` files and one shared library, which holds
all that rclpy and rmw_fastrtps_cpp need. The folder is built on first use below build/, under a
lock, and used again as long as texts, generators and this file stay the same.
"""

import fcntl
import hashlib
import importlib
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
import rosidl_generator_py
from rosidl_cli.command.translate.api import translate
from rosidl_generator_c.cli import GenerateC
from rosidl_generator_py.cli import GeneratePython
from rosidl_typesupport_c.cli import GenerateCTypesupport
from rosidl_typesupport_fastrtps_c.cli import GenerateFastRTPSCTypesupport

from launch_scripts.run.processes import ros_environment
from tests.foreign_messages import PACKAGES

CACHE = Path(__file__).resolve().parents[1] / "build" / "message_packages"
ROS = Path(rosidl_generator_py.__file__).parents[4]
"""Prefix of the ROS installation: .venv, or /opt/ros/jazzy."""
DEPENDENCIES = ("builtin_interfaces", "std_msgs", "geometry_msgs")
"""Installed packages whose messages may be inside ours."""
RUNTIME = (
    "rosidl_runtime_c",
    "rosidl_typesupport_c",
    "rosidl_typesupport_fastrtps_c",
    "rosidl_typesupport_fastrtps_cpp",
    "rcutils",
    "fastcdr",
)
"""Libraries that generated code uses."""
PARTS = ("rosidl_generator_c", "rosidl_generator_py", "rosidl_typesupport_fastrtps_c")
"""Libraries of each dependency that generated code uses."""


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
    generators = (name for name in (*RUNTIME, *PARTS, *DEPENDENCIES) if name not in ("fastcdr",))
    inputs = [
        repr(sorted(texts.items())),
        *(version(name) for name in (*generators, "numpy")),
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
    """Generate the sources of a package into `code`, and its Python modules into `python`."""
    share, code, python = (folder / part / package for part in ("share", "code", "python"))
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
        only = ["rosidl_typesupport_fastrtps_c"]  # one type support: called without a search
        GenerateC("c").generate(package, files, include, code)
        GenerateFastRTPSCTypesupport("fastrtps_c").generate(package, files, include, code)
        GenerateCTypesupport("c", typesupport_implementations=only).generate(
            package, files, include, code
        )
        (python / "msg").mkdir(parents=True)
        GeneratePython("py", typesupport_implementations=["rosidl_typesupport_c"]).generate(
            package, files, include, python
        )
    (python / "__init__.py").touch()


def compile_library(package: str, folder: Path) -> None:
    """Compile all sources of a package into the extension module that rclpy imports.

    Raises:
        RuntimeError: The compiler reports an error.
    """
    code, python = folder / "code", folder / "python" / package
    together = code / "all.cpp"  # the headers of the middleware are read once
    together.write_text("".join(f'#include "{file}"\n' for file in sorted(code.rglob("*.cpp"))))
    headers = [code, ROS / "include", *(ROS / "include").iterdir()]
    headers += [Path(sysconfig.get_path("include")), Path(numpy.get_include())]
    libraries = [*RUNTIME, *(f"{name}__{part}" for name in DEPENDENCIES for part in PARTS)]
    command = [
        *("gcc", "-shared", "-fPIC", "-O0", "-w"),
        *(f"-I{path}" for path in headers),
        *map(str, [*sorted(code.rglob("*.c")), *sorted(python.rglob("*.c")), together]),
        *(f"-L{ROS / 'lib'}", f"-Wl,-rpath,{ROS / 'lib'}", "-Wl,--as-needed"),
        *(f"-l{name}" for name in libraries),
        *("-lstdc++", "-o", str(python / f"{package}_s__rosidl_typesupport_c.so")),
    ]
    result = subprocess.run(command, capture_output=True, text=True, check=False)
    if result.returncode:
        errors = [line for line in result.stderr.splitlines() if "error" in line or "ld:" in line]
        raise RuntimeError(f"{package} cannot be compiled: {(errors or ['no message'])[0]}")
