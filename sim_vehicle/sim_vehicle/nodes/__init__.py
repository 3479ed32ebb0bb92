"""Simulator node."""
