"""Figures of the reproduction, as SVG text: labelled at the lines, legible on a phone."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

from ampc_msgs_config.metrics import ticks
from ampc_msgs_config.types import Array
from launch_scripts.reporting.style import CONTROLLER_STYLES, INK, label_ends, stack
from launch_scripts.run.simulated import SimulatedDrive
from launch_scripts.study.bench_pso_figure import STYLES
from launch_scripts.study.bench_pso_tables import REPORTED
from launch_scripts.study.cases import CONTENDERS
from launch_scripts.study.pso_yardsticks import GENERATIONS


def draw_adaptation(runs: Mapping[str, SimulatedDrive]) -> Figure:
    """Draw which gains were in use: horizons and terms, then Q / R."""
    figure, axes = stack([1.5, 1.3, 1.3, 1.5])
    fields = (
        ("prediction_horizon", "N_p [ticks]"),
        ("control_horizon", "N_c [ticks]"),
        ("laguerre_terms", "N"),
    )
    shown = {n: d for n, d in runs.items() if n in ("paper", "paper_pso", "preview")}
    last: dict[str, dict[str, float]] = {label: {} for label in ("N_p", "N_c", "N", "ratio")}
    for name, driven in shown.items():
        color, line = CONTROLLER_STYLES[name]
        time = ticks(driven.drive)
        for ax, (field, label) in zip(axes, fields, strict=False):
            values = np.array([getattr(d, field) for d in driven.diagnosis])
            ax.plot(time, values, linestyle=line, color=color, drawstyle="steps-post")
            ax.set_ylabel(label)
            last[label.split()[0]][CONTENDERS[name]] = float(values[-1])
        ratio = np.array([d.output_weight / d.increment_weight for d in driven.diagnosis])
        axes[3].plot(time, ratio, linestyle=line, color=color)
        last["ratio"][CONTENDERS[name]] = float(ratio[-1])
    axes[3].set_yscale("log")
    axes[3].set_ylabel("Q / R")
    axes[3].set_xlabel("time [s]")
    for ax in axes[:3]:
        ax.set_ylim(0, None)
    figure.draw_without_rendering()
    colors = {CONTENDERS[name]: CONTROLLER_STYLES[name][0] for name in shown}
    for ax, ends in zip(axes, last.values(), strict=True):
        label_ends(ax, ends, colors)
    return figure


def draw_sphere(curves: Mapping[str, Array]) -> Figure:
    """Draw medians and quartiles of the best value over the generations, and the paper's."""
    figure, (ax,) = stack([3.4])
    ax.set_yscale("log")
    ends = {}
    for name, values in curves.items():
        color, line = STYLES[name]
        low, middle, high = np.percentile(values, (25, 50, 75), axis=0)
        generation = np.arange(len(middle))
        ax.fill_between(generation, low, high, color=color, alpha=0.15, linewidth=0)
        ax.plot(generation, middle, line, color=color, linewidth=1.6)
        ends[name] = float(middle[-1])
        if name in REPORTED:
            style: dict[str, Any] = {"clip_on": False, "markersize": 9, "zorder": 5, "mew": 1}
            ax.plot(GENERATIONS, REPORTED[name], "*", color=color, mec=INK, **style)
    ax.set_xlabel("generation")
    ax.set_ylabel("best value so far")
    figure.draw_without_rendering()
    label_ends(ax, ends, {name: STYLES[name][0] for name in curves})
    return figure


def draw_lines(
    curves: Mapping[str, tuple[Sequence[float], Sequence[float]]],
    labels: tuple[str, str],
    levels: Mapping[str, float] | None = None,
    log_x: bool = False,
) -> Figure:
    """Draw some labelled curves on a logarithmic axis, and levels to compare them with."""
    figure, (ax,) = stack([2.6])
    palette = ("#0072B2", "#D55E00", "#009E73", "#CC79A7", "#000000", "#E69F00")
    colors = dict(zip((*curves, *(levels or {})), palette * 2, strict=False))
    ax.set_yscale("log")
    ax.yaxis.set_major_locator(LogLocator(subs=(1.0, 2.0, 5.0)))
    ax.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
    ax.yaxis.set_minor_formatter(NullFormatter())
    if log_x:
        ax.set_xscale("log")
    for name, (a, b) in curves.items():
        ax.plot(a, b, ".-", color=colors[name])
    for name, level in (levels or {}).items():
        ax.axhline(level, color=colors[name], linestyle=":", linewidth=1.3)
    ax.set_xlabel(labels[0])
    ax.set_ylabel(labels[1])
    figure.draw_without_rendering()
    ends = {name: float(b[-1]) for name, (_, b) in curves.items()} | dict(levels or {})
    label_ends(ax, ends, colors)
    return figure
