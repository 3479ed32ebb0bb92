"""Node `recorder`: write every topic of the contract to a bag, and count lost messages.

It logs `recording to <folder>` when all subscriptions exist; from then on the folder contains
`metadata.yaml`. SIGINT, SIGTERM, SIGHUP and SIGQUIT end it, after all messages published before
have arrived. It ends with ERROR in /diagnostics and exit code 1 if its file cannot be written or
was removed, replaced or truncated.
"""

import sys
import time
from collections.abc import Collection, Iterable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import rclpy
from diagnostic_msgs.msg import DiagnosticArray, DiagnosticStatus
from rcl_interfaces.msg import ParameterDescriptor
from rclpy.clock import Clock, ClockType
from rclpy.duration import Duration
from rclpy.event_handler import SubscriptionEventCallbacks
from rclpy.exceptions import ParameterException
from rclpy.executors import SingleThreadedExecutor
from rclpy.node import Node
from rclpy.qos import DurabilityPolicy, HistoryPolicy, QoSProfile, ReliabilityPolicy
from rclpy.signals import SignalHandlerOptions
from rclpy.subscription import Subscription
from rosbags import interfaces

from ampc_msgs_config import topics
from ampc_msgs_config.nodes import qos
from ampc_msgs_config.nodes.failed_callbacks import FailedCallbacks, shortened
from ampc_msgs_config.nodes.live_transforms import has_other_broadcaster
from ampc_msgs_config.nodes.message_loop import take_message
from ampc_msgs_config.nodes.other_cars import is_of_another_car
from ampc_msgs_config.recording.arrivals import Arrival, Arrivals
from ampc_msgs_config.recording.bag_writer import Recording
from ampc_msgs_config.recording.message_types import TOPIC_TYPES, message_class, type_name_of
from ampc_msgs_config.recording.transforms import TF_MESSAGE, prefix_of
from ampc_msgs_config.signals import handle_ending_signals
from ampc_msgs_config.types import NANOSECONDS

if TYPE_CHECKING:
    from ampc_msgs_config.nodes.derived_topics import DerivedTopics

WRITE_PERIOD = 0.3
"""Wall time between two batches [s]."""
TAKE_PERIOD = 0.05
"""Wall time between two looks at the queues of all topics [s]. Waiting for each message would build
the wait set of 30 topics anew for each one, at many times the processor time."""
CALLBACKS = 4
"""Largest number of callbacks (timer, events) that run in a batch."""
HOLD = 0.2
"""Wall time for which a message waits for others that were published before it [s]."""
LAST_LOOKS, LAST_PERIOD = 15, 0.02
"""Looks at the queues in a row that find nothing, after which no message is in flight; and wall
time between them [s]. A machine without time for us delivers late, and looks late, too."""
DELIVERY = 0.5
"""Longest wall time in which the subscribers confirm the last message [s]."""
KEEP_ALL: dict[str, Any] = {"depth": 0, "history": HistoryPolicy.KEEP_ALL}
EVERYTHING = QoSProfile(**KEEP_ALL, reliability=ReliabilityPolicy.RELIABLE)
"""Request of a recorder."""
LATCHED_EVERYTHING = QoSProfile(
    **KEEP_ALL,
    reliability=ReliabilityPolicy.RELIABLE,
    durability=DurabilityPolicy.TRANSIENT_LOCAL,
)
"""The same for topics whose last message a late subscriber receives, too."""
BEST_EFFORT = QoSProfile(**KEEP_ALL, reliability=ReliabilityPolicy.BEST_EFFORT)
"""The same for publishers that offer less, such as a sensor of a car."""
CONTRACT: dict[str, Any] = {
    name: message_class(type_)
    for name, type_ in TOPIC_TYPES.items()
    if name not in (topics.MARKERS, *topics.QUANTITIES)
}
"""Without topics that are derived instead: markers would be three quarters of a bag, and the debug
topics have the quantities of `controller/tick`."""
LATCHED_TOPICS = {
    topics.REFERENCE_PATH,
    topics.STOP_REQUEST,
    topics.GATE_STATE,
    topics.MEMORY,
    topics.TF_STATIC,
    *topics.CONFIGURATIONS,
}
DESCRIBING = (*topics.QUANTITIES, topics.PREDICTED_PATH, topics.TICK)
"""Topics with which the controller describes its last command."""
SHARED_TOPICS = {topics.PARAMETER_EVENTS, topics.ROSOUT}
"""Topics of all nodes: messages from before the start of the recorder do not count as missed."""
TRANSFORMS = (topics.TF, topics.TF_STATIC)
"""Topics that are derived from odometry, unless a node other than `markers` publishes `/tf`."""


