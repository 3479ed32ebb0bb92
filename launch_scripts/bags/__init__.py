"""Reading MCAP bags."""
