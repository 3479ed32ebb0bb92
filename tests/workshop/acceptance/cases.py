"""The cases of the result table, and the bars that they have to hold: data."""

import math
from collections.abc import Callable, Sequence
from dataclasses import replace
from functools import partial
from itertools import product
from typing import NamedTuple

import numpy as np

from ampc_msgs_config.config import find
from ampc_ros.preview.controller import PreviewMpc
from sim_vehicle.parameters import load_vehicle
from tests.workshop.acceptance.stability import delay_margin, spectral_radius
from tests.workshop.acceptance.trials import DATA, QUANTITIES, Trial, controller, run_all

BOTH, PREVIEW = ("preview", "paper"), ("preview",)
Measured = dict[str, float]


class Bar(NamedTuple):
    """What a case has to hold."""

    quantity: str
    """Key of `QUANTITIES`."""
    limit: float = math.inf
    """Infinite: told, not judged."""
    at_least: bool = False
    """The limit lies below."""

    def holds(self, value: float) -> bool:
        """Whether a value keeps to the limit; nan does not."""
        return value >= self.limit if self.at_least else value <= self.limit


class Case(NamedTuple):
    """One or more rows of the table."""

    group: str
    name: str
    measure: Callable[[str], Measured]
    """From the name of a controller to the quantities; raises ValueError where it cannot drive."""
    bars: tuple[Bar, ...]
    controllers: tuple[str, ...] = BOTH


def worst(trials: Sequence[Trial], quantities: Sequence[str], name: str) -> Measured:
    """Drive all trials; give the largest of each quantity, and how many diverged."""
    driven = run_all(trials, name)
    measures = {key: QUANTITIES[key].measure for key in quantities}
    values = {key: [m(d) for d in driven] for key, m in measures.items() if m}
    return {key: float((np.sum if key == "diverged" else np.max)(v)) for key, v in values.items()}


def added(trial: Trial, without: Trial, name: str) -> Measured:
    """Give the largest error of a trial, and what it exceeds that of another by."""
    most, least = (worst([t], ["max"], name)["max"] for t in (trial, without))
    return {"max": most, "added": most - least}


def fastest(trial: Trial, low: int, high: int, name: str) -> Measured:
    """Give the highest of the whole speeds in [low, high) that touches no cone, by bisection."""

    def passes(speed: int) -> bool:
        return worst([trial._replace(speed=speed / 3.6)], ["overlap"], name)["overlap"] <= 0

    if not passes(low):
        return {"fastest": math.nan}
    while high - low > 1:
        middle = (low + high) // 2
        low, high = (middle, high) if passes(middle) else (low, middle)
    return {"fastest": float(low)}


SPEEDS = (1.0, 3.0, 5.0, 9.0, 15.0, 20.0, 27.0, 33.0, 40.0)
"""Of the table of eigenvalues [m/s]."""


def eigenvalues(car: str, delay: float, name: str) -> Measured:
    """Give spectral radius and margin of unknown delay: at each speed, and the worst."""
    vehicle = load_vehicle(find("vehicles", car))
    steering = replace(vehicle.steering, delay=delay)
    steers = controller(name, car, vehicle.chassis, steering)
    assert isinstance(steers, PreviewMpc)
    loop = (steers, vehicle.chassis, steering)
    radius = {f"radius at {v:g} m/s": spectral_radius(*loop, v) for v in SPEEDS}
    margin = {f"margin at {v:g} m/s": delay_margin(*loop, v) for v in SPEEDS}
    return {"radius": max(radius.values()), "margin": min(margin.values()), **radius, **margin}


def driven(
    group: str,
    name: str,
    trials: Trial | Sequence[Trial],
    bars: dict[str, float],
    controllers: tuple[str, ...] = BOTH,
) -> Case:
    """Make the case whose rows are the worst of some trials."""
    several = (trials,) if isinstance(trials, Trial) else tuple(trials)
    rows = tuple(Bar(quantity, limit) for quantity, limit in bars.items())
    return Case(group, name, partial(worst, several, tuple(bars)), rows, controllers)


def scenarios() -> list[Case]:
    """The paper's scenarios."""
    bars = {
        "sc1": (1e-4, 1.5),
        "sc2": (1e-3, 1.5),
        "sc3_constant": (1e-2, 2.5),
        "sc3_varying": (1e-3, 1.5),
        "sc3_wind": (1e-3, 1.5),
    }
    return [
        driven("scenarios", name, Trial(name), {"mse": mse, "activity": activity})
        for name, (mse, activity) in bars.items()
    ]


