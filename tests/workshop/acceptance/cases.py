"""Cases of the result table and their thresholds."""

import math
from collections.abc import Callable, Sequence
from functools import partial
from itertools import product
from typing import NamedTuple

import numpy as np

from tests.workshop.acceptance.loop_margins import LOOP_RADIUS, loop_margins
from tests.workshop.acceptance.road_data import DATA
from tests.workshop.acceptance.trials import QUANTITIES, Trial, run_all
from tests.workshop.acceptance.tyre_demand import tyre_demand

BOTH, PREVIEW = ("preview", "paper"), ("preview",)
CARS = ("paper", "ordinary")
Measured = dict[str, float]


class Threshold(NamedTuple):
    """Threshold of a quantity."""

    quantity: str
    """Key of `QUANTITIES`."""
    limit: float = math.inf
    """Infinite: the value is reported without a threshold."""
    at_least: bool = False
    """True if the limit is a lower bound."""

    def holds(self, value: float) -> bool:
        """Check a value against the limit; NaN fails."""
        return value >= self.limit if self.at_least else value <= self.limit


class Case(NamedTuple):
    """One or more rows of the table."""

    group: str
    name: str
    measure: Callable[[str], Measured]
    """Returns the quantities of a controller by name; ValueError if it cannot take the path."""
    thresholds: tuple[Threshold, ...]
    controllers: tuple[str, ...] = BOTH


def worst(trials: Sequence[Trial], quantities: Sequence[str], name: str) -> Measured:
    """Drive all trials and return the maximum of each quantity, and the number that diverged."""
    driven = run_all(trials, name)
    measures = {key: QUANTITIES[key].measure for key in quantities}
    values = {key: [m(d) for d in driven] for key, m in measures.items() if m}
    return {key: float((np.sum if key == "diverged" else np.max)(v)) for key, v in values.items()}


def added(trial: Trial, without: Trial, name: str) -> Measured:
    """Return the largest error of a trial, and its excess over that of another trial."""
    most, least = (worst([t], ["max"], name)["max"] for t in (trial, without))
    return {"max": most, "added": most - least}


def fastest(trial: Trial, low: int, high: int, name: str) -> Measured:
    """Return the highest whole speed in [low, high) [km/h] without contact with a cone."""

    def passes(speed: int) -> bool:
        return worst([trial._replace(speed=speed / 3.6)], ["overlap"], name)["overlap"] <= 0

    if not passes(low):
        return {"fastest": math.nan}
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if passes(middle) else (low, middle)
    return {"fastest": float(low)}


def worst_case(
    group: str,
    name: str,
    trials: Trial | Sequence[Trial],
    thresholds: dict[str, float],
    controllers: tuple[str, ...] = BOTH,
) -> Case:
    """Build a case whose rows are the worst values of some trials."""
    several = (trials,) if isinstance(trials, Trial) else tuple(trials)
    rows = tuple(Threshold(quantity, limit) for quantity, limit in thresholds.items())
    return Case(group, name, partial(worst, several, tuple(thresholds)), rows, controllers)


def scenarios() -> list[Case]:
    """Return the scenarios of the paper."""
    thresholds = {
        "sc1": (1e-4, 1.5),
        "sc2": (1e-3, 1.5),
        "sc3_constant": (1e-2, 2.5),
        "sc3_varying": (1e-3, 1.5),
        "sc3_wind": (1e-3, 1.5),
    }
    return [
        worst_case("scenarios", name, Trial(name), {"mse": mse, "activity": activity})
        for name, (mse, activity) in thresholds.items()
    ]


def straight() -> list[Case]:
    """Return the cases of joining a straight road from the side."""
    grid = product((0.3, 0.5, 0.7, 0.9), (9.0, 15.0, 21.0, 27.0), (0.5, 1.0, 2.0, 3.0, 5.0))
    trials = [Trial("straight", speed=v, offset=d, friction=mu) for mu, v, d in grid]
    thresholds = {"diverged": 0.0, "last_5_s": 0.01, "max": math.inf}
    return [worst_case("straight", "0.5-5 m, 9-27 m/s, friction 0.3-0.9 (80)", trials, thresholds)]


def actuator() -> list[Case]:
    """Return the cases of steering delay and lag."""
    case = partial(worst_case, "actuator")
    return [
        case("sc1, 100 ms delay, configured", Trial(known_delay=0.1), {"mse": 1e-3}),
        case("sc1, 200 ms lag, configured", Trial(known_lag=0.2), {"mse": 2e-3}),
        case("sc1, 50 ms delay, unknown", Trial(delay=0.05), {"mse": math.inf, "last_3_s": 0.01}),
    ]


def noise() -> list[Case]:
    """Return the cases with measurement noise `x1`."""
    still = Trial("straight", speed=0.0, seed=1)
    return [
        worst_case("noise", "sc1, noise", Trial(seed=1), {"mse": 5e-3, "activity": 3.0}),
        worst_case("noise", "standstill, noise", still, {"swing": 0.5}),
    ]


