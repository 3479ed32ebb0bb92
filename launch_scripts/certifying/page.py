"""Page of a certificate: verdict, checks, and figures over speed."""

from collections.abc import Sequence
from itertools import cycle

import numpy as np
from matplotlib.axes import Axes
from matplotlib.figure import Figure

from launch_scripts.certifying.certificate import Check, Result, with_unit
from launch_scripts.reporting.pages import markdown_table, render
from launch_scripts.reporting.style import BLUE, ORANGE, stack, svg

MARKS = ("o", "s", "^", "v", "D")
COLORS = (BLUE, ORANGE, "#009E73", "#CC79A7", "#E69F00")
"""Colour-blind safe (Okabe and Ito)."""
PANELS = {
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
FINEST = 1.0e-4
"""Smallest value on a logarithmic axis."""
HEIGHT = 1.9
"""Height of a panel [inch]."""


def figures(result: Result) -> dict[str, Figure]:
    """Return the figures of a certificate by name."""
    return {name: draw(result, panels) for name, panels in PANELS.items()}


def draw(result: Result, panels: Sequence[tuple[str, tuple[str, ...], str]]) -> Figure:
    """Return a figure over speed; a dashed line is a bound, a cross at the top a lost car."""
    checks = {check.bound.key: check for check in result.checks}
    figure, axes = stack([HEIGHT] * len(panels))
    for ax, (label, keys, scale) in zip(axes, panels, strict=True):
        ax.set_yscale(scale)
        ax.set_ylabel(label)
        ax.margins(x=0.02)
        styles = zip(keys, cycle(COLORS), cycle(MARKS), strict=False)
        for key, color, mark in styles:
            draw_check(ax, result, checks[key], (color, mark))
        draw_bounds(ax, [checks[key].bound.limit for key in keys])
        ax.legend(fontsize=7, loc="lower left", bbox_to_anchor=(0.0, 1.0), ncols=3, frameon=False)
    axes[-1].set_xlabel("speed [m/s]")
    return figure


def draw_bounds(ax: Axes, limits: Sequence[float]) -> None:
    """Draw the bounds of a panel; each has the colour of its curve unless all are equal."""
    for limit, color in zip(limits, cycle(COLORS), strict=False):
        shown = color if len(set(limits)) > 1 else "#777777"
        ax.axhline(limit, color=shown, linestyle="--", linewidth=1)


def draw_check(ax: Axes, result: Result, check: Check, style: tuple[str, str]) -> None:
    """Draw one check; values that break the bound have a filled mark."""
    color, mark = style
    values = np.array(check.values)
    shown = np.maximum(values, FINEST) if ax.get_yscale() == "log" else values
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
            check.bound.reason,
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


def shipped_rows(results: Sequence[Result]) -> list[str]:
    """Return the table of the shipped results as lines of Markdown."""
    heads = ("gain table", "controller", "car", "certified", "delay margin [s]", "gain margin",
             "does not hold")  # fmt: skip
    rows = []
    for result in results:
        worst = {check.bound.key: check.values[check.worst] for check in result.checks}
        broken = [
            f"{check.bound.key.replace('_', ' ')} ({len(check.failed)} of {len(result.speeds)})"
            for check in result.checks
            if check.failed
        ]
        choices = result.subject.choices
        rows.append(
            (
                result.subject.gain_table.stem,
                f"{choices.controller}, {choices.settings}",
                choices.vehicle,
                "yes" if result.certified else "NO",
                with_unit(worst["delay_margin"], ""),
                with_unit(worst["gain_margin"], ""),
                ", ".join(broken),
            )
        )
    return markdown_table(heads, rows, "lllrrl")
