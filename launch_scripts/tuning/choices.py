"""Choices of `tune.py`, without the code that carries them out: `--help` needs only these."""

FORMULATIONS = ("paper", "preview")
"""Formulations whose gains are tuned; `task.PRESETS` has their default tasks."""
METHOD_NAMES = ("pso", "paper", "de", "cma", "random")
"""Search methods; `methods.SEARCH_METHODS` has their functions."""
SCHEDULES = ("network", "anfis")
"""Kinds of learned schedules."""
SYMBOLS = ("N_p", "N_c", "N", "alpha", "Q", "R")
"""Symbols of the paper, in the order of the fields of `Gains`."""
SETTINGS = "table3"
"""Shipped controller settings with which gains are tuned by default."""
FITNESS = {
    "paper": "mean squared error [m^2] of a step to the node's lateral reference, 10 s",
    "robust": "geometric mean of average and worst, over drives on a lane change and of joining a "
    "road by cars that differ from the model, of the mean squared error + mean (v T Delta u)^2 "
    "+ (5 mm)^2 [m^2]",
}
