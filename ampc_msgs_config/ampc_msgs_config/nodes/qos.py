"""Quality of service of the topics."""

from rclpy.qos import DurabilityPolicy, QoSProfile, ReliabilityPolicy

NEWEST = QoSProfile(depth=1, reliability=ReliabilityPolicy.BEST_EFFORT)
"""Subscribers of measurements, for which only the newest sample counts."""
RELIABLE = QoSProfile(depth=1000, reliability=ReliabilityPolicy.RELIABLE)
"""Publishers, and subscribers that need every message. The depth lets a recorder fall behind for
seconds while a drive in lock-step runs ten times as fast as real time."""
COMMAND = QoSProfile(depth=1, reliability=ReliabilityPolicy.RELIABLE)
"""Commands, of which only the newest is used."""
LATCHED = QoSProfile(
    depth=1,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""Path, configuration and stop request: late subscribers receive them, too."""
ANY_PUBLISHER = (LATCHED, COMMAND, NEWEST)
"""Profiles of subscriptions that together receive a topic from every publisher."""


def profile_text(qos: QoSProfile) -> str:
    """Return durability and reliability of a profile, such as `volatile, best effort`."""
    policies = (qos.durability, qos.reliability)
    return ", ".join(policy.name.lower().replace("_", " ") for policy in policies)
