"""The paper's formulation of the controller."""
