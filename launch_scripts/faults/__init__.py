"""Injected faults: schedule, kinds, changes to messages."""
