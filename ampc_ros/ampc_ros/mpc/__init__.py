"""Parts of both MPC formulations: model, prediction, constraints, QP solvers, gains."""
