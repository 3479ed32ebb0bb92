"""Switches between the paper and its authors' code, without the code that acts on them."""

DRIVE_SWITCHES = ("tyre", "plant", "speed", "horizon", "solver")
"""Differences between paper and authors' code that change a drive; the page explains each."""
SEARCH_SWITCHES = ("schedule", "sizes", "bounds", "fitness")
"""Differences between paper and authors' code that change a search."""
STUDY_SWITCHES = (*DRIVE_SWITCHES, *SEARCH_SWITCHES)
WEAK = "weak_baselines"
"""Reading of the hand-set gains that results in the order and the ratios of the paper."""
Switches = frozenset[str]
"""Names of the switches that are set to the authors' code, and WEAK in that reading."""
