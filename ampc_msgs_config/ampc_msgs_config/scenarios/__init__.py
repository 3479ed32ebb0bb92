"""Scenarios: road, speed profile, wind, start."""
