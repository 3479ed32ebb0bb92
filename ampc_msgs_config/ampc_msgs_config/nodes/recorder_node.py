"""Node `recorder`: writes every topic of the contract to a bag, and counts what it did not get.

It says `recording to <folder>` when all of its subscriptions stand; from then on `metadata.yaml`
lies in the folder. SIGINT and SIGTERM end it, after all that was published before has come in.
"""

import signal
import sys
import time
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import Any

import rclpy
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.clock import Clock, ClockType
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.exceptions import ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, QoSProfile
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription

from ampc_msgs_config import topics
from ampc_msgs_config.nodes import qos
from ampc_msgs_config.recording.arrivals import Arrival, Arrivals
from ampc_msgs_config.recording.bag_writer import (
    BEST_EFFORT,
    EVERYTHING,
    LATCHED_EVERYTHING,
    Recording,
)
from ampc_msgs_config.recording.message_types import TYPES, message_class, type_name_of
from ampc_msgs_config.recording.transforms import TF_MESSAGE, footprint_transform, pose_transform
from ampc_msgs_config.types import NANOSECONDS

WRITE_PERIOD = 0.3
"""Wall time between two batches [s]."""
HOLD = 0.2
"""Wall time for which a message waits for others that were published before it [s]."""
QUIET = 0.3
"""Wall time without a message after which nothing is in flight any more [s]."""
CONTRACT: dict[str, Any] = {
    name: message_class(type_) for name, type_ in TYPES.items() if name != topics.MARKERS
}
"""Markers show again what the others say, and would be three quarters of a bag."""
LATCHED = {topics.REFERENCE_PATH, topics.STOP_REQUEST, topics.TF_STATIC, *topics.CONFIGURATIONS}
DESCRIBING = (*topics.QUANTITIES, topics.PREDICTED_PATH, topics.TICK)
"""What the controller publishes about its last command."""
SHARED_TOPICS = {topics.PARAMETER_EVENTS, topics.ROSOUT}
"""Topics on which every node speaks: what they said before the recorder came is not missed."""
TRANSFORMS = {topics.TF: qos.RELIABLE, topics.TF_STATIC: qos.LATCHED}


