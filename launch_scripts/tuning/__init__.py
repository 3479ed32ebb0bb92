"""Offline tuning of gain tables."""
