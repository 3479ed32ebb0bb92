"""Reference paths: splines, progress along them, CSV files, curve shapes."""
