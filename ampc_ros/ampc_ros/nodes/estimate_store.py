"""The estimates of the car, stored by a node for its next drive."""

import threading

from rclpy.impl.rcutils_logger import RcutilsLogger

from ampc_ros.configuration import CarDifference, Configuration
from ampc_ros.estimation.stored_difference import (
    read_difference,
    remove_difference,
    store_difference,
)
from ampc_ros.supervision.supervisor import Supervisor

STORE_PERIOD, STORE_TIMEOUT = 60.0, 1.0
"""Time between two stored estimates of the car, and for the last ones [s]."""


class EstimateStore:
    """Reads the file of estimates at the start, and writes it while the car drives."""

    def __init__(self, logger: RcutilsLogger, *, is_used: bool) -> None:
        """Create the store; one that is not used never touches a file."""
        self.logger, self.is_used = logger, is_used
        self.thread: threading.Thread | None = None

    def with_stored(self, config: Configuration) -> Configuration:
        """Return a configuration that starts with the stored estimates of its car, if any."""
        if not (self.is_used and config.settings.adaptation):
            return config
        try:
            difference = read_difference(config)
        except ValueError as error:
            self.logger.warning(f"stored estimates are not used: {error}")
            return config
        if difference:
            values = ", ".join(f"{k} {v:.3g}" for k, v in difference._asdict().items())
            self.logger.info(f"stored estimates, differences from the vehicle file: {values}")
        return config._replace(difference=difference)

    def store(self, supervisor: Supervisor) -> None:
        """Store the estimates from a thread: a slow disk must not delay a command."""
        adaptation = supervisor.adaptation
        if adaptation and adaptation.is_latency_known and self.is_used:
            values = supervisor.config, adaptation.difference
            self.thread = threading.Thread(target=self._write, args=values, daemon=True)
            self.thread.start()

    def _write(self, config: Configuration, difference: CarDifference) -> None:
        try:
            store_difference(config, difference)
        except OSError as error:
            self.logger.warning(f"the estimates of the car are not stored: {error}", once=True)

    def remove(self, config: Configuration) -> None:
        """Remove the stored estimates.

        Raises:
            OSError: The file cannot be removed.
        """
        if self.is_used:
            remove_difference(config)

    def wait(self) -> None:
        """Wait until the last estimates are written, not for ever."""
        if self.thread:
            self.thread.join(STORE_TIMEOUT)