def model_errors() -> list[Case]:
    """Return the cases of a car that differs from the internal model.

    Friction is reduced to 0.5 only on roads that ask for less than half of what the car then
    reaches; see `tyres`.
    """
    axles = ("front_cornering_stiffness", "rear_cornering_stiffness")
    wrong = {
        "mass +20 %": Trial(factors=(("mass", 1.2),)),
        "mass -20 %": Trial(factors=(("mass", 0.8),)),
        "stiffness +30 %": Trial(factors=tuple((axle, 1.3) for axle in axles)),
        "stiffness -30 %": Trial(factors=tuple((axle, 0.7) for axle in axles)),
        "steering 1 deg off": Trial(misaligned_deg=1.0),
    }
    paths = ("sc1", "sc2", "sc3_constant", "sc3_varying", "sc3_wind")
    pairs = [
        (f"{path}, {name}", trial._replace(scenario=path))
        for (name, trial), path in product(wrong.items(), paths)
    ]
    slippery = [
        (f"{path}, friction 0.5", Trial(path, friction=0.5)) for path in ("sc1", "sc1_falcone")
    ]
    return [worst_case("model error", name, t, {"max": 0.5}) for name, t in pairs + slippery]


def roads_from_files() -> list[Case]:
    """Return circuits, trajectories and a motorway, recorded or generated; see `road_data`."""
    files = sorted(DATA.glob("*/*.csv"))
    return [
        worst_case(
            "roads",
            f"{file.stem}, {car} car",
            Trial(str(file.relative_to(DATA)), car),
            {"max": 0.10, "rms": 0.025},
        )
        for car, file in product(("paper", "ordinary"), files)
    ]


def iso3888() -> list[Case]:
    """Return the lane changes between cones, ordinary car."""
    tracks = {"iso3888_1": ("80 km/h", 60, 140), "iso3888_2": ("45 km/h", 40, 90)}
    rows = []
    for track, (speed, low, high) in tracks.items():
        trial = Trial(track, "ordinary")
        search = partial(fastest, trial, low, high)
        rows += [
            worst_case("iso3888", f"{track}, {speed}", trial, {"overlap": 0.0}),
            Case("iso3888", track, search, (Threshold("fastest"),)),
        ]
    return rows


def independent_plant() -> list[Case]:
    """Return the cases of the independent plant on sc1_falcone."""
    nominal = Trial("sc1_falcone", "independent")
    thresholds = {
        "9 m/s": (nominal._replace(speed=9.0), 0.08),
        "11 m/s": (nominal._replace(speed=11.0), 0.08),
        "15 m/s": (nominal._replace(speed=15.0), 0.15),
        "11 m/s, 100 ms delay, unknown": (nominal._replace(speed=11.0, delay=0.1), 0.20),
        "11 m/s, friction 0.5": (nominal._replace(speed=11.0, friction=0.5), 0.08),
        "13 m/s, friction 0.5": (nominal._replace(speed=13.0, friction=0.5), 0.20),
    }
    calm = nominal._replace(speed=11.0)
    gust = partial(added, calm._replace(gust=(1500.0, 400.0)), calm)
    return [
        *(
            worst_case("independent plant", k, t, {"max": limit})
            for k, (t, limit) in thresholds.items()
        ),
        Case(
            "independent plant", "11 m/s, gust", gust, (Threshold("added", 0.08), Threshold("max"))
        ),
    ]


def joining() -> list[Case]:
    """Return the cases of joining a straight road from 3 m with unchanged gains on three plants."""
    return [
        worst_case(
            "joining",
            f"{car} car, 3 m at {v:g} m/s",
            Trial("straight", car, speed=v, offset=3.0),
            {"last_3_s": 0.05},
        )
        for car, v in product(("independent", "paper", "ordinary"), (5.0, 15.0, 27.0))
    ]


def stability() -> list[Case]:
    """Return the cases of the closed loop from 1 to 40 m/s, the worst of each car."""
    thresholds = (
        Threshold("radius", LOOP_RADIUS),
        Threshold("estimator_radius", 0.97),
        Threshold("margin", 0.08, at_least=True),
        Threshold("small_margin"),
        Threshold("large_margin"),
    )
    return [
        Case(
            "eigenvalues",
            f"{car} car, delay {delay:g} s",
            partial(loop_margins, car, delay),
            thresholds,
            PREVIEW,
        )
        for car, delay in product(CARS, (0.0, 0.1, 0.2))
    ]


def tyres() -> list[Case]:
    """Return what roads ask of the tyres, and what the car reaches in a slow ramp."""
    thresholds = tuple(map(Threshold, ("asked", "reached", "demand")))
    axles = ("front_cornering_stiffness", "rear_cornering_stiffness")
    trials = {
        f"{road}, {car} car": Trial(road, car)
        for road, car in product(("sc1", "sc2", "sc3_constant", "sc3_varying"), CARS)
    }
    trials["sc3_constant, stiffness -30 %"] = Trial(
        "sc3_constant", factors=tuple((axle, 0.7) for axle in axles)
    )
    for car in CARS:
        trials[f"sc1 at 20 m/s, {car} car"] = Trial("sc1", car, speed=20.0)
    for road in ("sc1", "sc1_falcone"):
        trials[f"{road}, friction 0.5"] = Trial(road, friction=0.5)
    return [
        Case("tyres", name, partial(tyre_demand, trial), thresholds, PREVIEW)
        for name, trial in trials.items()
    ]


def all_cases() -> list[Case]:
    """Return all cases in the order of the table."""
    parts = (scenarios, straight, actuator, noise, model_errors, roads_from_files, iso3888,
             independent_plant, joining, stability, tyres)  # fmt: skip
    return [case for part in parts for case in part()]