class Recorder(Node):
    """Collects serialised messages, and writes them in the order of their publishing."""

    def __init__(self) -> None:
        """Subscribe to everything, then open the bag.

        Raises:
            ValueError: A parameter is wrong, or the folder holds a bag already.
        """
        super().__init__("recorder", start_parameter_services=False, enable_rosout=False)
        output = self.parameter("output", "", "Folder of the bag, which must hold none yet.")
        if not output:
            raise ValueError("parameter 'output' must name the folder of the bag")
        items = self.parameter("topics", [""], "Further topics to record, each as name:type.")
        further = parse_topics(items)
        self.arrivals = self.empty_arrivals()
        self.odom = self.resolve_topic_name(topics.ODOM)
        self.derives_transforms = topics.TF not in map(self.resolve_topic_name, further)
        self.inputs: dict[str, Subscription] = {}
        self.refused: set[str] = set()
        self.first_numbers: dict[str, int] = {}
        self.lost = 0
        self.awaited_ns = sys.maxsize
        self.heard = time.monotonic()
        for name, message_type in {**CONTRACT, **installed_transforms(), **further}.items():
            qos = LATCHED_EVERYTHING if name in LATCHED else EVERYTHING
            self.listen(self.resolve_topic_name(name), message_type, qos)
        self.recording = Recording(Path(output))
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(WRITE_PERIOD, self.on_timer, clock=steady)
        self.get_logger().info(f"recording to {self.recording.folder}")

    def empty_arrivals(self) -> Arrivals:
        """Give the queue of messages that wait to be written."""
        full = self.resolve_topic_name
        return Arrivals(
            simulated=bool(self.get_parameter("use_sim_time").value),
            clock=full(topics.CLOCK),
            command=full(topics.STEERING_COMMAND),
            quantities={full(name) for name in DESCRIBING},
            latched={full(name) for name in LATCHED},
        )

    def parameter(self, name: str, default: Any, description: str) -> Any:
        """Give a parameter."""
        descriptor = ParameterDescriptor(description=description, read_only=True)
        return self.declare_parameter(name, default, descriptor).value

    def listen(self, topic: str, message_type: Any, qos: QoSProfile) -> None:
        """Subscribe to a topic."""
        events = SubscriptionEventCallbacks(
            message_lost=self.on_lost, incompatible_qos=lambda _: self.refused.add(topic)
        )
        receive = partial(self.on_message, topic)
        self.inputs[topic] = self.create_subscription(
            message_type, topic, receive, qos, raw=True, event_callbacks=events
        )

    def on_message(self, topic: str, data: bytes, info: dict[str, int]) -> None:
        """Keep a message, and all that wait behind it.

        Note:
            An executor takes one message a round; taking all more than doubles the rate at which
            nothing is lost.
        """
        subscription = self.inputs[topic]
        taken: Any = (data, info)
        while taken:
            self.keep(topic, *taken)
            taken = subscription.handle.take_message(subscription.msg_type, True)

    def keep(self, topic: str, data: bytes, info: dict[str, int]) -> None:
        """Keep a message until it is written."""
        self.first_numbers.setdefault(topic, info["publication_sequence_number"] or 1)
        arrival = Arrival(info["source_timestamp"], info["received_timestamp"], topic, data)
        self.arrivals.add(arrival)
        if arrival.publish_ns < self.awaited_ns:
            self.heard = time.monotonic()

    def on_lost(self, event: Any) -> None:
        """Count messages that the middleware dropped."""
        self.lost += event.total_count_change

    def on_timer(self) -> None:
        """Write what has waited long enough, and adapt to other publishers."""
        if topics.TF in self.inputs and self.count_publishers(topics.TF):
            self.derives_transforms = False
        self.write_all(self.arrivals.take_before(time.time_ns() - int(HOLD * NANOSECONDS)))
        for arrival in self.arrivals.take_undated():
            self.write(arrival, 0)
        self.recording.flush()
        for topic in self.refused:
            self.get_logger().warning(f"{topic}: asking for less, as a publisher offers less")
            self.listen_for_less(self.inputs[topic])
        self.refused.clear()

    def listen_for_less(self, refused: Subscription) -> None:
        """Subscribe anew, without history, or where that was too much, without reliability."""
        latched = refused.qos_profile.durability is DurabilityPolicy.TRANSIENT_LOCAL
        self.listen(refused.topic_name, refused.msg_type, EVERYTHING if latched else BEST_EFFORT)
        self.destroy_subscription(refused)

    def write_all(self, dated: Iterable[tuple[Arrival, int]]) -> None:
        """Write messages at their log times; the first one replaces what was written undated."""
        for arrival, log_time_ns in dated:
            if self.arrivals.drafted:
                self.arrivals.drafted = 0
                self.recording.begin_anew()
            self.write(arrival, log_time_ns)

    def write(self, arrival: Arrival, log_time_ns: int) -> None:
        """Write one message, the first of a topic together with its quality of service."""
        topic = arrival.topic
        if topic not in self.recording.topics:
            offers = [each.qos_profile for each in self.get_publishers_info_by_topic(topic)]
            subscription = self.inputs[topic]
            type_name = type_name_of(subscription.msg_type)
            self.recording.add_topic(topic, type_name, offers or [subscription.qos_profile])
        self.recording.write(topic, arrival.data, log_time_ns, arrival.publish_ns)
        if topic == self.odom and self.derives_transforms:
            self.write_transforms(arrival, log_time_ns)

    def write_transforms(self, odometry: Arrival, log_time_ns: int) -> None:
        """Write where the car is, for viewers that know of transforms only."""
        place = pose_transform(odometry.data)
        if place is None:
            return
        transforms = {topics.TF: place}
        if topics.TF_STATIC not in self.recording.topics:
            transforms = {topics.TF_STATIC: footprint_transform(odometry.data), topics.TF: place}
        for topic, data in transforms.items():
            if topic not in self.recording.topics:
                self.recording.add_topic(topic, TF_MESSAGE, [TRANSFORMS[topic]])
            self.recording.write(topic, data, log_time_ns, odometry.publish_ns)

    def close(self) -> None:
        """Write the rest, close the bag, and say what is in it."""
        self.write_all(self.arrivals.take_all_before(sys.maxsize))
        self.recording.close()
        bag = self.recording
        missed = sum(
            self.first_numbers[topic] - 1 for topic in self.first_numbers.keys() - SHARED_TOPICS
        )
        self.get_logger().info(
            f"recorded {bag.extent.count} messages on {len(bag.topics)} topics, "
            f"{(bag.extent.end_ns - bag.extent.start_ns) / NANOSECONDS:.1f} s, "
            f"{bag.file.stat().st_size / 1e6:.2f} MB, "
            f"{missed} missed at the start, {self.lost} lost: {bag.folder}"
        )


def installed_transforms() -> dict[str, Any]:
    """Give the topics of transforms with their type, where it is installed: not with the wheels."""
    try:
        return dict.fromkeys(TRANSFORMS, message_class(TF_MESSAGE))
    except ValueError:
        return {}


def parse_topics(items: list[str]) -> dict[str, Any]:
    """Give the message class of each topic, from items such as `imu:sensor_msgs/msg/Imu`.

    Raises:
        ValueError: An item has no type, or one that is not installed.
    """
    pairs = [item.partition(":") for item in items if item]
    return {name: message_class(type_name) for name, _, type_name in pairs}


def record(recorder: Recorder, signals: list[int]) -> None:
    """Record until a signal comes, and then until nothing is in flight."""
    executor = SingleThreadedExecutor()
    executor.add_node(recorder)
    while not signals:
        executor.spin_once(timeout_sec=0.1)
    recorder.awaited_ns = time.time_ns()
    recorder.heard = time.monotonic()
    while time.monotonic() - recorder.heard < QUIET:
        executor.spin_once(timeout_sec=0.05)
    recorder.close()


def main() -> int:
    """Run the node. Signals are handled here: rclpy would end the middleware at once."""
    signals: list[int] = []
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda number, _: signals.append(number))
    rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
    code = 2  # the set-up is wrong
    try:
        recorder, code = Recorder(), 1
        record(recorder, signals)
    except (ValueError, OSError, ParameterException) as error:
        print(f"error: {error}", file=sys.stderr)
        return code
    finally:
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
