"""The result table says what holds, what does not, and who could not drive."""

import math
from functools import partial

from tests.workshop.acceptance.acceptance import answer, content, markdown, rows_of
from tests.workshop.acceptance.cases import Bar, Case, added, all_cases, fastest, worst
from tests.workshop.acceptance.trials import QUANTITIES, Trial

CIRCLE = Trial("circle")


def case(limit: float) -> Case:
    """Give a case on a circle, which the paper's formulation cannot drive."""
    return Case("shapes", "circle", partial(worst, [CIRCLE], ["max"]), (Bar("max", limit),))


def test_who_cannot_drive_a_path_gets_a_dash_and_no_number() -> None:
    cases = [case(0.5)]
    answers = {(0, name): answer(cases[0], name) for name in cases[0].controllers}
    assert answers[0, "preview"]["max"] < 0.5
    assert answers[0, "paper"] == {}
    assert markdown(rows_of(cases, answers)).splitlines()[-1].endswith(" | - | yes |")
    assert content(cases, answers)[0]["paper"] == {}


def test_only_the_preview_is_held_to_the_bars() -> None:
    good, bad = {"max": 0.1}, {"max": 2.0}
    held = rows_of([case(0.5)], {(0, "preview"): good, (0, "paper"): bad})[0]
    failed = rows_of([case(0.5)], {(0, "preview"): bad, (0, "paper"): good})[0]
    told = rows_of([case(math.inf)], {(0, "preview"): bad, (0, "paper"): good})[0]
    assert (held.holds, failed.holds, told.holds) == (True, False, True)
    assert (held.cells[-1], failed.cells[-1], told.cells[-1]) == ("yes", "NO", "")


def test_a_number_that_is_missing_holds_no_bar() -> None:
    assert not rows_of([case(0.5)], {})[0].holds
    assert not Bar("margin", 0.08, at_least=True).holds(math.nan)


def test_every_bar_names_a_quantity_and_every_case_is_named_once() -> None:
    cases = all_cases()
    assert {bar.quantity for c in cases for bar in c.bars} <= set(QUANTITIES)
    names = [(c.group, c.name, c.bars) for c in cases]
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


def test_what_wind_adds_is_the_difference_of_two_drives() -> None:
    windy, calm = Trial("sc3_wind"), Trial("sc3_varying")
    measured = added(windy, calm, "preview")
    alone = worst([calm], ["max"], "preview")["max"]
    assert measured["max"] - measured["added"] == alone
