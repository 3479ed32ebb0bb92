"""Page of a certificate: verdict, checks, and figures over speed."""

from collections.abc import Mapping, Sequence
from itertools import cycle
from typing import Any

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from launch_scripts.certifying.bounds import ACCEPTANCE_BOUNDS
from launch_scripts.certifying.certificate import Check, Result, with_unit
from launch_scripts.reporting.pages import markdown_table, render
from launch_scripts.reporting.style import BLUE, ORANGE, stack, svg

MARKS = ("o", "s", "^", "v", "D")
CHECK_COLORS = (BLUE, ORANGE, "#009E73", "#CC79A7", "#E69F00")
"""Colour-blind safe (Okabe and Ito)."""
FIGURE_PANELS = {
    "margins": (
        ("delay margin [s]", ("delay_margin",), "linear"),
        ("gain margin [factor]", ("gain_margin", "gain_reduction_margin"), "linear"),
        ("time constant [s]", ("loop_time_constant", "estimator_time_constant"), "linear"),
    ),
    "errors": (
        ("largest error [m]", ("lane_change", "gust", "friction", "noise", "spread"), "log"),
        ("overshoot [m]", ("joining_overshoot", "friction_overshoot", "spread_overshoot"), "log"),
        ("error at the end [m]", ("joining_rest", "friction_rest", "spread_rest"), "log"),
        ("step due to the\ngains [m/s$^2$]", ("gain_step",), "log"),
    ),
}
"""Panels of each figure: label, keys of the checks, scale."""
LEAST_SHOWN = 1.0e-4
"""Smallest value on a logarithmic axis."""
HEIGHT = 1.9
"""Height of a panel [inch]."""


def figures(result: Result) -> dict[str, Figure]:
    """Return the figures of a certificate by name."""
    return {name: draw_panels(result, panels) for name, panels in FIGURE_PANELS.items()}


def draw_panels(result: Result, panels: Sequence[tuple[str, tuple[str, ...], str]]) -> Figure:
    """Return a figure over speed; a dashed line is a bound, a cross at the top a lost car."""
    checks = {check.bound.key: check for check in result.checks}
    figure, axes = stack([HEIGHT] * len(panels))
    for ax, (label, keys, scale) in zip(axes, panels, strict=True):
        ax.set_yscale(scale)
        ax.set_ylabel(label)
        ax.margins(x=0.02)
        styles = zip(keys, cycle(CHECK_COLORS), cycle(MARKS), strict=False)
        for key, color, mark in styles:
            draw_check(ax, result, checks[key], (color, mark))
        draw_bounds(ax, [checks[key].bound.limit for key in keys])
        ax.legend(fontsize=7, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, frameon=False)
    axes[-1].set_xlabel("speed [m/s]")
    return figure


def draw_bounds(ax: Axes, limits: Sequence[float]) -> None:
    """Draw the bounds of a panel; each has the colour of its curve unless all are equal."""
    for limit, color in zip(limits, cycle(CHECK_COLORS), strict=False):
        shown = color if len(set(limits)) > 1 else "#777777"
        ax.axhline(limit, color=shown, linestyle="--", linewidth=1)


def draw_check(ax: Axes, result: Result, check: Check, style: tuple[str, str]) -> None:
    """Draw one check; values that break the bound have a filled mark."""
    color, mark = style
    values = np.array(check.values)
    shown = np.maximum(values, LEAST_SHOWN) if ax.get_yscale() == "log" else values
    finite = np.isfinite(values)
    shown = np.where(finite, shown, np.nan)
    label = check.bound.key.replace("_", " ")
    ax.plot(result.speeds, shown, f"-{mark}", color=color, markersize=3, linewidth=1, label=label,
            markerfacecolor="none")  # fmt: skip
    failed = list(check.failed)
    ax.plot(result.speeds[failed], shown[failed], mark, color=color, markersize=4)
    for v in result.speeds[~finite]:
        ax.plot(v, 1.0, "x", color=color, markersize=5, transform=ax.get_xaxis_transform())


def rows_of(result: Result) -> list[tuple[str, ...]]:
    """Return quantity, bound, worst value, its speed, verdict and reason of each check."""
    return [
        (
            check.bound.title,
            f"{'>=' if check.bound.at_least else '<='} "
            f"{with_unit(check.bound.limit, check.bound.unit)}",
            with_unit(check.values[check.worst], check.bound.unit),
            f"{result.speeds[check.worst]:g} m/s",
            f"{len(result.speeds) - len(check.failed)} of {len(result.speeds)}",
            "fail" if check.failed else "pass",
            check.bound.reason.replace("`", ""),
        )
        for check in result.checks
    ]


def page(result: Result, command: str, file: str) -> str:
    """Return the page of a certificate.

    Args:
        result: All checks.
        command: Command that repeats it.
        file: Name of the certificate file.
    """
    return render(
        "certifying/certificate.html",
        result=result,
        rows=rows_of(result),
        command=command,
        file=file,
        figures={name: svg(figure) for name, figure in figures(result).items()},
    )


def bounds_table() -> list[str]:
    """Return the table of all bounds with their reasons as lines of Markdown."""
    heads = ("key", "quantity, at every speed", "bound", "reason")
    rows = [
        (
            f"`{bound.key}`",
            bound.title,
            f"{'>=' if bound.at_least else '<='} {with_unit(bound.limit, bound.unit)}",
            bound.reason,
        )
        for bound in ACCEPTANCE_BOUNDS
    ]
    return markdown_table(heads, rows, "l")


def results_table(documents: Sequence[Mapping[str, Any]]) -> list[str]:
    """Return the table of several certificates as lines of Markdown.

    Args:
        documents: Contents of certificate files.
    """
    heads = ("gain table", "controller", "settings", "car", "speeds [m/s]", "certified",
             "delay margin [s]", "gain margin", "what does not hold (speeds)")  # fmt: skip
    rows = []
    for each in documents:
        checks = {check["key"]: check for check in each["checks"]}
        failed = {
            key.replace("_", " "): count_failed(check)
            for key, check in checks.items()
            if not check["holds"]
        }
        margins = [checks[key]["worst"] for key in ("delay_margin", "gain_margin")]
        rows.append(
            (
                each["gain_table"],
                each["identity"]["controller"],
                each["settings"],
                each["vehicle"],
                f"{each['speeds'][0]:g} to {each['speeds'][-1]:g}",
                "yes" if each["certified"] else "**no**",
                *("unstable" if margin is None else f"{margin:g}" for margin in margins),
                "; ".join(f"{key} ({n} of {len(each['speeds'])})" for key, n in failed.items()),
            )
        )
    return markdown_table(heads, rows, "lllllrrl")


def count_failed(check: Mapping[str, Any]) -> int:
    """Return at how many speeds a check of a certificate file fails."""
    bound = next(bound for bound in ACCEPTANCE_BOUNDS if bound.key == check["key"])
    return sum(value is None or not bound.holds(value) for value in check["values"])
