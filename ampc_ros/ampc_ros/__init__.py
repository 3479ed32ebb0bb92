"""What the controller believes and decides: model, prediction, constraints, QP, gains and nodes."""
