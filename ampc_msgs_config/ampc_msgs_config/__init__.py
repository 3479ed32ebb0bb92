"""What the car and the controller talk about: types, parameters, paths, scenarios, topics, bags."""

__version__ = "0.1.0"
