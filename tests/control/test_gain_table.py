"""The gain table: which gains it gives where, and what it says about a bad file."""

import math
from pathlib import Path
from typing import Any

import numpy as np
import pytest
import yaml
from hypothesis import given, settings
from hypothesis import strategies as st

from ampc_msgs_config.config import shipped
from ampc_ros.configuration import Choices
from ampc_ros.controller import make_controller
from ampc_ros.mpc.gain_table import Gains, GainTable, gain_table, load_gain_table

SLOW = Gains(40, 15, 5, 0.5, 10.0, 0.01)
FAST = Gains(20, 10, 4, 0.7, 1000.0, 100.0)
many = settings(max_examples=100, deadline=None, derandomize=True)


def two_speeds() -> GainTable:
    """Return a table with SLOW at 5 m/s and FAST at 15 m/s."""
    return GainTable([5.0, 15.0], [0.0], [SLOW, FAST])


def test_table_3_holds_the_gains_of_the_paper_wherever_it_is_read() -> None:
    table = load_gain_table("table3")
    for speed in (0.0, 3.0, 9.3, 27.0, 40.0):
        for reference in (-20.0, -15.0, 0.0, 2.2, 15.0):
            gains = table.lookup(speed, reference).gains
            assert gains == pytest.approx(Gains(45, 15, 5, 0.75, 10.0, 0.01))
            assert all(isinstance(value, int) for value in gains[:3])


@pytest.mark.parametrize("name", sorted(shipped("gains")))
def test_shipped_tables_load(name: str) -> None:
    assert load_gain_table(name).nodes


def test_nodes_give_their_own_gains() -> None:
    table = two_speeds()
    assert table.lookup(5.0).gains == pytest.approx(SLOW)
    assert table.lookup(15.0).gains == pytest.approx(FAST)


@many
@given(share=st.floats(0.0, 1.0))
def test_weights_are_interpolated_in_the_logarithm_and_the_pole_linearly(share: float) -> None:
    _, _, _, pole, Q, R = two_speeds().lookup(5.0 + 10.0 * share).gains
    assert pole == pytest.approx(0.5 + 0.2 * share)
    assert math.log10(Q) == pytest.approx(1.0 + 2.0 * share)
    assert math.log10(R) == pytest.approx(-2.0 + 4.0 * share)


def test_two_axes_are_interpolated_one_after_the_other() -> None:
    corners = [SLOW._replace(increment_weight=10.0**k) for k in (0, 1, 2, 5)]
    table = GainTable([0.0, 10.0], [-1.0, 1.0], corners)  # the references fastest
    for speed, reference, exponent in [(0, -1, 0), (0, 1, 1), (10, -1, 2), (10, 1, 5), (5, 0, 2)]:
        R = table.lookup(speed, reference).gains.increment_weight
        assert math.log10(R) == pytest.approx(exponent)


@pytest.mark.parametrize(
    ("speed", "reference", "outside"),
    [(5, 0, False), (15, 1, False), (4.99, 0, True), (15.01, 0, True), (9, -1.5, True)],
)
def test_outside_the_grid_the_edge_counts_and_the_lookup_says_so(
    speed: float, reference: float, outside: bool
) -> None:
    table = GainTable([5.0, 15.0], [-1.0, 1.0], [SLOW, SLOW, FAST, FAST])
    found = table.lookup(speed, reference)
    assert found.outside is outside
    edge = table.lookup(min(max(speed, 5.0), 15.0), min(max(reference, -1.0), 1.0))
    assert found.gains == edge.gains


def test_axis_of_one_place_is_never_left() -> None:
    table = GainTable([9.0], [0.0], [SLOW])
    assert table.lookup(30.0, 12.0) == (SLOW, False)


def test_integers_come_from_the_nearest_node() -> None:
    assert two_speeds().lookup(9.9).gains[:3] == SLOW[:3]
    assert two_speeds().lookup(10.1).gains[:3] == FAST[:3]


@pytest.mark.parametrize("start", [9.0, 11.0], ids=["from below", "from above"])
def test_integers_do_not_chatter_under_noise_about_the_midpoint(start: float) -> None:
    table = two_speeds()
    first = table.lookup(start).gains[:3]
    noise = np.random.default_rng(0).uniform(-0.45, 0.45, 500)
    assert {table.lookup(10.0 + float(e)).gains[:3] for e in noise} == {first}


