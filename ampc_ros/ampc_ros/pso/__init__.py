"""Particle swarm optimisation, Eqs. (31)-(34)."""
