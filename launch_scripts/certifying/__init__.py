"""Certification: what a gain table does with a car, checked against fixed bounds."""
