"""Quality of service of the topics."""

from rclpy.duration import Duration
from rclpy.qos import DurabilityPolicy, LivelinessPolicy, QoSProfile, ReliabilityPolicy

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
DEADLINE_PERIODS, LEASE_PERIODS = 2.5, 3.0
"""Deadline and lease of the commands of a controller [periods]."""


def watched_command(deadline: float, lease: float) -> QoSProfile:
    """Return `COMMAND` with a deadline [s] and a lease [s] that each message renews.

    Note:
        With an automatic lease, a process whose main thread hangs would count as alive.
    """
    return QoSProfile(
        depth=COMMAND.depth,
        reliability=COMMAND.reliability,
        deadline=Duration(seconds=deadline),
        liveliness=LivelinessPolicy.MANUAL_BY_TOPIC,
        liveliness_lease_duration=Duration(seconds=lease),
    )


def controller_command(period: float) -> QoSProfile:
    """Return the profile of `steering_command` from a controller with a period [s]."""
    return watched_command(DEADLINE_PERIODS * period, LEASE_PERIODS * period)


def profile_text(qos: QoSProfile) -> str:
    """Return durability and reliability of a profile, such as `volatile, best effort`."""
    policies = (qos.durability, qos.reliability)
    return ", ".join(policy.name.lower().replace("_", " ") for policy in policies)
