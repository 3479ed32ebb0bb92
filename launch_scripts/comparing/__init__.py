"""Comparison of controllers over scenarios."""
