"""The result table: thresholds that are met or not, and paths that a controller cannot take."""

import math
from functools import partial

from tests.workshop.acceptance.acceptance import (
    measure_case,
    result_table,
    results_to_json,
    rows_of,
)
from tests.workshop.acceptance.cases import Case, Threshold, added, all_cases, fastest, worst
from tests.workshop.acceptance.trials import QUANTITIES, Trial

CIRCLE = Trial("circle")


def case(limit: float) -> Case:
    """Return a case on a circle, which the paper's formulation cannot take."""
    return Case("shapes", "circle", partial(worst, [CIRCLE], ["max"]), (Threshold("max", limit),))


def test_a_controller_that_cannot_take_a_path_gets_a_dash() -> None:
    cases = [case(0.5)]
    measurements = {(0, name): measure_case(cases[0], name) for name in cases[0].controllers}
    assert measurements[0, "preview"]["max"] < 0.5
    assert measurements[0, "paper"] == {}
    assert result_table(rows_of(cases, measurements)).splitlines()[-1].endswith(" | - | yes |")
    assert results_to_json(cases, measurements)[0]["paper"] == {}


def test_only_the_preview_has_to_meet_the_thresholds() -> None:
    good, bad = {"max": 0.1}, {"max": 2.0}
    held = rows_of([case(0.5)], {(0, "preview"): good, (0, "paper"): bad})[0]
    failed = rows_of([case(0.5)], {(0, "preview"): bad, (0, "paper"): good})[0]
    reported = rows_of([case(math.inf)], {(0, "preview"): bad, (0, "paper"): good})[0]
    assert (held.holds, failed.holds, reported.holds) == (True, False, True)
    assert (held.cells[-1], failed.cells[-1], reported.cells[-1]) == ("yes", "NO", "")


def test_a_missing_value_meets_no_threshold() -> None:
    assert not rows_of([case(0.5)], {})[0].holds
    assert not Threshold("margin", 0.08, at_least=True).holds(math.nan)


def test_every_threshold_has_a_quantity_and_every_case_a_unique_name() -> None:
    cases = all_cases()
    assert {threshold.quantity for c in cases for threshold in c.thresholds} <= set(QUANTITIES)
    names = [(c.group, c.name, c.thresholds) for c in cases]
    assert len(names) == len(set(names))


def test_bisection_finds_the_highest_speed_that_touches_no_cone() -> None:
    track = Trial("iso3888_2", "ordinary")
    speed = fastest(track, 40, 60, "preview")["fastest"]
    at, above = (
        worst([track._replace(speed=v / 3.6)], ["overlap"], "preview")["overlap"]
        for v in (speed, speed + 1)
    )
    assert at <= 0 < above
    assert speed >= 45


def test_the_error_added_by_wind_is_the_difference_of_two_drives() -> None:
    windy, calm = Trial("sc3_wind"), Trial("sc3_varying")
    measured = added(windy, calm, "preview")
    alone = worst([calm], ["max"], "preview")["max"]
    assert measured["max"] - measured["added"] == alone
