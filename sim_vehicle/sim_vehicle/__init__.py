"""Simulated car: tyres, dynamics, aerodynamics, actuators and driver, with or without ROS."""

import ampc_msgs_config  # noqa: F401 - sets one BLAS thread before numpy is imported
