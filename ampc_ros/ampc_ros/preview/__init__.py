"""The preview formulation of the controller, the default."""
