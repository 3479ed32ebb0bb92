"""Vehicle files from the data sheet of a car."""