def test_integers_change_once_another_node_is_clearly_nearer() -> None:
    table = two_speeds()
    seen = [table.lookup(v).gains.prediction_horizon for v in (9.0, 10.4, 10.6, 9.6, 9.4)]
    assert seen == [40, 40, 20, 20, 40]
    table.lookup(15.0)
    table.reset()
    assert table.lookup(9.9).gains.prediction_horizon == 40


def content(**changes: Any) -> dict[str, Any]:
    """Return the content of a good file with some keys changed; None removes one."""
    good = {"speed": [5.0, 15.0], "gains": [dict(SLOW._asdict()), dict(FAST._asdict())]}
    return {key: value for key, value in {**good, **changes}.items() if value is not None}


def with_gain(key: str, value: Any) -> dict[str, Any]:
    """Return the content of a file whose second entry has one bad value."""
    return content(gains=[dict(SLOW._asdict()), {**FAST._asdict(), key: value}])


BAD = {
    r"missing key 'speed'": content(speed=None),
    r"missing key 'gains'": content(gains=None),
    r"unknown key 'gain'; known are speed, lateral_reference, gains": content(gain=1),
    r"speed = 5 must be a list": content(speed=5),
    r"speed\[1\] = 5.0 must be greater than 5.0": content(speed=[5.0, 5.0]),
    r"speed\[0\] = 'fast' must be a number": content(speed=["fast", 5.0]),
    r"speed\[0\] = nan must lie in \[-10000, 10000\]": content(speed=[math.nan, 5.0]),
    r"provenance = 'mine' must be a mapping of keys": content(provenance="mine"),
    r"gains: 2 entries, the axes ask for 3": content(speed=[1.0, 2.0, 3.0]),
    r"gains: 2 entries, the axes ask for 4": content(lateral_reference=[-1.0, 1.0]),
    r"gains: 'none' entries": content(gains="none"),
    r"gains\[0\] = 7 must have exactly the keys prediction_horizon": content(gains=[7, 7]),
    r"gains\[1\].output_weight = 0 must lie in \[1e-09, 1e\+09\]": with_gain("output_weight", 0),
    r"gains\[1\].increment_weight = '1e-3' must be a number \(YAML needs a point": with_gain(
        "increment_weight", "1e-3"
    ),
    r"gains\[1\].laguerre_pole = 1.0 must lie in \[0, 0.999\]": with_gain("laguerre_pole", 1.0),
    r"gains\[1\].laguerre_terms = 2.5 must be an integer": with_gain("laguerre_terms", 2.5),
    r"gains\[1\].control_horizon = 21 must not exceed prediction_horizon = 20": with_gain(
        "control_horizon", 21
    ),
    r"gains\[1\].prediction_horizon = True must be a number": with_gain("prediction_horizon", True),
}


@pytest.mark.parametrize("complaint", BAD)
def test_bad_file_is_refused_with_file_key_value_and_bound(complaint: str, tmp_path: Path) -> None:
    file = tmp_path / "bad.yaml"
    file.write_text(yaml.safe_dump(BAD[complaint]), encoding="utf-8")
    with pytest.raises(ValueError, match=f"bad.yaml: .*{complaint}"):
        load_gain_table(str(file))


def test_gains_that_make_the_programme_singular_are_refused_with_their_file(tmp_path: Path) -> None:
    file = tmp_path / "singular.yaml"
    row = {**SLOW._asdict(), "laguerre_terms": 15, "laguerre_pole": 0.9}
    file.write_text(yaml.safe_dump({"speed": [9.0], "gains": [row]}), encoding="utf-8")
    with pytest.raises(ValueError, match=r"singular.yaml: gains: laguerre_terms = 15 .*cond\(E\)"):
        make_controller(Choices(controller="paper", gain_table=str(file)))


@many
@given(speed=st.floats(-50, 200), reference=st.floats(-50, 50))
def test_interpolated_gains_stay_between_those_of_the_nodes(speed: float, reference: float) -> None:
    rng = np.random.default_rng(1)
    nodes = [SLOW._replace(output_weight=10 ** rng.uniform(-3, 3)) for _ in range(12)]
    table = GainTable([3.0, 9.0, 15.0, 27.0], [-1.0, 0.0, 1.0], nodes)
    weight = table.lookup(speed, reference).gains.output_weight
    weights = [node.output_weight for node in nodes]
    assert min(weights) * (1 - 1e-12) <= weight <= max(weights) * (1 + 1e-12)


def test_written_table_reads_back() -> None:
    assert gain_table(content()).nodes == [SLOW, FAST]


def test_provenance_changes_no_gains() -> None:
    assert gain_table(content(provenance={"seeds": [1]})).nodes == [SLOW, FAST]