def straight() -> list[Case]:
    """A straight road, joined from its side."""
    grid = product((0.3, 0.5, 0.7, 0.9), (9.0, 15.0, 21.0, 27.0), (0.5, 1.0, 2.0, 3.0, 5.0))
    trials = [Trial("straight", speed=v, offset=d, friction=mu) for mu, v, d in grid]
    bars = {"diverged": 0.0, "last_5_s": 0.01, "max": math.inf}
    return [driven("straight", "0.5-5 m, 9-27 m/s, friction 0.3-0.9 (80)", trials, bars)]


def actuator() -> list[Case]:
    """Delay and lag of the steering."""
    case = partial(driven, "actuator")
    return [
        case("sc1, 100 ms delay, configured", Trial(known_delay=0.1), {"mse": 1e-3}),
        case("sc1, 200 ms lag, configured", Trial(known_lag=0.2), {"mse": 2e-3}),
        case("sc1, 50 ms delay, unknown", Trial(delay=0.05), {"mse": math.inf, "last_3_s": 0.01}),
    ]


def noise() -> list[Case]:
    """Measurement noise x1."""
    still = Trial("straight", speed=0.0, seed=1)
    return [
        driven("noise", "sc1, noise", Trial(seed=1), {"mse": 5e-3, "activity": 3.0}),
        driven("noise", "standstill, noise", still, {"swing": 0.5}),
    ]


def wrong_beliefs() -> list[Case]:
    """A car that is not the one which the controller knows; friction 0.5 within 85 % of it."""
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
    return [driven("wrong belief", name, t, {"max": 0.5}) for name, t in pairs + slippery]


def recorded_roads() -> list[Case]:
    """Circuits, the authors' trajectories and a motorway, where the data are there."""
    files = sorted(DATA.glob("*/*.csv"))
    return [
        driven(
            "roads",
            f"{file.stem}, {car} car",
            Trial(str(file.relative_to(DATA)), car),
            {"max": 0.10, "rms": 0.025},
        )
        for car, file in product(("paper", "ordinary"), files)
    ]


def iso3888() -> list[Case]:
    """Lane changes between cones, ordinary car."""
    tracks = {"iso3888_1": ("80 km/h", 60, 140), "iso3888_2": ("45 km/h", 40, 90)}
    rows = []
    for track, (speed, low, high) in tracks.items():
        trial = Trial(track, "ordinary")
        search = partial(fastest, trial, low, high)
        rows += [
            driven("iso3888", f"{track}, {speed}", trial, {"overlap": 0.0}),
            Case("iso3888", track, search, (Bar("fastest"),)),
        ]
    return rows


def independent_plant() -> list[Case]:
    """A plant that nobody here wrote, on sc1_falcone; and joining a road from 3 m."""
    nominal = Trial("sc1_falcone", "independent")
    bars = {
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
        *(driven("independent plant", k, t, {"max": limit}) for k, (t, limit) in bars.items()),
        Case("independent plant", "11 m/s, gust", gust, (Bar("added", 0.08), Bar("max"))),
    ]


def joining() -> list[Case]:
    """The same gains join a straight road from 3 m, on three plants."""
    return [
        driven(
            "joining",
            f"{car} car, 3 m at {v:g} m/s",
            Trial("straight", car, speed=v, offset=3.0),
            {"last_3_s": 0.05},
        )
        for car, v in product(("independent", "paper", "ordinary"), (5.0, 15.0, 27.0))
    ]


def stability() -> list[Case]:
    """Eigenvalues of car and controller from 1 to 40 m/s, the worst of them."""
    bars = (Bar("radius", 0.97), Bar("margin", 0.08, at_least=True))
    return [
        Case(
            "eigenvalues",
            f"{car} car, delay {delay:g} s",
            partial(eigenvalues, car, delay),
            bars,
            PREVIEW,
        )
        for car, delay in product(("paper", "ordinary"), (0.0, 0.1, 0.2))
    ]


def all_cases() -> list[Case]:
    """The whole table, in order."""
    parts = (scenarios, straight, actuator, noise, wrong_beliefs, recorded_roads, iso3888,
             independent_plant, joining, stability)  # fmt: skip
    return [case for part in parts for case in part()]
