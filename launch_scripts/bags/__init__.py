"""Reading bags."""
