"""The last station before the car: passes commands on, or stops the car in its lane."""
