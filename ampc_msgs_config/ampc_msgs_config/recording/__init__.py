"""Writing MCAP bags."""
