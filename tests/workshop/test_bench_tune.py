"""The benchmark of the tuner: sizes and exponents; the durations are not tested."""

import json
from pathlib import Path

import pytest

from launch_scripts.tuning.fleet_rows import run_fleet
from tests.workshop.bench.bench_tune import BASE, SIZES, generation, growth_exponents, main


@pytest.mark.parametrize("axis", ["nodes", "particles", "plants", "ticks"])
def test_a_generation_drives_the_number_of_ticks_of_its_sizes(axis: str) -> None:
    small = BASE | {"particles": 2, "ticks": 5}
    for sizes in (small, small | {axis: 2 * small[axis]}):
        driven = sum(int(e.fleet.ticks.sum()) for e in generation(sizes))
        expected = sizes["nodes"] * sizes["particles"] * sizes["plants"] * sizes["ticks"]
        assert driven == expected
    log = run_fleet(generation(small)[0])
    assert log.shape[:2] == (small["particles"] * small["plants"], small["ticks"])


def test_time_that_doubles_with_the_size_grows_with_its_first_power() -> None:
    times = {axis: [0.1 * n for n in sizes] for axis, sizes in SIZES.items()}
    assert growth_exponents(times) == pytest.approx(dict.fromkeys(SIZES, 1.0))


def test_the_benchmark_leaves_numbers_and_a_picture(tmp_path: Path) -> None:
    assert main(["--rounds", "1", "--output", str(tmp_path)]) == 0
    content = json.loads((tmp_path / "bench_tune.json").read_text())
    assert set(content["exponents"]) == set(SIZES)
    assert (tmp_path / "bench_tune.png").read_bytes().startswith(b"\x89PNG")
