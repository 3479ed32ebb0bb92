"""Identification of a car from a bag: reading, result files, page."""
