"""The report of a drive: metrics, plots, page."""