class Recorder(Node):
    """Collects serialised messages, and writes them in the order of their publishing."""

    def __init__(self) -> None:
        """Subscribe to everything, then open the bag.

        Raises:
            ValueError: A parameter is wrong, or the folder contains a bag.
        """
        super().__init__("recorder", start_parameter_services=False, enable_rosout=False)
        output = self.parameter("output", "", "Folder of the bag, which must not contain one.")
        if not output:
            raise ValueError("parameter 'output' must name the folder of the bag")
        items = self.parameter("topics", [""], "Further topics to record, each as name:type.")
        further = parse_topics(items)
        full = partial(self.resolve_topic_name, only_expand=True)  # a bag has the contract's names
        self.arrivals = Arrivals(
            simulated=bool(self.get_parameter("use_sim_time").value),
            clock=full(topics.CLOCK),
            command=full(topics.STEERING_COMMAND),
            quantities={full(name) for name in DESCRIBING},
            latched={full(name) for name in LATCHED_TOPICS},
        )
        self.relative = {full(name): name for name in CONTRACT}
        self.derived = self.load_derived(further)
        self.inputs: dict[str, Subscription] = {}
        self.incompatible: set[str] = set()
        self.first_numbers: dict[str, int] = {}
        self.lost = 0
        self.failed = FailedCallbacks(self.get_logger())
        self.fault: OSError | ValueError | None = None
        self.end_ns = sys.maxsize
        self.last_arrival = time.monotonic()
        self.taken_ns = 0
        """Wall time before which every received message is in the queue of `arrivals` [ns]."""
        for name, message_type in {**CONTRACT, **installed_transforms(), **further}.items():
            wanted = LATCHED_EVERYTHING if name in LATCHED_TOPICS else EVERYTHING
            self.subscribe(full(name), message_type, wanted)
        self.diagnostics = self.create_publisher(DiagnosticArray, topics.DIAGNOSTICS, qos.RELIABLE)
        self.recording = Recording(Path(output))
        steady = Clock(clock_type=ClockType.STEADY_TIME)
        self.create_timer(WRITE_PERIOD, self.on_timer, clock=steady)
        self.get_logger().info(f"recording to {self.recording.folder}")

    def load_derived(self, further: Collection[str]) -> "DerivedTopics":
        """Return the source of transforms and pictures, without those that are recorded.

        Raises:
            ValueError: The vehicle is missing or wrong.
        """
        # Loads msgspec, while the other nodes start.
        from ampc_msgs_config.nodes.derived_topics import DerivedTopics

        vehicle = self.parameter("vehicle", "paper", "Shipped vehicle, or YAML file, to draw.")
        text = "Distance from odom to the centre of gravity [m]; -1: rear axle."
        to_cg = self.parameter("base_link_to_cg", -1.0, text)
        text = "Prefix of the car's frames, such as car1/; empty: the namespace."
        prefix = prefix_of(self.parameter("frame_prefix", "", text), self.get_namespace())
        full = partial(self.resolve_topic_name, only_expand=True)
        recorded = set(map(full, further))
        transforms, pictures = (full(n) not in recorded for n in (topics.TF, topics.MARKERS))
        debug = [name for name in topics.QUANTITIES if full(name) in recorded]
        return DerivedTopics(
            vehicle, to_cg, prefix, transforms=transforms, pictures=pictures, recorded=debug
        )

    def parameter(self, name: str, default: Any, description: str) -> Any:
        """Declare a parameter and return its value."""
        descriptor = ParameterDescriptor(description=description, read_only=True)
        return self.declare_parameter(name, default, descriptor).value

    def subscribe(self, topic: str, message_type: Any, qos: QoSProfile) -> None:
        """Subscribe to a topic."""
        events = SubscriptionEventCallbacks(
            message_lost=self.on_lost, incompatible_qos=lambda _: self.incompatible.add(topic)
        )
        receive = partial(self.on_message, topic)
        self.inputs[topic] = self.create_subscription(
            message_type, topic, receive, qos, raw=True, event_callbacks=events
        )

    def on_message(self, topic: str, data: bytes, info: dict[str, int]) -> None:
        """Queue a message, and all that wait behind it.

        Note:
            An executor takes one message a round. Taking all of them more than doubles the rate
            without losses.
        """
        taken: tuple[bytes, dict[str, int]] | None = (data, info)
        while taken:
            data, info = taken
            if not is_of_another_car(topic, data, self.get_namespace()):
                self.first_numbers.setdefault(topic, info["publication_sequence_number"] or 1)
                arrival = Arrival(info["source_timestamp"], info["received_timestamp"], topic, data)
                self.arrivals.waiting.append(arrival)
                if arrival.publish_ns < self.end_ns:
                    self.last_arrival = time.monotonic()
            taken = take_message(self.inputs[topic])

    def take_arrived(self) -> None:
        """Queue all messages that have arrived.

        Note:
            Messages received during this may miss it, while later ones on the next topic do not.
        """
        begin_ns = time.time_ns()
        for topic, subscription in list(self.inputs.items()):
            if taken := take_message(subscription):
                self.on_message(topic, *taken)
        self.taken_ns = begin_ns

    def on_lost(self, event: Any) -> None:
        """Count messages that the middleware dropped."""
        self.lost += event.total_count_change

    def on_timer(self) -> None:
        """Write messages that have waited long enough; the recording ends if that fails."""
        try:
            self.write_waiting()
        except (OSError, ValueError) as error:
            self.fault = error

    def write_waiting(self) -> None:
        """Write messages that have waited long enough, and adapt to publishers that offer less.

        Raises:
            OSError: The file cannot be written.
            ValueError: The same, or the file was removed, replaced or truncated.
        """
        if topics.TF in self.inputs and has_other_broadcaster(self):
            self.derived.has_transforms = False
        self.write_all(self.arrivals.take_before(self.taken_ns - int(HOLD * NANOSECONDS)))
        for arrival in self.arrivals.take_undated():
            self.write(arrival, 0)
        self.recording.flush()
        for topic in self.incompatible:
            self.get_logger().warning(
                f"{topic}: subscribing with lower QoS, because a publisher offers less"
            )
            # without durability, or if that is too much, without reliability
            old = self.inputs[topic]
            latched = old.qos_profile.durability is DurabilityPolicy.TRANSIENT_LOCAL
            self.subscribe(topic, old.msg_type, EVERYTHING if latched else BEST_EFFORT)
            self.destroy_subscription(old)
        self.incompatible.clear()

    def write_all(self, dated: Iterable[tuple[Arrival, int]]) -> None:
        """Write messages at their log times; the first one replaces those without a log time."""
        for arrival, log_time_ns in dated:
            if self.arrivals.undated:
                self.arrivals.undated = 0
                self.recording.begin_anew()
                self.derived.begin()
            self.write(arrival, log_time_ns)

    def write(self, arrival: Arrival, log_time_ns: int) -> None:
        """Write one message; the first of a topic adds the topic with its quality of service."""
        topic = arrival.topic
        if topic in TRANSFORMS and self.derived.has_transforms:
            return  # of our own node `markers`: the derived ones have every state
        if topic not in self.recording.topics:
            offers = [each.qos_profile for each in self.get_publishers_info_by_topic(topic)]
            own = self.inputs[topic]
            profiles = [plain_qos(profile) for profile in offers or [own.qos_profile]]
            self.recording.add_topic(topic, type_name_of(own.msg_type), profiles)
        self.recording.write(topic, arrival.data, log_time_ns, arrival.publish_ns)
        for derived in self.derived.of(self.relative.get(topic, topic), arrival.data):
            name = self.resolve_topic_name(derived.topic, only_expand=True)
            if name not in self.recording.topics:
                self.recording.add_topic(name, derived.type_name, [plain_qos(derived.profile)])
            self.recording.write(name, derived.data, log_time_ns, arrival.publish_ns)

    def report_failure(self, fault: str) -> None:
        """Publish an ERROR in /diagnostics: the recording has ended."""
        name = self.get_fully_qualified_name()
        status = DiagnosticStatus(level=DiagnosticStatus.ERROR, name=name, message=fault)
        message = DiagnosticArray(status=[status])
        message.header.stamp = self.get_clock().now().to_msg()
        self.diagnostics.publish(message)
        self.diagnostics.wait_for_all_acked(Duration(seconds=DELIVERY))

    def close(self) -> None:
        """Write the remaining messages, close the bag, and log its size."""
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
    """Return the topics of transforms with their type, if it is installed; the wheels lack it."""
    try:
        return dict.fromkeys(TRANSFORMS, message_class(TF_MESSAGE))
    except ValueError:
        return {}


