"""Fault injection: schedule, kinds, and their effects on messages."""
