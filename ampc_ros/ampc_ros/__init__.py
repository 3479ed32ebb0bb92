"""The controller: model, prediction, constraints, QP, gains, supervision and nodes.

The names of the Python interface are imported when they are first used (PEP 562), so that an import
of this package stays cheap.
"""

from importlib import import_module
from typing import TYPE_CHECKING, Any

import ampc_msgs_config  # noqa: F401 - sets one BLAS thread before numpy is imported

if TYPE_CHECKING:
    from ampc_ros.api import AdaptiveMpc, VehicleModel, load_vehicle, make_state

__all__ = ["AdaptiveMpc", "VehicleModel", "load_gains", "load_vehicle", "make_state"]


def __getattr__(name: str) -> Any:
    """Import a name of the Python interface at its first use."""
    if name in __all__:
        return getattr(import_module("ampc_ros.api"), name)
    raise AttributeError(f"module 'ampc_ros' has no attribute {name!r}")
