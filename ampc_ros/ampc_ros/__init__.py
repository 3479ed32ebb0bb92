"""What the controller believes and decides: model, prediction, constraints, QP, gains and nodes."""

import ampc_msgs_config  # noqa: F401 - sets one BLAS thread before numpy is imported
