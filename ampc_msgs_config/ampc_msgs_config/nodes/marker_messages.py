"""Shapes as messages for viewers."""

from geometry_msgs.msg import Point, Vector3
from std_msgs.msg import ColorRGBA
from visualization_msgs.msg import Marker

from ampc_msgs_config import ros
from ampc_msgs_config.config import find
from ampc_msgs_config.nodes.scene import Outline, Shape, car_of
from ampc_msgs_config.parameters import ChassisParameters, SizeParameters, SteeringParameters
from ampc_msgs_config.quaternions import quaternion_of
from ampc_msgs_config.vehicle_file import read_vehicle

MARKER_TYPES = {
    "cube": Marker.CUBE,
    "line": Marker.LINE_STRIP,
    "arrow": Marker.ARROW,
    "text": Marker.TEXT_VIEW_FACING,
}


def marker(shape: Shape, stamp_ns: int, frame_id: str = ros.MAP) -> Marker:
    """Pack a shape, without a lifetime."""
    message = Marker(ns=shape.name, id=shape.number, type=MARKER_TYPES[shape.kind], text=shape.text)
    message.header.frame_id, message.header.stamp = frame_id, ros.time_message(stamp_ns)
    message.scale = Vector3(**dict(zip("xyz", map(float, shape.size), strict=True)))
    message.color = ColorRGBA(**dict(zip("rgba", shape.colour, strict=True)))
    at, turned = message.pose.position, message.pose.orientation
    at.x, at.y, at.z = shape.position
    turned.z, turned.w = quaternion_of(shape.yaw)
    message.points = [Point(x=x, y=y, z=shape.height) for x, y in shape.points.tolist()]
    return message


def load_outline(vehicle: str, base_link_to_cg: float) -> tuple[Outline, SteeringParameters]:
    """Return the dimensions and the steering of a vehicle.

    Args:
        vehicle: Shipped vehicle, or YAML file.
        base_link_to_cg: From the point that `odom` describes forward to the centre of gravity [m];
            REAR_AXLE: the rear axle.

    Raises:
        ValueError: The file is missing or wrong.
    """
    content, user = read_vehicle(find("vehicles", vehicle)), "the picture of the car"
    chassis = content.section(ChassisParameters, "chassis", user)
    size = content.section(SizeParameters, "size", user)
    steering = content.section(SteeringParameters, "steering", user)
    return car_of(chassis, size, base_link_to_cg), steering