def parse_topics(items: list[str]) -> dict[str, Any]:
    """Return the message class of each topic, from items such as `imu:sensor_msgs/msg/Imu`.

    Raises:
        ValueError: An item has no type, or one that is not installed.
    """
    pairs = [item.partition(":") for item in items if item]
    return {name: message_class(type_name) for name, _, type_name in pairs}


def plain_qos(profile: QoSProfile) -> interfaces.Qos:
    """Return a quality of service as plain data; the enumerations have the same numbers."""
    durations = (profile.deadline, profile.lifespan, profile.liveliness_lease_duration)
    deadline, lifespan, lease = (
        interfaces.QosTime(*divmod(each.nanoseconds, NANOSECONDS)) for each in durations
    )
    return interfaces.Qos(
        interfaces.QosHistory(profile.history),
        profile.depth,
        interfaces.QosReliability(profile.reliability),
        interfaces.QosDurability(profile.durability),
        deadline,
        lifespan,
        interfaces.QosLiveliness(profile.liveliness),
        lease,
        profile.avoid_ros_namespace_conventions,
    )


def record(recorder: Recorder, signals: list[int]) -> None:
    """Record until a signal arrives, and then until no message is in flight.

    Raises:
        OSError: The file cannot be written.
        ValueError: The same, or the file was removed, replaced or truncated.
    """
    executor = SingleThreadedExecutor()
    executor.add_node(recorder)
    batch = time.monotonic()
    while not signals and not recorder.fault:
        time.sleep(TAKE_PERIOD)
        take_safely(recorder)
        if time.monotonic() - batch >= WRITE_PERIOD:
            batch = time.monotonic()
            for _ in range(CALLBACKS):
                recorder.failed.run_next(executor, timeout=0.0)
    recorder.end_ns = time.time_ns()
    looks, last = 0, recorder.last_arrival
    while looks < LAST_LOOKS and not recorder.fault:
        time.sleep(LAST_PERIOD)
        take_safely(recorder)
        recorder.failed.run_next(executor, timeout=0.0)
        looks = looks + 1 if recorder.last_arrival == last else 0
        last = recorder.last_arrival
    if recorder.fault:
        raise recorder.fault
    recorder.close()


def take_safely(recorder: Recorder) -> None:
    """Queue all messages that have arrived; a failure is counted and logged."""
    try:
        recorder.take_arrived()
    except Exception as error:  # of the middleware, or of a message
        recorder.failed.store(error)


def main() -> int:
    """Run the node. Own signal handlers: those of rclpy shut the middleware down at once."""
    signals: list[int] = []
    handle_ending_signals(lambda number, _: signals.append(number))
    recorder = None
    try:
        rclpy.init(signal_handler_options=SignalHandlerOptions.NO)
        recorder = Recorder()
        record(recorder, signals)
    except (ValueError, OSError, RuntimeError, ParameterException) as error:
        print(f"error: {shortened(str(error))}", file=sys.stderr, flush=True)
        if recorder is None:
            return 2  # wrong parameters
        recorder.report_failure(str(error))
        return 1
    finally:
        rclpy.try_shutdown()
    return 0


if __name__ == "__main__":
    sys.exit(main())
